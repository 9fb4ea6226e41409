"""The demo in the plane as a figure: the tip's path with the force on the hand, forces over the directions, the
hold, and the force ellipse.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from coulombus.analysis.figures.plane import ellipse_points, passive_sectors
from coulombus.analysis.rig.plane_display import plane_display
from coulombus.lab.demo.plane_demo import PlaneDemo, TipRun, directional_force
from coulombus.recording.pictures.style import BLACK, BLUE, GREEN, GREY, ORANGE, SKY, VERMILION, figure, label

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from coulombus.analysis.rig.plane_display import PosedDisplay
    from coulombus.lab.plane_figures import TipSamples

__all__ = ["Arrows", "arrows", "draw_plane_demo"]

Floats = npt.NDArray[np.float64]

COLOURS: Mapping[str, str] = {"active": VERMILION, "passive": BLUE, "hybrid": GREEN}
DASHES: Mapping[str, str] = {"active": "--", "passive": "-", "hybrid": "-"}
PARTS: Mapping[str, str] = {"active": "motors alone", "passive": "brakes alone", "hybrid": "motors and brakes"}
SECTORS = 20
"""Number of arrows around a path."""
HOLD_SPAN_S = 0.2
CM = 100.0


@dataclass(frozen=True)
class Arrows:
    """Forces on the hand at places of the path.

    Attributes
    ----------
    x_m, shown_N, wanted_N : shape (n, 2)
    """

    x_m: Floats
    shown_N: Floats
    wanted_N: Floats


def arrows(samples: TipSamples, count: int = SECTORS) -> Arrows:
    """Return the forces at the last pass of `count` directions of motion: the latest compared sample of each sector."""
    compared = np.flatnonzero(samples.compared)
    angle = np.arctan2(samples.v_m_s[compared, 1], samples.v_m_s[compared, 0]) % (2 * math.pi)
    sector = (angle * count / (2 * math.pi)).astype(int) % count
    middle = np.abs(angle * count / (2 * math.pi) - np.floor(angle * count / (2 * math.pi)) - 0.5)
    latest = []
    for number in range(count):
        inside = np.flatnonzero((sector == number) & (middle < 0.1))
        if len(inside):
            latest.append(compared[inside[-1]])
    rows = np.array(latest, int)
    return Arrows(samples.x_m[rows], samples.shown_N[rows], samples.wanted_N[rows])


def draw_plane_demo(demo: PlaneDemo) -> Figure:
    """Draw the runs of the demo in the plane, and the force ellipse at the start of the rig file."""
    pose = plane_display(demo.rig, grid=0).poses[0]
    modes = list(demo.runs)
    with figure(3.55 * len(modes), 7.9, 2, len(modes), squeeze=False) as (fig, panels):
        fig.suptitle(
            f"Friction in the plane: the rig '{demo.rig.name}', from simulated runs over its bus",
            fontsize=12,
            x=0.01,
            ha="left",
        )
        extent = _extent(demo)
        for axes, (mode, run) in zip(panels[0], demo.runs.items(), strict=True):
            _draw_path(axes, mode, run, extent, first=axes is panels[0, 0])
        for axes, draw in zip(panels[1], (_draw_forces, _draw_hold), strict=False):
            draw(axes, demo)
        if len(modes) > 2:
            _draw_arm(panels[1, 2], demo, pose)
    return fig


def _extent(demo: PlaneDemo) -> tuple[Floats, float]:
    """Return centre and half width of the paths [m], equal for all modes."""
    places = [run.samples.x_m[run.samples.compared] for run in demo.runs.values()]
    points = np.vstack([place for place in places if len(place)] or [run.samples.x_m for run in demo.runs.values()])
    low, high = points.min(axis=0), points.max(axis=0)
    return 0.5 * (low + high), 0.5 * float((high - low).max())


def _draw_path(axes: Axes, mode: str, run: TipRun, extent: tuple[Floats, float], *, first: bool) -> None:
    samples, colour, (centre, reach) = run.samples, COLOURS[mode], extent
    compared = samples.compared
    path = np.where(compared[:, None], samples.x_m, np.nan) * CM
    axes.plot(*path.T, color="0.75", lw=1.0)
    shown = arrows(samples)
    largest = float(np.hypot(*shown.wanted_N.T).max()) if len(shown.wanted_N) else 1.0
    per_cm = largest / (0.55 * reach * CM)
    options: dict[str, Any] = {"angles": "xy", "scale_units": "xy", "scale": per_cm, "zorder": 3}
    axes.quiver(*(shown.x_m * CM).T, *shown.wanted_N.T, color="0.55", width=0.011, **options)
    axes.quiver(*(shown.x_m * CM).T, *shown.shown_N.T, color=colour, width=0.007, **options)
    axes.plot(*(shown.x_m * CM).T, ".", color=BLACK, ms=3, zorder=4)
    half = 1.62 * reach * CM
    axes.set_xlim(centre[0] * CM - half, centre[0] * CM + half)
    axes.set_ylim(centre[1] * CM - half, centre[1] * CM + half)
    axes.set_aspect("equal")
    plane = run.result.plane or {}
    off = plane.get("angle_error_deg", {})
    text = f"{mode}: {PARTS[mode]}"
    if off.get("median") is not None:
        text += f"\n{off['median']:.1f}° off (95 %: {off['p95']:.0f}°), {plane['force_ratio']:.2f} times the size"
    if first:
        axes.plot([], [], color="0.55", lw=3, label="law's force")
        axes.plot([], [], color=colour, lw=2, label="displayed force")
        axes.legend(loc="center")
    label(axes, "x [cm]", "y [cm]", text)


def _draw_forces(axes: Axes, demo: PlaneDemo) -> None:
    """Draw displayed against wanted force over the directions of motion, as vectors."""
    samples = next(iter(demo.runs.values())).samples
    size = float(np.median(np.hypot(*samples.wanted_N[samples.compared].T))) if samples.compared.any() else 1.0
    angle = np.linspace(0.0, 2 * math.pi, 361)
    axes.fill(size * np.cos(angle), size * np.sin(angle), color="0.93", lw=0)
    axes.plot(size * np.cos(angle), size * np.sin(angle), color="0.6", lw=2.6, label="law")
    for mode, run in demo.runs.items():
        force = directional_force(run.samples)
        closed = np.vstack((force, force[:1]))
        axes.plot(
            *closed.T, color=COLOURS[mode], ls=DASHES[mode], lw=1.4, label=mode, zorder=3 if mode == "active" else 2
        )
    axes.axhline(0, color="0.8", lw=0.5)
    axes.axvline(0, color="0.8", lw=0.5)
    axes.set_aspect("equal", adjustable="datalim")
    axes.legend(loc="center")
    label(axes, "force along x [N]", "force along y [N]", "mean force, by the direction of motion")


def _draw_hold(axes: Axes, demo: PlaneDemo) -> None:
    """Draw a part of the hold: the tip's velocity along its largest motion."""
    for mode, run in demo.runs.items():
        t_s, middle = run.samples.t_s, 0.5 * sum(run.hold_s)
        inside = (t_s >= middle) & (t_s < middle + HOLD_SPAN_S)
        v_mm_s = 1e3 * run.samples.v_m_s[inside]
        axes.plot(
            (t_s[inside] - middle) * 1e3,
            v_mm_s @ _principal(v_mm_s),
            color=COLOURS[mode],
            ls=DASHES[mode],
            label=f"{mode}: {1e3 * run.hold_rms_m_s:.3g} mm/s RMS",
        )
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.35 * (high - low))
    axes.margins(x=0)
    axes.legend(loc="upper left")
    label(axes, "time in the hold [ms]", "velocity of the tip [mm/s]", "at rest, under the hand's push")


