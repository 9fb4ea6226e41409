"""Friction in the plane: displayed and desired force over the directions, and the force ellipse."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from coulombus.analysis.rig.plane_display import PlaneDisplay
from coulombus.recording.pictures.style import BLACK, BLUE, GREEN, GREY, VERMILION, figure, label

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from coulombus.analysis.rig.plane_display import PosedDisplay
    from coulombus.analysis.theory.plane_friction import Directions

__all__ = ["draw_plane", "ellipse_points", "passive_sectors"]

Floats = npt.NDArray[np.float64]

CURVES = (("active", VERMILION, "--"), ("passive", BLUE, "-"), ("hybrid", GREEN, ":"))


def draw_plane(display: PlaneDisplay, friction_N: float | None = None) -> Figure:
    """Draw the first pose: forces on the hand over 360 directions of motion, their angular error,
    and the force ellipse with its passive part.
    """
    pose, data = display.poses[0], display.directions(friction_N)
    with figure(10.5, 3.9, 1, 3) as (fig, panels):
        forces, off, ellipse = panels
        q1, q2 = (math.degrees(angle) for angle in pose.q_rad)
        level = float(np.hypot(*data.wanted_N[0]))
        fig.suptitle(
            f"{display.rig}: pose {q1:.4g}, {q2:.4g} deg, friction {level:.3g} N", fontsize=10, x=0.01, ha="left"
        )
        _draw_forces(forces, data)
        _draw_off(off, data)
        _draw_ellipse(ellipse, pose)
    return fig


def _draw_forces(axes: Axes, data: Directions) -> None:
    axes.plot(*data.wanted_N.T, color=BLACK, lw=2.4, alpha=0.35, label="wanted")
    for mode, colour, dash in CURVES:
        force = getattr(data, f"{mode}_N")
        closed = np.vstack((force, force[:1]))
        axes.plot(*closed.T, color=colour, ls=dash, label=mode)
    axes.set_aspect("equal", adjustable="datalim")
    axes.legend(loc="center")
    label(axes, "force along x [N]", "force along y [N]", "forces on the hand, all directions")


def _draw_off(axes: Axes, data: Directions) -> None:
    for mode, colour, dash in CURVES:
        axes.plot(np.degrees(data.angle_rad), data.off_deg(mode), color=colour, ls=dash, label=mode)
    axes.set_xlim(0, 360)
    axes.set_xticks(range(0, 361, 90))
    axes.set_ylim(-2, 1.35 * max(1.0, *(float(data.off_deg(mode).max()) for mode, _, _ in CURVES)))
    axes.legend(loc="upper center", ncols=3)
    label(axes, "direction of motion [deg]", "off the wanted force [deg]", "angle error")


def ellipse_points(jacobian: Floats, count: int = 1441) -> Floats:
    """Return points of the force ellipse of 1 Nm at the joints [N], shape (2, count)."""
    angle = np.linspace(0, 2 * math.pi, count)
    unit = np.stack((np.cos(angle), np.sin(angle)))
    points: Floats = unit / np.sqrt(((jacobian.T @ unit) ** 2).sum(axis=0))
    return points


def passive_sectors(jacobian: Floats) -> list[Floats]:
    """Return the sectors of the force ellipse in which brakes alone are correct, each a polygon from 0, shape (2, n)."""
    ellipse = ellipse_points(jacobian)
    right = np.all((jacobian.T @ ellipse) * np.linalg.solve(jacobian, ellipse) >= 0.0, axis=0)
    centre = np.zeros((2, 1))
    return [np.hstack((centre, ellipse[:, first:last])) for first, last in _runs(right)]


def _draw_ellipse(axes: Axes, pose: PosedDisplay) -> None:
    ellipse = ellipse_points(pose.jacobian)
    for sector in passive_sectors(pose.jacobian):
        axes.fill(*sector, color=BLUE, alpha=0.25, lw=0)
    axes.plot(*ellipse, color=GREY)
    axes.plot([], [], color=GREY, label="1 Nm at the joints")
    axes.fill([], [], color=BLUE, alpha=0.25, label="brakes alone can")
    axes.set_aspect("equal", adjustable="box")
    axes.set_xlim(right=1.9 * float(ellipse[0].max()))
    axes.legend(loc="lower right")
    label(axes, "force along x [N]", "force along y [N]", "force ellipse, passive part")


def _runs(mask: np.ndarray) -> list[tuple[int, int]]:
    """Return first and last + 1 of each run of True."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], mask.astype(int), [0]))))
    return [(int(first), int(last)) for first, last in edges.reshape(-1, 2)]
