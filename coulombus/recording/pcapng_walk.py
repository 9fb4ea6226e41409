"""Walk from block to block of a pcapng file, compiled."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from coulombus.kernels.decorator import inlined, kernel

__all__ = ["BAD", "END", "FULL", "SECTION", "Integers", "Words", "swapped", "walk"]

Words: TypeAlias = npt.NDArray[np.uint32]
Integers: TypeAlias = npt.NDArray[np.int64]

END, FULL, SECTION, BAD = range(4)
"""Why a walk stops: the words end, `offsets` is full, a section header, no block."""


@inlined
def swapped(word: int) -> int:
    """Return a word of 32 bits with its bytes in the other order."""
    return (word & 0xFF) << 24 | (word & 0xFF00) << 8 | (word >> 8) & 0xFF00 | word >> 24


@kernel
def walk(words: Words, at: int, swap: int, offsets: Integers) -> tuple[int, int, int]:
    """Note where blocks begin (in words), from `at` on.

    Return their number, the stop position, and its reason.
    """
    size = words.shape[0]
    count = 0
    while True:
        if size - at < 3:
            return count, at, END
        if np.int64(words[at]) == 0x0A0D0D0A:
            return count, at, SECTION
        if count == offsets.shape[0]:
            return count, at, FULL
        length: Any = np.int64(words[at + 1])
        if swap:
            length = swapped(length)
        if length < 12 or length % 4 != 0 or length > 0x1000000:
            return count, at, BAD
        after = at + length // 4
        if after > size:
            return count, at, END
        if words[after - 1] != words[at + 1]:
            return count, at, BAD
        offsets[count] = at
        count += 1
        at = after
