"""Compiled position control of a CiA 402 drive: modes 1 (profile), 7 (interpolated) and 8 (cyclic).

All positions are counts of the axis (`node.axis402`), all speeds counts/s:

    profile (1)      the profile of `node.trapezoid` to 607Ah, with 6081h, 6083h, 6084h; the set-points by bits 4,
                     5, 6 and 9 of the controlword
    cyclic (7, 8)    from set-point to set-point (60C1h:01; 607Ah + 60B0h) at a constant speed, in 60C2h or the time
                     since the last one
    control          speed = speed demand + Kp (position demand - position) + 60B1h (CSP)
                     torque = speed control of it (`node.motion402`) + acceleration demand / load + 60B2h (CSP)

Kp: 2010h:03. The demand stays within 607Dh, the accelerations within 60C5h and 60C6h, the speed within 607Fh and
6080h. The following error is too large if it is beyond 6065h for 6066h.

In the kernels: `n` the node's record (`node.record`), `up`, `down` accelerations.
"""

from __future__ import annotations

from coulombus.eds import cia402
from coulombus.kernels.decorator import kernel
from coulombus.node import axis402, motion402, slots402, trapezoid
from coulombus.node.record import NodeRecord

__all__ = ["accelerations", "actuate", "arrived", "control", "fastest", "new_controlword", "new_target", "status_bits"]

_PROFILE, _INTERPOLATED = cia402.OPERATION_MODE_PROFILE_POSITION, cia402.OPERATION_MODE_INTERPOLATED_POSITION
_CSP = cia402.OPERATION_MODE_CSP

_NEW_SETPOINT, _IMMEDIATELY, _RELATIVE, _HALT, _ON_SETPOINT = 0x10, 0x20, 0x40, 0x100, 0x200
_INTERPOLATE = 0x10
_TARGET_REACHED, _ACKNOWLEDGE, _FOLLOWS, _FOLLOWING_ERROR = 0x0400, 0x1000, 0x1000, 0x2000
_BY_DEMAND, _BY_ACTUAL = 1, 2  # 60F2h, bits 0 and 1: origin of a relative set-point
_LOWEST, _HIGHEST = -0x80000000, 0x7FFFFFFF
_SHORTEST_NS, _LONGEST_NS = 1_000_000, 100_000_000  # of a measured time between cyclic set-points


@kernel
def fastest(n: NodeRecord) -> float:
    """Return the largest speed allowed, counts/s: 607Fh, 6080h."""
    speed: float = min(float(n.values[slots402.MAX_VELOCITY]) * n.unit_counts_s, motion402.largest_speed(n))
    return max(speed, 0.0)


@kernel
def _bounded(n: NodeRecord, rate: int, limit: int) -> float:
    """Return an acceleration, counts/s^2, within its limit (0: none)."""
    return float(max(min(rate, limit) if limit > 0 else rate, 1)) * n.unit_counts_s


@kernel
def accelerations(n: NodeRecord, up: int, down: int) -> tuple[float, float]:
    """Return two accelerations in counts/s^2, within 60C5h and 60C6h."""
    values = n.values
    return (
        _bounded(n, up, values[slots402.MAX_ACCELERATION]),
        _bounded(n, down, values[slots402.MAX_DECELERATION]),
    )


@kernel
def _rest(n: NodeRecord, t_ns: int) -> None:
    """Come to rest, as halt does: by 6084h, or by 6085h where 605Dh is 2."""
    values = n.values
    quick = values[slots402.HALT_OPTION] == motion402.QUICK
    rate = values[slots402.QUICK_STOP_DECELERATION if quick else slots402.DECELERATION]
    trapezoid.rest(n, t_ns, _bounded(n, rate, values[slots402.MAX_DECELERATION]))


@kernel
def _within(n: NodeRecord, target: float) -> float:
    """Return a target within 607Dh."""
    values = n.values
    if values[slots402.LOWEST_POSITION] != _LOWEST:
        target = max(target, float(values[slots402.LOWEST_POSITION] + n.zero_counts))
    if values[slots402.HIGHEST_POSITION] != _HIGHEST:
        target = min(target, float(values[slots402.HIGHEST_POSITION] + n.zero_counts))
    return target


