"""What the cores use of an object's value in a form of their own: computed when the object is written, not in the cycle."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

from coulombus.node.dictionary import Dictionary
from coulombus.node.record import KIND_BRAKE, KIND_DRIVE, KIND_GENERIC

__all__ = ["AUTO_ZERO", "SCALES", "auto_zero", "scale"]

AUTO_ZERO = 0x6F72657A
"""What 6125h takes: "zero", little endian."""

NO_SPEED_LIMIT = 0xFFFFFFFF
_LOWEST, _HIGHEST = -0x80000000, 0x7FFFFFFF


def _decimals(digits: int) -> float:
    """Return 10 to the `digits`, of which no file may make more than a float holds."""
    return 10.0 ** min(max(digits, -30), 30)


def _scale_drive(record: Any, objects: Dictionary) -> None:
    """Largest speed (6080h in rpm by 608Fh), whether 607Dh or 6080h may limit at all, and the gains 2010h."""
    number, own = objects.number, objects.own
    rpm = number(0x6080, 0, NO_SPEED_LIMIT)
    counts_rev = number(0x608F, 1, 8192) / max(number(0x608F, 2, 1), 1)
    record["speed_max_counts_s"] = 1e18 if rpm == NO_SPEED_LIMIT else rpm * counts_rev / 60
    positions = number(0x607D, 1, _LOWEST), number(0x607D, 2, _HIGHEST)
    record["guarded"] = int(rpm != NO_SPEED_LIMIT or positions != (_LOWEST, _HIGHEST))
    record["speed_kp"] = own(0x2010, 1, 15_000) * 1e-6
    record["speed_ki"] = own(0x2010, 2, 300_000) * 1e-6


def _scale_output(record: Any, objects: Dictionary) -> None:
    """Scale the output block: field value by the line through (7320h, 7321h) and (7322h, 7323h), of which 1000 is full scale."""
    number = objects.number
    unit_Nm = _decimals(-number(0x6302, 1))
    full = max(int(record["setpoint_high"]), 1)
    pv_1, fv_1, pv_2, fv_2 = (
        number(index, 1, default) for index, default in ((0x7320, 0), (0x7321, 0), (0x7322, full), (0x7323, 1000))
    )
    if ((pv_1, fv_1, fv_2) == (0, 0, 1000) and pv_2 == full) or pv_1 == pv_2:
        slope = 1.0  # exactly; and where a file has two points that are one
    else:
        slope = (fv_2 - fv_1) / (pv_2 - pv_1) * full / 1000
    record["ao_gain_Nm"] = unit_Nm * slope
    record["ao_bias_Nm"] = fv_1 / 1000 * full * unit_Nm - pv_1 * slope * unit_Nm
    record["ao_full_Nm"] = full * unit_Nm
    record["ao_FV_Nm"] = 1000 / (full * unit_Nm)


def _scale_inputs(record: Any, objects: Dictionary) -> None:
    """Scale the input blocks (6124h, 6126h, 6127h, 6132h, 7148h, 7149h); one that 6112h switches off accepts nothing."""
    for k in range(3):
        unit = _decimals(objects.number(0x6132, k + 1))
        offset = objects.real(0x6127, k + 1, 0.0) + objects.real(0x6124, k + 1, 0.0)
        record["ai_gain"][k] = objects.real(0x6126, k + 1, 1.0) * unit
        record["ai_bias"][k] = offset * unit
        on = objects.number(0x6112, k + 1, 1)
        record["ai_low"][k] = objects.number(0x7148, k + 1, -32768) if on else math.inf
        record["ai_high"][k] = objects.number(0x7149, k + 1, 32767) if on else -math.inf


def _scale_brake(record: Any, objects: Dictionary) -> None:
    """Scale the blocks, and bring the driver's watches up to 2010h, 2011h and 2012h."""
    own = objects.own
    _scale_output(record, objects)
    _scale_inputs(record, objects)
    record["max_A"], record["short_A"] = own(0x2010, 1, 1500) / 1000, own(0x2010, 2, 3000) / 1000
    record["least_A"], record["open_ns"] = own(0x2010, 3, 50) / 1000, own(0x2010, 4, 50_000) * 1000
    warm, hot = own(0x2011, 1, 900) / 10, own(0x2011, 2, 1100) / 10
    record["warm_degC"], record["hot_degC"] = min(warm, hot), hot
    record["cooled_degC"], record["share_left"] = hot - own(0x2011, 3, 100) / 10, own(0x2011, 4, 50) / 100
    coil_A_Nm = float(record["coil_A_Nm"])
    record["limit_Nm"] = record["max_A"] / coil_A_Nm if coil_A_Nm > 0 else math.inf
    record["derated"] = 1  # computed anew with the present temperature
    record["demag_A"], record["demag_ns"] = own(0x2012, 1, 0) / 1000, own(0x2012, 2, 5000) * 1000
    record["demag_delay_ns"] = own(0x2012, 3, 20_000) * 1000


def auto_zero(record: Any, objects: Dictionary, channel: int) -> None:
    """Set 6124h so that the input `channel` (from 1) shows 0 now (6125h)."""
    value = (record["in_handle_Nm"], record["in_coil_A"], record["in_coil_degC"])[channel - 1]
    gain, offset = objects.real(0x6126, channel, 1.0), objects.real(0x6127, channel, 0.0)
    objects[0x6124, channel] = -(float(value) * gain + offset)


def _nothing(record: Any, objects: Dictionary) -> None:
    pass


SCALES: Mapping[int, tuple[frozenset[int], Callable[[Any, Dictionary], None]]] = {
    KIND_GENERIC: (frozenset(), _nothing),
    KIND_DRIVE: (frozenset((0x2010, 0x607D, 0x6080, 0x608F)), _scale_drive),
    KIND_BRAKE: (
        frozenset((0x2010, 0x2011, 0x2012, 0x6112, 0x6124, 0x6126, 0x6127, 0x6132, 0x6302, *range(0x7320, 0x7324)))
        | frozenset((0x7148, 0x7149)),
        _scale_brake,
    ),
}
"""By kind: the objects that are looked at, and the function that brings the record up to them."""


def scale(kind: int, record: Any, objects: Dictionary, index: int | None = None) -> None:
    """Bring the record up to the object `index`, None: to all of them."""
    indices, bring_up = SCALES[kind]
    if index is None or index in indices:
        bring_up(record, objects)
