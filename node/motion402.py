"""Compiled torque of a CiA 402 drive: limits, modes, slopes, velocity loop (IEC 61800-7-201).

Torques in per mille of rated, speeds in counts/s, as everywhere in the drive:

    limits      high = min(6072h, 6073h, 60E0h), low = -min(6072h, 6073h, 60E1h); 0 on the side on which the position is
                beyond 607Dh or the speed beyond 6080h
    CST (10)    demand = clip(6071h + 60B2h, low, high)
    vendor's    demand = clip(set-point * vendor_pm, low, high): a vendor-specific mode
    torque (4)  d demand / dt = +- 6087h until demand = clip(6071h, low, high)
    speeds      d speed / dt = +- 6083h or 6084h until speed = 60FFh (profile velocity, 3); speed = 60FFh + 60B1h (CSV, 9)
                demand = clip(Kp (speed - 606Ch) + integral + feed-forward, low, high),   d integral / dt = Ki (speed - 606Ch)
    positions   a speed and a feed-forward of `node.position402`; the feed-forward of CSV is 60B2h

The integral is held while the demand is at a limit and the error would increase it (anti-windup).
Kp, Ki: 2010h.

A gradual change to torque 0 (option codes 605Ah to 605Eh, a change of the mode) is a *ramp*:
`begin` starts it, `actuate` computes it, and after it the torque is 0 and the power state
`slowing_to` follows. A ramp lasts at most 2006h, and ends with the supply. In the torque modes the
quick stop ramp is "at once": a hand is on the handle.

In the kernels: `n` the node's record (`node.record`).
"""

from __future__ import annotations

import math

from coulombus.eds import cia402
from coulombus.kernels.decorator import constant, kernel
from coulombus.node import slots402, trapezoid
from coulombus.node.record import NodeRecord

__all__ = [
    "HOMED",
    "MODES",
    "POSITION_MODES",
    "QUICK",
    "SLOW",
    "begin",
    "change_mode",
    "control_speed",
    "enter",
    "has_limits",
    "high_limit",
    "is_position_mode",
    "is_speed_mode",
    "largest_speed",
    "low_limit",
    "next_deadline",
    "other_mode",
    "put_out",
    "stop",
    "target_bits",
    "velocity",
]

_VELOCITY, _TORQUE = cia402.OPERATION_MODE_PROFILE_VELOCITY, cia402.OPERATION_MODE_PROFILE_TORQUE
_CSV, _CST = cia402.OPERATION_MODE_CSV, cia402.OPERATION_MODE_CST
_SPEED_MODES = (_VELOCITY, _CSV)
POSITION_MODES = (
    cia402.OPERATION_MODE_PROFILE_POSITION,
    cia402.OPERATION_MODE_HOMING,
    cia402.OPERATION_MODE_INTERPOLATED_POSITION,
    cia402.OPERATION_MODE_CSP,
)
MODES = (*POSITION_MODES, _VELOCITY, _TORQUE, _CSV, _CST)
"""Modes of 6060h that a drive can have: those of 6502h for which its file has the objects."""

SLOW, QUICK, _TO_ZERO = constant(1), constant(2), constant(3)
"""Ramps: the slow-down ramp (6087h, 6084h), the quick stop ramp (at once, 6085h), and torque by 6087h in
every mode.
"""

_ENABLED = constant(cia402.PowerState.OPERATION_ENABLED)
_HALT = 0x0100
_TARGET_REACHED, _SPEED_ZERO, _SLIPPAGE = 0x0400, 0x1000, 0x2000
_LOWEST, _HIGHEST = -0x80000000, 0x7FFFFFFF
_NO_TIME_NS = constant(0)
HOMED = 5
"""Stage of the homing that has found the home position (`node.homing402`)."""
_LONGEST_STEP_S = 0.01  # largest step of the integral, after a longer time without calls
_STILL = 1.0  # speed below which the axis stands, counts/s


@kernel
def is_speed_mode(mode: int) -> bool:
    """Whether 60FFh is the set-point."""
    return mode in _SPEED_MODES


@kernel
def is_position_mode(n: NodeRecord) -> bool:
    """Whether the active mode controls the position."""
    return n.mode in POSITION_MODES and n.mode != n.vendor_mode


@kernel
def velocity(n: NodeRecord) -> float:
    """Return the velocity in units of 606Ch, which 60A9h gives."""
    value: float = n.in_velocity_counts_s / n.unit_counts_s
    return value


@kernel
def largest_speed(n: NodeRecord) -> float:
    """Return 6080h in counts/s; infinity if it limits nothing."""
    rpm = n.values[slots402.MAX_MOTOR_SPEED]
    return math.inf if rpm == slots402.NO_SPEED_LIMIT else rpm * n.index_counts / 60.0


