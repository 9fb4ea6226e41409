"""Scale factors of the brake's objects, computed when an object is written, not in the cycle."""

from __future__ import annotations

import math

from coulombus.node.profile import Objects
from coulombus.node.record import NodeRecord

__all__ = ["AUTO_ZERO", "SCALED", "auto_zero", "scale"]

AUTO_ZERO = 0x6F72657A
"""Signature for 6125h: "zero", little endian."""

_OUTPUT, _INPUTS = range(0x7320, 0x7324), (0x6112, 0x6124, 0x6126, 0x6127, 0x6132, 0x7148, 0x7149)
SCALED = frozenset((0x2010, 0x2011, 0x2012, 0x6302, *_OUTPUT, *_INPUTS))
"""Objects from which scale factors are computed."""


def _decimals(digits: int) -> float:
    """Return 10 ** `digits`, limited to the range of a float."""
    return 10.0 ** min(max(digits, -30), 30)


def _scale_output(record: NodeRecord, objects: Objects) -> None:
    """Scale the output block: field value by the line through (7320h, 7321h) and (7322h, 7323h); 1000
    is full scale.
    """
    number = objects.number
    unit_Nm = _decimals(-number(0x6302, 1))
    full = max(int(record["setpoint_high"]), 1)
    pv_1, fv_1, pv_2, fv_2 = (
        number(index, 1, default) for index, default in ((0x7320, 0), (0x7321, 0), (0x7322, full), (0x7323, 1000))
    )
    if ((pv_1, fv_1, fv_2) == (0, 0, 1000) and pv_2 == full) or pv_1 == pv_2:
        slope = 1.0  # exactly; also for a file whose two points are equal
    else:
        slope = (fv_2 - fv_1) / (pv_2 - pv_1) * full / 1000
    record["ao_gain_Nm"] = unit_Nm * slope
    record["ao_bias_Nm"] = fv_1 / 1000 * full * unit_Nm - pv_1 * slope * unit_Nm
    record["ao_full_Nm"] = full * unit_Nm
    record["ao_FV_Nm"] = 1000 / (full * unit_Nm)


def _scale_inputs(record: NodeRecord, objects: Objects) -> None:
    """Scale the input blocks (6124h, 6126h, 6127h, 6132h, 7148h, 7149h); a channel disabled by 6112h accepts
    nothing.
    """
    for k in range(3):
        unit = _decimals(objects.number(0x6132, k + 1))
        offset = objects.real(0x6127, k + 1, 0.0) + objects.real(0x6124, k + 1, 0.0)
        record["ai_gain"][k] = objects.real(0x6126, k + 1, 1.0) * unit
        record["ai_bias"][k] = offset * unit
        on = objects.number(0x6112, k + 1, 1)
        record["ai_low"][k] = objects.number(0x7148, k + 1, -32768) if on else math.inf
        record["ai_high"][k] = objects.number(0x7149, k + 1, 32767) if on else -math.inf


def scale(record: NodeRecord, objects: Objects) -> None:
    """Scale the blocks, and update the driver's checks from 2010h, 2011h and 2012h."""
    own = objects.own
    _scale_output(record, objects)
    _scale_inputs(record, objects)
    record["max_A"], record["short_A"] = own(0x2010, 1, 1500) / 1000, own(0x2010, 2, 3000) / 1000
    record["least_A"], record["open_ns"] = own(0x2010, 3, 50) / 1000, own(0x2010, 4, 50_000) * 1000
    warm, hot = own(0x2011, 1, 900) / 10, own(0x2011, 2, 1100) / 10
    record["warm_degC"], record["hot_degC"] = min(warm, hot), hot
    record["cooled_degC"], record["share_left"] = hot - own(0x2011, 3, 100) / 10, own(0x2011, 4, 50) / 100
    coil_A_Nm, board_Nm = float(record["coil_A_Nm"]), float(record["board_Nm"])
    limit_Nm = record["max_A"] / coil_A_Nm if coil_A_Nm > 0 else math.inf
    record["limit_Nm"] = min(limit_Nm, board_Nm) if board_Nm > 0 else limit_Nm
    record["derated"] = 1  # recompute with the present temperature
    record["demag_A"], record["demag_ns"] = own(0x2012, 1, 0) / 1000, own(0x2012, 2, 5000) * 1000
    record["demag_delay_ns"] = own(0x2012, 3, 20_000) * 1000


def auto_zero(record: NodeRecord, objects: Objects, channel: int) -> None:
    """Set 6124h so that the input `channel` (from 1) shows 0 now (6125h)."""
    value = (record["in_handle_Nm"], record["in_coil_A"], record["in_coil_degC"])[channel - 1]
    gain, offset = objects.real(0x6126, channel, 1.0), objects.real(0x6127, channel, 0.0)
    objects[0x6124, channel] = -(float(value) * gain + offset)
