r"""Split of a force in the plane between the brakes and motors of two joints.

The law gives :math:`\psi`, and the hand feels :math:`F = -\psi`. The torques of the joints are
:math:`\tau = J^T F`. A joint's own friction :math:`f_i` acts as a brake that is always on.

In slip, with the direction :math:`s_i = \mathrm{sgn}\,\dot q_i`:

.. math::

    b_i &= \max(0, -\tau_i s_i - f_i)\,\min\left(1, \frac{|\dot q_i|}{T_r |\ddot q_i|}\right) \\
    \tau_{m,i} &= \tau_i + \hat s_i (\hat b_i + f_i)

:math:`\hat b_i` is the torque of brake i in the host's model: the set-point after the bus delay, the coil's
lag and the fluid's lag, at the end of the cycle in which the commands act. So the motors give the part that
the brakes do not give: while the brakes lag, and where a brake would have to push. The second factor is
below 1 only for a joint that comes to rest within :math:`T_r`. Its brake is released before, because a
brake that lags behind a reversal pulls in the wrong direction. :math:`\hat s_i` is the direction at the
time when the commands act, :math:`\mathrm{sgn}(\dot q_i + \ddot q_i T_l)`, because the measured speed is a
few milliseconds old. A joint at rest while the other joint moves has no direction; its motor gives the
whole torque, and compensates the friction in the direction in which hand and motor turn the joint:
:math:`\hat s_i = \mathrm{sat}(8 (\tau_{h,i} + \tau_i)/f_i)`. Without motors (passive) the second factor is 1.

At rest, under the hand's force :math:`F_h` with the joint torques :math:`\tau_h = J^T F_h`:

.. math::

    b_i = |\tau_{h,i}| + (F_s - |F_h|)\,\|J_i\| - f_i \quad (|F_h| \le F_s), \qquad
    b_i = |\tau_{h,i}|\,F_s/|F_h| - f_i \quad (|F_h| > F_s)

The box of the joints' torques always contains the disc :math:`|F_h| \le F_s`, because
:math:`|J_i \cdot \Delta F| \le \|J_i\||\Delta F|`. At the edge of the disc both joints slip together.

Three bounds always hold:

- No command exceeds its limit.
- A set-point is never negative.
- The motors' torques and the brakes' expected torques together absorb power. If a limit would make the
  sum active, the pushing torques are reduced until the power is 0 (``push_N``, the spring of a wall, is
  exempt). If the motors have given more energy than ``passivity_J`` above the absorbed energy, they no
  longer push.

    c : the `SplitControlRecord`      s : the `SplitStateRecord`      pose : a `PoseRecord`
"""

from __future__ import annotations

import math

from coulombus.host.plane.plane_host_record import SplitControlRecord, SplitStateRecord
from coulombus.kernels.decorator import kernel
from coulombus.kernels.records import FloatField, Floats
from coulombus.rigs.kinematics.mechanisms import JOINTS, PoseRecord

__all__ = ["expect_brakes", "hold", "observe", "release", "slip"]

REST_GAIN = 8.0
"""A joint at rest has its friction compensated in full from this part of the friction on."""
FLUID_LEAD, COIL_LEAD = 3.0, 2.0
"""Gains of the lead compensation of a brake's lags (`host.cycle.brake_model`)."""


@kernel
def _lagged(
    c: SplitControlRecord, joint: int, coil_Nm: float, torque_Nm: float, setpoint_Nm: float
) -> tuple[float, float]:
    """Return a brake's torque behind the coil's lag, and behind both lags, a cycle later.

    The fluid follows the mean of the coil's torque in the cycle, or the new torque without a coil lag.
    """
    coil_step = c.coil_step[joint]
    coil = coil_Nm + coil_step * (setpoint_Nm - coil_Nm)
    seen = coil if coil_step >= 1.0 else 0.5 * (coil_Nm + coil)
    return coil, torque_Nm + c.fluid_step[joint] * (seen - torque_Nm)