@kernel
def has_limits(n: NodeRecord) -> bool:
    """Tell whether 607Dh or 6080h may limit."""
    values = n.values
    positions = values[slots402.LOWEST_POSITION] != _LOWEST or values[slots402.HIGHEST_POSITION] != _HIGHEST
    return bool(positions or values[slots402.MAX_MOTOR_SPEED] != slots402.NO_SPEED_LIMIT)


@kernel
def _beyond(n: NodeRecord) -> int:
    """Return +1 if no upward push is allowed, -1 for downward, 2 for both directions: 607Dh and 6080h.

    A position mode keeps its demand within 607Dh instead.
    """
    position = ((n.in_position_counts - n.zero_counts + 0x80000000) & 0xFFFFFFFF) - 0x80000000
    lowest, highest = n.values[slots402.LOWEST_POSITION], n.values[slots402.HIGHEST_POSITION]
    if is_position_mode(n):
        lowest, highest = _LOWEST, _HIGHEST
    speed, largest = n.in_velocity_counts_s, largest_speed(n)
    up = (position >= highest and highest != _HIGHEST) or speed >= largest
    down = (position <= lowest and lowest != _LOWEST) or speed <= -largest
    return (2 if down else 1) if up else -1 if down else 0


@kernel
def high_limit(n: NodeRecord) -> int:
    """Return the largest torque allowed now."""
    values = n.values
    high: int = min(min(values[slots402.MAX_TORQUE], values[slots402.POSITIVE_LIMIT]), values[slots402.MAX_CURRENT])
    high = max(high, 0)  # a file may give a limit a signed type
    return 0 if _beyond(n) > 0 else high


@kernel
def low_limit(n: NodeRecord) -> int:
    """Return the most negative torque allowed now."""
    values = n.values
    most = min(min(values[slots402.MAX_TORQUE], abs(values[slots402.NEGATIVE_LIMIT])), values[slots402.MAX_CURRENT])
    low: int = -max(most, 0)
    beyond = _beyond(n)
    return 0 if beyond == -1 or beyond == 2 else low


@kernel
def stop(n: NodeRecord) -> None:
    """Set torque 0 at once, and clear the controllers."""
    n.slowing = 0
    n.ramping = 0
    n.integral_pm = 0.0
    n.feed_forward_pm = 0.0
    n.following_lost = 0
    n.stalled_s = 0.0
    n.torque_demand_pm = 0.0
    n.out_torque_pm = 0.0
    n.values[slots402.TORQUE_DEMAND] = 0
    n.values[slots402.VELOCITY_DEMAND] = 0


@kernel
def enter(n: NodeRecord, t_ns: int) -> None:
    """Begin Operation Enabled from torque 0, and from the present speed and position."""
    n.slowing = 0
    _hold(n, t_ns)
    n.integral_pm = 0.0
    n.speed_demand = velocity(n)
    n.demand_ns = n.off_target_ns = n.moving_ns = t_ns


@kernel
def _hold(n: NodeRecord, t_ns: int) -> None:
    """Begin a position mode at the present position, without set-points."""
    if not is_position_mode(n):
        return
    trapezoid.hold(n, t_ns)
    n.target_speed = 0.0
    n.target_limited = n.acknowledged = n.halted = n.waiting = n.following_lost = 0
    n.cyclic_ns = -1
    n.following_ns = n.off_target_ns = t_ns
    if n.homing != HOMED:
        n.homing = 0


@kernel
def _take_mode(n: NodeRecord, t_ns: int) -> None:
    """Activate the mode in 6060h; a mode that the drive lacks is none. If enabled, only the next set-point
    gives torque; a position mode holds the position.
    """
    mode = n.values[slots402.MODE]
    if not (0 < mode <= 32 and n.modes >> (mode - 1) & 1) and mode != n.vendor_mode:
        mode = 0
    if mode == n.mode:
        return
    n.mode = mode
    n.values[slots402.MODE_DISPLAY] = mode
    stop(n)
    if n.power_state == _ENABLED:
        n.setpoint_stale = 1
        n.speed_demand = velocity(n)
        _hold(n, t_ns)


@kernel
def change_mode(n: NodeRecord, t_ns: int) -> None:
    """Handle a 6060h that differs from the active mode: ramp to torque 0, then change; from one position mode to
    another at once.
    """
    if n.slowing:
        return
    both_hold = is_position_mode(n) and n.values[slots402.MODE] in POSITION_MODES
    if n.power_state == _ENABLED and n.torque_demand_pm != 0.0 and n.mode != 0 and not both_hold:
        begin(n, t_ns, _TO_ZERO, _ENABLED)
    else:
        _take_mode(n, t_ns)


