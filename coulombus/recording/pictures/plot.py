"""``coulombus plot`` and ``Recording.plot()``: signals over time, a panel for each unit.

Where there are more samples than a picture has room for, each of its columns shows the least and
the largest value: a spike of one sample is seen at any length.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
import numpy.typing as npt

from coulombus.recording.block import Source
from coulombus.recording.pictures.style import COLOURS, DASHES, QUANTITIES, WORDS, figure, shade
from coulombus.recording.sample_groups import EXAMPLE
from coulombus.recording.time_search import WHOLE, Span, SpanError, checked_span
from coulombus.rigs.arguments import texts

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["Envelope", "Look", "Plot", "Trace", "draw", "figure_of", "hidden", "plot", "save_picture", "traces_of"]

Floats: TypeAlias = npt.NDArray[np.float64]

BINS = 1200
"""Columns of a picture in which a signal is drawn."""
MOST_SAMPLES = 2 * BINS
"""That are drawn one by one."""
CM_PER_INCH = 2.54
LINE, COVERED = 0.01, 0.95
"""Width of a line as a share of a panel's range; share of a curve under another one that hides it."""
WIDE = 2.6
"""Width of a curve that another one covers [pt]."""
MOST_MARKERS = 24
"""That are written beside their line."""


@dataclass(frozen=True)
class Trace:
    """A signal as it is drawn: at `t_s` the least and the largest value; the same array twice where
    each sample is drawn.
    """

    name: str
    unit: str
    t_s: Floats
    low: Floats
    high: Floats
    samples: int

    @property
    def is_envelope(self) -> bool:
        """Whether a point stands for several samples."""
        return self.low is not self.high


@dataclass(frozen=True)
class Plot:
    """What a picture shows."""

    title: str
    begin_s: float
    end_s: float
    traces: tuple[Trace, ...]
    markers: tuple[tuple[float, str], ...]
    left_out: tuple[str, ...] = ()
    """Signals of the recording that are not drawn, because no signals were named."""


@dataclass(frozen=True)
class Look:
    """Title and size of a picture; None: chosen from the data."""

    title: str | None = None
    size_cm: tuple[float, float] | None = None
    """Width and height."""
    dpi: float | None = None
    """Pixels an inch of a .png."""


@dataclass
class Envelope:
    """Gathers a signal between two times, in a memory that does not grow with it."""

    begin_s: float
    end_s: float
    count: int = 0
    _raw: list[tuple[Floats, Floats]] = field(default_factory=list)
    _low: Floats = field(default_factory=lambda: np.full(BINS, np.inf))
    _high: Floats = field(default_factory=lambda: np.full(BINS, -np.inf))

    def add(self, t_s: Floats, values: Any) -> None:
        """Take samples; those outside the times, and what is not a number, are left out."""
        inside = (t_s >= self.begin_s) & (t_s <= self.end_s) & np.isfinite(values)
        t_s, values = t_s[inside], np.asarray(values, np.float64)[inside]
        self.count += len(t_s)
        if self.count <= MOST_SAMPLES:
            self._raw.append((t_s, values))
            return
        waiting, self._raw = [*self._raw, (t_s, values)], []
        for times, samples in waiting:
            place = (times - self.begin_s) / (self.end_s - self.begin_s) * BINS
            bins = np.minimum(place.astype(np.int64), BINS - 1)
            np.minimum.at(self._low, bins, samples)
            np.maximum.at(self._high, bins, samples)

    def trace(self, name: str, unit: str) -> Trace:
        """Return what is to be drawn."""
        if self.count <= MOST_SAMPLES:
            times, values = (np.concatenate([np.zeros(0), *parts]) for parts in zip(*self._raw, strict=True))
            return Trace(name, unit, times, values, values, self.count)
        centres = self.begin_s + (np.arange(BINS) + 0.5) * (self.end_s - self.begin_s) / BINS
        filled = self._low <= self._high
        return Trace(name, unit, centres[filled], self._low[filled], self._high[filled], self.count)


