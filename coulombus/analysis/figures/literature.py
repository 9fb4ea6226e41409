"""Curves of the literature beside those of the compiled laws, a figure each."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from coulombus.recording.pictures.style import BLACK, COLOURS, figure, label, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from coulombus.analysis.theory.published_curves import LiteratureCurve

__all__ = ["draw_literature", "write_literature_figures"]

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
        with figure(6.4, 4.2) as (made, axes):
            draw_literature(axes, curve)
            paths += save(made, directory, curve.name)
    return paths
