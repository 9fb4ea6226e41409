"""Frames for the observers: some thousands at a time, grouped by identifier."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from coulombus.eds.cia301 import CobId
from coulombus.wire.can_flags import CAN_EFF_FLAG, CAN_ERR_FLAG, CAN_RTR_FLAG
from coulombus.wire.data_word import data_bytes
from coulombus.wire.frame import FRAME, Records

__all__ = ["BLOCK", "SYNC", "Block", "Frames", "Integers", "Pieces"]

Integers = npt.NDArray[np.int64]

BLOCK = 1 << 16
"""Maximum frames of a block: 2.6 MB."""
FAR, FAR_NS = 8192, 1_000_000_000
"""Frames, or ns, after the last SYNC beyond which a block no longer ends before it."""
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

    A block begins with a SYNC if possible, so that the frames after a SYNC are in one block.
    `comments` are (row within the block, text); `last`: no block follows.
    """

    frames: Records
    first_row: int
    comments: tuple[tuple[int, str], ...] = ()
    last: bool = False

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

    def of(self, *keys: int) -> Iterator[tuple[int, int, int, int, int]]:
        """Yield (row, t_ns, key, word, length) of these groups' frames, in the file's order."""
        groups = [(key, self.groups[key]) for key in keys if key in self.groups]
        if not groups:
            return
        rows = np.concatenate([group.rows for _, group in groups])
        order = np.argsort(rows, kind="stable")
        which = np.concatenate([np.full(len(group), key, np.int64) for key, group in groups])
        columns = [np.concatenate([getattr(group, name) for _, group in groups]) for name in ("t_ns", "word", "length")]
        chosen = (rows, columns[0], which, columns[1], columns[2])
        yield from zip(*(column[order].tolist() for column in chosen), strict=True)


class Pieces:
    """Cuts frames into blocks that begin with a SYNC."""

    def __init__(self) -> None:
        self._rest = np.zeros(0, FRAME)
        self._comments: list[tuple[int, str]] = []
        self._row = 0

    def take(self, frames: Records, comments: list[tuple[int, str]]) -> Iterator[Block]:
        """Yield the blocks that are complete; `comments` are (row of `frames`, text)."""
        self._comments += [(row + len(self._rest), text) for row, text in comments]
        whole = np.concatenate((self._rest, frames)) if len(self._rest) else frames
        while len(whole) > BLOCK:
            cut = _before_sync(whole[:BLOCK])
            yield self._cut(whole[:cut])
            whole = whole[cut:]
        cut = _before_sync(whole)
        if cut:
            yield self._cut(whole[:cut])
        self._rest = whole[cut:]

    def all_of(self, frames: Records) -> Iterator[Block]:
        """Yield frames in blocks, without waiting for the next SYNC."""
        for start in range(0, len(frames), BLOCK):
            yield self._cut(frames[start : start + BLOCK])

    @property
    def first_ns(self) -> int:
        """The stamp of the first pending frame, -1 if none."""
        return int(self._rest["t_ns"][0]) if len(self._rest) else -1

    def end(self, *, last: bool = True) -> Block:
        """Return the pending frames; `last`: no block follows."""
        rest, self._rest = self._rest, self._rest[:0]
        return self._cut(rest, last=last)

    def _cut(self, frames: Records, *, last: bool = False) -> Block:
        here = tuple((row, text) for row, text in self._comments if last or row < len(frames))
        self._comments = [(row - len(frames), text) for row, text in self._comments if not last and row >= len(frames)]
        block = Block(frames, self._row, here, last)
        self._row += len(frames)
        return block


def _before_sync(frames: Records) -> int:
    """Return the number of frames before the last SYNC; all frames if it is far back."""
    places = np.flatnonzero(frames["can_id"][-FAR:] == SYNC)
    cut = max(len(frames) - FAR, 0) + int(places[-1]) if len(places) else len(frames)
    far = cut == len(frames) or int(frames["t_ns"][-1]) - int(frames["t_ns"][cut]) > FAR_NS
    return len(frames) if far else cut
