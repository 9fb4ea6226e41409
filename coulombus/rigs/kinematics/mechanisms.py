r"""Mechanisms with two joints in a plane: the tip and the Jacobian of a pose, and their records.

Plain functions; `rigs.kinematics.pose_kernels` and `rigs.kinematics.load_mechanism` compile them.

A mechanism's function takes its dimensions and a pose, reads ``pose.angle_rad`` and writes ``pose.x_m`` and
``pose.jacobian``. `locate` calls it with a joint's offset and sign:

.. math:: \alpha_i = o_i + s_i q_i, \qquad J_{ki} = s_i\,\frac{\partial x_k}{\partial\alpha_i}

An unreachable pose has NaN in both.

    m : a `MechanismRecord`        pose : a `PoseRecord`
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Annotated, TypeAlias

from coulombus.kernels.records import FloatField, Record

__all__ = [
    "JOINTS",
    "MECHANISMS",
    "MechanismFunction",
    "MechanismRecord",
    "PoseRecord",
    "cartesian",
    "columns_angle",
    "condition",
    "five_bar",
    "locate",
    "serial_2r",
]


JOINTS = 2
"""Joints of a mechanism in the plane."""


class PoseRecord(Record):
    """One pose: joint angles, tip and Jacobian."""

    q_rad: Annotated[FloatField, JOINTS]  # the joints' angles, as the axes count them
    angle_rad: Annotated[FloatField, JOINTS]  # the mechanism's own angles: offset + sign q
    x_m: Annotated[FloatField, 2]  # the tip
    jacobian: Annotated[FloatField, (2, JOINTS)]  # dx/dq [m/rad]; of a mechanism's function dx/d(angle)


class MechanismRecord(Record):
    """Dimensions of a mechanism."""

    link_m: Annotated[FloatField, 4]  # lengths of the links; of cartesian travel per angle [m/rad] in the first two
    base_m: float  # distance of the two fixed joints of a five-bar
    offset_rad: Annotated[FloatField, JOINTS]  # the mechanism's angle where the joint's is 0
    sign: Annotated[FloatField, JOINTS]  # +1 or -1: sense of the joint in the mechanism
    user: Annotated[FloatField, 16]  # numbers of a user-defined mechanism


MechanismFunction: TypeAlias = Callable[[MechanismRecord, PoseRecord], None]
"""A compiled mechanism: from ``pose.angle_rad`` to ``pose.x_m`` and ``pose.jacobian``."""


def serial_2r(m: MechanismRecord, pose: PoseRecord) -> None:
    r"""Two links in series; the second joint's angle is counted from the first link.

    .. math::

        x = l_1 (\cos\alpha_1, \sin\alpha_1) + l_2 (\cos(\alpha_1+\alpha_2), \sin(\alpha_1+\alpha_2))

    Stretched out at :math:`\alpha_2 = 0`, folded at :math:`\pi`: singular there.
    """
    first, both = pose.angle_rad[0], pose.angle_rad[0] + pose.angle_rad[1]
    x1, y1 = m.link_m[0] * math.cos(first), m.link_m[0] * math.sin(first)
    x2, y2 = m.link_m[1] * math.cos(both), m.link_m[1] * math.sin(both)
    pose.x_m[0], pose.x_m[1] = x1 + x2, y1 + y2
    pose.jacobian[0, 0], pose.jacobian[0, 1] = -y1 - y2, -y2
    pose.jacobian[1, 0], pose.jacobian[1, 1] = x1 + x2, x2


def five_bar(m: MechanismRecord, pose: PoseRecord) -> None:
    r"""Two arms on fixed joints at (0, 0) and (b, 0) that meet at the tip.

    The elbows are :math:`A = l_1(\cos\alpha_1, \sin\alpha_1)` and :math:`B = (b, 0) +
    l_3(\cos\alpha_2, \sin\alpha_2)`. The tip P has the distance :math:`l_2` from A and :math:`l_4`
    from B, and lies to the left of the line from A to B. Its velocity follows from

    .. math:: (P-A)\cdot\dot P = (P-A)\cdot\dot A, \qquad (P-B)\cdot\dot P = (P-B)\cdot\dot B

    Source: J. Cervantes-Sanchez et al., On the workspace, assembly configurations and singularity
    curves of the RRRRR-type planar manipulator, Mech. Mach. Theory 35(8), 2000.
    """
    c1, s1 = math.cos(pose.angle_rad[0]), math.sin(pose.angle_rad[0])
    c2, s2 = math.cos(pose.angle_rad[1]), math.sin(pose.angle_rad[1])
    ax, ay = m.link_m[0] * c1, m.link_m[0] * s1
    bx, by = m.base_m + m.link_m[2] * c2, m.link_m[2] * s2
    dx, dy = bx - ax, by - ay
    square = dx * dx + dy * dy
    along = (m.link_m[1] ** 2 - m.link_m[3] ** 2 + square) / (2.0 * square) if square > 0.0 else math.nan
    height = m.link_m[1] ** 2 - along * along * square
    across = math.sqrt(height / square) if height >= 0.0 and square > 0.0 else math.nan
    pose.x_m[0], pose.x_m[1] = ax + along * dx - across * dy, ay + along * dy + across * dx
    px, py, rx, ry = pose.x_m[0] - ax, pose.x_m[1] - ay, pose.x_m[0] - bx, pose.x_m[1] - by
    determinant = px * ry - py * rx
    first = m.link_m[0] * (py * c1 - px * s1)  # (P - A) . dA/d(angle 1)
    second = m.link_m[2] * (ry * c2 - rx * s2)
    inverse = 1.0 / determinant if determinant != 0.0 else math.nan
    pose.jacobian[0, 0], pose.jacobian[0, 1] = ry * first * inverse, -py * second * inverse
    pose.jacobian[1, 0], pose.jacobian[1, 1] = -rx * first * inverse, px * second * inverse


def cartesian(m: MechanismRecord, pose: PoseRecord) -> None:
    r"""Two slides at right angles, each with a pulley: :math:`x_k = r_k \alpha_k`. Nothing is coupled."""
    pose.x_m[0], pose.x_m[1] = m.link_m[0] * pose.angle_rad[0], m.link_m[1] * pose.angle_rad[1]
    pose.jacobian[0, 0], pose.jacobian[0, 1] = m.link_m[0], 0.0
    pose.jacobian[1, 0], pose.jacobian[1, 1] = 0.0, m.link_m[1]


MECHANISMS: dict[str, MechanismFunction] = {"serial_2r": serial_2r, "five_bar": five_bar, "cartesian": cartesian}
"""Built-in mechanisms by their kinds in the rig file."""


def locate(mechanism: MechanismFunction, m: MechanismRecord, pose: PoseRecord) -> None:
    """Set tip and Jacobian of a pose from its joints' angles."""
    for i in range(JOINTS):
        pose.angle_rad[i] = m.offset_rad[i] + m.sign[i] * pose.q_rad[i]
    mechanism(m, pose)
    for i in range(JOINTS):
        pose.jacobian[0, i] *= m.sign[i]
        pose.jacobian[1, i] *= m.sign[i]


def condition(pose: PoseRecord) -> float:
    r"""Return :math:`\sigma_{min}/\sigma_{max}` of the Jacobian: 1 is isotropic, 0 singular or no pose."""
    a, b, c, d = pose.jacobian[0, 0], pose.jacobian[0, 1], pose.jacobian[1, 0], pose.jacobian[1, 1]
    sum_of_squares = a * a + b * b + c * c + d * d
    determinant = abs(a * d - b * c)
    if not (sum_of_squares > 0.0 and math.isfinite(sum_of_squares)):
        return 0.0
    root = math.sqrt(max(sum_of_squares**2 - 4.0 * determinant**2, 0.0))
    return float(2.0 * determinant / (sum_of_squares + root))


def columns_angle(pose: PoseRecord) -> float:
    """Return the angle between the Jacobian's columns, 0 to pi [rad]: between the tip's directions for each joint
    alone.
    """
    a, b, c, d = pose.jacobian[0, 0], pose.jacobian[0, 1], pose.jacobian[1, 0], pose.jacobian[1, 1]
    return math.atan2(abs(a * d - b * c), a * b + c * d)
