"""Figure of a real-time run's timing: wake-up delay of the cycle, and time from SYNC to the last RPDO."""

from __future__ import annotations

from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from coulombus.host.realtime.data_plane import Spread
from coulombus.recording.pictures.style import BLACK, BLUE, VERMILION, figure, label

__all__ = ["Counts", "coarse", "coarse_dict", "draw_histograms"]

Counts: TypeAlias = npt.NDArray[np.int64]
"""Number of times in each bin."""

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


def coarse_dict(bins: Counts) -> dict[str, Any]:
    """Return `coarse` as plain values, up to the last bin that is not empty: N + 1 edges [us], N
    counts.
    """
    edges, counts = coarse(bins)
    end = int(np.flatnonzero(counts).max(initial=-1)) + 1
    return {"edges": edges[: end + 1 if end else 0].tolist(), "counts": counts[:end].tolist()}


def draw_histograms(wakeup: Counts, latency: Counts, period_us: float, path: Path) -> None:
    """Write the figure of both histograms to `path`, with the period as the deadline of both."""
    with figure(7.0, 4.2) as (fig, axes):
        for bins, colour, name in (
            (wakeup, BLUE, "woke after its deadline"),
            (latency, VERMILION, "SYNC to last RPDO"),
        ):
            edges, counts = coarse(bins)
            spread = Spread.from_bins(bins, len(bins) * 1000)
            if spread is None:
                continue
            legend = f"{name}: p50 {spread.p50:g} us, p99 {spread.p99:g} us"
            axes.stairs(counts, edges, label=legend, fill=True, color=colour, alpha=0.6)
            axes.axvline(spread.p99, color=colour, lw=1.0, ls="--")
        axes.axvline(period_us, color=BLACK, lw=1.2, label=f"the period, {period_us:g} us")
        axes.set(xscale="log", yscale="log")
        label(axes, "time [us]; dashed: p99", "cycles", f"{int(wakeup.sum()):,} cycles of the data plane")
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2)
        fig.savefig(path, metadata={"Date": None} if path.suffix == ".svg" else None)