@kernel
def _sense(v_rad_s: float) -> float:
    """Return the direction of a speed: 1, -1, or 0 at rest."""
    return 1.0 if v_rad_s > 0.0 else -1.0 if v_rad_s < 0.0 else 0.0


@kernel
def _lead(c: SplitControlRecord, s: SplitStateRecord, joint: int, level_Nm: float) -> float:
    """Return the set-point that brings a brake to a level faster than its lags."""
    seen, wish = s.expected_Nm[joint], level_Nm
    if c.fluid_step[joint] < 1.0:
        wish = seen + FLUID_LEAD * (level_Nm - seen)
    if c.coil_step[joint] < 1.0:
        wish = s.coil_Nm[joint] + COIL_LEAD * (wish - s.coil_Nm[joint])
    return min(max(wish, 0.0), c.brake_limit_Nm[joint])


@kernel
def expect_brakes(c: SplitControlRecord, s: SplitStateRecord) -> None:
    """Step the brakes' expected torques by one cycle; call it once a cycle, before `slip` or `hold`."""
    for i in range(JOINTS):
        s.coil_Nm[i], s.expected_Nm[i] = _lagged(c, i, s.coil_Nm[i], s.expected_Nm[i], s.sent_Nm[i])
        s.sent_Nm[i], s.motor_sent_Nm[i] = s.brake_Nm[i], s.motor_Nm[i]


@kernel
def _ahead(c: SplitControlRecord, s: SplitStateRecord, joint: int) -> float:
    """Return a brake's torque at the end of the cycle in which the commands of this cycle act.

    They act from the next cycle's start to its end, half a cycle later on average, and a motor lags by about
    another half.
    """
    coil, torque = _lagged(c, joint, s.coil_Nm[joint], s.expected_Nm[joint], s.sent_Nm[joint])
    return _lagged(c, joint, coil, torque, s.brake_Nm[joint])[1]


@kernel
def observe(c: SplitControlRecord, s: SplitStateRecord, v_rad_s: FloatField) -> None:
    """Add the energies of the last cycle: each motor's work, and the absorbed energy of motors, brakes and
    friction.

    Call it once a cycle, before `expect_brakes`.
    """
    for i in range(JOINTS):
        given = s.motor_sent_Nm[i] * v_rad_s[i] * c.period_s
        s.motor_J[i] += given
        s.taken_J += (s.expected_Nm[i] + c.friction_Nm[i]) * abs(v_rad_s[i]) * c.period_s - given


