"""One cycle of friction in the plane: from encoders and transducers to the commands of brakes and motors.

h : the `PlaneHostRecord`
"""

from __future__ import annotations

import math
from typing import NamedTuple

from coulombus.host.laws.plane.plane_law import PlaneLawFunction
from coulombus.host.plane.brake_split import expect_brakes, hold, observe, release, slip
from coulombus.host.plane.plane_host_record import ACTIVE, TRACK, PlaneHostRecord
from coulombus.kernels.decorator import kernel
from coulombus.rigs.kinematics.mechanisms import JOINTS, MechanismFunction
from coulombus.rigs.kinematics.pose_kernels import condition, locate

__all__ = ["PlaneFunctions", "evaluate", "in_workspace", "may_display", "measure_plane", "plane_step", "share_out"]

SLOW_M_S_N = 0.027
"""Speed of the tip, for each newton of the law, below which the direction of its motion is smoothed."""
SMOOTH_COSINE = 0.5
"""Least cosine of the angle to the mean motion with which it is smoothed: a motion that turns back is not."""


class PlaneFunctions(NamedTuple):
    """The compiled law and mechanism of two joints."""

    law: PlaneLawFunction
    mechanism: MechanismFunction


@kernel
def plane_step(mechanism: MechanismFunction, law: PlaneLawFunction, h: PlaneHostRecord) -> None:
    """Do one cycle: measure, evaluate the law, split its force."""
    measure_plane(mechanism, h)
    observe(h.control, h.split, h.v_rad_s)
    expect_brakes(h.control, h.split)
    if may_display(h) and evaluate(law, h):
        share_out(h)
    else:
        h.outside += 1
        release(h.split)


@kernel
def may_display(h: PlaneHostRecord) -> bool:
    """Return whether the pose is far enough from singular, and the tip in the workspace."""
    return in_workspace(h) and h.condition >= h.least_condition


@kernel
def in_workspace(h: PlaneHostRecord) -> bool:
    """Return whether the tip is in the rig file's workspace."""
    x, y = h.pose.x_m[0], h.pose.x_m[1]
    return h.low_m[0] <= x <= h.high_m[0] and h.low_m[1] <= y <= h.high_m[1]


@kernel
def evaluate(law: PlaneLawFunction, h: PlaneHostRecord) -> bool:
    """Evaluate the law; return whether its force is finite."""
    h.smallest_condition = min(h.smallest_condition, h.condition)
    fx, fy = law(h.motion, h.law, h.state)
    h.state.psi_N[0], h.state.psi_N[1] = fx, fy
    if not (math.isfinite(fx + fy) and math.isfinite(h.state.motor_N[0] + h.state.motor_N[1] + h.state.hold_N)):
        return False
    for i in range(2):
        h.psi_N[i], h.push_N[i] = h.gain * h.state.psi_N[i], h.gain * h.state.motor_N[i]
    holds = h.mode != ACTIVE and h.state.stuck == 1 and h.state.hold_N > 0.0
    h.hold_N = h.gain * h.state.hold_N if holds else 0.0
    return True


@kernel
def share_out(h: PlaneHostRecord) -> None:
    """Set the commands of brakes and motors for the force."""
    if h.hold_N > 0.0:
        hold(h.control, h.split, h.pose, h.hold_N, h.hand_Nm)
    else:
        _compensate_inertia(h)
        slip(h.control, h.split, h.pose, h.psi_N, h.push_N, h.v_rad_s, h.rate_rad_s2, h.hand_Nm)


@kernel
def measure_plane(mechanism: MechanismFunction, h: PlaneHostRecord) -> None:
    """Set pose, speeds and the law's input from the encoders' counts and the transducers."""
    window = min(h.window_cycles, h.cycle)
    for i in range(JOINTS):
        moved = h.counts[i] - h.track[(h.cycle - window) % TRACK, i] if window > 0 else 0
        h.v_rad_s[i] = moved * h.count_rad[i] / (window * h.control.period_s) if window > 0 else 0.0
        h.rate_rad_s2[i] = _rate(h, i)
        h.track[h.cycle % TRACK, i] = h.counts[i]
        h.pose.q_rad[i] = h.start_rad[i] + h.counts[i] * h.count_rad[i]
    locate(mechanism, h.mechanism, h.pose)
    h.condition = condition(h.pose)
    a, b, d, e = h.pose.jacobian[0, 0], h.pose.jacobian[0, 1], h.pose.jacobian[1, 0], h.pose.jacobian[1, 1]
    determinant = a * e - b * d
    h.track_m[h.cycle % TRACK, 0], h.track_m[h.cycle % TRACK, 1] = h.pose.x_m[0], h.pose.x_m[1]
    motion = h.motion
    motion.dt_s = h.control.period_s
    motion.x_m[0], motion.x_m[1] = h.pose.x_m[0], h.pose.x_m[1]
    v1, v2 = _soon(h, 0), _soon(h, 1)
    motion.v_m_s[0], motion.v_m_s[1] = a * v1 + b * v2, d * v1 + e * v2
    if h.mode != ACTIVE:
        v1, v2 = _mean_speed(h, 0), _mean_speed(h, 1)
        _steady(h, a * v1 + b * v2, d * v1 + e * v2)
    motion.hand_N[0] = (e * h.hand_Nm[0] - d * h.hand_Nm[1]) / determinant
    motion.hand_N[1] = (a * h.hand_Nm[1] - b * h.hand_Nm[0]) / determinant
    h.cycle += 1


