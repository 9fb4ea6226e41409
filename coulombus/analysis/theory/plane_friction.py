r"""Coulomb friction in a plane, by brakes and motors on two coupled joints.

The tip moves with :math:`v = J\dot q`; the friction to be displayed is :math:`F = -c\,v/|v|`, at the
joints :math:`\tau = J^T F`. A brake gives only :math:`\tau_i \dot q_i \le 0`. Together the joints
absorb :math:`\tau\cdot\dot q = -c|v|`, so at most one of them must push.

Let :math:`j_1, j_2` be the columns of :math:`J` and :math:`\varphi` the angle between them, 0 to
:math:`\pi`. A motion at the angle :math:`\alpha` from :math:`j_1` has

.. math::

    \tau_1 = -c\,|j_1| \cos\alpha, \qquad
    \dot q_1 = \frac{|v| \sin(\varphi - \alpha)}{|j_1| \sin\varphi}

and the same with 1 and 2, :math:`\alpha` and :math:`\varphi - \alpha` exchanged. From the signs and the
extremes of the products follow, for any two links, and for any mechanism:

.. math::

    \text{share of wrong directions} &= |1 - 2\varphi/\pi| \\
    \text{worst angle} &= |\pi/2 - \varphi| \\
    \text{power of the motors} &\le \frac{c|v|}{2} \left(\frac{1}{\sin\varphi} - 1\right)

A direction is wrong if one brake would have to push. The worst angle is the least upper bound,
over all directions, of the angle between F and the nearest force that the brakes can give in that
motion (a cone, spanned by :math:`J^{-T}` of the torques against each joint's own speed). It is
approached where one joint is at rest. The lengths of the columns do not matter.

Two links of the same length, with :math:`q_2` counted from the first link (0: stretched out), have
:math:`\varphi = |q_2|/2`: a share of :math:`1 - q_2/180°` and a worst angle of :math:`90° - q_2/2`. At
90 degrees half of all directions is wrong, by up to 45 degrees; at 60 degrees two thirds are, a third
is right, and the worst angle is 60 degrees.

Source of the limits of brakes: C. Cho, J.-B. Song, M. Kim, Design and control of a planar haptic
device with passive actuators based on passive force manipulability ellipsoid (FME) analysis,
J. Robotic Systems 22(9), 2005, 475-486.

**Stuck hands** (`stuck_hands`): they should slide, and brakes hold them.

**Along a wall.** A wall without friction has the normal :math:`n` out of it and the tangent :math:`t`. A
hand presses on it with :math:`N` and pushes along it with :math:`T > 0` in the sense :math:`s = \pm 1`: it
should slide. With :math:`a = J^{-1} t` and :math:`b = J^{-1} n`, the joints turn with :math:`\dot q \sim s a`.
A brake on joint i gives the torque :math:`-L_i\,\mathrm{sgn}(s a_i)` and so the force
:math:`L_i J^{-T} e_i` of that sign. Its part along the normal is :math:`-L_i\,\mathrm{sgn}(s a_i)\,b_i`, and its
part along the motion :math:`-L_i |a_i|`. To bear N, joint i needs :math:`s a_i b_i < 0`, and resists the
motion like friction of the coefficient

.. math:: \mu_i = |a_i / b_i|.

The least coefficient of both joints is that of the wall in this sense. A hand that pushes within
:math:`\arctan\mu` of the normal is stuck. Where no joint has that sign, brakes bear N only by holding
both joints: stuck in all directions of that sense. Motors bear N without friction.

Here :math:`\mu_i = |\tan\delta_i|`, with the angle :math:`\delta_i` between the normal and the column of the
other joint's brake, so that the stuck shares of the pushes of both senses are linear in the wall's
direction. With the share :math:`w = |1 - 2\varphi/\pi|` of directions in which brakes alone are wrong
(`passive_display`), the stuck share of all pushes is :math:`\frac12 + \frac{w^2}{4}` in the mean over the walls,
and between :math:`\frac{1 - w}{2}` and :math:`\frac{1 + w}{2}`; along the share w of the walls the hand
slides in one sense only.

**Against friction.** Brakes at rest that hold a disc of forces :math:`|F| \le F_s` with constant levels
:math:`F_s |j_i|` hold the rhombus :math:`|j_i \cdot F| \le F_s |j_i|` around it. Its far corner is at
:math:`F_s / \min(\cos\frac\varphi2, \sin\frac\varphi2)`. A force of :math:`\kappa F_s` is held in the
directions farther than :math:`\beta = \arccos(1/\kappa)` from both columns, to either side:

.. math:: \frac{\max(0, \varphi - 2\beta) + \max(0, \pi - \varphi - 2\beta)}{\pi}.

The phenomenon is described by C. Cho, J.-B. Song, M. Kim, J. Robotic Systems 22(9), 2005, 475-486. These
equations are this project's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

__all__ = [
    "OVER",
    "Directions",
    "ForceEllipse",
    "Levels",
    "PassiveDisplay",
    "StuckHands",
    "directions",
    "force_ellipse",
    "largest_friction_N",
    "passive_display",
    "stuck_hands",
    "wall_coefficients",
]

Floats = npt.NDArray[np.float64]
SINGULAR_RAD = 1e-9
"""Angle below which the columns are collinear."""


@dataclass(frozen=True)
class PassiveDisplay:
    """Errors of brakes alone in a pose, and the motors' power needed instead.

    Attributes
    ----------
    columns_angle_rad : the angle between the Jacobian's columns
    share_wrong : share of the directions of motion in which brakes alone are wrong, 0 to 1
    worst_angle_deg : least upper bound of the angle to the nearest force that brakes can give
    motor_power_per_cv : the motors' largest power over c |v|; infinite in a singular pose
    """

    columns_angle_rad: float
    share_wrong: float
    worst_angle_deg: float
    motor_power_per_cv: float


def passive_display(jacobian: Floats) -> PassiveDisplay:
    """Return the errors of brakes alone in the pose with this Jacobian (2 x 2) [m/rad]."""
    first, second = jacobian[:, 0], jacobian[:, 1]
    across = abs(float(first[0] * second[1] - first[1] * second[0]))
    angle = math.atan2(across, float(first @ second))
    off = abs(math.pi / 2 - angle)
    singular = min(angle, math.pi - angle) < SINGULAR_RAD
    power = math.inf if singular else 0.5 * (1.0 / math.sin(angle) - 1.0)
    return PassiveDisplay(angle, off / (math.pi / 2), math.degrees(off), power)


class Levels(NamedTuple):
    """Maximum torques of each joint [Nm], two each."""

    brake_Nm: tuple[float, float]
    motor_Nm: tuple[float, float]


def largest_friction_N(jacobian: Floats, levels: Levels) -> dict[str, float]:
    r"""Return the largest isotropic friction [N] by mode.

    Motors alone must supply all of :math:`c|j_i|`. In hybrid the brakes supply it, and the motors
    at most :math:`c|j_i||\cos\varphi|`. Brakes alone display no isotropic friction unless the
    columns are at right angles; "hold" is the largest disc of forces that they hold at rest.
    """
    lengths = np.hypot(jacobian[0], jacobian[1])
    coupled = abs(math.cos(passive_display(jacobian).columns_angle_rad))
    with np.errstate(divide="ignore"):
        hold = float(min(np.asarray(levels.brake_Nm) / lengths))
        active = float(min(np.asarray(levels.motor_Nm) / lengths))
    hybrid = hold if coupled < SINGULAR_RAD else min(hold, active / coupled)
    return {"active": active, "passive": hold if coupled < SINGULAR_RAD else 0.0, "hybrid": hybrid, "hold": hold}


@dataclass(frozen=True)
class ForceEllipse:
    r"""Tip forces of joint torques with :math:`|\tau| \le 1` Nm, and their passive part.

    Attributes
    ----------
    semi_axes_N : the longer and the shorter semi-axis [N per Nm]
    direction_rad : direction of the longer one
    passive_area : share of the ellipse's area in directions in which brakes alone are correct
    """

    semi_axes_N: tuple[float, float]
    direction_rad: float
    passive_area: float


def force_ellipse(jacobian: Floats) -> ForceEllipse:
    """Return the force manipulability ellipse of a pose and its passive part.

    The ellipse is :math:`F^T J J^T F = 1`. Its passive part consists of the sectors of directions
    of motion -F in which both joints absorb power.
    """
    left, values, _ = np.linalg.svd(jacobian)
    longer = math.inf if values[1] == 0.0 else 1.0 / values[1]
    shorter = math.inf if values[0] == 0.0 else 1.0 / values[0]
    direction = math.atan2(left[1, 1], left[0, 1]) % math.pi
    angles = (np.arange(7200) + 0.5) * (2 * math.pi / 7200)
    unit = np.stack((np.cos(angles), np.sin(angles)))
    square = 1.0 / np.maximum(((jacobian.T @ unit) ** 2).sum(axis=0), 1e-300)
    right = np.ones(len(angles), bool)
    if math.isfinite(longer):
        right = ((jacobian.T @ unit) * np.linalg.solve(jacobian, unit) >= 0.0).all(axis=0)
    return ForceEllipse((longer, shorter), direction, float(square[right].sum() / square.sum()))


@dataclass(frozen=True)
class Directions:
    """Desired and displayed forces over the directions of motion, in a pose.

    Attributes
    ----------
    angle_rad : directions of motion
    wanted_N, active_N, passive_N, hybrid_N : forces on the hand, shape (n, 2)
    motor_share : the motors' power in hybrid over c |v|
    """

    angle_rad: Floats
    wanted_N: Floats
    active_N: Floats
    passive_N: Floats
    hybrid_N: Floats
    motor_share: Floats

    def off_deg(self, mode: str) -> Floats:
        """Return the angle between displayed and desired force [deg]; 180 without a displayed force."""
        force: Floats = getattr(self, f"{mode}_N")
        cosine = (force * self.wanted_N).sum(axis=1)
        sine = force[:, 0] * self.wanted_N[:, 1] - force[:, 1] * self.wanted_N[:, 0]
        off = np.degrees(np.arctan2(np.abs(sine), cosine))
        return np.where(np.hypot(force[:, 0], force[:, 1]) > 0.0, off, 180.0)


def directions(jacobian: Floats, friction_N: float, levels: Levels, count: int = 360) -> Directions:
    """Return the displayed part of a Coulomb friction in `count` directions of motion.

    Each brake supplies the desired torque as far as its joint's speed permits, up to its level; the
    motors supply all (active), nothing (passive) or the rest (hybrid), up to their level.

    Raises
    ------
    ValueError
        the pose is singular
    """
    if min(np.linalg.svd(jacobian, compute_uv=False)) < 1e-12:
        raise ValueError("the pose is singular: no speeds of the joints move the tip in every direction")
    angle: Floats = 2 * math.pi * np.arange(count) / count
    unit = np.stack((np.cos(angle), np.sin(angle)))
    force_N = -friction_N * unit
    torque, speed = jacobian.T @ force_N, np.linalg.solve(jacobian, unit)
    brake_Nm, motor_Nm = np.array(levels.brake_Nm, np.float64)[:, None], np.array(levels.motor_Nm, np.float64)[:, None]
    brake = -np.sign(speed) * np.clip(-torque * np.sign(speed), 0.0, brake_Nm)
    rest = np.clip(torque - brake, -motor_Nm, motor_Nm)
    tip = np.linalg.inv(jacobian).T
    power = np.maximum(rest * speed, 0.0).sum(axis=0) / friction_N
    shown = (np.clip(torque, -motor_Nm, motor_Nm), brake, brake + rest)
    active, passive, hybrid = (np.asarray((tip @ torques).T, np.float64) for torques in shown)
    return Directions(angle, force_N.T, active, passive, hybrid, power)


OVER = 1.2
"""The hand's force over F_s for which the stuck share is given."""


