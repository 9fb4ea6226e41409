"""Signal data kept for drawing: the last samples, and the envelope of ten seconds.

Both are ring buffers. Times are integer nanoseconds and rise.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

__all__ = ["BIN_NS", "ENVELOPE_BINS", "LiveEnvelope", "Samples", "Track", "velocity"]

Floats: TypeAlias = npt.NDArray[np.float64]
Integers: TypeAlias = npt.NDArray[np.int64]

BIN_NS = 20_000_000
"""Width of a bin of an envelope."""
ENVELOPE_BINS = 500
"""Bins of an envelope: ten seconds."""


class LiveEnvelope:
    """Minimum and maximum of signals in the last `ENVELOPE_BINS` bins of `BIN_NS`.

    Bin k holds the samples of k BIN_NS <= t < (k + 1) BIN_NS. A bin without a sample is NaN.

    Parameters
    ----------
    signals : their number; they share their times
    """

    def __init__(self, signals: int = 1) -> None:
        self._bounds = np.full((2, signals, ENVELOPE_BINS), np.nan)  # minima, maxima
        self.newest = -1
        """The bin of the newest sample; -1: no sample."""

    def add(self, t_ns: Integers, values: Floats) -> None:
        """Add samples of one signal, shape (n,), or of all, (signals, n).

        Samples before the newest bin and non-finite values are ignored.
        """
        bins, values = t_ns // BIN_NS, np.atleast_2d(values)
        if not len(bins):
            return
        if not np.isfinite(values).all():
            values = np.where(np.isfinite(values), values, np.nan)
        steps = bins[1:] - bins[:-1]
        if (steps < 0).any():  # the clock was set back
            order = np.argsort(bins, kind="stable")
            bins, values = bins[order], values[:, order]
            steps = bins[1:] - bins[:-1]
        last = max(int(bins[-1]), self.newest)
        oldest = max(self.newest, last - ENVELOPE_BINS + 1)
        if last > self.newest:
            first = last - ENVELOPE_BINS + 1 if self.newest < 0 else max(self.newest + 1, oldest)
            self._bounds[..., np.arange(first, last + 1) % ENVELOPE_BINS] = np.nan
            self.newest = last
        starts = np.concatenate(([0], np.flatnonzero(steps) + 1))
        starts = starts[bins[starts] >= oldest]
        if len(starts):
            places = bins[starts] % ENVELOPE_BINS
            low, high = self._bounds
            low[:, places] = np.fmin(low[:, places], np.fmin.reduceat(values, starts, axis=1))
            high[:, places] = np.fmax(high[:, places], np.fmax.reduceat(values, starts, axis=1))

    def since(self, bin_: int, signal: int = 0) -> tuple[int, Floats, Floats]:
        """Return the bins of a signal from `bin_` to the newest: number of the first, minima, maxima.

        Bins that are no longer kept are omitted.
        """
        first = max(bin_, self.newest - ENVELOPE_BINS + 1, 0)
        low, high = self._bounds[:, signal, np.arange(first, self.newest + 1) % ENVELOPE_BINS]
        return first, low, high


class Samples:
    """The last `capacity` samples of signals that share their times.

    Each sample is stored twice, `capacity` apart, so that the last ones are contiguous and are returned without a copy.
    """

    def __init__(self, capacity: int, signals: int = 1) -> None:
        self._t_ns = np.zeros(2 * capacity, np.int64)
        self._values = np.zeros((signals, 2 * capacity))
        self._capacity, self._count = capacity, 0

    def __len__(self) -> int:
        return min(self._count, self._capacity)

    @property
    def count(self) -> int:
        """Number of samples added so far."""
        return self._count

    def add(self, t_ns: Integers, values: Floats) -> None:
        """Add samples of one signal, shape (n,), or of all, (signals, n)."""
        capacity = self._capacity
        t_ns, values = t_ns[-capacity:], values[..., -capacity:]
        begin = self._count % capacity
        room = capacity - begin
        for first, part in ((begin, slice(0, room)), (0, slice(room, None))):
            if len(times := t_ns[part]):
                for place in (first, first + capacity):
                    self._t_ns[place : place + len(times)] = times
                    self._values[:, place : place + len(times)] = values[..., part]
        self._count += len(t_ns)

    def _piece(self, n: int) -> slice:
        end = self._count % self._capacity + self._capacity
        return slice(end - min(n, len(self)), end)

    def last(self, n: int, signal: int = 0) -> tuple[Integers, Floats]:
        """Return the last `n` samples of a signal, or as many as there are: times [ns], values."""
        piece = self._piece(n)
        return self._t_ns[piece].copy(), self._values[signal, piece].copy()

    def since(self, t_ns: int, signal: int = 0) -> tuple[Integers, Floats]:
        """Return the samples from `t_ns` while times rise: times [ns], values; views, as in `all_since`."""
        times, values = self.all_since(t_ns)
        return times, values[signal]

    def all_since(self, t_ns: int) -> tuple[Integers, Floats]:
        """Return the samples of all signals from `t_ns`: times [ns], values of shape (signals, n).

        They are views: later samples may change them.
        """
        piece = self._piece(len(self))
        first = piece.start + int(self._t_ns[piece].searchsorted(t_ns))
        return self._t_ns[first : piece.stop], self._values[:, first : piece.stop]


@dataclass(frozen=True)
class Track:
    """One signal of a `Samples` and an `LiveEnvelope`."""

    samples: Samples
    bins: LiveEnvelope
    signal: int

    def last(self, n: int) -> tuple[Integers, Floats]:
        """Return the last `n` samples, or as many as there are: times [ns], values."""
        return self.samples.last(n, self.signal)

    def since(self, t_ns: int) -> tuple[Integers, Floats]:
        """Return the samples of `t_ns` and later: times [ns], values."""
        return self.samples.since(t_ns, self.signal)

    def bins_since(self, bin_: int) -> tuple[int, Floats, Floats]:
        """Return the bins from `bin_`: number of the first, minima, maxima."""
        return self.bins.since(bin_, self.signal)


def velocity(t_ns: Integers, angle: Floats, period_ns: int, cycles: int) -> tuple[Integers, Floats]:
    """Return times and velocity [angle's unit/s] over `cycles` samples: (x[k] - x[k - n]) / (t[k] -
    t[k - n]).

    One count per cycle is coarse for a display, so the difference spans several cycles. The time
    between is rounded to whole periods, because the jitter of the stamps is not motion of the
    handle.
    """
    if len(t_ns) <= cycles:
        return t_ns[:0], angle[:0]
    periods: npt.NDArray[Any] = np.maximum(np.rint((t_ns[cycles:] - t_ns[:-cycles]) / period_ns), 1.0)
    return t_ns[cycles:], (angle[cycles:] - angle[:-cycles]) / (periods * (period_ns * 1e-9))
