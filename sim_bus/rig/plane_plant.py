r"""True model of two links in a plane with brakes, motors and a hand: coupled, with exact stick-slip.

With the mechanism's angles :math:`\alpha`, their speeds v and the hand's mass at the tip

.. math::

    M(\alpha_2)\,\dot v + c(\alpha_2, v) + B v = J^T F_h + \tau_m - \lambda, \qquad
    M = \begin{pmatrix} a_1 + 2k\cos\alpha_2 & a_2 + k\cos\alpha_2 \\ \cdot & a_3 \end{pmatrix}

with the hand's :math:`F_h = f + K_o (x_d - x) + B_o (\dot x_d - \dot x)` in two directions, and the joints'
friction and brakes :math:`\lambda_i \in L_i\,\mathrm{Sgn}(v_i)`. They are solved together and never
approximated: a sticking joint has the speed 0.

A step is the midpoint rule with a discrete gradient: with :math:`w = (v_0 + v_1)/2`,
:math:`N = k\,((2,1),(1,0))` and :math:`D = \Delta\cos\alpha_2/\Delta\alpha_2`

.. math::

    \tfrac12(M_0 + M_1)(v_1 - v_0)/h + D\,w_2 N w - \tfrac12 D\,(2 w^T N w - Y)\,e_2 = \text{torques}, \qquad
    Y = \tfrac12 (v_0^T N v_0 + v_1^T N v_1)

so that the works of all torques, torque times mean speed, equal the change of the kinetic energy to
rounding, at any step size. If a joint's speed changes its sign inside a step, the step ends there;
then the joint sticks or continues to slip. Of nine choices of sticking joints only one is
consistent.

Source of the discrete gradient: O. Gonzalez, Time integration and discrete Hamiltonian systems,
J. Nonlinear Science 6, 1996, doi:10.1007/BF02440162.

    p : the `PlanePlantRecord`
"""

from __future__ import annotations

import math

from coulombus.kernels.decorator import kernel
from coulombus.sim_bus.rig.records import PlanePlantRecord

__all__ = ["advance_plane", "kinetic_J", "step_plane", "tip_force"]

ITERATIONS = 8
CLOSE = 1e-15
"""Change of the speeds at which the iteration of a step ends [rad/s]."""
PARTS = 6
"""Largest number of parts of a step."""
SLACK = 1.0 + 1e-12
STICK = 2
"""Mode of a joint that stands at the end of a step, regardless of the required friction."""


@kernel
def kinetic_J(p: PlanePlantRecord, v1: float, v2: float, cosine: float) -> float:
    """Return the kinetic energy of hand and device together at two speeds [J]."""
    m11, m12 = p.a1 + 2.0 * p.k * cosine, p.a2 + p.k * cosine
    return float(0.5 * (m11 * v1 * v1 + 2.0 * m12 * v1 * v2 + p.a3 * v2 * v2))


@kernel
def _torques(p: PlanePlantRecord, dt: float, w1: float, w2: float) -> None:
    """Set the hand's force and its torques at the middle of a step with the mean speeds w."""
    first = p.angle[0] + 0.5 * dt * w1
    both = first + p.angle[1] + 0.5 * dt * w2
    x1, y1 = p.l1 * math.cos(first), p.l1 * math.sin(first)
    x2, y2 = p.l2 * math.cos(both), p.l2 * math.sin(both)
    vx, vy = -(y1 + y2) * w1 - y2 * w2, (x1 + x2) * w1 + x2 * w2
    t = p.part_s + 0.5 * dt
    for i in range(2):
        place = x1 + x2 if i == 0 else y1 + y2
        speed = vx if i == 0 else vy
        p.hand_N[i] = (
            p.stiffness[i] * (p.goal_m[i] + t * p.goal_m_s[i] - place)
            + p.damping[i] * (p.goal_m_s[i] - speed)
            + p.push_N[i]
        )
    p.hand_Nm[0] = -(y1 + y2) * p.hand_N[0] + (x1 + x2) * p.hand_N[1]
    p.hand_Nm[1] = -y2 * p.hand_N[0] + x2 * p.hand_N[1]