@dataclass(frozen=True)
class StuckHands:
    """How often a hand gets stuck in a pose with brakes alone, though it should slide.

    Attributes
    ----------
    wall_share : mean share of the pushes against a wall, over all its directions, 0 to 1
    wall_best_share, wall_worst_share : of the best and of the worst direction of a wall
    wall_one_way : share of the directions of a wall along which a hand slides in one sense only
    friction_share : share of the directions in which constant levels hold `OVER` times F_s
    friction_most : the largest force that they hold, over F_s; infinite in a singular pose
    """

    wall_share: float
    wall_best_share: float
    wall_worst_share: float
    wall_one_way: float
    friction_share: float
    friction_most: float


def wall_coefficients(jacobian: Floats, normal_rad: Floats) -> Floats:
    """Return the coefficient of friction of brakes alone along walls, in both senses, shape (n, 2).

    The tangent is the normal turned by 90 degrees against the clock; the first column is for a motion
    along it, the second against it. Infinite: brakes hold the hand.
    """
    normal = np.stack((np.cos(normal_rad), np.sin(normal_rad)))
    tangent = np.stack((-normal[1], normal[0]))
    a, b = np.linalg.solve(jacobian, tangent), np.linalg.solve(jacobian, normal)
    with np.errstate(divide="ignore", invalid="ignore"):
        size = np.abs(a / b)
    senses = [np.where(sense * a * b < 0.0, size, np.inf).min(axis=0) for sense in (1.0, -1.0)]
    return np.stack(senses, axis=1)


def stuck_hands(jacobian: Floats) -> StuckHands | None:
    """Return how often a hand gets stuck in the pose with this Jacobian (2 x 2) [m/rad]; None in a singular pose."""
    columns = passive_display(jacobian).columns_angle_rad
    if min(columns, math.pi - columns) < SINGULAR_RAD:
        return None
    share_wrong = passive_display(jacobian).share_wrong
    beta = math.acos(1.0 / OVER)
    held = max(0.0, columns - 2 * beta) + max(0.0, math.pi - columns - 2 * beta)
    return StuckHands(
        0.5 + 0.25 * share_wrong**2,
        0.5 * (1.0 - share_wrong),
        0.5 * (1.0 + share_wrong),
        share_wrong,
        held / math.pi,
        1.0 / min(math.cos(columns / 2), math.sin(columns / 2)),
    )
