"""Check of a model that comes from outside: what is not plausible never reaches the cycle."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import numpy as np

from coulombus.host.errors import HostError
from coulombus.host.world.records import MOST_SAMPLES, ModelParts

__all__ = ["RANGES", "ModelRefused", "why_not"]

RANGES: Mapping[str, tuple[float, float]] = MappingProxyType(
    {
        "law": (0.0, 1.0),
        "wall_x_rad": (-1e6, 1e6),
        "wall_K_Nm_rad": (0.0, 1e7),
        "wall_B_Nms_rad": (0.0, 1e6),
        "spring_x_rad": (-1e6, 1e6),
        "spring_K_Nm_rad": (0.0, 1e7),
        "spring_B_Nms_rad": (0.0, 1e6),
        "spring_most_Nm": (0.0, 1e4),
        "field_Nm": (-1e4, 1e4),
        "field_Nm_rad": (-1e7, 1e7),
        "field_Nms_rad": (-1e6, 1e6),
    }
)
"""Smallest and largest value of each number, whether its part is used or not."""
PLANE_RANGES: Mapping[str, tuple[float, float]] = MappingProxyType(
    {
        "law": (0.0, 1.0),
        "plane_wall_point_m": (-1e3, 1e3),
        "plane_wall_normal": (-1.0, 1.0),
        "plane_wall_K_N_m": (0.0, 1e7),
        "plane_wall_B_Ns_m": (0.0, 1e6),
        "plane_spring_point_m": (-1e3, 1e3),
        "plane_spring_K_N_m": (0.0, 1e7),
        "plane_spring_B_Ns_m": (0.0, 1e6),
        "plane_spring_most_N": (0.0, 1e4),
        "plane_field_N": (-1e4, 1e4),
        "plane_field_N_m": (-1e7, 1e7),
        "plane_field_Ns_m": (-1e6, 1e6),
        "profile_direction": (-1.0, 1.0),
    }
)
"""The same of a model in the plane."""
UNIT_VECTORS = {ModelParts.WALL: "plane_wall_normal", ModelParts.PROFILE: "profile_direction"}
UNIT_WITHIN = 1e-6
"""Largest deviation of a unit vector's length from 1."""
LONGEST_SAMPLE_NS = 1_000_000_000
ALL_PARTS = sum(ModelParts)


class ModelRefused(HostError):
    """A model of a world was refused; the text gives the reason.

    `again`: the model itself is right, and may be sent again.
    """

    exit_status = 2

    def __init__(self, reason: str, *, again: bool = False) -> None:
        super().__init__(reason)
        self.again = again


def why_not(model: Any, axes: int, longest_life_ns: int, *, arm: bool = False) -> str | None:
    """Return the reason why a `ModelRecord` is refused; None if it is plausible.

    `arm`: the axes are the joints of an arm, and a model is of its tip (axis 0). The law's parameters are not
    checked here: their bounds are the law's.
    """
    if arm:
        axes = 1
    if not 0 <= model["axis"] < axes:
        return f"axis is {model['axis']}: expected from 0 to {axes - 1}"
    if not 0 < model["life_ns"] <= longest_life_ns:
        return f"life_ns is {model['life_ns']}: expected from 1 to {longest_life_ns} (world.longest_life_s)"
    if model["parts"] & ~ALL_PARTS:
        return f"parts is {model['parts']}: expected bits of {ALL_PARTS}"
    in_plane = bool(model["parts"] & ModelParts.PLANE)
    if arm != in_plane and model["parts"] & ~(ModelParts.PARAMETERS | ModelParts.PLANE):
        place = "an arm in the plane" if arm else "of single axes"
        return f"the rig is {place}: expected parts {'in the plane' if arm else 'of one axis'}"
    for name, (low, high) in (PLANE_RANGES if in_plane else RANGES).items():
        for value in np.ravel(model[name]).tolist():
            if not low <= value <= high:  # NaN, too
                return f"{name} is {value:g}: expected from {low:g} to {high:g}"
    if in_plane:
        for part, name in UNIT_VECTORS.items():
            if model["parts"] & part and not abs(math.hypot(*model[name].tolist()) - 1.0) <= UNIT_WITHIN:
                return f"{name} is {model[name].tolist()}: expected a vector of length 1"
    elif model["parts"] & ModelParts.WALL and abs(model["wall_side"]) != 1:
        return f"wall_side is {model['wall_side']}: expected 1 or -1"
    return _why_no_profile(model) if model["parts"] & ModelParts.PROFILE else None


def _why_no_profile(model: Any) -> str | None:
    if not 1 <= model["samples"] <= MOST_SAMPLES:
        return f"samples is {model['samples']}: expected from 1 to {MOST_SAMPLES}"
    if not 0 < model["sample_ns"] <= LONGEST_SAMPLE_NS:
        return f"sample_ns is {model['sample_ns']}: expected from 1 to {LONGEST_SAMPLE_NS}"
    if not all(math.isfinite(value) and abs(value) <= 1e4 for value in model["sample"].tolist()):
        return "sample: expected numbers from -10000 to 10000"
    return None
