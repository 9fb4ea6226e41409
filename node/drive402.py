"""The motor drive of CiA 402 (IEC 61800-7-201/301), compiled: power state machine, torque modes, statusword.

The torque that acts is

    demand = clip(6071h + 60B2h, -limit, limit)            in CST (mode 10)
    d demand / dt = +- 6087h until demand = clip(6071h)    in profile torque (mode 4)
    limit = min(6072h, 60E0h or 60E1h by sign)

in per mille of the rated torque, and 0 in every state but Operation Enabled, without supply, and while the set-point is
older than 2001h. The fault reaction and every way out of Operation Enabled are "torque 0 at once": a hand is on the
handle. So FAULT REACTION ACTIVE (transition 14) is passed within one step.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from eds import cia402
from eds.cia402 import COMMAND_OF_CONTROLWORD, NEXT_STATE
from eds.cia402 import STATUSWORD as STATUSWORD_OF_STATE
from eds.compiled import kernel
from node import emcy, slots

__all__ = [
    "MODES",
    "connection_lost",
    "fault",
    "new_controlword",
    "new_setpoint",
    "next_deadline",
    "sample",
    "start",
    "step",
]


MODES = (0, cia402.OPERATION_MODE_PROFILE_TORQUE, cia402.OPERATION_MODE_CST)
"""What 6060h may hold."""

_PROFILE, _CST = cia402.OPERATION_MODE_PROFILE_TORQUE, cia402.OPERATION_MODE_CST
_DISABLED = int(cia402.PowerState.SWITCH_ON_DISABLED)
_SWITCHED_ON = int(cia402.PowerState.SWITCHED_ON)
_ENABLED = int(cia402.PowerState.OPERATION_ENABLED)
_QUICK_STOP = int(cia402.PowerState.QUICK_STOP_ACTIVE)
_FAULT = int(cia402.PowerState.FAULT)
_FAULT_RESET = int(cia402.Command.FAULT_RESET)
_STOPPED = 4

_HALT = 0x0100
_WARNING, _REMOTE, _TARGET_REACHED, _LIMIT, _FOLLOWS = 0x0080, 0x0200, 0x0400, 0x0800, 0x1000

# 6007h, abort connection option code, when NMT leaves OPERATIONAL by command: the state that follows (-1: no action).
# Option 1, "fault signal", is for a connection that breaks; what the master commands is no malfunction.
_ABORT_STATE = np.array([-1, _DISABLED, _DISABLED, _QUICK_STOP], np.int64)


@kernel
def start(n: Any, t_ns: int) -> None:
    """Enter Switch On Disabled (transitions 0 and 1): after power-on and reset node."""
    n.power_state = _DISABLED
    n.controlword = 0
    n.setpoint_armed = 0
    n.setpoint_stale = 0
    n.torque_demand_pm = 0.0
    n.demand_ns = t_ns
    n.limited = 0
    n.ramping = 0
    n.out_torque_pm = 0.0


@kernel
def _leave_enabled(n: Any, state: int) -> None:
    n.power_state = state
    n.torque_demand_pm = 0.0
    n.out_torque_pm = 0.0
    n.values[slots.TORQUE_DEMAND] = 0


@kernel
def fault(n: Any) -> None:
    """Transitions 13 and 14: torque 0 and FAULT; what was commanded before acts no more."""
    n.setpoint_stale = 1
    _leave_enabled(n, _FAULT)


@kernel
def needs_supply(n: Any) -> bool:
    """Whether the high-level power is switched on, so that its loss is a fault."""
    return bool(_SWITCHED_ON <= n.power_state <= _QUICK_STOP)


@kernel
def connection_lost(n: Any, forced: int) -> None:
    """NMT leaves OPERATIONAL: 6007h decides unless `forced`; a drive that is not enabled stays where it is."""
    n.setpoint_armed = 0
    if forced or n.values[slots.ABORT_OPTION] != 0:
        n.setpoint_stale = 1
    if n.power_state != _ENABLED and n.power_state != _QUICK_STOP:
        return
    if forced:
        _leave_enabled(n, _DISABLED)
        return
    option = n.values[slots.ABORT_OPTION]
    state = _ABORT_STATE[option] if 0 <= option < _ABORT_STATE.shape[0] else _DISABLED
    if state == -1:
        return
    _leave_enabled(n, state)
    if state == _QUICK_STOP and n.values[slots.QUICK_STOP_OPTION] < 5:
        n.power_state = _DISABLED


@kernel
def new_controlword(n: Any, i: int, t_ns: int, queue: Any, header: Any) -> None:
    """Act on the controlword that was written: one transition of the table at most."""
    word = n.values[slots.CONTROLWORD]
    rising = word & 0x80 and not n.controlword & 0x80
    n.controlword = word
    state = n.power_state
    if state == _FAULT:
        if rising and n.causes & emcy.FAULT_MASK == 0:
            n.power_state = NEXT_STATE[state, _FAULT_RESET]
            if n.latched & emcy.FAULT_MASK:
                emcy.clear_latches(n, i, t_ns, emcy.FAULT_MASK, queue, header)
        return
    following = NEXT_STATE[state, COMMAND_OF_CONTROLWORD[word & 0xF]]
    if following == state:
        return
    if n.in_supply_ok == 0 and (following == _ENABLED or (following == _SWITCHED_ON and state < following)):
        return  # no high-level power: the drive cannot be switched on
    if state == _ENABLED:
        _leave_enabled(n, following)
    n.power_state = following
    if following == _QUICK_STOP and n.values[slots.QUICK_STOP_OPTION] < 5:
        n.power_state = _DISABLED  # transition 12: torque is 0 at once, so the quick stop is complete
    n.demand_ns = t_ns


@kernel
def _highest(n: Any) -> int:
    highest: int = min(n.values[slots.MAX_TORQUE], n.values[slots.POSITIVE_LIMIT])
    return highest


@kernel
def _lowest(n: Any) -> int:
    lowest: int = -min(n.values[slots.MAX_TORQUE], n.values[slots.NEGATIVE_LIMIT])
    return lowest


@kernel
def new_setpoint(n: Any, t_ns: int) -> None:
    """Take the set-point in 6071h that was received at `t_ns`."""
    n.setpoint_ns = t_ns
    n.setpoint_armed = 1
    n.setpoint_stale = 0
    target = n.values[slots.TARGET_TORQUE]
    if target > _highest(n) or target < _lowest(n):
        n.clipped_setpoints += 1


@kernel
def step(n: Any, t_ns: int) -> None:
    """Compute the torque that acts at `t_ns`."""
    values = n.values
    mode = values[slots.MODE]
    values[slots.MODE_DISPLAY] = mode
    age_ns = values[slots.SETPOINT_AGE_US] * 1000
    if n.setpoint_armed and age_ns > 0 and t_ns - n.setpoint_ns >= age_ns:
        n.setpoint_stale = 1
    elapsed_ns = t_ns - n.demand_ns
    n.demand_ns = t_ns
    high, low = _highest(n), _lowest(n)
    target = values[slots.TARGET_TORQUE]
    if mode == _CST:
        target += values[slots.TORQUE_OFFSET]
    n.limited = 1 if target > high or target < low else 0
    target = min(max(target, low), high)
    demand = 0.0
    n.ramping = 0
    if n.power_state == _ENABLED and n.in_supply_ok and not n.setpoint_stale:
        if n.controlword & _HALT:
            target = 0
        if mode == _CST:
            demand = float(target)
        elif mode == _PROFILE:
            change = values[slots.TORQUE_SLOPE] * 1e-9 * elapsed_ns
            present = n.torque_demand_pm
            demand = min(present + change, target) if target >= present else max(present - change, target)
            n.ramping = 1 if demand != target else 0
            demand = min(max(demand, low), high)  # a limit lowered by SDO acts at once, not by the slope
    n.torque_demand_pm = demand
    n.out_torque_pm = demand
    values[slots.TORQUE_DEMAND] = math.floor(demand + 0.5)


@kernel
def _to_int32(value: float) -> int:
    if not value > -2147483648.0:
        return -2147483648
    if value > 2147483647.0:
        return 2147483647
    return math.floor(value + 0.5)


@kernel
def sample(n: Any) -> None:
    """Write actual position, velocity, torque and the statusword to their slots."""
    values = n.values
    values[slots.POSITION] = (
        (n.in_position_counts + 0x80000000) & 0xFFFFFFFF
    ) - 0x80000000  # wraps as the counter does
    values[slots.VELOCITY] = _to_int32(n.in_velocity_counts_s)
    values[slots.DC_LINK_MV] = n.supply_mV if n.in_supply_ok else 0
    values[slots.TORQUE_ACTUAL] = min(max(_to_int32(n.in_torque_pm), -32768), 32767)
    values[slots.CURRENT_ACTUAL] = values[slots.TORQUE_ACTUAL]  # per mille of rated current: a DC motor's torque
    word = STATUSWORD_OF_STATE[n.power_state]
    if n.in_supply_ok:
        word |= cia402.VOLTAGE_ENABLED
    if n.latched & ~emcy.FAULT_MASK:
        word |= _WARNING
    if n.nmt != _STOPPED:
        word |= _REMOTE
    if n.limited:
        word |= _LIMIT
    if n.power_state == _ENABLED and not n.setpoint_stale:
        if values[slots.MODE] == _CST:
            word |= _FOLLOWS
        elif n.torque_demand_pm == values[slots.TARGET_TORQUE]:
            word |= _TARGET_REACHED
    values[slots.STATUSWORD] = word


@kernel
def next_deadline(n: Any, next_ns: int) -> int:
    """Return the earlier of `next_ns` and the drive's own next deadline."""
    age_ns = n.values[slots.SETPOINT_AGE_US] * 1000
    if n.setpoint_armed and age_ns > 0 and not n.setpoint_stale:
        next_ns = min(next_ns, n.setpoint_ns + age_ns)
    return next_ns
