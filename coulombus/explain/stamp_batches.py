"""Stamps of adapters that hand over several frames at once, as over USB: the times between them are unknown."""

from __future__ import annotations

import numpy as np

from coulombus.explain.frames import Block, Integers

__all__ = ["OF_TIMES", "StampBatches"]

WHOLE = 10_000
"""Intervals of which the stamps are judged: the first ones."""
LEAST = 20
ONE_NS = 30_000
"""Interval of two frames that no bus carries: the shortest frame lasts 47 us at 1 Mbit/s."""
BATCH_NS = 1_500_000
"""Least time between two batches."""
SHARE, LATTICE, NEAR = 0.3, 0.9, 0.1
"""Least share of frames that come at one time; of the other intervals, of those that are a multiple of the shortest
usual one, and how near they are to it."""
OF_TIMES = frozenset(
    {
        *("sync_gap", "sync_jitter", "two_sync", "babble", "bus_load", "starved", "tpdo_late", "rpdo_late", "repeated"),
        *("tpdo_missing", "event_timer", "inhibit_time", "heartbeat_late"),
    }
)
"""Kinds about times between frames."""


class StampBatches:
    """Detects stamps that are those of batches."""

    def __init__(self) -> None:
        self._gaps: Integers = np.zeros(0, np.int64)
        self._last_ns = -1

    def add_frames(self, block: Block) -> None:
        """Process a block."""
        if not len(block.t_ns) or len(self._gaps) >= WHOLE:
            return
        first = block.t_ns[:1] if self._last_ns < 0 else np.array([self._last_ns])
        self._gaps = np.concatenate((self._gaps, np.diff(block.t_ns, prepend=first)[self._last_ns < 0 :]))[:WHOLE]
        self._last_ns = int(block.t_ns[-1])

    @property
    def period_ns(self) -> int:
        """Return the time [ns] between batches; 0: the stamps are those of frames."""
        apart = self._gaps[self._gaps >= ONE_NS]
        if len(apart) < LEAST or len(apart) > (1 - SHARE) * len(self._gaps):
            return 0
        period = int(np.percentile(apart, 10))
        away = np.abs(apart / period - np.maximum(np.round(apart / period), 1))
        return period if period >= BATCH_NS and (away < NEAR).mean() >= LATTICE else 0
