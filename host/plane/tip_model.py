r"""The local model of an arm's tip in the cycle, compiled: wall, spring, field and force profile beside the law.

As on one axis (`host.world.local_model`), with vectors. With the normal n out of the wall, the tip at x, its
velocity v, the wall's point :math:`x_w` and the spring's :math:`x_s`:

.. math:: \psi_{el} = \underbrace{-n K_w p}_{p > 0} + \mathrm{sat}(K_s (x - x_s)) - (a + B x), \qquad
          p = n \cdot (x_w - x)

The part that pushes is the motors' (``push_N``). Where the motors of a joint are too weak for it, all of it
is made smaller by one factor, so that its direction stays. The rest, and the damping, go the way of the
law's friction: brakes resist, and motors give what the brakes cannot (`host.plane.brake_split`).

A field's matrix need not be symmetric. What such a field gives on a closed path, the hand has not put in:
it counts as the motors' net work (`unpaid`).

    w : the `LocalModelRecord` of the first joint        m : the `ModelRecord` in use
    plane : the `PlaneHostRecord`
"""

from __future__ import annotations

import math

from coulombus.host.laws.law import LawRecord
from coulombus.host.plane.plane_host_record import PlaneHostRecord
from coulombus.host.world.local_model import PASSIVE, advance_model, parameter_of, sampled
from coulombus.host.world.records import OFFERS, LocalModelRecord, ModelParts
from coulombus.host.world.softening import come_back, field_stiffness
from coulombus.kernels.decorator import kernel
from coulombus.rigs.kinematics.mechanisms import JOINTS

__all__ = ["add_tip_model", "end_tip_model", "follow_tip_model", "resist_at_rest", "unpaid"]

WALL, SPRING, FIELD = int(ModelParts.WALL), int(ModelParts.SPRING), int(ModelParts.FIELD)
PARAMETERS = int(ModelParts.PARAMETERS)


@kernel
def follow_tip_model(w: LocalModelRecord, plane: PlaneHostRecord, law: LawRecord) -> None:
    """Begin a cycle: advance the model, and set the parameters of the law in the plane from those of the rig."""
    if advance_model(w):
        w.field_from_m[0], w.field_from_m[1] = plane.motion.x_m[0], plane.motion.x_m[1]
    m = w.offered[w.taken % OFFERS]
    if m.parts & PARAMETERS:
        for k in range(plane.law.user.shape[0]):
            plane.law.user[k] = parameter_of(m, 4 + k, law.user[k], w.share)


@kernel
def unpaid(w: LocalModelRecord, plane: PlaneHostRecord) -> float:
    """Return the energy that wall, spring and field have given since the last cycle, and the hand had not stored [J].

    Nothing is kept beyond what they can return: a spring that a program moves does net work.
    """
    x, y = plane.motion.x_m[0], plane.motion.x_m[1]
    taken_J = w.elastic_N[0] * (x - w.tip_m[0]) + w.elastic_N[1] * (y - w.tip_m[1])
    w.tip_m[0], w.tip_m[1] = x, y
    stored_J = w.stored_J + taken_J
    w.stored_J = min(max(stored_J, 0.0), w.most_J)
    return max(-stored_J, 0.0)


@kernel
def _elastic(w: LocalModelRecord, x: float, y: float) -> tuple[float, float]:
    """Return what wall, spring and field exert at a point [N]; set the energy that they can return at most."""
    m, px, py, most_J = w.offered[w.taken % OFFERS], 0.0, 0.0, 0.0
    if m.parts & WALL:
        nx, ny = m.plane_wall_normal[0], m.plane_wall_normal[1]
        depth = nx * (m.plane_wall_point_m[0] - x) + ny * (m.plane_wall_point_m[1] - y)
        if depth > 0.0:
            wall_N = (1.0 - w.softened) * m.plane_wall_K_N_m * depth
            px -= wall_N * nx
            py -= wall_N * ny
            most_J += wall_N * depth
    if m.parts & SPRING:
        ex, ey = x - m.plane_spring_point_m[0], y - m.plane_spring_point_m[1]
        away = math.hypot(ex, ey)
        spring_N = min((1.0 - w.softened) * m.plane_spring_K_N_m * away, m.plane_spring_most_N)
        if away > 0.0:
            px += spring_N * ex / away
            py += spring_N * ey / away
        most_J += spring_N * away
    if m.parts & FIELD:
        fx = m.plane_field_N[0] + m.plane_field_N_m[0] * x + m.plane_field_N_m[1] * y
        fy = m.plane_field_N[1] + m.plane_field_N_m[2] * x + m.plane_field_N_m[3] * y
        if field_stiffness(m) > 0.0:
            fx, fy = (1.0 - w.softened) * fx, (1.0 - w.softened) * fy
        px -= fx
        py -= fy
        most_J += math.hypot(fx, fy) * math.hypot(x - w.field_from_m[0], y - w.field_from_m[1])
    w.most_J = w.share * most_J
    return w.share * px, w.share * py


