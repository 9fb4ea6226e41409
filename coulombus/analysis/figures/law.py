"""Plots of laws: along a motion (the motion, the torque over time, the loop), and beside the literature's curves."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from coulombus.recording.pictures.style import BLACK, COLOURS, VERMILION, figure, label, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from coulombus.analysis.theory.published_curves import LiteratureCurve
    from coulombus.host.laws.along import Driven, GivenLaw

__all__ = ["draw_law", "draw_literature", "write_literature_figures"]

PARAMETERS_IN_A_LINE = 4


def titled(law: GivenLaw) -> str:
    """Return a law's name and its parameters, wrapped for a plot."""
    texts = law.parameter_texts
    lines = [texts[k : k + PARAMETERS_IN_A_LINE] for k in range(0, len(texts), PARAMETERS_IN_A_LINE)]
    return "\n".join([f"law {law.name}", *(", ".join(line) for line in lines)])


def draw_law(given: GivenLaw, driven: Driven) -> Figure:
    """Draw the angle and the torque over the time, and the torque over the angle and the speed; the
    title has the law's parameters.
    """
    samples = driven.samples
    with figure(8.0, 5.2, 2, 2) as (fig, panels):
        (motion, loop), (torque, speed) = panels
        fig.suptitle(titled(given), fontsize=9, x=0.01, ha="left")
        motion.plot(samples["t_s"], samples["x_rad"], color=BLACK)
        motion.set(title="motion", xlabel="time [s]", ylabel="angle [rad]")
        torque.plot(samples["t_s"], samples["torque_Nm"], color=VERMILION)
        torque.set(title="friction", xlabel="time [s]", ylabel="torque [Nm]")
        loop.plot(samples["x_rad"], samples["torque_Nm"], color=VERMILION)
        loop.set(title="over the angle", xlabel="angle [rad]", ylabel="torque [Nm]")
        speed.plot(samples["v_rad_s"], samples["torque_Nm"], color=VERMILION)
        speed.set(title="over the speed", xlabel="speed [rad/s]", ylabel="torque [Nm]")
    return fig


MARKED = 25
"""About so many points of the compiled law are marked on each line."""


def draw_literature(axes: Axes, curve: LiteratureCurve) -> None:
    """Draw a curve: published as lines, the compiled law as markers."""
    for colour, line in zip(COLOURS, curve.lines, strict=False):
        axes.plot(line.x, line.published, color=colour, label=line.label)
        every = max(1, len(line.x_law) // MARKED)
        axes.plot(line.x_law[::every], line.law[::every], "o", color=BLACK, markersize=3, fillstyle="none")
    legend = f"lines: published; circles: compiled law; deviation: {curve.deviation_text}"
    label(axes, *curve.axes, f"{curve.law}: {curve.title}\n{legend}")
    axes.legend()


def write_literature_figures(directory: str | os.PathLike[str], curves: Sequence[LiteratureCurve]) -> list[Path]:
    """Write each curve as PNG and SVG; return the paths."""
    paths: list[Path] = []
    for curve in curves:
        with figure(6.4, 4.2) as (fig, axes):
            draw_literature(axes, curve)
            paths += save(fig, directory, curve.name)
    return paths