# profile position


@kernel
def _target(n: NodeRecord) -> float:
    """Return 607Ah as a position of the axis."""
    values = n.values
    target = values[slots402.TARGET_POSITION]
    if not n.controlword & _RELATIVE:
        return axis402.axis_position(n, target, n.position_demand)
    origin = values[slots402.POSITION_OPTION] & 3
    start = n.target_counts
    if origin == _BY_DEMAND:
        start = n.position_demand
    elif origin == _BY_ACTUAL:
        start = float(n.in_position_counts)
    return start + target


@kernel
def _set_point(n: NodeRecord, t_ns: int) -> None:
    """Take 607Ah: at once, or after the active target; ignore it if another set-point waits already."""
    values = n.values
    trapezoid.evaluate(n, t_ns)
    idle = n.waiting == 0 and t_ns >= n.profile_end_ns and n.halted == 0
    at_once = idle or n.controlword & _IMMEDIATELY
    if n.waiting and not at_once:
        return
    unclipped = _target(n)
    n.waiting_counts = _within(n, unclipped)
    n.waiting_limited = 1 if n.waiting_counts != unclipped else 0
    n.waiting_speed = min(values[slots402.PROFILE_VELOCITY] * n.unit_counts_s, fastest(n))
    n.waiting_up, n.waiting_down = accelerations(n, values[slots402.ACCELERATION], values[slots402.DECELERATION])
    n.waiting = n.acknowledged = 1
    if at_once:
        _next(n, t_ns)
    elif (
        n.controlword & _ON_SETPOINT
        and (n.waiting_counts - n.target_counts) * (n.target_counts - n.position_demand) > 0
    ):
        up, down = accelerations(n, values[slots402.ACCELERATION], values[slots402.DECELERATION])
        trapezoid.move(n, t_ns, n.target_counts, n.target_speed, n.target_speed, up, down)


@kernel
def _next(n: NodeRecord, t_ns: int) -> None:
    """Begin the waiting set-point."""
    n.waiting = 0
    n.target_counts, n.target_speed, n.target_limited = n.waiting_counts, n.waiting_speed, n.waiting_limited
    if not n.halted:
        trapezoid.move(n, t_ns, n.target_counts, 0.0, n.target_speed, n.waiting_up, n.waiting_down)
    n.off_target_ns = t_ns
    if not n.controlword & _NEW_SETPOINT:
        n.acknowledged = 0


@kernel
def new_controlword(n: NodeRecord, t_ns: int, before: int) -> None:
    """Act on bits 4 to 9 of the controlword in Operation Enabled; `before`: the last controlword."""
    if n.mode != _PROFILE:
        return
    if n.controlword & ~before & _NEW_SETPOINT:
        _set_point(n, t_ns)
    elif not n.controlword & _NEW_SETPOINT and n.waiting == 0:
        n.acknowledged = 0


@kernel
def _halt(n: NodeRecord, t_ns: int) -> None:
    """Begin or end a halt."""
    trapezoid.evaluate(n, t_ns)
    if n.halted == 0:
        n.halted = 1
        _rest(n, t_ns)
        return
    n.halted = 0
    if n.mode == _PROFILE and n.target_speed > 0.0:
        values = n.values
        up, down = accelerations(n, values[slots402.ACCELERATION], values[slots402.DECELERATION])
        trapezoid.move(n, t_ns, n.target_counts, 0.0, n.target_speed, up, down)
        n.off_target_ns = t_ns


# cyclic set-points