@kernel
def _moving(w: LocalModelRecord, plane: PlaneHostRecord, x: float, y: float) -> tuple[float, float, float, float]:
    """Return the damping of wall, spring and field at a point [N], and what drives: the profile, and the field's other part.

    Of a field's force by the velocity, the part along the velocity damps where it opposes it. The rest drives.
    """
    m, dx, dy = w.offered[w.taken % OFFERS], 0.0, 0.0
    vx, vy = plane.motion.v_m_s[0], plane.motion.v_m_s[1]
    profile_N = sampled(w)
    ax, ay = -profile_N * m.profile_direction[0], -profile_N * m.profile_direction[1]
    if m.parts & WALL:
        nx, ny = m.plane_wall_normal[0], m.plane_wall_normal[1]
        depth = nx * (m.plane_wall_point_m[0] - x) + ny * (m.plane_wall_point_m[1] - y)
        if depth > 0.0:  # the wall never pulls
            wall_N = max(-m.plane_wall_B_Ns_m * (nx * vx + ny * vy), -m.plane_wall_K_N_m * depth)
            dx -= wall_N * nx
            dy -= wall_N * ny
    if m.parts & SPRING:
        speed = math.hypot(vx, vy)
        spring_N = min(m.plane_spring_B_Ns_m * speed, m.plane_spring_most_N)
        if speed > 0.0:
            dx += spring_N * vx / speed
            dy += spring_N * vy / speed
    if m.parts & FIELD:
        fx = m.plane_field_Ns_m[0] * vx + m.plane_field_Ns_m[1] * vy
        fy = m.plane_field_Ns_m[2] * vx + m.plane_field_Ns_m[3] * vy
        square = vx * vx + vy * vy
        along = min((fx * vx + fy * vy) / square, 0.0) if square > 0.0 else 0.0
        dx -= along * vx
        dy -= along * vy
        ax -= fx - along * vx
        ay -= fy - along * vy
    damped = w.share * (1.0 - w.softened)
    return damped * dx, damped * dy, w.share * ax, w.share * ay


@kernel
def _deliverable_share(plane: PlaneHostRecord, x: float, y: float) -> float:
    """Return the share of a force (x, y) that the motors can exert beside the law's push, 0 to 1."""
    deliverable = 1.0
    for i in range(JOINTS):
        a, b = plane.pose.jacobian[0, i], plane.pose.jacobian[1, i]
        room_Nm = max(plane.control.motor_limit_Nm[i] - abs(a * plane.push_N[0] + b * plane.push_N[1]), 0.0)
        torque_Nm = abs(a * x + b * y)
        if torque_Nm > room_Nm:
            deliverable = min(deliverable, room_Nm / torque_Nm)
    return deliverable


@kernel
def add_tip_model(w: LocalModelRecord, plane: PlaneHostRecord) -> None:
    """Weigh the law's force, and add the model's to it."""
    for i in range(2):
        plane.psi_N[i] *= w.law_share
        plane.push_N[i] *= w.law_share
    plane.hold_N *= w.law_share
    x, y = plane.motion.x_m[0], plane.motion.x_m[1]
    ahead_x, ahead_y = x + plane.motion.v_m_s[0] * w.ahead_s, y + plane.motion.v_m_s[1] * w.ahead_s
    ex, ey = _elastic(w, ahead_x, ahead_y)
    dx, dy, ax, ay = _moving(w, plane, ahead_x, ahead_y)
    deliverable = (
        0.0 if w.mode == PASSIVE else _deliverable_share(plane, plane.gain * (ex + ax), plane.gain * (ey + ay))
    )
    w.psi_N[0], w.psi_N[1] = plane.gain * (ex + ax + dx), plane.gain * (ey + ay + dy)
    w.push_N[0], w.push_N[1] = plane.gain * deliverable * (ex + ax), plane.gain * deliverable * (ey + ay)
    m = w.offered[w.taken % OFFERS]
    constant = w.share if m.parts & FIELD and field_stiffness(m) == 0.0 else 0.0
    w.driven_N[0] = plane.gain * deliverable * (ax - constant * m.plane_field_N[0])
    w.driven_N[1] = plane.gain * deliverable * (ay - constant * m.plane_field_N[1])
    sx, sy = _elastic(w, x, y)
    w.elastic_N[0], w.elastic_N[1] = plane.gain * deliverable * sx, plane.gain * deliverable * sy
    if deliverable > 0.0:
        w.demand = max(w.demand, 1.0 / deliverable)
    come_back(w, sx != 0.0 or sy != 0.0)
    w.clipped += 1 if w.mode != PASSIVE and deliverable < 1.0 else 0
    for i in range(2):
        plane.psi_N[i] += w.psi_N[i]
        plane.push_N[i] += w.push_N[i]


@kernel
def resist_at_rest(w: LocalModelRecord, plane: PlaneHostRecord) -> None:
    """Let motors push and brakes resist at a joint at rest, whose brake has the level of the law alone.

    There the direction of the hand's torque decides what resists.
    """
    s = plane.split
    holds = plane.hold_N > 0.0
    for i in range(JOINTS):
        a, b = plane.pose.jacobian[0, i], plane.pose.jacobian[1, i]
        push_Nm = a * w.push_N[0] + b * w.push_N[1]
        if holds:
            s.motor_Nm[i] = s.push_Nm[i] = -push_Nm
        left_Nm = a * w.psi_N[0] + b * w.psi_N[1] - push_Nm
        if (holds or plane.v_rad_s[i] == 0.0) and left_Nm * plane.hand_Nm[i] > 0.0:
            s.brake_Nm[i] = min(s.brake_Nm[i] + abs(left_Nm), plane.control.brake_limit_Nm[i])


@kernel
def end_tip_model(w: LocalModelRecord) -> None:
    """Exert nothing: the arm does not display."""
    for i in range(2):
        w.psi_N[i] = w.push_N[i] = w.elastic_N[i] = 0.0
