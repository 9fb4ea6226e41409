"""Find a time in a long recording without reading it: bisection over the stamps of its packets.

This holds for recordings of this project, whose stamps rise. A packet is found from any offset by
the shape of its block and of those behind it (`recording.pcapng_blocks`).
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from coulombus.recording.pcapng_blocks import ENHANCED_PACKET, next_block
from coulombus.recording.pcapng_packets import Interface, decode_packets
from coulombus.recording.pcapng_walk import Integers

__all__ = ["ALL", "Window", "offset_before"]

FIRST_NS, LAST_NS = -(1 << 63), (1 << 63) - 1
SLACK_NS = 1_000_000_000
"""Stamps may be that far out of order: those of the host's telemetry are written after the frames."""
PROBED = 1 << 18
"""Bytes searched for a packet."""
LONGEST = 1 << 16
CHAIN = 8
"""Blocks that must follow one another, so that data of an attachment are not taken for blocks."""
CLOSE = 1 << 20
"""Bytes before the time that are read rather than searched."""


@dataclass(frozen=True)
class Window:
    """A stretch of time, both ends included [ns]; None: open."""

    begin_ns: int | None = None
    end_ns: int | None = None

    def places(self, t_ns: Integers) -> Integers:
        """Return -1 for a stamp before the window, 0 for one in it, 1 for one behind it."""
        early = t_ns < (FIRST_NS if self.begin_ns is None else self.begin_ns)
        late = t_ns > (LAST_NS if self.end_ns is None else self.end_ns)
        return late.astype(np.int64) - early

    def is_before(self, t_ns: int) -> bool:
        """Return whether every frame behind one of this stamp is later than the window."""
        return self.end_ns is not None and t_ns > self.end_ns + SLACK_NS

    def is_behind(self, t_ns: int) -> bool:
        """Return whether every frame before one of this stamp is earlier than the window."""
        return self.begin_ns is not None and t_ns < self.begin_ns - SLACK_NS


ALL = Window()


def offset_before(path: str | Path, start: int, order: str, interfaces: Sequence[Interface], window: Window) -> int:
    """Return the offset of a block, at or after `start`, behind which everything of the window stands.

    Parameters
    ----------
    start : offset of a block before the window
    order, interfaces : of the file's section
    """
    with Path(path).open("rb") as file:
        begin, end = start, os.fstat(file.fileno()).st_size
        while end - begin > CLOSE:
            middle = (begin + end) // 2 // 4 * 4
            file.seek(middle)
            packet = _packet(file.read(PROBED), order, interfaces)
            if packet is not None and window.is_behind(packet[1]):
                begin = middle + packet[0]
            else:
                end = middle
    return begin


def _packet(data: bytes, order: str, interfaces: Sequence[Interface]) -> tuple[int, int] | None:
    """Return offset and stamp of the first packet in a part of a file."""
    place, chain = next_block(data, 0, order, LONGEST), _Chain(data, order)
    while place is not None:
        if place % 4 == 0 and chain.holds(place):
            break
        place = next_block(data, place + 1, order, LONGEST)
    while place is not None and place + 12 <= len(data):
        kind, length = chain.head(place)
        if length < 12 or place + length > len(data):
            return None
        if kind == ENHANCED_PACKET:
            words = np.frombuffer(data, "<u4", length // 4, place)
            stamps_ns = decode_packets(words, np.zeros(1, np.int64), order, interfaces, 0).stamps_ns
            if len(stamps_ns):
                return place, int(stamps_ns[0])
        place += length
    return None


class _Chain:
    """The blocks of a part of a file."""

    def __init__(self, data: bytes, order: str) -> None:
        self._data, self._order = data, "little" if order == "<" else "big"

    def head(self, place: int) -> tuple[int, int]:
        """Return type and length of the block at `place`."""
        words = (self._data[place : place + 4], self._data[place + 4 : place + 8])
        kind, length = (int.from_bytes(word, self._order) for word in words)  # type: ignore[arg-type]
        return kind, length

    def holds(self, place: int) -> bool:
        """Return whether `CHAIN` whole blocks follow one another from `place` on."""
        for _ in range(CHAIN):
            _, length = self.head(place)
            tail = self._data[place + length - 4 : place + length]
            if length < 12 or length % 4 or tail != self._data[place + 4 : place + 8]:
                return False
            place += length
        return True
