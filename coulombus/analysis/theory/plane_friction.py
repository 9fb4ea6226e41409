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
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

__all__ = [
    "Directions",
    "ForceEllipse",
    "Levels",
    "PassiveDisplay",
    "directions",
    "force_ellipse",
    "largest_friction_N",
    "passive_display",
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
    wanted = -friction_N * unit
    torque, speed = jacobian.T @ wanted, np.linalg.solve(jacobian, unit)
    brake_Nm, motor_Nm = np.array(levels.brake_Nm, np.float64)[:, None], np.array(levels.motor_Nm, np.float64)[:, None]
    brake = -np.sign(speed) * np.clip(-torque * np.sign(speed), 0.0, brake_Nm)
    rest = np.clip(torque - brake, -motor_Nm, motor_Nm)
    tip = np.linalg.inv(jacobian).T
    power = np.maximum(rest * speed, 0.0).sum(axis=0) / friction_N
    shown = (np.clip(torque, -motor_Nm, motor_Nm), brake, brake + rest)
    active, passive, hybrid = (np.asarray((tip @ torques).T, np.float64) for torques in shown)
    return Directions(angle, wanted.T, active, passive, hybrid, power)