@kernel
def new_target(n: NodeRecord, t_ns: int) -> None:
    """Go to a cyclic set-point received at `t_ns`."""
    values = n.values
    duration_ns = n.period_ns
    if duration_ns == 0:
        since_ns = t_ns - n.cyclic_ns if n.cyclic_ns >= 0 else _SHORTEST_NS
        duration_ns = min(max(since_ns, _SHORTEST_NS), _LONGEST_NS)
    n.cyclic_ns = t_ns
    if n.controlword & _HALT or (n.mode == _INTERPOLATED and not n.controlword & _INTERPOLATE):
        return
    trapezoid.evaluate(n, t_ns)
    if n.mode == _CSP:
        target = values[slots402.TARGET_POSITION] + values[slots402.POSITION_OFFSET]
    else:
        target = values[slots402.INTERPOLATED_POSITION]
    unclipped = axis402.axis_position(n, target, n.position_demand)
    n.target_counts = _within(n, unclipped)
    n.target_limited = 1 if n.target_counts != unclipped else 0
    n.off_target_ns = t_ns
    trapezoid.interpolate(n, t_ns, n.target_counts, duration_ns)


# control


@kernel
def actuate(n: NodeRecord, t_ns: int, elapsed_ns: int) -> None:
    """Compute the torque at `t_ns` in Operation Enabled."""
    halt = n.controlword & _HALT or (n.mode == _INTERPOLATED and not n.controlword & _INTERPOLATE)
    if (1 if halt else 0) != n.halted:
        _halt(n, t_ns)
    if n.waiting and not n.halted and t_ns >= n.profile_end_ns:
        began_ns = n.profile_end_ns
        trapezoid.evaluate(n, began_ns)
        _next(n, began_ns)
    control(n, t_ns, elapsed_ns)


@kernel
def control(n: NodeRecord, t_ns: int, elapsed_ns: int) -> None:
    """Follow the profile at `t_ns`."""
    values = n.values
    n.limited = n.target_limited
    trapezoid.evaluate(n, t_ns)
    error = n.position_demand - n.in_position_counts
    speed = n.profile_speed + n.position_kp * error
    n.feed_forward_pm = n.profile_acceleration / n.load_counts_s2 if n.load_counts_s2 > 0.0 else 0.0
    if n.mode == _CSP:
        speed += values[slots402.VELOCITY_OFFSET] * n.unit_counts_s
        n.feed_forward_pm += values[slots402.TORQUE_OFFSET]
    speed_limit = fastest(n)
    n.speed_demand = min(max(speed, -speed_limit), speed_limit) / n.unit_counts_s
    motion402.control_speed(n, elapsed_ns)
    n.ramping = 1  # the loop also runs without calls
    if n.values[slots402.FOLLOWING_WINDOW] == slots402.NO_WINDOW or abs(error) <= values[slots402.FOLLOWING_WINDOW]:
        n.following_ns = t_ns
        n.following_lost = 0
    elif t_ns - n.following_ns >= values[slots402.FOLLOWING_MS] * 1_000_000:
        n.following_lost = 1
    window = values[slots402.POSITION_WINDOW]
    away = window != slots402.NO_WINDOW and abs(n.target_counts - n.in_position_counts) > window
    if n.halted:
        away = abs(motion402.velocity(n)) > values[slots402.VELOCITY_THRESHOLD]
    if away or n.waiting or t_ns < n.profile_end_ns:
        n.off_target_ns = t_ns


@kernel
def arrived(n: NodeRecord) -> bool:
    """Whether the profile is over and the position has been within 6067h for 6068h; with halt: whether it is at rest."""
    since_ns = n.demand_ns - n.off_target_ns
    return bool(since_ns > 0 and since_ns >= n.values[slots402.POSITION_WINDOW_MS] * 1_000_000)


@kernel
def status_bits(n: NodeRecord) -> int:
    """Return bits 10, 12 and 13 of the statusword in Operation Enabled, in the modes 1, 7 and 8."""
    bits = _FOLLOWING_ERROR if n.following_lost else 0
    if n.mode == _CSP:
        return bits | (_FOLLOWS if n.cyclic_ns >= 0 and not n.halted and not n.setpoint_stale else 0)
    if arrived(n):
        bits |= _TARGET_REACHED
    if n.mode == _INTERPOLATED:
        return bits | (_ACKNOWLEDGE if not n.halted else 0)
    return bits | (_ACKNOWLEDGE if n.acknowledged else 0)
