"""A time axis that does not go back, for logs whose stamps do."""

from __future__ import annotations

import numpy as np

from coulombus.explain.frames import Integers
from coulombus.wire.frame import Records

__all__ = ["StraightTimes"]

SET_NS = 1_000_000_000
"""Step by which a clock was set; less is the order in which frames were written."""


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
