r"""Limit curve of friction in the plane: an ellipse of forces, with the rule of maximum dissipation.

Within the ellipse, with the semi-axis F along the angle :math:`\beta` and :math:`\rho F` across it, the
tip sticks. In slip the force is the point of the ellipse that dissipates the most power:

.. math::

    \psi = \frac{A v}{\sqrt{v^T A v}}, \qquad
    A = F^2\,R(\beta)\,\mathrm{diag}(1, \rho^2)\,R(\beta)^T

For :math:`\rho = 1` this is :math:`F v/|v|`, and the same in every direction.

Source: S. Goyal, A. Ruina, J. Papadopoulos, Planar sliding with dry friction, part 1, Wear 143(2), 1991,
doi:10.1016/0043-1648(91)90104-3.
"""

from __future__ import annotations

import math

from coulombus.kernels.decorator import kernel

__all__ = ["gauge", "slip_force"]


@kernel
def slip_force(vx: float, vy: float, level_N: float, ratio: float, angle_rad: float) -> tuple[float, float]:
    """Return the force in slip [N] for a velocity that is not 0."""
    if ratio == 1.0:
        share = level_N / math.sqrt(vx * vx + vy * vy)
        return share * vx, share * vy
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    along, across = c * vx + s * vy, c * vy - s * vx
    share = level_N / math.sqrt(along * along + (ratio * across) ** 2)
    along, across = share * along, share * ratio * ratio * across
    return c * along - s * across, s * along + c * across


@kernel
def gauge(fx: float, fy: float, level_N: float, ratio: float, angle_rad: float) -> float:
    """Return a force as a share of the limit in its direction: 1 on the ellipse."""
    if ratio == 1.0:
        return math.sqrt(fx * fx + fy * fy) / level_N if level_N > 0.0 else math.inf
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    along, across = c * fx + s * fy, (c * fy - s * fx) / ratio
    return math.sqrt(along * along + across * across) / level_N if level_N > 0.0 else math.inf
