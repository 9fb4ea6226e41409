"""Two recordings side by side, a piece at a time, and what their differences come to."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from coulombus.recording.difference import Pair
from coulombus.recording.long_recording import LongRecording
from coulombus.recording.signals import Recording, Series

__all__ = ["PIECE_NS", "CommonSpan", "Cursor", "Tally", "pair_in", "pieces"]

Floats: TypeAlias = npt.NDArray[np.float64]
PIECE_NS = 60_000_000_000
"""Length of a piece of long recordings."""
SUMMED = 1 << 18
"""Squares that are summed at a time."""


@dataclass(frozen=True)
class CommonSpan:
    """A common stretch: its time 0 in each recording, and its begin and end from there."""

    name: str
    zero: tuple[float, float]
    begin_s: float
    end_s: float

    @property
    def ends_ns(self) -> tuple[float, float]:
        """Begin and end in whole ns, so that the same sample has the same time in both."""
        begin, end = np.rint((self.begin_s * 1e9, self.end_s * 1e9))
        return float(begin), float(end)


def pieces(span: CommonSpan, *, is_long: bool) -> Iterator[tuple[float, float]]:
    """Yield begin and end [ns] of the pieces of a span."""
    begin, end = span.ends_ns
    while is_long and end - begin > PIECE_NS:
        yield begin, begin + PIECE_NS
        begin += PIECE_NS
    yield begin, end


def pair_in(a: Series, b: Series, zero: tuple[float, float], ends_ns: tuple[float, float]) -> tuple[Pair, int]:
    """Return both signals at the first one's times between two times from `zero`, and the number of
    the second one's samples there; without them the values of the second are those around.
    """
    times = [np.rint((signal.t_s - at) * 1e9) for signal, at in zip((a, b), zero, strict=True)]
    inside, others = ((t >= ends_ns[0]) & (t < ends_ns[1]) for t in times)
    t_s, t_ns = a.t_s[inside], times[0][inside]
    values = b.values.astype(np.float64)
    if not len(values) or not len(t_s):
        other = np.full(len(t_s), np.nan)
    elif b.unit:
        other = np.interp(t_ns, times[1], values)
    else:
        other = values[np.maximum(np.searchsorted(times[1], t_ns, "right") - 1, 0)]
    return Pair(t_s, a.values[inside].astype(np.float64), other), int(np.count_nonzero(others))


class Cursor:
    """The signals of a recording around a stretch of time that moves on; a short recording is given whole."""

    def __init__(self, recording: Recording, names: Collection[str]) -> None:
        self._names = names
        self._is_long = isinstance(recording, LongRecording)
        self._last_s = {name: recording.last_s(name) for name in names}
        self._blocks = iter(recording)
        self._parts: dict[str, Series] = {}

    def around(self, begin_s: float, end_s: float) -> dict[str, Series]:
        """Return each signal from a sample before a stretch to one behind it."""
        added: dict[str, list[Series]] = {name: [] for name in self._names}
        reached = {name: part.t_s[-1] for name, part in self._parts.items() if len(part)}
        while any(self._lacks(name, reached.get(name), end_s) for name in self._names):
            block = next(self._blocks, None)
            if block is None:
                break
            for name in self._names:
                part = block.signals[name]
                if len(part) or not self._is_long:
                    added[name].append(part)
                    reached[name] = part.t_s[-1] if len(part) else -np.inf
        for name, parts in added.items():
            here = [part for part in (self._parts.get(name), *parts) if part is not None]
            if not here:
                self._parts[name] = Series(np.zeros(0), np.zeros(0), "")
                continue
            first = here[0] if len(here) == 1 else _joined(here)
            begin = max(int(np.searchsorted(first.t_s, begin_s)) - 2, 0) if self._is_long else 0
            self._parts[name] = Series(first.t_s[begin:], first.values[begin:], first.unit)
        return self._parts

    def _lacks(self, name: str, reached_s: float | None, end_s: float) -> bool:
        last_s = self._last_s[name]
        return last_s is not None and (reached_s is None or (reached_s <= end_s and reached_s < last_s))


def _joined(parts: list[Series]) -> Series:
    t_s, values = (np.concatenate([getattr(part, name) for part in parts]) for name in ("t_s", "values"))
    return Series(t_s, values, parts[-1].unit)


@dataclass
class Tally:
    """What the differences of one signal come to."""

    samples: int = 0
    largest: float = 0.0
    at_s: float = 0.0
    phase: str = ""
    whole: bool = True
    """Whether both have the same number of samples in each span."""
    _squares: list[Floats] = field(default_factory=list)
    _sum: float | None = None
    """Of squares that are no longer kept."""
    _waiting: list[Pair] = field(default_factory=list)
    """Pieces of a span in which the second signal has no sample so far."""
    _counts: tuple[int, int] = (0, 0)
    """Samples of both in the span."""

    def add(self, pair: Pair, others: int, phase: str) -> None:
        """Add a piece of a span, in which the second signal has `others` samples."""
        self._counts = (self._counts[0] + len(pair.t_s), self._counts[1] + others)
        self._waiting.append(pair)
        if self._counts[1]:
            for part in self._waiting:
                if len(part.t_s):
                    self._take(part, phase)
            self._waiting = []

    def end(self) -> None:
        """End a span; it counts if both have samples in it."""
        self.whole = self.whole and self._counts[0] == self._counts[1]
        self._waiting, self._counts = [], (0, 0)

    def _take(self, pair: Pair, phase: str) -> None:
        apart = np.abs(pair.difference)
        apart = np.where(np.isnan(apart), np.inf, apart)
        at = int(np.argmax(apart))
        if not self.samples or apart[at] > self.largest:
            self.largest, self.at_s, self.phase = float(apart[at]), float(pair.t_s[at]), phase
        self.samples += len(apart)
        self._squares.append(apart**2)
        if sum(map(len, self._squares)) > SUMMED:
            self._sum = (self._sum or 0.0) + float(np.sum(np.concatenate(self._squares)))
            self._squares = []

    @property
    def rms(self) -> float:
        """Root mean square of the differences."""
        rest = np.concatenate([np.zeros(0), *self._squares])
        if self._sum is None:
            return float(np.sqrt(np.mean(rest)))
        return float(np.sqrt((self._sum + float(np.sum(rest))) / self.samples))