@kernel
def begin(n: NodeRecord, t_ns: int, ramp: int, state: int) -> None:
    """Begin a ramp to torque 0, after which `state` follows; it may end at once."""
    n.slowing, n.slowing_to, n.slowing_ns = ramp, state, t_ns
    n.demand_ns = t_ns
    n.feed_forward_pm = 0.0
    if is_position_mode(n):
        n.speed_demand = velocity(n)
    _slow_down(n, t_ns, _NO_TIME_NS)


@kernel
def _towards(present: float, target: float, change: float) -> float:
    change = max(change, 0.0)  # a file may give a rate a signed type
    return min(present + change, target) if target >= present else max(present - change, target)


@kernel
def _slows_speed(n: NodeRecord) -> bool:
    """Whether the active ramp is that of a speed, not of the torque."""
    return n.slowing != _TO_ZERO and (is_speed_mode(n.mode) or is_position_mode(n))


@kernel
def _slow_down(n: NodeRecord, t_ns: int, elapsed_ns: int) -> None:
    values = n.values
    late = t_ns - n.slowing_ns >= values[slots402.SLOW_DOWN_MS] * 1_000_000
    if late or n.in_supply_ok == 0:
        over = True
    elif _slows_speed(n):
        rate = values[slots402.DECELERATION] if n.slowing == SLOW else values[slots402.QUICK_STOP_DECELERATION]
        n.speed_demand = _towards(n.speed_demand, 0.0, rate * 1e-9 * elapsed_ns)
        over = n.speed_demand == 0.0
        if not over:
            control_speed(n, elapsed_ns)
    else:
        demand = _towards(n.torque_demand_pm, 0.0, values[slots402.TORQUE_SLOPE] * 1e-9 * elapsed_ns)
        n.torque_demand_pm = min(max(demand, float(low_limit(n))), float(high_limit(n)))
        over = n.torque_demand_pm == 0.0 or n.slowing == QUICK
    if over:
        n.power_state = n.slowing_to
        stop(n)
        if values[slots402.MODE] != n.mode:
            _take_mode(n, t_ns)
        return
    n.ramping = 1
    put_out(n)


@kernel
def put_out(n: NodeRecord) -> None:
    """Command the torque demand."""
    n.out_torque_pm = n.torque_demand_pm
    n.values[slots402.TORQUE_DEMAND] = math.floor(n.torque_demand_pm + 0.5)


@kernel
def control_speed(n: NodeRecord, elapsed_ns: int) -> None:
    """Compute the PI control of `speed_demand`, with the torque feed-forward."""
    high, low = float(high_limit(n)), float(low_limit(n))
    error = n.speed_demand - velocity(n)
    if not abs(error) < math.inf:  # the speed is not a number
        n.torque_demand_pm = n.integral_pm = n.speed_demand = 0.0
        return
    elapsed_s = min(elapsed_ns * 1e-9, _LONGEST_STEP_S)
    change = n.speed_ki * error * elapsed_s
    demand = n.speed_kp * error + n.integral_pm + change + n.feed_forward_pm
    if (demand > high and error > 0.0) or (demand < low and error < 0.0):
        n.limited = 1
    else:
        n.integral_pm += change
    n.integral_pm = min(max(n.integral_pm, low), high)
    n.torque_demand_pm = min(max(demand, low), high)
    n.values[slots402.VELOCITY_DEMAND] = math.floor(n.speed_demand + 0.5)
    stalled = abs(n.in_velocity_counts_s) < _STILL and demand != n.torque_demand_pm and n.torque_demand_pm != 0.0
    n.stalled_s = n.stalled_s + elapsed_s if stalled else 0.0


@kernel
def _speed_target(n: NodeRecord) -> float:
    """Return 60FFh (and 60B1h in CSV) within 607Fh, 6080h and 607Dh."""
    values = n.values
    target = float(values[slots402.TARGET_VELOCITY])
    if n.mode == _CSV:
        target += values[slots402.VELOCITY_OFFSET]
    fastest = max(min(float(values[slots402.MAX_VELOCITY]), largest_speed(n) / n.unit_counts_s), 0.0)
    clipped: float = min(max(target, -fastest), fastest)
    beyond = _beyond(n)
    if (clipped > 0.0 and beyond > 0) or (clipped < 0.0 and (beyond == -1 or beyond == 2)):
        clipped = 0.0
    n.limited = 1 if clipped != target else 0
    return clipped


