"""Compiled CiA 402 motor drive (IEC 61800-7-201/301): power state machine, option codes, statusword.

`node.motion402` computes the torque. It is 0 without supply, while the set-point is older than
2001h, and in every state except Operation Enabled and a ramp that leaves it.

Transitions out of Operation Enabled, and their option codes (0: torque 0 at once; a ramp, and then
the state):

    transition          5 (605Ch)   8 (605Bh)   9         11, 12 (605Ah)       13, 14 (605Eh)   NMT (6007h)
    to                  Switched On Ready       Disabled  Quick Stop, Disabled  Reaction, Fault  as 13, 9 or 11
    option codes        0, 1        0, 1        at once   0, 1, 2, 5, 6         0, 1, 2          0, 1, 2, 3

1 and 5 are the slow-down ramp, 2 and 6 the quick stop ramp; from 5 on the drive stays in Quick Stop
Active. A fault that makes a ramp impossible (supply, encoder, power stage) sets torque 0 at once,
regardless of 605Eh.

In the kernels: `n` the node's record (`node.record`), `out` the queue of frames to send.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from coulombus.eds import cia402
from coulombus.eds.cia301 import NmtState
from coulombus.eds.cia402 import COMMAND_OF_CONTROLWORD, NEXT_STATE, Command, PowerState
from coulombus.eds.cia402 import STATUSWORD as STATUSWORD_OF_STATE
from coulombus.eds.codec import nearest_integer
from coulombus.kernels.decorator import constant, kernel
from coulombus.node import emcy, homing402, motion402, servo402, slots, slots402
from coulombus.node.record import NodeRecord
from coulombus.wire.frame import Queue

__all__ = [
    "ALL_MODES",
    "OPTION_CODES",
    "actuate",
    "connection_lost",
    "detect",
    "fault",
    "new_controlword",
    "new_setpoint",
    "next_deadline",
    "sample",
    "start",
]

OPTION_CODES: Mapping[int, tuple[int, ...]] = {
    0x6007: (0, 1, 2, 3),
    0x605A: (0, 1, 2, 5, 6),
    0x605B: (0, 1),
    0x605C: (0, 1),
    0x605D: (1, 2),
    0x605E: (0, 1, 2),
    0x6086: (0,),
    0x6098: homing402.METHODS,
    0x60C0: (0,),
}
"""Allowed option codes: the drive has no ramp at the current or the voltage limit (3, 4, 7, 8), no profile
but the trapezoid (6086h) and no interpolation but the linear (60C0h).
"""

ALL_MODES = sum(1 << (mode - 1) for mode in motion402.MODES)
"""Value of 6502h: modes that the drive supports."""

_CST, _CSP = cia402.OPERATION_MODE_CST, cia402.OPERATION_MODE_CSP
_INTERPOLATED = cia402.OPERATION_MODE_INTERPOLATED_POSITION

_HALT = 0x0100
_WARNING, _REMOTE, _TARGET_REACHED, _LIMIT, _FOLLOWS = 0x0080, 0x0200, 0x0400, 0x0800, 0x1000

_NO_ACTION, _FAULT_SIGNAL, _QUICK_STOP_COMMAND = (
    0,
    1,
    3,
)  # 6007h; 2 is "disable voltage", and so are values that are not allowed
_STAYS = 5  # 605Ah: from here on the drive stays in Quick Stop Active
_FOLLOWING_LOST = 1 << (emcy.FOLLOWING - emcy.FIRST_DEVICE_CAUSE)
_BLOCKED = 1 << (emcy.BLOCKED - emcy.FIRST_DEVICE_CAUSE)
_BLOCKED_S = 0.5  # at the torque limit at standstill
_FAULT, _OFF = constant(PowerState.FAULT), constant(PowerState.SWITCH_ON_DISABLED)
_RAMP = np.array([0, motion402.SLOW, motion402.QUICK, 0, 0, motion402.SLOW, motion402.QUICK, 0, 0], np.int64)
"""Ramp by option code; 0: at once."""


@kernel
def start(n: NodeRecord, t_ns: int) -> None:
    """Enter Switch On Disabled (transitions 0 and 1): after power-on and reset node."""
    n.power_state = PowerState.SWITCH_ON_DISABLED
    n.controlword = 0
    n.setpoint_armed = 0
    n.setpoint_stale = 0
    n.demand_ns = t_ns
    n.limited = 0
    n.homing = n.zero_counts = n.probe_function = n.values[slots402.PROBE_STATUS] = 0
    motion402.stop(n)
    n.mode = n.values[slots402.MODE_DISPLAY] = 0
    motion402.change_mode(n, t_ns)


@kernel
def _leave_enabled(n: NodeRecord, state: int) -> None:
    n.power_state = state
    motion402.stop(n)


@kernel
def _ramp(option: int) -> int:
    ramp: int = _RAMP[option] if 0 <= option < _RAMP.shape[0] else 0
    return ramp


@kernel
def _driven(n: NodeRecord) -> bool:
    """Whether torque is allowed."""
    return bool(
        n.power_state == PowerState.OPERATION_ENABLED
        or n.power_state == PowerState.QUICK_STOP_ACTIVE
        or n.power_state == PowerState.FAULT_REACTION_ACTIVE
    )


@kernel
def fault(n: NodeRecord, t_ns: int, at_once: int) -> None:
    """Transitions 13 and 14: the fault reaction and FAULT.

    Earlier commands have no effect any more.
    """
    n.setpoint_stale = 1
    ramp = _ramp(n.values[slots402.FAULT_OPTION])
    if at_once or ramp == 0 or not _driven(n):
        _leave_enabled(n, _FAULT)
    elif n.power_state != PowerState.FAULT_REACTION_ACTIVE:
        n.power_state = PowerState.FAULT_REACTION_ACTIVE
        motion402.begin(n, t_ns, ramp, _FAULT)


@kernel
def detect(n: NodeRecord, t_ns: int) -> None:
    """Detect a following error and a blocked motor."""
    n.detected &= ~(_FOLLOWING_LOST | _BLOCKED)
    if n.following_lost:
        n.detected |= _FOLLOWING_LOST
    if n.stalled_s >= _BLOCKED_S:
        n.detected |= _BLOCKED


@kernel
def needs_supply(n: NodeRecord) -> bool:
    """Whether the high-level power is switched on, so that its loss is a fault."""
    return bool(PowerState.SWITCHED_ON <= n.power_state <= PowerState.FAULT_REACTION_ACTIVE)


@kernel
def _quick_stop(n: NodeRecord, t_ns: int) -> None:
    """Transition 11, and 12 after the ramp unless 605Ah lets the drive stay."""
    option = n.values[slots402.QUICK_STOP_OPTION]
    n.power_state = PowerState.QUICK_STOP_ACTIVE
    following = PowerState.QUICK_STOP_ACTIVE if option >= _STAYS else PowerState.SWITCH_ON_DISABLED
    if _ramp(option):
        motion402.begin(n, t_ns, _ramp(option), following)
    else:
        _leave_enabled(n, following)


@kernel
def connection_lost(n: NodeRecord, t_ns: int, forced: int) -> int:
    """Handle NMT leaving OPERATIONAL: 6007h decides unless `forced`; return 1 if a fault follows.

    A drive that is not enabled keeps its state.
    """
    option = n.values[slots402.ABORT_OPTION]
    n.setpoint_armed = 0
    if forced or option != _NO_ACTION:
        n.setpoint_stale = 1
    if not _driven(n):
        return 0
    if not forced:
        if option == _NO_ACTION or n.power_state == PowerState.FAULT_REACTION_ACTIVE:
            return 0
        if option == _FAULT_SIGNAL:
            return 1
        if option == _QUICK_STOP_COMMAND:
            if n.power_state == PowerState.OPERATION_ENABLED:
                _quick_stop(n, t_ns)
            return 0
    _leave_enabled(n, _OFF)
    return 0


@kernel
def new_controlword(n: NodeRecord, t_ns: int, out: Queue) -> None:
    """Act on the written controlword: at most one row of the table, then the bits of a position mode."""
    before = n.controlword
    _command(n, t_ns, out)
    if n.servo:
        servo402.serve(n, servo402.CONTROLWORD, t_ns, before)


@kernel
def _command(n: NodeRecord, t_ns: int, out: Queue) -> None:
    word = n.values[slots402.CONTROLWORD]
    rising = word & 0x80 and not n.controlword & 0x80
    n.controlword = word
    state = n.power_state
    if state == PowerState.FAULT:
        if rising and n.causes & emcy.FAULT_MASK == 0:
            n.power_state = NEXT_STATE[state, Command.FAULT_RESET]
            if n.latched & emcy.FAULT_MASK:
                emcy.clear_latches(n, t_ns, emcy.FAULT_MASK, out)
        return
    following = NEXT_STATE[state, COMMAND_OF_CONTROLWORD[word & 0xF]]
    if following == state:
        if (
            state == PowerState.OPERATION_ENABLED
            and n.slowing
            and n.slowing_to != PowerState.OPERATION_ENABLED
            and word & 0xF == 0xF
        ):
            n.slowing = 0  # enabled again before the end of the ramp
        return
    if n.in_supply_ok == 0 and (
        following == PowerState.OPERATION_ENABLED or (following == PowerState.SWITCHED_ON and state < following)
    ):
        return  # no high-level power: the drive cannot be switched on
    if state == PowerState.OPERATION_ENABLED:
        _leave(n, t_ns, following)
    elif state == PowerState.QUICK_STOP_ACTIVE:
        if following == PowerState.OPERATION_ENABLED and n.values[slots402.QUICK_STOP_OPTION] < _STAYS:
            return  # transition 16 requires a drive that stays
        _leave_enabled(n, following)
    else:
        n.power_state = following
    if following == PowerState.OPERATION_ENABLED:
        motion402.enter(n, t_ns)


@kernel
def _leave(n: NodeRecord, t_ns: int, following: int) -> None:
    """Leave Operation Enabled by command (transitions 5, 8, 9, 11), as the option codes say."""
    if following == PowerState.QUICK_STOP_ACTIVE:
        _quick_stop(n, t_ns)
        return
    option = 0
    if following == PowerState.SWITCHED_ON:
        option = n.values[slots402.DISABLE_OPTION]
    elif following != PowerState.SWITCH_ON_DISABLED:
        option = n.values[slots402.SHUTDOWN_OPTION]
    if option != 1:
        _leave_enabled(n, following)
    elif n.slowing == 0 or n.slowing_to == PowerState.OPERATION_ENABLED:
        motion402.begin(n, t_ns, motion402.SLOW, following)
    else:
        n.slowing_to = following  # already in transition


@kernel
def new_setpoint(n: NodeRecord, t_ns: int, acts: int) -> None:
    """Apply the set-point received at `t_ns`, if the mode uses it; `acts`: that of 6071h, 60FFh or 607Ah and 60C1h."""
    if motion402.is_position_mode(n):
        if acts != slots402.ACTS_POSITION or (n.mode != _CSP and n.mode != _INTERPOLATED):
            return
        servo402.serve(n, servo402.TARGET, t_ns, 0)
    elif acts != (slots402.ACTS_SPEED if motion402.is_speed_mode(n.mode) else slots402.ACTS_TORQUE):
        return
    if n.setpoint_armed == 0:
        n.next_ns = min(n.next_ns, t_ns + 1)  # to schedule the check of its age
    if n.ramping == 0:
        n.demand_ns = max(n.demand_ns, t_ns)  # a slope begins now, not at the last computation
    n.setpoint_ns = t_ns
    n.setpoint_armed = 1
    n.setpoint_stale = 0
    if acts == slots402.ACTS_TORQUE and n.mode != n.vendor_mode:
        target = n.values[slots402.TARGET_TORQUE]
        if target > motion402.high_limit(n) or target < motion402.low_limit(n):
            n.clipped_setpoints += 1


@kernel
def actuate(n: NodeRecord, t_ns: int) -> None:
    """Compute the torque at `t_ns`."""
    values = n.values
    if values[slots402.MODE] != n.mode:
        motion402.change_mode(n, t_ns)
    age_ns = values[slots.SETPOINT_AGE_US] * 1000
    if n.setpoint_armed and age_ns > 0 and t_ns - n.setpoint_ns >= age_ns:
        n.setpoint_stale = 1
    elapsed_ns = t_ns - n.demand_ns
    n.demand_ns = t_ns
    n.ramping = 0
    if n.servo and servo402.serve(n, servo402.ACTUATE, t_ns, elapsed_ns):
        return
    if n.mode != _CST or n.slowing or n.mode == n.vendor_mode:
        motion402.other_mode(n, t_ns, elapsed_ns)
        return
    high, low = motion402.high_limit(n), motion402.low_limit(n)
    target = values[slots402.TARGET_TORQUE] + values[slots402.TORQUE_OFFSET]
    n.limited = 1 if target > high or target < low else 0
    target = min(max(target, low), high)
    if (
        n.power_state != PowerState.OPERATION_ENABLED
        or n.in_supply_ok == 0
        or n.setpoint_stale
        or n.controlword & _HALT
    ):
        target = 0
    if n.sync_armed == 0 and motion402.has_limits(n):
        n.ramping = 1  # nothing else looks at 607Dh and 6080h
    n.torque_demand_pm = n.out_torque_pm = float(target)
    values[slots402.TORQUE_DEMAND] = target


@kernel
def sample(n: NodeRecord) -> None:
    """Write actual position, velocity, torque and the statusword to their slots."""
    values = n.values
    position = ((n.in_position_counts + 0x80000000) & 0xFFFFFFFF) - 0x80000000  # wraps like the counter
    values[slots402.POSITION] = values[slots402.POSITION_DEMAND] = position
    values[slots402.INTERNAL_POSITION] = position
    position_bits = servo402.serve(n, servo402.SAMPLE, 0, 0) if n.servo else 0
    values[slots402.VELOCITY] = nearest_integer(motion402.velocity(n), 32)
    values[slots402.DC_LINK_MV] = n.supply_mV if n.in_supply_ok else 0
    values[slots402.TORQUE_ACTUAL] = nearest_integer(n.in_torque_pm, 16)
    values[slots402.CURRENT_ACTUAL] = values[slots402.TORQUE_ACTUAL]  # per mille of rated current: a DC motor's torque
    word = STATUSWORD_OF_STATE[n.power_state]
    if n.in_supply_ok:
        word |= cia402.VOLTAGE_ENABLED
    if n.latched & ~emcy.FAULT_MASK:
        word |= _WARNING
    if n.nmt != NmtState.STOPPED:
        word |= _REMOTE
    if n.limited:
        word |= _LIMIT
    if motion402.is_position_mode(n) and n.power_state == PowerState.OPERATION_ENABLED:
        word |= position_bits
    elif n.power_state == PowerState.OPERATION_ENABLED and not n.setpoint_stale:
        if n.mode != _CST:
            word |= motion402.target_bits(n)
        elif not n.slowing and not n.controlword & _HALT:
            word |= _FOLLOWS
    elif n.power_state == PowerState.QUICK_STOP_ACTIVE and not n.slowing:
        word |= _TARGET_REACHED  # the quick stop is complete, and the drive stays
    values[slots402.STATUSWORD] = word


@kernel
def next_deadline(n: NodeRecord, next_ns: int) -> int:
    """Return the earlier of `next_ns` and the drive's own next deadline."""
    age_ns = n.values[slots.SETPOINT_AGE_US] * 1000
    if n.setpoint_armed and age_ns > 0 and not n.setpoint_stale:
        next_ns = min(next_ns, n.setpoint_ns + age_ns)
    if n.slowing:
        next_ns = motion402.next_deadline(n, next_ns)
    if (n.detected & _FOLLOWING_LOST and not n.following_lost) or (n.detected & _BLOCKED and n.stalled_s == 0.0):
        next_ns = min(next_ns, n.demand_ns)  # to release the cause
    return next_ns