def traces_of(source: Source, signals: Sequence[str] | None = None, span: Span = WHOLE) -> Plot:
    """Go through a recording and return what a picture of it shows.

    Parameters
    ----------
    source
        The recording.
    signals
        Their names; None: all but words of bits.
    span
        From when to when [s]; None: from the beginning, to the end.

    Raises
    ------
    coulombus.recording.signals.UnknownSignal
        A signal that the recording does not have.
    coulombus.rigs.arguments.WrongCall
        `signals` is no list of texts, or `span` no pair of times.
    SpanError
        The recording has no frame in the span.
    """
    signals, span = None if signals is None else texts(signals, "signals", EXAMPLE), checked_span(span)
    pdos = source.pdos if source.known_rig is None else source.known_rig.pdos()
    pdo_signals = [signal for pdo in pdos for signal in pdo.signals]
    measured = [signal.name for signal in pdo_signals if signal.unit] or [signal.name for signal in pdo_signals]
    names = measured if signals is None else list(signals)
    units = {name: source.signal(name).unit for name in names}
    extent = source.extent()
    if extent is None:
        raise SpanError(f"{source.path}: it has no frame, so nothing can be drawn")
    first, last = extent
    begin = first if span[0] is None else max(span[0], first)
    end = last if span[1] is None else min(span[1], last)
    if not begin < end:
        raise SpanError(f"{source.path}: there is nothing to show: it goes from {first:.3f} s to {last:.3f} s")
    envelopes = {name: Envelope(begin, end) for name in names}
    markers: list[tuple[float, str]] = []
    for block in source.within(begin, end):
        markers += [(t_s, text) for t_s, text in block.markers if begin <= t_s <= end]
        if len(block.frames) and block.t_s[-1] >= begin and block.t_s[0] <= end:
            for name, envelope in envelopes.items():
                envelope.add(block.signals[name].t_s, block.signals[name].values)
    traces = tuple(envelope.trace(name, units[name]) for name, envelope in envelopes.items())
    left_out = tuple(signal.name for signal in pdo_signals if signal.name not in names) if signals is None else ()
    return Plot(Path(source.path).name, begin, end, traces, tuple(markers), left_out)


def hidden(data: Plot) -> tuple[tuple[str, str], ...]:
    """Return the curves that a later one of their panel covers, and that other one: at `COVERED` of
    the times they are less than a line apart.
    """
    pairs: list[tuple[str, str]] = []
    for place, trace in enumerate(data.traces):
        panel = [other for other in data.traces if trace.unit and other.unit == trace.unit and len(other.t_s)]
        if not len(trace.t_s) or trace not in panel:
            continue
        near = LINE * (max(other.high.max() for other in panel) - min(other.low.min() for other in panel))
        later = (other for other in data.traces[place + 1 :] if other in panel)
        cover = next((other for other in later if _apart(trace, other, near) <= 1 - COVERED), None)
        if cover is not None:
            pairs.append((trace.name, cover.name))
    return tuple(pairs)


def _apart(one: Trace, other: Trace, near: float) -> float:
    """Return the share of times at which two curves are more than `near` apart."""
    low, high = (np.interp(one.t_s, other.t_s, values) for values in (other.low, other.high))
    return float(np.mean((np.abs(low - one.low) > near) | (np.abs(high - one.high) > near)))


def draw(picture: Figure, data: Plot) -> None:
    """Draw panels, one for each unit, into an empty figure."""
    panels: dict[str, list[Trace]] = {}
    for trace in data.traces:
        panels.setdefault(trace.unit or trace.name, []).append(trace)
    axes = picture.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    below = dict(hidden(data))
    for panel, traces in zip(axes, panels.values(), strict=True):
        for trace, (colour, dashes) in zip(traces, _manners(traces), strict=True):
            _draw_trace(panel, trace, colour, dashes, wide=trace.name in below)
        unit = traces[0].unit
        panel.set_ylabel(f"{WORDS.get(unit, '')} [{unit}]".strip() if unit else traces[0].name.rpartition(".")[2])
        panel.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), borderaxespad=0.2)
        panel.margins(x=0)
        for t_s, _ in data.markers:
            panel.axvline(t_s, color="0.5", lw=0.6, ls=":")
    axes[0].set_title(data.title, pad=16 if data.markers else None)
    axes[-1].set_xlabel("time [s]")
    axes[-1].set_xlim(data.begin_s, data.end_s)
    _write_markers(axes[0], data)


