"""Compiled driver of the MR brake as a CiA 404 device: one analogue output block, three input blocks.

Output: the set-point 7300h:01 * 10 ** -6302h:01 in Nm, through the scale 7320h to 7323h (by default
1), limited by the coil's current (`node.coil404`). The channel is unsigned: a negative set-point
acts as 0 and is counted, a set-point above the EDS's high limit is clipped and counted. Without a
new set-point for 2001h microseconds the output ramps linearly within 2005h microseconds to the
fault value 7341h:01, if the fault mode 6340h:01 is 1; a new set-point ends the ramp. A device fault
starts the same ramp to 0, a short circuit sets 0 at once.

Inputs: 7130h = saturate_int16((in * 6126h + 6127h + 6124h) * 10 ** 6132h): handle torque, coil
current, coil temperature. Their status 6150h: bit 0 not valid (channel off, no number), bit 1 above
7149h, bit 2 below 7148h.

The scale factors are computed when an object is written, not in the cycle.

In the kernels: `n` the node's record (`node.record`), `k` a number
from 0, `out` the queue of frames to send.
"""

from __future__ import annotations

import math

from coulombus.eds.cia301 import Abort
from coulombus.eds.codec import nearest_integer
from coulombus.eds.own_devices import PRODUCTS
from coulombus.eds.values import LARGEST_REAL32
from coulombus.kernels.decorator import constant, kernel
from coulombus.node import coil404, emcy, slots, slots404
from coulombus.node.profile import BY_ITSELF, BY_RESET, Behaviour, Objects, Profile, SdoAbort
from coulombus.node.record import BrakeFields, NodeRecord
from coulombus.wire.frame import Queue

__all__ = ["BRAKE404", "actuate", "connection_lost", "cut", "new_setpoint", "next_deadline", "sample", "start"]

_AUTO_ZERO = 0x6F72657A
"""Signature for 6125h: "zero", little endian."""

_OUTPUT, _INPUTS = range(0x7320, 0x7324), (0x6112, 0x6124, 0x6126, 0x6127, 0x6132, 0x7148, 0x7149)
_SCALED = frozenset((0x2010, 0x2011, 0x2012, 0x6302, *_OUTPUT, *_INPUTS))
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


def _scale(record: NodeRecord, objects: Objects) -> None:
    """Scale the blocks, and update the driver's checks from 2010h, 2011h and 2012h."""
    own_number = objects.own_number
    _scale_output(record, objects)
    _scale_inputs(record, objects)
    record["max_A"], record["short_A"] = own_number(0x2010, 1, 1500) / 1000, own_number(0x2010, 2, 3000) / 1000
    record["least_A"], record["open_ns"] = own_number(0x2010, 3, 50) / 1000, own_number(0x2010, 4, 50_000) * 1000
    warm, hot = own_number(0x2011, 1, 900) / 10, own_number(0x2011, 2, 1100) / 10
    record["warm_degC"], record["hot_degC"] = min(warm, hot), hot
    record["cooled_degC"], record["share_left"] = hot - own_number(0x2011, 3, 100) / 10, own_number(0x2011, 4, 50) / 100
    coil_A_Nm, board_Nm = float(record["coil_A_Nm"]), float(record["board_Nm"])
    limit_Nm = record["max_A"] / coil_A_Nm if coil_A_Nm > 0 else math.inf
    record["limit_Nm"] = min(limit_Nm, board_Nm) if board_Nm > 0 else limit_Nm
    record["derated"] = 1  # recompute with the present temperature
    record["demag_A"], record["demag_ns"] = own_number(0x2012, 1, 0) / 1000, own_number(0x2012, 2, 5000) * 1000
    record["demag_delay_ns"] = own_number(0x2012, 3, 20_000) * 1000


def _auto_zero(record: NodeRecord, objects: Objects, channel: int) -> None:
    """Set 6124h so that the input `channel` (from 1) shows 0 now (6125h)."""
    value = (record["in_handle_Nm"], record["in_coil_A"], record["in_coil_degC"])[channel - 1]
    gain, offset = objects.real(0x6126, channel, 1.0), objects.real(0x6127, channel, 0.0)
    objects[0x6124, channel] = min(max(-(float(value) * gain + offset), -LARGEST_REAL32), LARGEST_REAL32)


_NO, _YES = constant(0), constant(1)


