"""The bus load, and the identifiers that lose arbitration."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from coulombus.explain.bus import SDO_RX, SDO_TX, Bus
from coulombus.explain.frames import Block, Integers
from coulombus.kernels.decorator import kernel
from coulombus.kernels.records import Records
from coulombus.wire.bits import data_frame_bits
from coulombus.wire.can_flags import CAN_ERR_FLAG
from coulombus.wire.frame import FRAME

__all__ = ["BusLoad"]

RATES = (10_000, 20_000, 50_000, 125_000, 250_000, 500_000, 1_000_000)
"""Bit rates of CiA 301 [bit/s]; 800 kbit/s is too close to 1 Mbit/s to distinguish, and rare."""
WINDOW_NS = 20_000_000
FULL, FILLED = 0.9, 5
"""Load, and number of successive windows, of a full bus."""
LEARN, BATCHES = 2000, 10
"""Frames from which the bit rate is learned, and number of times."""
FASTER, CLOSE = 0.01, 0.05
"""Allowed share of frames sooner than the bit rate permits; least share of back-to-back frames."""
REGULAR = 5
"""Least number of frames in so many windows of a usual identifier, for its absence to be noted."""


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
        self._new = np.zeros(0, FRAME)  # frames to learn from
        self._learned = 0
        self._rest = np.zeros(0, FRAME)  # of the window that is not complete
        self._windows = 0
        self._bits_so_far = 0
        self._counts: dict[int, int] = {}  # frames of an identifier in windows that are not full
        self._full: list[tuple[int, int, dict[int, int]]] = []  # successive full windows: number, first row, counts
        _bits_of(*[np.zeros(0, np.int64)] * 4)  # loads the machine code, while no frame of a live bus waits

    def add_frames(self, block: Block) -> None:
        """Process a block."""
        frames, row = block.frames, block.first_row
        if not self.bus.bitrate and self._learned < BATCHES:
            row -= len(self._new)
            frames = np.concatenate((self._new, frames))
            while len(frames) >= LEARN and self._learned < BATCHES:
                self._learn(frames[:LEARN])
                self._fill(frames[:LEARN], row)
                frames, row = frames[LEARN:], row + LEARN
            self._new = frames[:0]
            if self._learned < BATCHES:
                self._new = frames
                return
        self._fill(frames, row)

    def _fill(self, new: Records, row: int) -> None:
        """Process the windows that these frames complete."""
        if len(new) == 0:
            return
        frames = np.concatenate((self._rest, new))
        first_row = row - len(self._rest)
        window = np.maximum.accumulate(np.ascontiguousarray(frames["t_ns"]) // WINDOW_NS)  # stamps may step back
        complete = int(window.searchsorted(window[-1]))
        self._rest = frames[complete:]
        if complete and self.bitrate:
            self._process(Block(frames[:complete], first_row), window[:complete])

    def _process(self, block: Block, window: Integers) -> None:
        """Process whole windows."""
        bits = _bits(block.frames)
        self._bits_so_far += int(bits.sum())
        bits[_are_sdo(block.frames["can_id"])] = 0  # a block transfer takes what the others leave
        starts = np.flatnonzero(np.diff(window, prepend=-1))
        sums = np.add.reduceat(bits, starts)
        full = sums / (self.bitrate * WINDOW_NS / 1e9) >= FULL
        begin = 0
        for i in np.flatnonzero(full).tolist():
            start = int(starts[i])
            end = int(starts[i + 1]) if i + 1 < len(starts) else len(window)
            self._free(block, begin, start)
            begin = end
            if self._full and int(window[start]) != self._full[-1][0] + 1:
                self._over()
            self._full.append((int(window[start]), block.first_row + start, _counts(block, start, end)))
            self._full = self._full[-FILLED:] if self.clues.stands("bus_load", None) else self._full
            if len(self._full) == FILLED and not self.clues.stands("bus_load", None):
                self._note()
        self._free(block, begin, len(window))
        self._windows += int(np.count_nonzero(~full))
        if self._full and int(window[-1]) > self._full[-1][0]:
            self._over()

    def share(self, duration_ns: int) -> float:
        """Return the load since the log's beginning, of 1; 0 while the bit rate is unknown."""
        return self._bits_so_far / (self.bitrate * duration_ns / 1e9) if self.bitrate and duration_ns > 0 else 0.0

    def _learn(self, frames: Records) -> None:
        """Find the lowest bit rate at which these frames are possible."""
        self._learned += 1
        gaps, bits = np.diff(frames["t_ns"]), _bits(frames)[1:]
        for rate in RATES:
            share = gaps * rate / 1e9 / np.maximum(bits, 47)
            if (share < 0.8).mean() <= FASTER:
                if rate >= self.bitrate and (share < 1.25).mean() >= CLOSE:
                    self.bitrate = rate
                return

    def _free(self, block: Block, start: int, end: int) -> None:
        """Count the frames in windows that are not full."""
        for key, count in _counts(block, start, end).items():
            self._counts[key] = self._counts.get(key, 0) + count

    def _over(self) -> None:
        """End a full bus."""
        self.clues.end("bus_load", None, (self._full[-1][0] + 1) * WINDOW_NS, "the load is lower again")
        self._full.clear()

    def _note(self) -> None:
        """Note a full bus, its most frequent identifier, and the missing ones."""
        counts: dict[int, int] = {}
        for _, _, some in self._full:
            for key, count in some.items():
                counts[key] = counts.get(key, 0) + count
        (first, row, _), number = self._full[0], max(self._windows, 1)
        begin = max(first * WINDOW_NS, self.bus.first_ns)
        top = max(counts, key=lambda key: counts[key])
        share = counts[top] / max(sum(counts.values()), 1)
        text = f"the bus is full for {FILLED * WINDOW_NS // 1_000_000} ms at {self.bitrate // 1000} kbit/s"
        text += f": {share:.0%} of the frames are {top:03X}h" if share > 0.5 else ""
        self.clues.begin("bus_load", None, begin, text, row=row)
        for key, usual in self._counts.items():
            if usual * FILLED >= REGULAR * number and not counts.get(key) and key > top:
                text = f"{key:03X}h does not come, {top:03X}h goes before it"
                self.clues.note("starved", self.bus.sender(key), begin, text, row=row, subject=key)


def _bits(frames: Records) -> Integers:
    """Return the bits of each frame on the wire."""
    can_id, length, word = (np.ascontiguousarray(frames[name], np.int64) for name in ("can_id", "length", "word"))
    bits = np.zeros(len(frames), np.int64)
    _bits_of(can_id, length, word, bits)
    return bits


def _are_sdo(can_id: Integers) -> npt.NDArray[np.bool_]:
    return (can_id >= SDO_TX) & (can_id < SDO_RX + 0x80)


def _counts(block: Block, start: int, end: int) -> dict[int, int]:
    """Return the data frames of each base identifier between two places of a block."""
    can_id = np.ascontiguousarray(block.frames["can_id"][start:end])
    number = np.bincount(can_id[can_id <= 0x7FF])
    return {key: int(number[key]) for key in np.flatnonzero(number).tolist()}
