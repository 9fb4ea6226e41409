"""The time axis of a log: stamps that go back, stand still, are differences, or come from another clock."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

__all__ = ["DIFFERENCES", "are_differences", "remarks"]

Integers = npt.NDArray[np.int64]
LEAST = 3
"""Fewest frames of which a time axis is judged."""
BACK = 0.2
"""Share of stamps lower than the one before, from which on stamps are differences. Of a clock, few are."""
CLOCK_NS = 10_000_000
"""A single stamp so far from those around it is another clock's; frames of two channels swap by less."""

DIFFERENCES = "its stamps are times since the frame before (candump -t d) and were added up"


def are_differences(t_ns: Integers) -> bool:
    """Return whether stamps are times since the frame before: they rise and fall, or all but the first are equal."""
    steps = np.diff(t_ns)
    if len(t_ns) < LEAST:
        return False
    return bool(np.count_nonzero(steps < 0) >= BACK * len(steps) or (t_ns[1] > 0 and (steps[1:] == 0).all()))


def remarks(t_ns: Integers) -> list[str]:
    """Return sentences on the time axis of the frames, which are counted from 1.

    Parameters
    ----------
    t_ns : (N,) stamps in the file's order [ns]
    """
    if len(t_ns) < LEAST:
        return []
    if (t_ns == t_ns[0]).all():
        return [f"all {len(t_ns)} frames have the stamp {t_ns[0] / 1e9:g} s: it has no times; log with time stamps"]
    strays = _strays(t_ns)
    texts = []
    if len(strays):
        row = int(strays[0])
        away_s = max(abs(int(t_ns[row] - t_ns[row - 1])), abs(int(t_ns[row] - t_ns[row + 1]))) / 1e9
        texts.append(
            f"{_count(len(strays), 'frame has', 'frames have')} the stamp of another clock: frame {row + 1} is "
            f"{away_s:g} s from the frames around it; times and rates there are wrong"
        )
    kept = np.delete(np.arange(len(t_ns)), strays)
    steps = np.diff(t_ns[kept])
    back = np.flatnonzero(steps < 0)
    if len(back):
        row = int(kept[back[0] + 1])
        texts.append(
            f"{_count(len(back), 'stamp goes', 'stamps go')} back: that of frame {row + 1} by {-steps[back[0]] / 1e9:g} s; "
            "a reset adapter, a counter that began again, or logs joined: split the log there"
        )
    return texts


def _strays(t_ns: Integers) -> Integers:
    """Return the rows of single stamps far outside of the stamps around them, which are in order."""
    before, here, after = t_ns[:-2], t_ns[1:-1], t_ns[2:]
    outside = np.maximum(before - here, here - after) > CLOCK_NS
    rows: Integers = np.flatnonzero(outside & (before <= after)) + 1
    return rows


def _count(number: int, one: str, several: str) -> str:
    return f"{number} {one if number == 1 else several}"
