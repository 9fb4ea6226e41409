"""The picture of a real run's timing: how late the cycle woke, and how long after SYNC its
set-points went out.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
import numpy.typing as npt

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["Counts", "coarse", "draw_histogram", "draw_histograms"]

Counts: TypeAlias = npt.NDArray[np.int64]
"""How many times fell into each bin."""

BINS_PER_DECADE = 20


def coarse(bins: Counts) -> tuple[npt.NDArray[np.float64], Counts]:
    """Return edges [us] on a logarithmic grid, and counts of a histogram whose bins are one
    microsecond wide.

    The first edge is 1 us: shorter times are counted with those between 1 and 2 us.
    """
    decades = np.log10(len(bins))
    edges = np.unique(np.round(np.logspace(0, decades, round(decades * BINS_PER_DECADE) + 1)))
    counts = np.add.reduceat(bins, edges[:-1].astype(int))
    counts[0] += bins[0]
    return edges, counts


def draw_histogram(ax: Axes, bins: Counts, label: str) -> None:
    """Draw one histogram with logarithmic axes."""
    edges, counts = coarse(bins)
    ax.stairs(counts, edges, label=label, fill=True, alpha=0.6)


def draw_histograms(wakeup: Counts, latency: Counts, path: Path) -> None:
    """Write the picture of both histograms to `path`."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7, 4), layout="constrained")
    FigureCanvasAgg(figure)
    ax = figure.subplots()
    draw_histogram(ax, wakeup, "woke after its deadline")
    draw_histogram(ax, latency, "SYNC to the last RPDO")
    ax.set(xscale="log", yscale="log", xlabel="time [us]", ylabel="cycles", title="Cycles of the data plane")
    ax.legend()
    figure.savefig(path, dpi=120)