def _principal(points: Floats) -> Floats:
    """Return the unit vector of the largest spread of points, shape (2,)."""
    _, _, axes = np.linalg.svd(points, full_matrices=False)
    unit: Floats = axes[0] if axes[0][np.argmax(np.abs(axes[0]))] > 0 else -axes[0]
    return unit


def _draw_arm(axes: Axes, demo: PlaneDemo, pose: PosedDisplay) -> None:
    """Draw the arm in its first pose with the force ellipse at the tip, its passive part filled."""
    tip = np.array(pose.x_m) * CM
    elbow = _elbow_m(demo, pose)
    if elbow is not None:
        joints = np.array([(0.0, 0.0), tuple(elbow * CM), tuple(tip)])
        axes.plot(*joints.T, color="0.35", lw=5, solid_capstyle="round", solid_joinstyle="round", zorder=2)
        axes.plot(*joints[:2].T, "o", color="white", mec="0.35", mew=2, ms=8, zorder=3)
    if pose.ellipse is not None:
        scale = 0.55 * float(np.hypot(*tip)) / pose.ellipse.semi_axes_N[0]
        outline = ellipse_points(pose.jacobian)
        for sector in passive_sectors(pose.jacobian):
            axes.fill(*(tip[:, None] + scale * sector), color=SKY, alpha=0.55, lw=0, zorder=1)
        axes.plot(*(tip[:, None] + scale * outline), color=GREY, lw=1.2, zorder=1, label="force for 1 Nm")
        axes.fill([], [], color=SKY, alpha=0.55, label=f"brakes alone can ({100 * pose.ellipse.passive_area:.0f} %)")
    samples = demo.runs["hybrid"].samples
    path = np.where(samples.compared[:, None], samples.x_m, np.nan) * CM
    axes.plot(*path.T, color=ORANGE, lw=1.2, zorder=4, label="path of the tip")
    axes.set_aspect("equal", adjustable="datalim")
    axes.legend(loc="lower right")
    label(axes, "x [cm]", "y [cm]", "the arm, and the force ellipse at its tip")


def _elbow_m(demo: PlaneDemo, pose: PosedDisplay) -> Floats | None:
    """Return the elbow of two links in series [m]; None of another mechanism."""
    kinematics = demo.rig.kinematics
    if kinematics is None or kinematics.kind != "serial_2r":
        return None
    first = kinematics.signs[0] * pose.q_rad[0] + kinematics.offsets_rad[0]
    return np.array([math.cos(first), math.sin(first)]) * kinematics.l1_m
