"""The driver of the MR brake as a CiA 404 device, compiled: one analogue output block, three analogue input blocks.

Output: torque = 7300h:01 * 10 ** -6302h:01 in Nm. The channel is unsigned: a negative set-point is 0 and counted, one
above the EDS' high limit is clipped and counted. Without a new set-point for 2001h microseconds the output goes in a
straight line of 2005h microseconds to the fault value 7341h:01, when the fault mode 6340h:01 is 1; a new set-point ends
it.

Inputs: 7130h = saturate_int16((in * 6126h + 6127h) * 10 ** 6132h): handle torque, coil current, coil temperature.
"""

from __future__ import annotations

import math
from typing import Any

from eds.compiled import kernel
from node import emcy, slots

__all__ = ["connection_lost", "new_setpoint", "next_deadline", "sample", "start", "step"]


@kernel
def start(n: Any, t_ns: int) -> None:
    """Output 0, no set-point yet: after power-on."""
    n.setpoint_armed = 0
    n.ramping = 2
    n.ramp_from_Nm = 0.0
    n.ramp_start_ns = t_ns
    n.out_brake_Nm = 0.0


@kernel
def new_setpoint(n: Any, t_ns: int) -> None:
    """Take the set-point in 7300h:01 that was received at `t_ns`; the slot then shows what acts."""
    raw = n.values[slots.SETPOINT]
    if raw < 0:
        n.negative_setpoints += 1
        raw = 0
    elif raw > n.setpoint_high:
        n.clipped_setpoints += 1
        raw = n.setpoint_high
    n.values[slots.SETPOINT] = raw
    n.setpoint_ns = t_ns
    n.setpoint_armed = 1  # also when it came by SDO: a brake that nobody looks after lets go
    if n.causes & emcy.DEVICE_MASK == 0:
        n.ramping = 0


@kernel
def connection_lost(n: Any, t_ns: int, forced: int) -> None:
    """Begin the ramp to the fault value at `t_ns`, from the present output; fault mode 0 keeps it unless `forced`."""
    n.setpoint_armed = 0
    if n.ramping == 0 and (forced or n.values[slots.FAULT_MODE] == 1):
        step(n, t_ns)
        n.ramp_from_Nm = n.out_brake_Nm
        n.ramp_start_ns = t_ns
        n.ramping = 1
        step(n, t_ns)


@kernel
def host_lost(n: Any, t_ns: int) -> None:
    """NMT left OPERATIONAL by itself (1029h): the last set-point is still held for its time, if that is watched."""
    if n.setpoint_armed == 0 or n.values[slots.SETPOINT_AGE_US] <= 0:
        connection_lost(n, t_ns, 0)


@kernel
def step(n: Any, t_ns: int) -> None:
    """Compute the output at `t_ns`."""
    values = n.values
    if n.ramping == 0:
        n.out_brake_Nm = max(values[slots.SETPOINT], 0) * n.ao_unit_Nm
        hold_ns = values[slots.SETPOINT_AGE_US] * 1000
        expired = n.setpoint_armed and hold_ns > 0 and t_ns - n.setpoint_ns >= hold_ns
        if not expired or values[slots.FAULT_MODE] != 1:
            return
        n.ramp_from_Nm = n.out_brake_Nm
        n.ramp_start_ns = n.setpoint_ns + hold_ns  # the line begins where the hold ended, whenever this is called
        n.ramping = 1
    target = max(values[slots.FAULT_VALUE], 0) * n.ao_unit_Nm
    if n.ramping == 1:
        ramp_ns = values[slots.RAMP_US] * 1000
        elapsed_ns = t_ns - n.ramp_start_ns
        if elapsed_ns < ramp_ns:
            n.out_brake_Nm = n.ramp_from_Nm + (target - n.ramp_from_Nm) * max(elapsed_ns, 0) / ramp_ns
            return
        n.ramping = 2
        n.out_brake_Nm = target


@kernel
def _to_int16(value: float) -> int:
    if not value > -32768.0:
        return -32768
    if value > 32767.0:
        return 32767
    return math.floor(value + 0.5)


@kernel
def sample(n: Any) -> None:
    """Write the three input blocks to their slots."""
    values = n.values
    values[slots.INPUT] = _to_int16(n.in_handle_Nm * n.ai_gain[0] + n.ai_bias[0])
    values[slots.INPUT + 1] = _to_int16(n.in_coil_A * n.ai_gain[1] + n.ai_bias[1])
    values[slots.INPUT + 2] = _to_int16(n.in_coil_degC * n.ai_gain[2] + n.ai_bias[2])


@kernel
def next_deadline(n: Any, next_ns: int) -> int:
    """Return the earlier of `next_ns` and the brake's own next deadline."""
    if n.ramping == 1:
        next_ns = min(next_ns, n.ramp_start_ns + n.values[slots.RAMP_US] * 1000)
    hold_ns = n.values[slots.SETPOINT_AGE_US] * 1000
    if n.ramping == 0 and n.setpoint_armed and hold_ns > 0 and n.values[slots.FAULT_MODE] == 1:
        next_ns = min(next_ns, n.setpoint_ns + hold_ns)
    return next_ns