@kernel
def _speed_mode(n: NodeRecord, elapsed_ns: int) -> None:
    values = n.values
    target = _speed_target(n)
    halted = n.mode == _VELOCITY and n.controlword & _HALT
    n.feed_forward_pm = 0.0
    if n.mode == _CSV:
        n.feed_forward_pm = float(values[slots402.TORQUE_OFFSET])
        n.speed_demand = 0.0 if n.controlword & _HALT else target
    else:
        present = n.speed_demand
        if halted:
            target = 0.0
        faster = present == 0.0 or (target * present > 0.0 and abs(target) > abs(present))
        rate = values[slots402.ACCELERATION] if faster else values[slots402.DECELERATION]
        if halted and values[slots402.HALT_OPTION] == QUICK:
            rate = values[slots402.QUICK_STOP_DECELERATION]
        if target * present < 0.0:
            target = 0.0  # slow down first, then accelerate in the other direction
        n.speed_demand = _towards(present, target, rate * 1e-9 * elapsed_ns)
    control_speed(n, elapsed_ns)
    n.ramping = 1  # the loop also runs without calls


@kernel
def _profile_torque(n: NodeRecord, elapsed_ns: int) -> None:
    values = n.values
    high, low = high_limit(n), low_limit(n)
    target = values[slots402.TARGET_TORQUE]
    n.limited = 1 if target > high or target < low else 0
    target = min(max(target, low), high)
    change = values[slots402.TORQUE_SLOPE] * 1e-9 * elapsed_ns
    if n.controlword & _HALT:
        target = 0
        if values[slots402.HALT_OPTION] == QUICK:
            change = abs(n.torque_demand_pm)
    demand = _towards(n.torque_demand_pm, float(target), change)
    n.ramping = 1 if demand != target else 0
    # a lowered limit acts at once, not by the slope
    n.torque_demand_pm = min(max(demand, float(low)), float(high))


@kernel
def _vendor_torque(n: NodeRecord) -> None:
    high, low = float(high_limit(n)), float(low_limit(n))
    target = 0.0 if n.controlword & _HALT else n.values[n.vendor_slot] * n.vendor_pm
    n.limited = 1 if target > high or target < low else 0
    n.torque_demand_pm = min(max(target, low), high)


@kernel
def other_mode(n: NodeRecord, t_ns: int, elapsed_ns: int) -> None:
    """Compute the torque at `t_ns` on a ramp, and in every mode except CST."""
    if n.slowing:
        _slow_down(n, t_ns, elapsed_ns)
        return
    n.limited = 0
    if n.power_state != _ENABLED or n.in_supply_ok == 0 or n.setpoint_stale or n.mode == 0:
        stop(n)
        n.speed_demand = velocity(n)
        return
    if n.mode == n.vendor_mode:
        _vendor_torque(n)
    elif n.mode == _TORQUE:
        _profile_torque(n, elapsed_ns)
    else:
        _speed_mode(n, elapsed_ns)
    put_out(n)


@kernel
def target_bits(n: NodeRecord) -> int:
    """Return bits 10, 12 and 13 of the statusword in Operation Enabled, in every mode except CST."""
    values = n.values
    if n.mode == _TORQUE and n.mode != n.vendor_mode:
        target = 0 if n.controlword & _HALT else values[slots402.TARGET_TORQUE]
        return _TARGET_REACHED if n.torque_demand_pm == target and not n.slowing else 0
    if n.mode == _CSV:
        return _SPEED_ZERO if not n.slowing and not n.controlword & _HALT else 0  # here: "follows the command"
    if n.mode != _VELOCITY:
        return 0
    bits, t_ns, speed = 0, n.demand_ns, velocity(n)
    target = 0 if n.controlword & _HALT else values[slots402.TARGET_VELOCITY]
    if abs(speed - target) > values[slots402.VELOCITY_WINDOW]:
        n.off_target_ns = t_ns
    elif t_ns - n.off_target_ns >= values[slots402.VELOCITY_WINDOW_MS] * 1_000_000:
        bits |= _TARGET_REACHED
    if abs(speed) > values[slots402.VELOCITY_THRESHOLD]:
        n.moving_ns = t_ns
    elif t_ns - n.moving_ns >= values[slots402.VELOCITY_THRESHOLD_MS] * 1_000_000:
        bits |= _SPEED_ZERO
    if abs(n.speed_demand - speed) > values[slots402.MAX_SLIPPAGE]:
        bits |= _SLIPPAGE
    return bits


@kernel
def next_deadline(n: NodeRecord, next_ns: int) -> int:
    """Return the earlier of `next_ns` and the end of the ramp."""
    values = n.values
    end = n.slowing_ns + values[slots402.SLOW_DOWN_MS] * 1_000_000
    speeds = _slows_speed(n)
    rate = values[slots402.DECELERATION if n.slowing == SLOW else slots402.QUICK_STOP_DECELERATION]
    if not speeds:
        rate = values[slots402.TORQUE_SLOPE]
    if rate > 0:
        left = abs(n.speed_demand if speeds else n.torque_demand_pm)
        end = min(end, n.demand_ns + math.ceil(min(left / rate, 100.0) * 1e9) + 1)
    return int(min(next_ns, end))