@kernel
def _solve(p: PlanePlantRecord, dt: float, mode1: int, mode2: int) -> None:
    """Set the speeds ``v1`` at the end of a step and the friction ``load`` during it.

    A mode is -1 or 1 for a joint that slips in this direction, 0 or `STICK` for a joint that stands at the end.
    """
    u1, u2 = p.v[0], p.v[1]
    n1, n2 = (u1, u2) if mode1 * mode1 + mode2 * mode2 > 0 else (0.0, 0.0)
    cos0 = math.cos(p.angle[1])
    before = 2.0 * u1 * u1 + 2.0 * u1 * u2
    for _ in range(ITERATIONS):
        w1, w2 = 0.5 * (u1 + n1), 0.5 * (u2 + n2)
        turn = 0.5 * dt * w2
        sinc = math.sin(turn) / turn if abs(turn) > 1e-9 else 1.0
        slope = -math.sin(p.angle[1] + turn) * sinc
        cosine = cos0 + slope * turn  # mean of both ends
        m11, m12, m22 = p.a1 + 2.0 * p.k * cosine, p.a2 + p.k * cosine, p.a3
        nw1, nw2 = p.k * (2.0 * w1 + w2), p.k * w1
        middle = w1 * nw1 + w2 * nw2
        mean = 0.5 * p.k * (before + 2.0 * n1 * n1 + 2.0 * n1 * n2)
        _torques(p, dt, w1, w2)
        r1 = p.hand_Nm[0] + p.motor[0] - p.viscous[0] * w1 - slope * w2 * nw1
        r2 = p.hand_Nm[1] + p.motor[1] - p.viscous[1] * w2 - slope * w2 * nw2 + 0.5 * slope * (2.0 * middle - mean)
        b1 = dt * (r1 - mode1 * p.level[0]) if mode1 * mode1 == 1 else 0.0
        b2 = dt * (r2 - mode2 * p.level[1]) if mode2 * mode2 == 1 else 0.0
        if mode1 * mode1 == 1 and mode2 * mode2 == 1:
            determinant = m11 * m22 - m12 * m12
            d1, d2 = (m22 * b1 - m12 * b2) / determinant, (m11 * b2 - m12 * b1) / determinant
        elif mode1 * mode1 == 1:
            d2 = -u2
            d1 = (b1 - m12 * d2) / m11
        elif mode2 * mode2 == 1:
            d1 = -u1
            d2 = (b2 - m12 * d1) / m22
        else:
            d1, d2 = -u1, -u2
        p.load[0] = mode1 * p.level[0] if mode1 * mode1 == 1 else r1 - (m11 * d1 + m12 * d2) / dt
        p.load[1] = mode2 * p.level[1] if mode2 * mode2 == 1 else r2 - (m12 * d1 + m22 * d2) / dt
        change = abs(u1 + d1 - n1) + abs(u2 + d2 - n2)
        n1, n2 = u1 + d1, u2 + d2
        if change < CLOSE:
            break
    p.v_end[0] = 0.0 if mode1 * mode1 != 1 else n1
    p.v_end[1] = 0.0 if mode2 * mode2 != 1 else n2


