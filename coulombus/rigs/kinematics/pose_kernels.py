"""The functions of a pose, compiled (`rigs.kinematics.mechanisms`)."""

from __future__ import annotations

from coulombus.kernels.decorator import kernel
from coulombus.rigs.kinematics import mechanisms

__all__ = ["columns_angle", "condition", "locate"]

locate = kernel(mechanisms.locate)
condition = kernel(mechanisms.condition)
columns_angle = kernel(mechanisms.columns_angle)
