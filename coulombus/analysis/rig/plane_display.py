"""Displayable friction of a rig in the plane: in given poses, and over its workspace."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from coulombus.analysis.theory.plane_friction import (
    Directions,
    ForceEllipse,
    Levels,
    PassiveDisplay,
    StuckHands,
    directions,
    force_ellipse,
    largest_friction_N,
    passive_display,
    stuck_hands,
)
from coulombus.rigs.axis import Axis
from coulombus.rigs.errors import RigError
from coulombus.rigs.kinematics.kinematics_section import Kinematics
from coulombus.rigs.kinematics.load_mechanism import Mechanism, MechanismMistake, load_mechanism
from coulombus.rigs.kinematics.pose_kernels import condition
from coulombus.rigs.rig import Rig

__all__ = ["GRID", "PlaneDisplay", "PlaneMap", "PosedDisplay", "plane_display", "rig_levels", "rig_mechanism"]

GRID = 24
"""Number of angles of each joint on the map."""


@dataclass(frozen=True)
class PosedDisplay:
    """Displayable friction in one pose.

    Attributes
    ----------
    q_rad, x_m : the joints' angles and the tip
    condition : of the Jacobian, 0 to 1
    allowed : whether the rig file allows the pose
    jacobian : shape (2, 2) [m/rad]
    passive : errors of brakes alone
    ellipse : the force manipulability ellipse; None in a singular pose
    stuck : hands that get stuck with brakes alone; None in a singular pose
    largest_N : the largest isotropic friction, by mode
    resolution_m : the tip's displacement per count of each encoder
    """

    q_rad: tuple[float, float]
    x_m: tuple[float, float]
    condition: float
    allowed: bool
    jacobian: npt.NDArray[np.float64]
    passive: PassiveDisplay
    ellipse: ForceEllipse | None
    stuck: StuckHands | None
    largest_N: dict[str, float]
    resolution_m: tuple[float, float]

    def as_dict(self) -> dict[str, Any]:
        """Return it as plain values."""
        return {
            "q_rad": list(self.q_rad),
            "x_m": list(self.x_m),
            "condition": self.condition,
            "allowed": self.allowed,
            "share_wrong": self.passive.share_wrong,
            "worst_angle_deg": self.passive.worst_angle_deg,
            "motor_power_per_cv": self.passive.motor_power_per_cv,
            "columns_angle_deg": math.degrees(self.passive.columns_angle_rad),
            "largest_friction_N": self.largest_N,
            "force_ellipse": None if self.ellipse is None else vars(self.ellipse),
            "stuck": None if self.stuck is None else vars(self.stuck),
            "resolution_m": list(self.resolution_m),
        }

    def lines(self) -> list[str]:
        """Return it as text."""
        q1, q2 = (math.degrees(angle) for angle in self.q_rad)
        passive, largest = self.passive, self.largest_N
        text = [
            f"pose {q1:.4g}, {q2:.4g} deg: tip at ({self.x_m[0]:.4g}, {self.x_m[1]:.4g}) m, "
            f"condition {self.condition:.3g}" + ("" if self.allowed else " (not allowed by [kinematics])"),
            f"  brakes alone: wrong in {100 * passive.share_wrong:.1f} % of the directions, "
            f"by up to {passive.worst_angle_deg:.1f} deg",
            f"  hybrid: the motors give at most {passive.motor_power_per_cv:.3f} c |v|",
            f"  largest friction in all directions: hybrid {largest['hybrid']:.3g} N, active {largest['active']:.3g} N; "
            f"at rest the brakes hold {largest['hold']:.3g} N",
        ]
        if self.ellipse is not None:
            longer, shorter = self.ellipse.semi_axes_N
            text.append(
                f"  force ellipse: {longer:.3g} by {shorter:.3g} N for 1 Nm; {100 * self.ellipse.passive_area:.0f} % of "
                "its area is passive"
            )
        if self.stuck is not None:
            stuck = self.stuck
            text.append(
                f"  brakes alone: a hand that should slide along a wall is stuck in {100 * stuck.wall_share:.0f} % of its "
                f"pushes; constant levels at rest hold up to {stuck.friction_most:.2f} F_s"
            )
        return text


@dataclass(frozen=True)
class PlaneMap:
    """The workspace: the allowed poses of a grid of joint angles.

    Attributes
    ----------
    poses : the allowed ones
    tried : number of poses tested
    """

    poses: tuple[PosedDisplay, ...]
    tried: int

    def as_dict(self) -> dict[str, Any]:
        """Return ranges over the workspace, and the rows of the map."""
        names = ("share_wrong", "worst_angle_deg", "motor_power_per_cv", "condition")
        rows = [pose.as_dict() for pose in self.poses]
        columns: dict[str, list[float]] = {name: [row[name] for row in rows] for name in names}
        columns["hybrid_N"] = [pose.largest_N["hybrid"] for pose in self.poses]
        keys = ("q_rad", "x_m", "condition", "share_wrong", "worst_angle_deg", "motor_power_per_cv")
        ranges = {
            name: {"least": min(values), "median": float(np.median(values)), "most": max(values)}
            for name, values in columns.items()
            if values
        }
        short = [
            {name: row[name] for name in keys} | {"hybrid_N": pose.largest_N["hybrid"]}
            for row, pose in zip(rows, self.poses, strict=True)
        ]
        return {"tried": self.tried, "allowed": len(rows), "ranges": ranges, "rows": short}

    def lines(self) -> list[str]:
        """Return the ranges as text."""
        figures = self.as_dict()
        if not self.poses:
            return [f"workspace: none of {self.tried} poses is allowed by [kinematics]"]
        spelled = {name: "{least:.3g} to {most:.3g}".format(**value) for name, value in figures["ranges"].items()}
        return [
            f"workspace: {figures['allowed']} of {self.tried} poses are allowed by [kinematics]",
            f"  share of wrong directions {spelled['share_wrong']}, worst angle {spelled['worst_angle_deg']} deg",
            f"  motors' power {spelled['motor_power_per_cv']} c |v|, largest friction {spelled['hybrid_N']} N (hybrid)",
        ]


@dataclass(frozen=True)
class PlaneDisplay:
    """Displayable friction of a rig in the plane.

    Attributes
    ----------
    rig, kind : the rig's name and its mechanism
    levels : the torques available at each joint
    poses : the requested ones
    workspace : the map
    """

    rig: str
    kind: str
    levels: Levels
    poses: tuple[PosedDisplay, ...]
    workspace: PlaneMap

    def as_dict(self) -> dict[str, Any]:
        """Return it as plain values."""
        return {
            "rig": self.rig,
            "kind": self.kind,
            "levels_Nm": self.levels._asdict(),
            "poses": [pose.as_dict() for pose in self.poses],
            "map": self.workspace.as_dict(),
        }

    def lines(self) -> list[str]:
        """Return it as text."""
        return [line for pose in self.poses for line in pose.lines()] + self.workspace.lines()

    def directions(self, friction_N: float | None = None) -> Directions:
        """Return desired and displayed forces of the first pose; the default friction is the largest of hybrid.

        Raises
        ------
        RigError
            the pose is singular
        """
        pose = self.poses[0]
        try:
            return directions(pose.jacobian, friction_N or pose.largest_N["hybrid"], self.levels)
        except ValueError as error:
            q = ", ".join(f"{math.degrees(angle):g}" for angle in pose.q_rad)
            raise RigError([f"--pose {q}: {error}"]) from error


def rig_mechanism(rig: Rig) -> tuple[Kinematics, Mechanism]:
    """Return kinematics and compiled mechanism of a rig in the plane.

    Raises
    ------
    RigError
        its axes are independent, or only a recording names a user-defined mechanism
    """
    if rig.kinematics is None:
        raise RigError([f"{rig.path}: the rig {rig.name} has no [kinematics]; expected a rig in the plane, as plane"])
    if rig.origin.attached and rig.kinematics.function is not None:
        raise RigError([f"{rig.path}: kinematics.kind: '{rig.kinematics.kind}' is of a recording, and is not run"])
    try:
        return rig.kinematics, load_mechanism(rig.kinematics, Path(rig.path).parent)
    except MechanismMistake as mistake:
        raise RigError([f"{rig.path}: kinematics.kind: got '{rig.kinematics.kind}', but {mistake}"]) from mistake


def rig_levels(rig: Rig, mode: str = "hybrid") -> Levels:
    """Return the torques available to the law at each joint: for a motor, its limit in `mode` minus the compensation."""
    brake, motor = [], []
    for axis in rig.axes:
        settings = axis.mode[mode]
        limit = min(settings.motor_limit_Nm, axis.motor.rated_torque_Nm * axis.mechanics.ratio)
        brake.append(min(axis.limits.brake_torque_Nm, axis.brake.rated_torque_Nm))
        motor.append(max(limit - settings.compensation * axis.mechanics.friction_Nm, 0.0))
    return Levels((brake[0], brake[1]), (motor[0], motor[1]))


def plane_display(
    rig: Rig, poses_rad: Sequence[tuple[float, float]] = (), grid: int = GRID, mode: str = "hybrid"
) -> PlaneDisplay:
    """Return the displayable friction of a rig in the plane, in poses and over its workspace.

    Parameters
    ----------
    rig : with [kinematics]
    poses_rad : joints' angles; default: the start of the rig file
    grid : number of angles of each joint on the map, over a full turn; 0: no map
    mode : whose motor limits apply

    Raises
    ------
    RigError
        the rig is not in the plane, or a pose is unreachable
    """
    kinematics, mechanism = rig_mechanism(rig)
    levels, counts = rig_levels(rig, mode), [_count_rad(axis) for axis in rig.axes]

    def posed(q: tuple[float, float]) -> PosedDisplay | None:
        pose = mechanism.pose(*q)
        if not (np.isfinite(pose["x_m"]).all() and np.isfinite(pose["jacobian"]).all()):
            return None
        jacobian, pose_condition, x = pose["jacobian"].copy(), condition(pose), pose["x_m"].tolist()
        passive = passive_display(jacobian)
        singular = not math.isfinite(passive.motor_power_per_cv)
        lengths = np.hypot(jacobian[0], jacobian[1])
        return PosedDisplay(
            q,
            (x[0], x[1]),
            pose_condition,
            pose_condition >= kinematics.least_condition and kinematics.contains(x[0], x[1]),
            jacobian,
            passive,
            None if singular else force_ellipse(jacobian),
            stuck_hands(jacobian),
            largest_friction_N(jacobian, levels),
            (float(lengths[0] * counts[0]), float(lengths[1] * counts[1])),
        )

    shown = []
    for q in poses_rad or [kinematics.start_rad]:
        display = posed(q)
        if display is None:
            degrees = ", ".join(f"{math.degrees(angle):g}" for angle in q)
            raise RigError([f"--pose {degrees}: the mechanism cannot take it: its links do not meet there"])
        shown.append(display)
    turn = np.linspace(-math.pi, math.pi, 2 * grid + 1)[1::2]
    tried = [posed((float(q1), float(q2))) for q1 in turn for q2 in turn]
    workspace = PlaneMap(tuple(pose for pose in tried if pose is not None and pose.allowed), len(tried))
    return PlaneDisplay(rig.name, kinematics.kind, levels, tuple(shown), workspace)


def _count_rad(axis: Axis) -> float:
    """Return an encoder count at the joint [rad]."""
    return 2 * math.pi / (axis.motor.encoder_counts_rev * axis.mechanics.ratio)