@kernel
def start(n: NodeRecord, t_ns: int) -> None:
    """Reset to output 0 without a set-point: after power-on."""
    n.setpoint_armed = 0
    n.ramping = 2
    n.ramp_from_Nm = 0.0
    n.ramp_to_Nm = 0.0
    n.ramp_start_ns = t_ns
    n.out_brake_Nm = 0.0
    coil404.start(n)


@kernel
def _torque(n: NodeRecord, raw: int) -> float:
    """Return the torque [Nm] of a value of 7300h, at most full scale; the caller applies the coil's limit."""
    torque: float = min(max(max(raw, 0) * n.ao_gain_Nm + n.ao_bias_Nm, 0.0), n.ao_full_Nm)
    return torque


@kernel
def _begin_ramp(n: NodeRecord, t_ns: int) -> None:
    """Begin the ramp from the present output: to the fault value, or to 0 for a device fault."""
    n.ramp_from_Nm = n.out_brake_Nm
    n.ramp_to_Nm = 0.0 if n.causes & emcy.DEVICE_MASK else _torque(n, n.values[slots404.FAULT_VALUE])
    n.ramp_start_ns = t_ns
    n.ramping = 1


@kernel
def cut(n: NodeRecord) -> None:
    """Set the output to 0 at once."""
    n.ramping = 2
    n.ramp_to_Nm = 0.0
    n.out_brake_Nm = 0.0


@kernel
def new_setpoint(n: NodeRecord, t_ns: int) -> None:
    """Apply the set-point in 7300h:01 that was received at `t_ns`; the slot then shows the effective value."""
    raw = n.values[slots404.SETPOINT]
    if raw < 0:
        n.negative_setpoints += 1
        raw = 0
    elif raw > n.setpoint_high:
        n.clipped_setpoints += 1
        raw = n.setpoint_high
    n.values[slots404.SETPOINT] = raw
    n.setpoint_ns = t_ns
    if n.setpoint_armed == 0:
        n.next_ns = min(n.next_ns, t_ns + 1)  # to schedule the check of its age
    n.setpoint_armed = 1  # also if it came by SDO: a brake without supervision is released
    if n.causes & emcy.DEVICE_MASK == 0:
        n.ramping = 0


@kernel
def connection_lost(n: NodeRecord, t_ns: int, forced: int) -> None:
    """Begin the ramp to the fault value at `t_ns`, from the present output; fault mode 0 keeps the output
    unless `forced`.
    """
    n.setpoint_armed = 0
    if not forced and n.values[slots404.FAULT_MODE] != 1:
        return
    if n.ramping == 0 or (n.causes & emcy.DEVICE_MASK and n.ramp_to_Nm > 0.0):
        actuate(n, t_ns)
        _begin_ramp(n, t_ns)
        actuate(n, t_ns)


@kernel
def host_lost(n: NodeRecord, t_ns: int) -> None:
    """Handle NMT leaving OPERATIONAL by itself (1029h): the last set-point stays until its age limit, if that
    is set.
    """
    if n.setpoint_armed == 0 or n.values[slots.SETPOINT_AGE_US] <= 0:
        connection_lost(n, t_ns, _NO)


@kernel
def actuate(n: NodeRecord, t_ns: int) -> None:
    """Compute the output at `t_ns`."""
    values = n.values
    if n.ramping == 0:
        n.out_brake_Nm = min(_torque(n, values[slots404.SETPOINT]), n.limit_Nm)
        hold_ns = values[slots.SETPOINT_AGE_US] * 1000
        expired = n.setpoint_armed and hold_ns > 0 and t_ns - n.setpoint_ns >= hold_ns
        if not expired or values[slots404.FAULT_MODE] != 1:
            return
        _begin_ramp(n, n.setpoint_ns + hold_ns)  # the ramp begins where the hold ended, whenever this is called
    if n.ramping == 1:
        ramp_ns = values[slots.RAMP_US] * 1000
        elapsed_ns = t_ns - n.ramp_start_ns
        if elapsed_ns < ramp_ns:
            output = n.ramp_from_Nm + (n.ramp_to_Nm - n.ramp_from_Nm) * max(elapsed_ns, 0) / ramp_ns
            n.out_brake_Nm = min(output, n.limit_Nm)
            return
        n.ramping = 2
    n.out_brake_Nm = min(n.ramp_to_Nm, n.limit_Nm)


