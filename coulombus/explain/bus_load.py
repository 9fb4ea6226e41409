"""The bus load, and the identifiers that lose arbitration."""

from __future__ import annotations

import numpy as np

from coulombus.explain.bus import Bus
from coulombus.explain.frames import REMOTE, Block, Integers
from coulombus.kernels.decorator import kernel
from coulombus.wire.bits import data_frame_bits
from coulombus.wire.can_flags import CAN_ERR_FLAG

__all__ = ["BusLoad"]

RATES = (10_000, 20_000, 50_000, 125_000, 250_000, 500_000, 1_000_000)
"""Bit rates of CiA 301 [bit/s]; 800 kbit/s is too close to 1 Mbit/s to distinguish, and rare."""
WINDOW_NS = 20_000_000
FULL, FILLED = 0.9, 5
"""Load, and number of successive windows, of a full bus."""
LEARN = 2000
"""Frames from which the bit rate is learned."""
FASTER, CLOSE = 0.01, 0.05
"""Allowed share of frames sooner than the bit rate permits; least share of back-to-back frames."""
REGULAR = 5
"""Least number of windows in which an identifier is usual, for its absence to be noted."""


@kernel
def _bits_of(can_id: Integers, length: Integers, word: Integers, bits: Integers) -> None:
    """Fill in the bits of each frame on the wire; 0 for an error frame."""
    for i in range(len(can_id)):
        if can_id[i] & CAN_ERR_FLAG == 0:
            bits[i] = data_frame_bits(can_id[i], length[i], word[i])


class BusLoad:
    """Adds up the bits in windows of 20 ms.

    Without a rig the bit rate is learned from back-to-back frames; without any, the bus is not full.
    """

    def __init__(self, bus: Bus) -> None:
        self.bus, self.clues = bus, bus.clues
        self.bitrate = bus.bitrate
        self._learned = 0
        self._bits: dict[int, float] = {}  # by window: windows begun by the last block
        self._full = 0
        self._usual: dict[int, float] = {}  # frames of an identifier in a window that is not full
        self._windows = 0
        _bits_of(*[np.zeros(0, np.int64)] * 4)  # loads the machine code, while no frame of a live bus waits

    def take(self, block: Block) -> None:
        """Process a block."""
        if len(block.t_ns) < 2:
            return
        can_id, length, word = (
            np.ascontiguousarray(block.frames[name], np.int64) for name in ("can_id", "length", "word")
        )
        bits = np.zeros(len(block.t_ns), np.int64)
        _bits_of(can_id, length, word, bits)
        if not self.bus.bitrate and self._learned < 10 * LEARN:
            self._learn(block.t_ns, bits)
        if not self.bitrate:
            return
        self._fill(block, bits)

    def _learn(self, t_ns: Integers, bits: Integers) -> None:
        """Find the lowest bit rate at which these frames are possible."""
        gaps = np.diff(t_ns)
        self._learned += len(gaps)
        for rate in RATES:
            share = gaps * rate / 1e9 / np.maximum(bits[1:], 47)
            if (share < 0.8).mean() <= FASTER:
                if rate >= self.bitrate and (share < 1.25).mean() >= CLOSE and len(gaps) >= LEARN:
                    self.bitrate = rate
                return

    def _fill(self, block: Block, bits: Integers) -> None:
        window = np.maximum.accumulate(block.t_ns // WINDOW_NS)  # stamps may step back
        first, last = int(window[0]), int(window[-1])
        if last - first > 100_000:
            return  # a log with a gap
        sums = np.bincount(window - first, weights=bits)
        sums[0] += self._bits.pop(first, 0.0)
        self._bits = {last: float(sums[-1])}
        full = sums[:-1] / (self.bitrate * WINDOW_NS / 1e9) >= FULL
        free = int(full.argmax()) if full.any() else len(full)
        if not self._full:
            self._count(block, free, block.first_row + int(np.searchsorted(window, first + free)))
        if not full.any():
            self._full = 0
            if self.clues.stands("bus_load", None):
                self.clues.end("bus_load", None, (first + 1) * WINDOW_NS, "the load is lower again")
            return
        for i in range(len(full)):
            self._full = self._full + 1 if full[i] else 0
            if not full[i]:
                self.clues.end("bus_load", None, (first + i) * WINDOW_NS, "the load is lower again")
            elif self._full == FILLED:
                self._note(block, window, (first + i - FILLED + 1) * WINDOW_NS, first + i)

    def _count(self, block: Block, windows: int, behind_row: int) -> None:
        """Learn the usual number of frames of each identifier in windows that are not full."""
        if windows < 1:
            return
        for key, group in block.groups.items():
            if key < REMOTE:
                frames = self._usual.get(key, 0.0) * self._windows + int(np.searchsorted(group.rows, behind_row))
                self._usual[key] = frames / (self._windows + windows)
        self._windows += windows

    def _note(self, block: Block, window: Integers, begin_ns: int, last: int) -> None:
        """Note a full bus, its most frequent identifier, and the missing ones."""
        first, behind = np.searchsorted(window, (last - FILLED + 1, last + 1))
        rows = block.first_row + first, block.first_row + behind
        counts = {
            key: int(np.searchsorted(group.rows, rows[1]) - np.searchsorted(group.rows, rows[0]))
            for key, group in block.groups.items()
        }
        top = max(counts, key=lambda key: counts[key])
        share = counts[top] / max(int(behind - first), 1)
        text = f"the bus is full for {FILLED * WINDOW_NS // 1_000_000} ms at {self.bitrate // 1000} kbit/s"
        text += f": {share:.0%} of the frames are {top:03X}h" if share > 0.5 else ""
        self.clues.begin("bus_load", None, max(begin_ns, self.bus.first_ns), text, row=int(rows[0]))
        for key, usual in self._usual.items():
            if usual * FILLED >= REGULAR and not counts.get(key) and key > top:
                text = f"{key:03X}h does not come, {top:03X}h goes before it"
                self.clues.note("starved", self.bus.sender(key), begin_ns, text, row=int(rows[0]), subject=key)
