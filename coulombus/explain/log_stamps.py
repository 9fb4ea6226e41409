"""Stamps of a log that are not those of frames on the bus: a clock was set back, or an adapter stamps batches.

Adapters that hand over several frames at once, as over USB, leave the times between them unknown.
"""

from __future__ import annotations

import numpy as np

from coulombus.explain.frames import Block, Integers
from coulombus.kernels.records import Records

__all__ = ["OF_TIMES", "StampBatches", "StraightTimes"]

SET_NS = 1_000_000_000
"""Step by which a clock was set; less is the order in which frames were written."""
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


class StraightTimes:
    """Makes stamps monotonic: a clock that was set back goes on, and a single frame of another clock is put in its place."""

    def __init__(self) -> None:
        self._raw_ns: int | None = None  # the last stamp
        self._last_ns = 0  # the same on this axis
        self._behind_ns = 0  # time by which the clock was set back so far

    def straight(self, frames: Records) -> Records:
        """Return frames with monotonic stamps; the same array if theirs are."""
        if len(frames) == 0:
            return frames
        raw = np.ascontiguousarray(frames["t_ns"]).astype(np.int64)
        before = int(raw[0]) if self._raw_ns is None else self._raw_ns
        if not self._behind_ns and raw[0] >= before and (np.diff(raw) >= 0).all():
            self._raw_ns = self._last_ns = int(raw[-1])
            return frames
        t_ns = _without_strays(raw, before)
        back = np.diff(t_ns, prepend=before) < -SET_NS
        set_ns = np.where(back, _before_each(t_ns, before) - t_ns, 0)
        t_ns = t_ns + np.cumsum(set_ns) + self._behind_ns
        self._behind_ns += int(set_ns.sum())
        self._raw_ns = int(raw[-1])
        t_ns = np.maximum.accumulate(np.maximum(t_ns, self._last_ns))
        self._last_ns = int(t_ns[-1])
        straight = frames.copy()
        straight["t_ns"] = t_ns
        return straight


def _before_each(t_ns: Integers, before: int) -> Integers:
    """Return the stamp before each one."""
    return np.concatenate(([before], t_ns[:-1]))


def _without_strays(t_ns: Integers, before: int) -> Integers:
    """Return stamps of which each that lies alone far from those around it has that of the frame before."""
    earlier = _before_each(t_ns, before)
    later = np.append(t_ns[1:], t_ns[-1])
    stray = (np.abs(t_ns - earlier) > SET_NS) & (np.abs(later - earlier) <= SET_NS)
    return np.where(stray, earlier, t_ns)


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
