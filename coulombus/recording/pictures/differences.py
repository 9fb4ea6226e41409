"""``coulombus diff -o``: plot each signal of both recordings, and their difference."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from coulombus.recording.difference import Comparison, Difference, Pair
from coulombus.recording.host_telemetry import NODE
from coulombus.recording.pictures.plot import Envelope
from coulombus.recording.pictures.style import BLUE, GREY, VERMILION, figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["draw_differences"]

MOST_ROWS = 8


def draw_differences(comparison: Comparison) -> Figure:
    """Return a figure with a row per signal: those with a unit first, at most `MOST_ROWS`; the
    host's telemetry only if it differs.
    """
    drawn = [signal for signal in comparison.signals if signal.samples and not (_inside(signal.name) and signal.equal)]
    shown = sorted(drawn, key=lambda signal: (not signal.unit, _inside(signal.name)))[:MOST_ROWS]
    with figure(11, 1.2 + 1.6 * max(len(shown), 1), max(len(shown), 1), 2, squeeze=False, sharex=True) as (
        picture,
        axes,
    ):
        for row, signal in zip(axes, shown, strict=False):
            _draw_row(row, signal, comparison.pairs[signal.name])
        axes[0, 1].set_title("A - B")
        if shown:
            curves, _ = axes[0, 0].get_legend_handles_labels()
            names = (f"A: {Path(comparison.a).name}", f"B: {Path(comparison.b).name}")
            axes[0, 0].legend(curves, names, loc="lower left", bbox_to_anchor=(0.0, 1.0), borderaxespad=0.1, ncols=2)
        for axis in axes[-1]:
            axis.set_xlabel("time in A [s]")
    return picture


def _inside(name: str) -> bool:
    return f".{name}".rfind(f".{NODE}.") >= 0


def _draw_row(row: tuple[Axes, Axes], signal: Difference, pair: Pair) -> None:
    both, apart = row
    for values, colour, name, width in ((pair.a, BLUE, "A", 1.6), (pair.b, VERMILION, "B", 0.8)):
        gathered = Envelope(float(pair.t_s[0]), float(pair.t_s[-1]) + 1e-9)
        gathered.add(pair.t_s, values)
        _line(both, gathered, colour, width, name)
    gathered = Envelope(float(pair.t_s[0]), float(pair.t_s[-1]) + 1e-9)
    gathered.add(pair.t_s, pair.difference)
    _line(apart, gathered, BLUE, 0.8, "A - B")
    if signal.tolerance:
        for sign in (-1, 1):
            apart.axhline(sign * signal.tolerance, color=GREY, lw=0.8, ls="--")
    both.set_ylabel(f"{signal.name}\n[{signal.unit or 'bits'}]", fontsize=7)
    apart.annotate(
        f"max {signal.max:.3g}, rms {signal.rms:.3g} {signal.unit}",
        (1.0, 1.0),
        xycoords="axes fraction",
        xytext=(-2, 3),
        textcoords="offset points",
        ha="right",
        fontsize=7,
    )
    for axes in row:
        axes.margins(x=0)


def _line(axes: Axes, gathered: Envelope, colour: str, width: float, name: str) -> None:
    trace = gathered.trace(name, "")
    axes.plot(trace.t_s, trace.low, color=colour, lw=width, label=name)
    if trace.is_envelope:
        axes.plot(trace.t_s, trace.high, color=colour, lw=width)
        axes.fill_between(trace.t_s, trace.low, trace.high, color=colour, alpha=0.35, lw=0)
