"""Quantiles of many times, exact, in a memory that depends on how many different times there are."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

__all__ = ["TimeCounts"]

Integers: TypeAlias = npt.NDArray[np.int64]
WAITING = 1 << 16
"""Times that wait to be counted."""
NONE = np.zeros(0, np.int64)


class TimeCounts:
    """How often each time [ns] came: a cycle's times repeat, or differ by its jitter."""

    def __init__(self, times_ns: Integers = NONE, counts: Integers = NONE) -> None:
        self._times, self._counts = times_ns, counts
        self._waiting: list[Integers] = []
        self._size = 0

    def add(self, times_ns: Integers) -> None:
        """Count times."""
        self._waiting.append(times_ns)
        self._size += len(times_ns)
        if self._size >= WAITING:
            self._count()

    def _count(self) -> None:
        times, counts = np.unique(np.concatenate([NONE, *self._waiting]), return_counts=True)
        self._waiting, self._size = [], 0
        self._times, places = np.unique(np.concatenate((self._times, times)), return_inverse=True)
        sums = np.zeros(len(self._times), np.int64)
        np.add.at(sums, places, np.concatenate((self._counts, counts)))
        self._counts = sums

    def __len__(self) -> int:
        return int(self._counts.sum()) + self._size

    def at(self, place: float) -> float:
        """Return the time at a place of the sorted times, counted from 0, interpolated as `numpy.percentile` does."""
        self._count()
        ends = np.cumsum(self._counts)
        begin = int(place)
        rows = np.searchsorted(ends, [begin, min(begin + 1, int(ends[-1]) - 1)], "right")
        low, high = self._times[rows].tolist()
        share = place - begin
        return float(low + (high - low) * share if share < 0.5 else high - (high - low) * (1 - share))

    def percentiles(self, percents: Sequence[float]) -> list[float]:
        """Return percentiles [ns]."""
        return [self.at((len(self) - 1) * (percent / 100)) for percent in percents]

    def median(self) -> float:
        """Return the median [ns]; of an even number the mean of the middle two."""
        middle = (len(self) - 1) // 2
        return (self.at(middle) + self.at(len(self) // 2)) / 2

    def distances(self, from_ns: float) -> TimeCounts:
        """Return the distances from a time, in whole ns."""
        self._count()
        apart = TimeCounts(np.abs(self._times - from_ns).astype(np.int64), self._counts)
        apart._count()
        return apart
