r"""Hands that get stuck on a planar device with brakes, though they should slide.

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
(`plane_friction`), the stuck share of all pushes is :math:`\frac12 + \frac{w^2}{4}` in the mean over the walls,
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

import numpy as np
import numpy.typing as npt

from coulombus.analysis.theory.plane_friction import SINGULAR_RAD, passive_display

__all__ = ["OVER", "StuckHands", "stuck_hands", "wall_coefficients"]

Floats = npt.NDArray[np.float64]
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
    wrong = passive_display(jacobian).share_wrong
    beta = math.acos(1.0 / OVER)
    held = max(0.0, columns - 2 * beta) + max(0.0, math.pi - columns - 2 * beta)
    return StuckHands(
        0.5 + 0.25 * wrong**2,
        0.5 * (1.0 - wrong),
        0.5 * (1.0 + wrong),
        wrong,
        held / math.pi,
        1.0 / min(math.cos(columns / 2), math.sin(columns / 2)),
    )
