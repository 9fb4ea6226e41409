"""All figures of a study into one directory."""

from __future__ import annotations

from pathlib import Path

from analysis.figures_frequency import write_frequency_figures
from analysis.figures_time import write_delay_figure, write_fig10, write_orbit_figure
from analysis.report import Study

__all__ = ["write_all"]


def write_all(directory: Path, found: Study) -> list[Path]:
    """Write every figure of `found` as PNG and SVG; return the paths."""
    paths = write_frequency_figures(directory, found.parameters, found.crossings, found.absolute)
    paths += write_fig10(directory, found.fig10)
    paths += write_orbit_figure(directory, found.parameters, found.orbits)
    paths += write_delay_figure(directory, found.delays)
    return paths
