"""All figures of a study into one directory."""

from __future__ import annotations

from pathlib import Path

from coulombus.analysis.figures.frequency import write_frequency_figures
from coulombus.analysis.figures.report import TheoryResults
from coulombus.analysis.figures.rig import (
    write_bus_figure,
    write_fig12,
    write_fig13,
    write_fig14,
    write_map,
    write_stick_figure,
)
from coulombus.analysis.figures.time import write_delay_figure, write_fig10, write_orbit_figure

__all__ = ["write_all"]


def write_all(directory: Path, found: TheoryResults) -> list[Path]:
    """Write every figure of `found` as PNG and SVG; return the paths."""
    paths = write_frequency_figures(directory, found.parameters, found.crossings, found.absolute)
    paths += write_fig10(directory, found.fig10)
    paths += write_orbit_figure(directory, found.parameters, found.orbits)
    paths += write_delay_figure(directory, found.delays)
    paths += write_fig12(directory)
    paths += write_fig13(directory, found.friction)
    paths += write_fig14(directory, found.hold)
    paths += write_stick_figure(directory, found.hold)
    paths += write_bus_figure(directory, found.through_bus)
    paths += write_map(directory, found.map)
    return paths