@kernel
def _input(n: NodeRecord, k: int, value: float) -> None:
    scaled = value * n.ai_gain[k] + n.ai_bias[k]
    if n.ai_low[k] <= scaled <= n.ai_high[k]:
        n.values[slots404.INPUT + k] = nearest_integer(scaled, 16)
        n.values[slots404.INPUT_STATUS + k] = 0
    else:
        _odd_input(n, k, scaled)


@kernel
def _odd_input(n: NodeRecord, k: int, scaled: float) -> None:
    status = 1
    if n.ai_low[k] == math.inf:
        scaled = 0.0  # the channel is off
    elif scaled > n.ai_high[k]:
        status = 2
    elif scaled < n.ai_low[k]:
        status = 4
    n.values[slots404.INPUT + k] = nearest_integer(scaled, 16)
    n.values[slots404.INPUT_STATUS + k] = status


@kernel
def sample(n: NodeRecord) -> None:
    """Write the three input blocks, and the output's field value, to their slots."""
    for k, value in enumerate((n.in_handle_Nm, n.in_coil_A, n.in_coil_degC)):
        _input(n, k, value)
    n.values[slots404.OUTPUT_FV] = math.floor(n.out_brake_Nm * n.ao_FV_Nm + 0.5)


@kernel
def next_deadline(n: NodeRecord, t_ns: int, next_ns: int) -> int:
    """Return the earlier of `next_ns` and the brake's own next deadline."""
    if n.ramping == 1:
        next_ns = min(next_ns, n.ramp_start_ns + n.values[slots.RAMP_US] * 1000)
    hold_ns = n.values[slots.SETPOINT_AGE_US] * 1000
    if n.ramping == 0 and n.setpoint_armed and hold_ns > 0 and n.values[slots404.FAULT_MODE] == 1:
        next_ns = min(next_ns, n.setpoint_ns + hold_ns)
    return coil404.next_deadline(n, t_ns, next_ns)


@kernel
def _actuate(n: NodeRecord, t_ns: int) -> None:
    actuate(n, t_ns)
    if n.demag_A > 0.0:
        coil404.demagnetise(n, t_ns)


@kernel
def _apply(n: NodeRecord, t_ns: int, received_ns: int, carries: int, out: Queue) -> None:
    if carries & slots404.ACTS_SETPOINT:
        new_setpoint(n, received_ns)


@kernel
def _connection_lost(n: NodeRecord, t_ns: int, why: int) -> int:
    if why == BY_ITSELF:
        host_lost(n, t_ns)
    else:
        connection_lost(n, t_ns, 1 if why == BY_RESET else 0)
    return 0


@kernel
def _react(n: NodeRecord, t_ns: int, cause: int) -> None:
    """React to a fault of the driver: begin the ramp, or end the current at once for a short circuit."""
    if emcy.DEVICE_MASK >> cause & 1:
        if cause == emcy.COIL_SHORT:
            cut(n)
        else:
            connection_lost(n, t_ns, _YES)


def _started(record: NodeRecord, objects: Objects, t_ns: int) -> None:
    record["setpoint_high"] = objects.high(0x7300, 1, 32767)
    coil404.start(record)
    _scale(record, objects)


def _changed(record: NodeRecord, objects: Objects, index: int, subindex: int) -> None:
    if index == 0x6125:
        _auto_zero(record, objects, subindex)
    if index == 0x6125 or index in _SCALED:
        _scale(record, objects)


def _check(objects: Objects, index: int, subindex: int, value: int) -> None:
    """Require the signature in 6125h, and two different points of the output's scale."""
    if index == 0x6125 and value != _AUTO_ZERO:
        raise SdoAbort(Abort.VALUE)
    other = {0x7320: 0x7322, 0x7322: 0x7320}.get(index)
    if other is not None and subindex == 1 and value == objects.number(other, 1):
        raise SdoAbort(Abort.PARAMETER_INCOMPATIBLE)


BRAKE404 = Profile(
    "brake",
    objects=slots404.OBJECTS,
    fields=BrakeFields,
    terminals=slots404.TERMINALS,
    behaviour=Behaviour(
        sample=sample,
        actuate=_actuate,
        apply=_apply,
        connection_lost=_connection_lost,
        react=_react,
        detect=coil404.detect,
        next_deadline=next_deadline,
    ),
    product=PRODUCTS["brake"],
    started=_started,
    powered_on=start,
    changed=_changed,
    check=_check,
)
"""Driver of an MR brake: CiA 404, one output, three inputs."""
