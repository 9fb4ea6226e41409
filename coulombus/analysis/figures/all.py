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


def write_all(directory: Path, results: TheoryResults) -> list[Path]:
    """Write every figure of `results` as PNG and SVG; return the paths."""
    paths = write_frequency_figures(directory, results.parameters, results.crossings, results.absolute)
    paths += write_fig10(directory, results.fig10)
    paths += write_orbit_figure(directory, results.parameters, results.orbits)
    paths += write_delay_figure(directory, results.delays)
    paths += write_fig12(directory)
    paths += write_fig13(directory, results.friction)
    paths += write_fig14(directory, results.hold)
    paths += write_stick_figure(directory, results.hold)
    paths += write_bus_figure(directory, results.through_bus)
    paths += write_map(directory, results.map)
    return paths