@kernel
def slip(
    c: SplitControlRecord,
    s: SplitStateRecord,
    pose: PoseRecord,
    psi_N: Floats,
    push_N: Floats,
    v_rad_s: FloatField,
    rate_rad_s2: FloatField,
    hand_Nm: FloatField,
) -> None:
    """Set the commands for a moving tip.

    Parameters
    ----------
    psi_N : the law's force, against the motion
    push_N : the part of it that pushes back independently of the motion, for the motors alone
    v_rad_s, rate_rad_s2 : the joints' speeds and accelerations
    hand_Nm : the hand's torques on the joints, from the transducers
    """
    power = 0.0
    pushing = 0.0
    for i in range(JOINTS):
        a, b = pose.jacobian[0, i], pose.jacobian[1, i]
        push = -(a * push_N[0] + b * push_N[1])
        torque = -(a * psi_N[0] + b * psi_N[1]) - push
        v = v_rad_s[i]
        sense = _sense(v)
        if v == 0.0 and v_rad_s[1 - i] != 0.0 and c.friction_Nm[i] > 0.0:
            soon = min(max(REST_GAIN * (hand_Nm[i] + torque + push) / c.friction_Nm[i], -1.0), 1.0)
        else:
            soon = _sense(v + rate_rad_s2[i] * c.lead_s)
        part, soonest = 1.0, c.reversal_s[i] * abs(rate_rad_s2[i])
        if c.motor_limit_Nm[i] > 0.0 and v * rate_rad_s2[i] < 0.0 and abs(v) < soonest:
            part = abs(v) / soonest
        level = max(-torque * sense - c.friction_Nm[i], 0.0) * part
        s.brake_Nm[i] = min(level, c.brake_limit_Nm[i])
        s.clipped[i] = 1 if c.brake_limit_Nm[i] > 0.0 and level > c.brake_limit_Nm[i] else 0
        s.ahead_Nm[i] = _ahead(c, s, i)
        passive = -sense * (s.ahead_Nm[i] + c.friction_Nm[i])
        most = max(c.motor_limit_Nm[i] - abs(push), 0.0)
        rest = torque + soon * (s.ahead_Nm[i] + c.compensation_Nm[i]) + s.inertia_Nm[i]
        s.motor_Nm[i] = min(max(rest, -most), most)
        if c.motor_limit_Nm[i] > 0.0 and abs(rest) > most:
            s.clipped[i] = 1
        power += (s.motor_Nm[i] + passive) * v
        pushing += max(s.motor_Nm[i] * v, 0.0)
    keep = _kept_share(c, s, power, pushing)
    for i in range(JOINTS):
        if s.motor_Nm[i] * v_rad_s[i] > 0.0:
            s.motor_Nm[i] *= keep
        push = -(pose.jacobian[0, i] * push_N[0] + pose.jacobian[1, i] * push_N[1])
        s.push_Nm[i] = min(max(push, -c.motor_limit_Nm[i]), c.motor_limit_Nm[i])
        s.motor_Nm[i] += s.push_Nm[i]


@kernel
def _kept_share(c: SplitControlRecord, s: SplitStateRecord, power: float, pushing: float) -> float:
    """Return the share of the pushing torques with which the joints absorb power.

    Parameters
    ----------
    power : power of motors, brakes and friction on the joints [W]
    pushing : the part of it that motors add to the motion [W]
    """
    owed = s.motor_J[0] + s.motor_J[1] - max(s.taken_J, 0.0) > c.passivity_J
    if pushing <= 0.0 or not (power > 0.0 or owed):
        return 1.0
    s.withheld += 1
    return 0.0 if owed else max(1.0 - power / pushing, 0.0)


@kernel
def hold(c: SplitControlRecord, s: SplitStateRecord, pose: PoseRecord, level_N: float, hand_Nm: FloatField) -> None:
    """Set the commands for a tip at rest, which the brakes hold up to a limit of the hand's force.

    Parameters
    ----------
    level_N : F_s, against the direction in which the hand pushes
    hand_Nm : the hand's torques on the joints, from the transducers
    """
    a, b, d, e = pose.jacobian[0, 0], pose.jacobian[0, 1], pose.jacobian[1, 0], pose.jacobian[1, 1]
    determinant = a * e - b * d
    fx = (e * hand_Nm[0] - d * hand_Nm[1]) / determinant
    fy = (a * hand_Nm[1] - b * hand_Nm[0]) / determinant
    force = math.hypot(fx, fy)
    spare = max(level_N - force, 0.0)
    share = level_N / force if force > level_N else 1.0
    for i in range(JOINTS):
        length = math.hypot(pose.jacobian[0, i], pose.jacobian[1, i])
        level = share * abs(hand_Nm[i]) + spare * length - c.friction_Nm[i]
        s.brake_Nm[i] = _lead(c, s, i, min(max(level, 0.0), c.brake_limit_Nm[i]))
        s.clipped[i] = 1 if level > c.brake_limit_Nm[i] else 0
        s.motor_Nm[i] = s.push_Nm[i] = 0.0


@kernel
def release(s: SplitStateRecord) -> None:
    """Set no command."""
    for i in range(JOINTS):
        s.brake_Nm[i] = s.motor_Nm[i] = s.push_Nm[i] = 0.0
        s.clipped[i] = 0
