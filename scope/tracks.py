"""What of a signal is kept for drawing: its last samples, and the envelope of ten seconds.

Both are bounded: a ring that is full forgets its oldest. Times are integer nanoseconds and rise.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

__all__ = ["BIN_NS", "ENVELOPE_BINS", "Envelope", "Samples", "velocity"]

Floats: TypeAlias = npt.NDArray[np.float64]
Integers: TypeAlias = npt.NDArray[np.int64]

BIN_NS = 20_000_000
"""Width of a bin of an envelope."""
ENVELOPE_BINS = 500
"""Ten seconds of them."""


class Envelope:
    """Minimum and maximum of a signal in each bin of `BIN_NS`; the last `ENVELOPE_BINS` of them.

    Bin k holds the samples of k BIN_NS <= t < (k + 1) BIN_NS. A bin without a sample is NaN.
    """

    def __init__(self) -> None:
        self._low = np.full(ENVELOPE_BINS, np.nan)
        self._high = np.full(ENVELOPE_BINS, np.nan)
        self.newest = -1
        """The bin of the newest sample; -1: none came."""

    def add(self, t_ns: Integers, values: Floats) -> None:
        """Add samples; those of before the newest bin are left out, and NaN counts as no sample."""
        bins = t_ns // BIN_NS
        right = np.isfinite(values) & (bins >= self.newest)
        bins, values = bins[right], values[right]
        if not len(bins):
            return
        last = int(bins.max())
        first = last - ENVELOPE_BINS + 1 if self.newest < 0 else max(self.newest + 1, last - ENVELOPE_BINS + 1)
        fresh = np.arange(first, last + 1) % ENVELOPE_BINS
        self._low[fresh] = self._high[fresh] = np.nan
        self.newest = last
        kept = bins > last - ENVELOPE_BINS
        places, values = bins[kept] % ENVELOPE_BINS, values[kept]
        np.fmin.at(self._low, places, values)
        np.fmax.at(self._high, places, values)

    def since(self, bin_: int) -> tuple[int, Floats, Floats]:
        """Return the bins from `bin_` on, the newest included: the first one's number, minima,
        maxima.

        Earlier ones than are kept are left out.
        """
        first = max(bin_, self.newest - ENVELOPE_BINS + 1, 0)
        places = np.arange(first, self.newest + 1) % ENVELOPE_BINS
        return first, self._low[places], self._high[places]


class Samples:
    """The last samples of a signal, `capacity` of them.

    Each stands twice, `capacity` apart: so the last ones are one piece, and nothing is copied to look
    at them.
    """

    def __init__(self, capacity: int) -> None:
        self._t_ns = np.zeros(2 * capacity, np.int64)
        self._values = np.zeros(2 * capacity)
        self._capacity, self._count = capacity, 0

    def __len__(self) -> int:
        return min(self._count, self._capacity)

    def add(self, t_ns: Integers, values: Floats) -> None:
        """Add samples."""
        t_ns, values = t_ns[-self._capacity :], values[-self._capacity :]
        places = np.arange(self._count, self._count + len(t_ns)) % self._capacity
        self._t_ns[places], self._values[places] = t_ns, values
        self._t_ns[places + self._capacity], self._values[places + self._capacity] = t_ns, values
        self._count += len(t_ns)

    def _piece(self, n: int) -> slice:
        end = self._count % self._capacity + self._capacity
        return slice(end - min(n, len(self)), end)

    def last(self, n: int) -> tuple[Integers, Floats]:
        """Return the last `n` samples, or as many as there are: times [ns], values."""
        piece = self._piece(n)
        return self._t_ns[piece].copy(), self._values[piece].copy()

    def since(self, t_ns: int) -> tuple[Integers, Floats]:
        """Return the samples of `t_ns` and later, as far as times rise: times [ns], values."""
        piece = self._piece(len(self))
        first = piece.start + int(np.searchsorted(self._t_ns[piece], t_ns))
        return self._t_ns[first : piece.stop].copy(), self._values[first : piece.stop].copy()


def velocity(t_ns: Integers, angle: Floats, period_ns: int, cycles: int) -> tuple[Integers, Floats]:
    """Return times and velocity [angle's unit/s] over `cycles` samples: (x[k] - x[k - n]) / (t[k] -
    t[k - n]).

    One count a cycle is much for a display, so that the difference is over several. The time
    between is taken in whole periods: the jitter of the stamps is none of the handle's.
    """
    if len(t_ns) <= cycles:
        return t_ns[:0], angle[:0]
    periods: npt.NDArray[Any] = np.maximum(np.rint((t_ns[cycles:] - t_ns[:-cycles]) / period_ns), 1.0)
    return t_ns[cycles:], (angle[cycles:] - angle[:-cycles]) / (periods * (period_ns * 1e-9))