@kernel
def _rate(h: PlaneHostRecord, joint: int) -> float:
    """Return the change of a joint's speed over ``turn_cycles`` [rad/s^2].

    This time is long enough to smooth the encoder's counts, and short enough to follow a turning motion.
    """
    window, back = h.window_cycles, h.turn_cycles
    if back <= 0 or h.cycle < back + window:
        return 0.0
    moved = h.track[(h.cycle - back) % TRACK, joint] - h.track[(h.cycle - back - window) % TRACK, joint]
    earlier = moved * h.count_rad[joint] / (window * h.control.period_s)
    return (h.v_rad_s[joint] - earlier) / (back * h.control.period_s)


@kernel
def _compensate_inertia(h: PlaneHostRecord) -> None:
    """Set the torques that move a part of the arm's inertia in place of the hand.

    The arm is a mass at the tip and the inertias of the joints. The accelerations are second differences of the
    encoders' counts, and of the tip's positions: so the latter contains the centripetal part. A spring that
    pushes back needs the whole inertia for its stability, and so nothing is compensated there.
    """
    c, s, back, last = h.control, h.split, h.bend_cycles, h.cycle - 1
    s.inertia_Nm[0] = s.inertia_Nm[1] = 0.0
    if back <= 0 or last < 2 * back or h.push_N[0] != 0.0 or h.push_N[1] != 0.0:
        return
    now, middle, before = last % TRACK, (last - back) % TRACK, (last - 2 * back) % TRACK
    per_s2 = h.gain / (back * c.period_s) ** 2
    q1 = (h.track[now, 0] - 2 * h.track[middle, 0] + h.track[before, 0]) * h.count_rad[0] * per_s2
    q2 = (h.track[now, 1] - 2 * h.track[middle, 1] + h.track[before, 1]) * h.count_rad[1] * per_s2
    fx = c.tip_mass_kg * (h.track_m[now, 0] - 2.0 * h.track_m[middle, 0] + h.track_m[before, 0]) * per_s2
    fy = c.tip_mass_kg * (h.track_m[now, 1] - 2.0 * h.track_m[middle, 1] + h.track_m[before, 1]) * per_s2
    own, jacobian = c.inertia_kg_m2, h.pose.jacobian
    s.inertia_Nm[0] = own[0] * q1 + own[1] * q2 + jacobian[0, 0] * fx + jacobian[1, 0] * fy
    s.inertia_Nm[1] = own[1] * q1 + own[2] * q2 + jacobian[0, 1] * fx + jacobian[1, 1] * fy


@kernel
def _soon(h: PlaneHostRecord, joint: int) -> float:
    """Return a joint's speed at the time when the commands act; a joint at rest stays there."""
    v = h.v_rad_s[joint]
    return v + h.rate_rad_s2[joint] * h.control.lead_s if v != 0.0 else v


@kernel
def _mean_speed(h: PlaneHostRecord, joint: int) -> float:
    """Return a joint's mean speed over ``turn_cycles`` [rad/s]."""
    back = min(h.turn_cycles, h.cycle)
    if back <= 0:
        return 0.0
    moved = h.counts[joint] - h.track[(h.cycle - back) % TRACK, joint]
    return moved * h.count_rad[joint] / (back * h.control.period_s)


@kernel
def _steady(h: PlaneHostRecord, mean_x_m_s: float, mean_y_m_s: float) -> None:
    """Turn the velocity of a slow tip towards its mean over ``turn_cycles``, and keep its size.

    A force c against the direction of motion is a damper c/|v| across it. Rendered by motors with the delay
    T it shakes a mass m if c/|v| is above about m/(2 T). Below that speed a share of the change counts, so that
    the damper of fast changes stays at this bound.
    """
    motion = h.motion
    x, y = motion.v_m_s[0], motion.v_m_s[1]
    speed, mean = math.hypot(x, y), math.hypot(mean_x_m_s, mean_y_m_s)
    slow = SLOW_M_S_N * math.hypot(h.state.psi_N[0], h.state.psi_N[1])
    if speed >= slow or x * mean_x_m_s + y * mean_y_m_s <= SMOOTH_COSINE * speed * mean:
        return
    share = speed / slow
    x, y = share * x + (1.0 - share) * mean_x_m_s, share * y + (1.0 - share) * mean_y_m_s
    size = math.hypot(x, y)
    motion.v_m_s[0], motion.v_m_s[1] = x * speed / size, y * speed / size