def _manners(traces: Sequence[Trace]) -> Iterator[tuple[str, Any]]:
    """Yield colour and dashes: a quantity has its own colour, the same one of another axis a shade
    of it and other dashes (an envelope shows no dashes), and the rest what is left.
    """
    fixed = [QUANTITIES.get(trace.name.rpartition(".")[2]) for trace in traces]
    free = [colour for colour in COLOURS if colour not in fixed] or list(COLOURS)
    seen: dict[str, int] = {}
    rest = 0
    for fixed_colour in fixed:
        colour = fixed_colour or free[rest % len(free)]
        rest += fixed_colour is None
        again = seen.get(colour, 0)
        seen[colour] = again + 1
        yield shade(colour, again), DASHES[again % len(DASHES)]


def _draw_trace(axes: Axes, trace: Trace, colour: str, dashes: Any, *, wide: bool) -> None:
    """Draw a curve; one that another covers is wide, so that it stays visible below it."""
    if trace.is_envelope:
        axes.fill_between(trace.t_s, trace.low, trace.high, color=colour, alpha=0.35, lw=0)
        axes.plot(trace.t_s, trace.high, color=colour, lw=WIDE if wide else 0.7)
        axes.plot(trace.t_s, trace.low, color=colour, lw=WIDE if wide else 0.7, label=trace.name)
    else:
        style: Any = {"drawstyle": "default" if trace.unit else "steps-post"}
        axes.plot(trace.t_s, trace.low, color=colour, ls=dashes, lw=WIDE if wide else 1.0, label=trace.name, **style)


def _write_markers(axes: Axes, data: Plot) -> None:
    """Write texts above the first panel, those of phases first, where they do not cover each
    other.
    """
    width_s = (data.end_s - data.begin_s) * 0.011
    places: list[tuple[float, float]] = []
    for t_s, text in sorted(data.markers, key=lambda marker: "phase " not in marker[1])[:MOST_MARKERS]:
        shown = text.removeprefix("phase ").replace(".phase ", " ")[:24]
        end_s = t_s + width_s * (len(shown) + 1)
        if any(t_s < end and begin < end_s for begin, end in places):
            continue
        places.append((t_s, end_s))
        place: Any = {"xycoords": ("data", "axes fraction"), "xytext": (1, 3), "textcoords": "offset points"}
        axes.annotate(shown, (t_s, 1.0), fontsize=7, **place)


def plot(source: Source, signals: Sequence[str] | None = None, span: Span = WHOLE) -> Figure:
    """Return a figure of a recording's signals; parameters and errors as `traces_of`."""
    return figure_of(traces_of(source, signals, span))


def figure_of(data: Plot, look: Look | None = None) -> Figure:
    """Return a figure of what a picture shows, with a panel for each unit."""
    look = look or Look()
    panels = len({trace.unit or trace.name for trace in data.traces})
    width, height = (10, 1.2 + 1.5 * panels) if look.size_cm is None else (cm / CM_PER_INCH for cm in look.size_cm)
    with figure(width, height) as (picture, axes):
        axes.remove()
        draw(picture, data if look.title is None else replace(data, title=look.title))
    return picture


def save_picture(picture: Figure, path: Path, dpi: float | None = None) -> None:
    """Write a figure; the ending names the format, and the same figure has the same bytes.

    Parameters
    ----------
    dpi : pixels an inch of a .png; None: those of the common style
    """
    metadata: Mapping[str, Any] = {
        ".png": {"Software": None},
        ".svg": {"Date": None, "Creator": None},
        ".pdf": {"CreationDate": None, "Creator": None, "Producer": None},
    }
    import matplotlib

    from coulombus.recording.pictures.style import SETTINGS

    with matplotlib.rc_context(SETTINGS if dpi is None else {**SETTINGS, "savefig.dpi": dpi}):
        picture.savefig(path, metadata=metadata[path.suffix.lower()])
