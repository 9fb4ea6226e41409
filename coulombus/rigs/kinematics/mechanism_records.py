"""Records of a mechanism with two joints: its dimensions, and one pose."""

from __future__ import annotations

from collections.abc import Callable
from typing import Annotated, TypeAlias

from coulombus.kernels.records import FloatField, Record

__all__ = ["JOINTS", "MechanismFunction", "MechanismRecord", "PoseRecord"]

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
