"""A position followed across the wraps of its counter.

A device tells its position modulo 2^bits. Between two samples the handle has gone the shorter way::

    step = (raw - raw before + half) mod 2 half - half,     half = 2^(bits - 1)

That is sure while a step is less than `half` counts. The host trips above
`limits.encoder_jump_counts` a cycle, so a gap of half / encoder_jump_counts cycles is the longest
over which the position can be followed; longer ones are counted. A step of more than half of
`half` even the shorter way, and faster than the host lets pass, is a jump and no wrap: it
stays as it was told.
"""

from __future__ import annotations

from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from coulombus.eds.pdo import Entry
from coulombus.rigs.rig import Rig

__all__ = ["POSITION", "Turns", "Unwrapped", "fastest", "follow"]

POSITION = "motor.position_rad"
"""The signal that is followed (of each axis, with its name before it)."""

Integers: TypeAlias = npt.NDArray[np.int64]


class Turns(NamedTuple):
    """A position's last sample: raw count, time, the counts that its wraps came to, and in how many
    gaps before it more wraps may have been.
    """

    raw: int
    t_ns: int
    wrapped: int
    doubts: int = 0


class Unwrapped(NamedTuple):
    """The counts without wraps, and the last of them."""

    counts: npt.NDArray[Any]
    last: Turns | None


def fastest(rig: Rig, name: str) -> float:
    """Return the counts a ns that the host lets pass of a position; `name`: the signal's."""
    axis = next(candidate for candidate in rig.axes if candidate.prefix + POSITION == name)
    return axis.limits.encoder_jump_counts / axis.bus.period_ns


def follow(raw: npt.NDArray[Any], t_ns: Integers, entry: Entry, before: Turns | None, counts_ns: float) -> Unwrapped:
    """Return raw counts of a position without its wraps.

    Parameters
    ----------
    raw, t_ns : the samples, in their order
    entry : the object as it is mapped; one that is no integer, or of 64 bits, does not wrap
    before : the sample before them; None at the beginning
    counts_ns : the fastest that it may go [counts/ns]
    """
    if not len(raw) or entry.kind != "int" or entry.bits >= 64:
        return Unwrapped(raw, before)
    whole, half = 1 << entry.bits, 1 << entry.bits - 1
    first = Turns(int(raw[0]), int(t_ns[0]), 0) if before is None else before
    steps = np.diff(raw, prepend=first.raw)
    shorter = (steps + half) % whole - half
    farthest = counts_ns * np.diff(t_ns, prepend=first.t_ns)
    wraps = np.where(np.abs(shorter) <= np.maximum(farthest, half // 2), shorter - steps, 0)
    wrapped = first.wrapped + np.cumsum(wraps)
    doubts = first.doubts + int(np.count_nonzero(farthest >= half))
    return Unwrapped(raw + wrapped, Turns(int(raw[-1]), int(t_ns[-1]), int(wrapped[-1]), doubts))
