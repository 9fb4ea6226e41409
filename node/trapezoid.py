"""Compiled position profile of a drive: at most four stretches of constant acceleration.

A *profile* leads from a position and a speed to a target, with the accelerations up and down and a
largest speed. It is evaluated in closed form at any time, so it does not depend on the times at
which the drive computes::

    p(t) = p0 + v0 t + a t^2 / 2        in each stretch
    v_peak^2 = (2 D + v0^2 / up + v1^2 / down) / (1 / up + 1 / down)

with the distance D, the initial speed v0 and the speed v1 at the target. At its end the position is
the target exactly. Positions in counts of the axis, speeds in counts/s.

In the kernels: `n` the node's record (`node.record`), `k` the number of a stretch.
"""

from __future__ import annotations

import math

from coulombus.kernels.decorator import kernel
from coulombus.node.record import NodeRecord

__all__ = ["evaluate", "hold", "interpolate", "move", "rest"]

_STRETCHES = 4
_LONGEST_S = 1e9  # of a profile: its end is an integer of ns


@kernel
def _begin(n: NodeRecord, t_ns: int) -> None:
    """Begin a profile without stretches at the present demand."""
    n.profile_ns = n.profile_end_ns = t_ns
    n.profile_from, n.profile_from_speed = n.position_demand, n.profile_speed
    n.profile_to, n.profile_to_speed = n.position_demand, 0.0
    for k in range(_STRETCHES):
        n.stretch_s[k] = n.stretch_a[k] = 0.0


@kernel
def _end(n: NodeRecord, target: float, speed: float) -> None:
    duration = 0.0
    for k in range(_STRETCHES):
        duration += n.stretch_s[k]
    n.profile_end_ns = n.profile_ns + math.ceil(min(duration, _LONGEST_S) * 1e9)
    n.profile_to, n.profile_to_speed = target, speed


@kernel
def hold(n: NodeRecord, t_ns: int) -> None:
    """Demand the present position of the axis."""
    n.position_demand, n.profile_speed, n.profile_acceleration = float(n.in_position_counts), 0.0, 0.0
    n.target_counts = n.position_demand
    _begin(n, t_ns)


@kernel
def rest(n: NodeRecord, t_ns: int, down: float) -> None:
    """Go from the present demand to speed 0."""
    _begin(n, t_ns)
    speed = n.profile_from_speed
    n.stretch_s[0] = abs(speed) / down
    n.stretch_a[0] = -math.copysign(down, speed)
    _end(n, n.profile_from + speed * abs(speed) / (2 * down), 0.0)


@kernel
def interpolate(n: NodeRecord, t_ns: int, target: float, duration_ns: int) -> None:
    """Go from the present demand to a target at a constant speed."""
    _begin(n, t_ns)
    n.stretch_s[0] = duration_ns * 1e-9
    n.profile_from_speed = (target - n.profile_from) / n.stretch_s[0]
    _end(n, target, 0.0)


@kernel
def move(n: NodeRecord, t_ns: int, target: float, end_speed: float, fastest: float, up: float, down: float) -> None:
    """Go from the present demand to a target; `end_speed` is the speed there, in the direction of the move."""
    if not fastest > 0.0:
        rest(n, t_ns, down)
        return
    _begin(n, t_ns)
    distance, speed = target - n.profile_from, n.profile_from_speed
    sign = 1.0 if distance >= speed * abs(speed) / (2 * down) else -1.0
    if end_speed > 0.0 and distance * speed > 0.0:
        sign = math.copysign(1.0, distance)  # it goes through the target
    distance, speed = distance * sign, speed * sign
    if speed < 0.0:  # away from the target, or too fast to stop there
        n.stretch_s[0], n.stretch_a[0] = -speed / down, down * sign
        distance += speed * speed / (2 * down)
        speed = 0.0
    elif speed > fastest:
        n.stretch_s[0], n.stretch_a[0] = (speed - fastest) / down, -down * sign
        distance -= (speed * speed - fastest * fastest) / (2 * down)
        speed = fastest
    last = min(end_speed, fastest)
    reach = (2 * distance + speed * speed / up + last * last / down) / (1 / up + 1 / down)
    peak = min(math.sqrt(max(reach, speed * speed)), fastest)
    if peak < last:  # too short for the speed at the end
        peak = last = min(math.sqrt(max(speed * speed + 2 * up * distance, 0.0)), last)
    n.stretch_s[1], n.stretch_a[1] = (peak - speed) / up, up * sign
    n.stretch_s[3], n.stretch_a[3] = (peak - last) / down, -down * sign
    even = distance - (peak * peak - speed * speed) / (2 * up) - (peak * peak - last * last) / (2 * down)
    if even > 0.0 and peak > 0.0:
        n.stretch_s[2] = even / peak
    _end(n, target, last * sign)


@kernel
def evaluate(n: NodeRecord, t_ns: int) -> None:
    """Compute position, speed and acceleration demand at `t_ns`."""
    if t_ns >= n.profile_end_ns:
        past = (t_ns - n.profile_end_ns) * 1e-9
        n.position_demand = n.profile_to + n.profile_to_speed * past
        n.profile_speed, n.profile_acceleration = n.profile_to_speed, 0.0
        return
    left = (t_ns - n.profile_ns) * 1e-9
    position, speed, acceleration = n.profile_from, n.profile_from_speed, 0.0
    for k in range(_STRETCHES):
        if left < 0.0:
            break
        acceleration = n.stretch_a[k]
        step = min(left, n.stretch_s[k])
        position += (speed + acceleration * step / 2) * step
        speed += acceleration * step
        left = left - step if step < left else -1.0
    n.position_demand, n.profile_speed, n.profile_acceleration = position, speed, acceleration