@kernel
def _modes(p: PlanePlantRecord) -> int:
    """Return which joints slip at the begin of a step, and their directions: 3 (mode 1 + 1) + mode 2 + 1.

    A moving joint continues to slip. Of the choices for the standing joints only one is consistent: a starting
    joint moves in the direction of its acceleration, a sticking joint has a load within its level.
    """
    _torques(p, 0.0, p.v[0], p.v[1])
    cosine, sine = math.cos(p.angle[1]), math.sin(p.angle[1])
    m11, m12, m22 = p.a1 + 2.0 * p.k * cosine, p.a2 + p.k * cosine, p.a3
    v1, v2 = p.v[0], p.v[1]
    r1 = p.hand_Nm[0] + p.motor[0] - p.viscous[0] * v1 + p.k * sine * v2 * (2.0 * v1 + v2)
    r2 = p.hand_Nm[1] + p.motor[1] - p.viscous[1] * v2 - p.k * sine * v1 * v1
    fixed1 = 1 if v1 > 0.0 else -1 if v1 < 0.0 else 0
    fixed2 = 1 if v2 > 0.0 else -1 if v2 < 0.0 else 0
    determinant = m11 * m22 - m12 * m12
    for choice1 in range(1 if fixed1 != 0 else 3):
        s1 = fixed1 if fixed1 != 0 else choice1 if choice1 < 2 else -1
        for choice2 in range(1 if fixed2 != 0 else 3):
            s2 = fixed2 if fixed2 != 0 else choice2 if choice2 < 2 else -1
            f1, f2 = r1 - s1 * p.level[0], r2 - s2 * p.level[1]
            a1 = a2 = 0.0
            if s1 != 0 and s2 != 0:
                a1, a2 = (m22 * f1 - m12 * f2) / determinant, (m11 * f2 - m12 * f1) / determinant
            elif s1 != 0:
                a1 = f1 / m11
            elif s2 != 0:
                a2 = f2 / m22
            fits1 = fixed1 != 0 or (a1 * s1 > 0.0 if s1 != 0 else abs(f1 - m12 * a2) <= p.level[0] * SLACK)
            fits2 = fixed2 != 0 or (a2 * s2 > 0.0 if s2 != 0 else abs(f2 - m12 * a1) <= p.level[1] * SLACK)
            if fits1 and fits2:
                return 3 * (s1 + 1) + s2 + 1
    return 3 * (fixed1 + 1) + fixed2 + 1


