"""Frames for the observers: many at a time, grouped by identifier."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from coulombus.eds.cia301 import CobId
from coulombus.kernels.records import Records
from coulombus.wire.can_flags import CAN_EFF_FLAG, CAN_ERR_FLAG, CAN_RTR_FLAG
from coulombus.wire.data_word import data_bytes

__all__ = ["BLOCK", "SYNC", "Block", "Frames", "Integers", "Rolling"]

Integers = npt.NDArray[np.int64]

BLOCK = 1 << 16
"""Maximum frames of a block: 2.6 MB."""
SYNC = int(CobId.SYNC)
REMOTE, EXTENDED, ERROR = 0x2000, 0x4000, 0x8000
"""Bits of a group's key above the 11 bits of a base identifier."""


@dataclass(frozen=True)
class Frames:
    """The frames of one identifier in a block, in their order."""

    rows: Integers
    """Numbers of the frames in the file, from 0."""
    t_ns: Integers
    word: Integers
    length: Integers

    def __len__(self) -> int:
        return len(self.rows)

    def data(self, i: int) -> bytes:
        """Return the data bytes of frame `i`."""
        return data_bytes(int(self.word[i]), int(self.length[i]))


@dataclass(frozen=True)
class Block:
    """Some frames of a log, with their comments.

    `comments` are (row within the block, text).
    """

    frames: Records
    first_row: int
    comments: tuple[tuple[int, str], ...] = ()

    def part(self, start: int, end: int) -> Block:
        """Return the frames from `start` until before `end`, with their comments."""
        if start == 0 and end == len(self.frames):
            return self  # with its groups
        last = end == len(self.frames)
        comments = tuple((row - start, text) for row, text in self.comments if start <= row and (last or row < end))
        return Block(self.frames[start:end], self.first_row + start, comments)

    @cached_property
    def t_ns(self) -> Integers:
        """Stamps [ns]."""
        return np.ascontiguousarray(self.frames["t_ns"])

    @cached_property
    def groups(self) -> dict[int, Frames]:
        """The frames by key: the base identifier, with `REMOTE` for remote frames.

        All extended frames are the group `EXTENDED`, all error frames the group `ERROR`.
        """
        can_id = np.ascontiguousarray(self.frames["can_id"])
        key = (can_id & 0x7FF) | np.where(can_id & CAN_RTR_FLAG, REMOTE, 0)
        key = np.where(can_id & CAN_EFF_FLAG, EXTENDED, key)
        key = np.where(can_id & CAN_ERR_FLAG, ERROR, key).astype(np.uint16)
        order = np.argsort(key, kind="stable")  # 16 bits: a radix sort
        in_order = key[order]
        starts = np.flatnonzero(np.r_[True, in_order[1:] != in_order[:-1]]) if len(order) else np.zeros(0, np.int64)
        ends = np.r_[starts[1:], len(order)] if len(order) else starts
        word = np.ascontiguousarray(self.frames["word"])
        length = np.ascontiguousarray(self.frames["length"])
        return {
            int(in_order[start]): Frames(
                self.first_row + order[start:end],
                *(column[order[start:end]] for column in (self.t_ns, word, length)),
            )
            for start, end in zip(starts.tolist(), ends.tolist(), strict=True)
        }

    def merged(self, *keys: int) -> Iterator[tuple[int, int, int, int, int]]:
        """Yield (row, t_ns, key, word, length) of these groups' frames, in the file's order."""
        groups = [(key, self.groups[key]) for key in keys if key in self.groups]
        if not groups:
            return
        rows = np.concatenate([group.rows for _, group in groups])
        order = np.argsort(rows, kind="stable")
        which = np.concatenate([np.full(len(group), key, np.int64) for key, group in groups])
        columns = [np.concatenate([getattr(group, name) for _, group in groups]) for name in ("t_ns", "word", "length")]
        fields = (rows, columns[0], which, columns[1], columns[2])
        yield from zip(*(column[order].tolist() for column in fields), strict=True)


class Rolling:
    """Number of true values among the last `size` ones of a stream."""

    def __init__(self, size: int) -> None:
        self.size = size
        self._last = np.zeros(0, bool)

    def counts(self, values: npt.NDArray[np.bool_]) -> Integers:
        """Return the number behind each of the next values."""
        whole = np.concatenate((self._last, values))
        self._last = whole[-self.size :]
        total = np.concatenate(([0], np.cumsum(whole)))
        behind = np.arange(len(whole) - len(values), len(whole)) + 1
        return total[behind] - total[np.maximum(behind - self.size, 0)]
