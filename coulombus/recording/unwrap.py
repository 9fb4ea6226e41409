"""Unwrap a position across overflows of its counter.

A device reports its position modulo 2^bits. Between two samples the handle is assumed to take the shorter way::

    step = (raw - raw before + half) mod 2 half - half,     half = 2^(bits - 1)

This is certain while a step is less than `half` counts. The host trips above
`limits.encoder_jump_counts` a cycle, so the longest gap that can be bridged is half /
encoder_jump_counts cycles; longer gaps are counted. A step that is both larger than half / 2 and
faster than the host's limit is a jump, not a wrap: it is kept.
"""

from __future__ import annotations

from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from coulombus.eds.pdo import Entry
from coulombus.rigs.rig import Rig

__all__ = ["POSITION", "Turns", "Unwrapped", "fastest", "follow"]

POSITION = "motor.position_rad"
"""The signal to unwrap (of each axis, with its name as prefix)."""

Integers: TypeAlias = npt.NDArray[np.int64]


class Turns(NamedTuple):
    """A position's last sample: raw count, time, sum of its wraps in counts, and number of earlier
    gaps with possible further wraps.
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
    """Return the host's speed limit for a position [counts/ns]; `name`: the signal's."""
    axis = next(candidate for candidate in rig.axes if candidate.prefix + POSITION == name)
    return axis.limits.encoder_jump_counts / axis.bus.period_ns


def follow(raw: npt.NDArray[Any], t_ns: Integers, entry: Entry, before: Turns | None, counts_ns: float) -> Unwrapped:
    """Return the unwrapped counts of a position.

    Parameters
    ----------
    raw, t_ns : the samples, in their order
    entry : the mapped object; non-integers and 64-bit integers do not wrap
    before : the previous sample; None at the beginning
    counts_ns : the speed limit [counts/ns]
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