@kernel
def _stops_after(p: PlanePlantRecord, dt: float, joint: int, modes: int) -> float:
    """Return the time at which the speed of a joint that changes its sign within a step is 0 [s]."""
    low, high = 0.0, dt
    f_low, f_high = p.v[joint], p.v_end[joint]
    t = dt
    for _ in range(4):
        t = low + (high - low) * f_low / (f_low - f_high)
        if not low < t < high:
            return min(max(t, 0.0), dt)
        _solve(p, t, modes // 3 - 1, modes % 3 - 1)
        f = p.v_end[joint]
        if f * f_low > 0.0:
            low, f_low = t, f
        else:
            high, f_high = t, f
        if abs(f) < 1e-13:
            break
    return t


@kernel
def _part(p: PlanePlantRecord, dt: float) -> float:
    """Advance by at most `dt` without a change of a speed's sign; return the remaining time [s]."""
    modes = _modes(p)
    mode1, mode2 = modes // 3 - 1, modes % 3 - 1
    _solve(p, dt, mode1, mode2)
    left = 0.0
    stop1 = mode1 != 0 and p.v_end[0] * mode1 < 0.0
    stop2 = mode2 != 0 and p.v_end[1] * mode2 < 0.0
    if stop1 or stop2:
        end1, end2 = p.v_end[0], p.v_end[1]
        t1 = _stops_after(p, dt, 0, modes) if stop1 and p.v[0] != 0.0 else 0.0 if stop1 else dt
        p.v_end[0], p.v_end[1] = end1, end2
        t2 = _stops_after(p, dt, 1, modes) if stop2 and p.v[1] != 0.0 else 0.0 if stop2 else dt
        t = min(t1, t2)
        if t <= 0.0:  # it would start against its own direction: it stands for this step
            t = dt
        left = dt - t
        _solve(p, t, STICK if stop1 and t1 <= t2 else mode1, STICK if stop2 and t2 <= t1 else mode2)
        dt = t
    _keep(p, dt)
    return left


@kernel
def _keep(p: PlanePlantRecord, dt: float) -> None:
    """Apply the end of a step: angles, speeds, torques, works."""
    if dt > 0.0:
        _transduce(p, dt)
    for i in range(2):
        w = 0.5 * (p.v[i] + p.v_end[i])
        way = w * dt
        standing = p.v[i] == 0.0 and p.v_end[i] == 0.0
        friction = (
            min(max(p.load[i], -p.inherent[i]), p.inherent[i])
            if standing
            else (p.load[i] * p.inherent[i] / p.level[i] if p.level[i] > 0.0 else 0.0)
        )
        p.friction_Nm[i] = -friction
        p.brake_Nm[i] = friction - p.load[i]
        p.angle[i] += way
        p.work_hand[i] += p.hand_Nm[i] * way
        p.work_motor[i] += p.motor[i] * way
        p.work_brake[i] += p.brake_Nm[i] * way
        p.work_friction[i] += p.friction_Nm[i] * way
        p.work_viscous[i] += p.viscous[i] * w * way
        p.v[i] = p.v_end[i]
    p.part_s += dt


@kernel
def _transduce(p: PlanePlantRecord, dt: float) -> None:
    """Set the transducers' readings: the hand's torques on the joints minus those that move its own mass."""
    w1, w2 = 0.5 * (p.v[0] + p.v_end[0]), 0.5 * (p.v[1] + p.v_end[1])
    x0, y0, vx0, vy0 = _tip(p, p.angle[0], p.angle[1], p.v[0], p.v[1])
    x1, y1, vx1, vy1 = _tip(p, p.angle[0] + dt * w1, p.angle[1] + dt * w2, p.v_end[0], p.v_end[1])
    fx, fy = p.hand_kg * (vx1 - vx0) / dt, p.hand_kg * (vy1 - vy0) / dt
    x, y = 0.5 * (x0 + x1), 0.5 * (y0 + y1)
    both = p.angle[0] + p.angle[1] + 0.5 * dt * (w1 + w2)
    x2, y2 = p.l2 * math.cos(both), p.l2 * math.sin(both)
    p.transduced_Nm[0] = p.hand_Nm[0] - (-y * fx + x * fy)
    p.transduced_Nm[1] = p.hand_Nm[1] - (-y2 * fx + x2 * fy)


@kernel
def _tip(p: PlanePlantRecord, angle1: float, angle2: float, v1: float, v2: float) -> tuple[float, float, float, float]:
    """Return position and velocity of the tip."""
    x2, y2 = p.l2 * math.cos(angle1 + angle2), p.l2 * math.sin(angle1 + angle2)
    x, y = p.l1 * math.cos(angle1) + x2, p.l1 * math.sin(angle1) + y2
    return x, y, -y * v1 - y2 * v2, x * v1 + x2 * v2


@kernel
def tip_force(p: PlanePlantRecord) -> None:
    """Set ``shown_N``: the force of motors, brakes and friction on the hand, at the present pose."""
    first, both = p.angle[0], p.angle[0] + p.angle[1]
    x2, y2 = p.l2 * math.cos(both), p.l2 * math.sin(both)
    x, y = p.l1 * math.cos(first) + x2, p.l1 * math.sin(first) + y2
    t1 = p.motor[0] + p.brake_Nm[0] + p.friction_Nm[0]
    t2 = p.motor[1] + p.brake_Nm[1] + p.friction_Nm[1]
    determinant = -y * x2 + y2 * x
    p.shown_N[0], p.shown_N[1] = (x2 * t1 - x * t2) / determinant, (y2 * t1 - y * t2) / determinant
    p.tip_m[0], p.tip_m[1] = x, y
    p.tip_m_s[0], p.tip_m_s[1] = -y * p.v[0] - y2 * p.v[1], x * p.v[0] + x2 * p.v[1]


@kernel
def step_plane(p: PlanePlantRecord) -> None:
    """Advance the plant by a step with constant torques of the motors and largest frictions (``motor``, ``level``)."""
    p.part_s = 0.0
    left = p.h
    for _part_number in range(PARTS):
        left = _part(p, left)
        if left <= 0.0:
            break


@kernel
def advance_plane(p: PlanePlantRecord, steps: int) -> None:
    """Advance the plant by `steps` of its steps with constant commands (``motor_want``, ``brake_want``), while
    the hand's target moves with ``goal_m_s``.
    """
    for _ in range(steps):
        for i in range(2):
            before = p.motor_lagged[i]
            p.motor_lagged[i] = p.motor_want[i] + (before - p.motor_want[i]) * p.motor_decay[i]
            p.motor[i] = 0.5 * (before + p.motor_lagged[i])
            p.coil[i] = p.brake_want[i] + (p.coil[i] - p.brake_want[i]) * p.coil_decay[i]
            p.fluid[i] = p.coil[i] + (p.fluid[i] - p.coil[i]) * p.fluid_decay[i]
            p.level[i] = p.inherent[i] + p.fluid[i]
        step_plane(p)
        for i in range(2):
            p.goal_m[i] += p.h * p.goal_m_s[i]
