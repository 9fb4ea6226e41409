"""Markers set during a run by keys of the terminal, ``coulombus mark``, and bits of signals.

None of them can be mistaken for a marker of the run itself.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from coulombus.kernels.records import Records
from coulombus.rigs.errors import nearest
from coulombus.rigs.rig import Rig

__all__ = ["BitMark", "BitMarks", "StruckKeys", "bit_mark", "marker_of"]

SAID, MOST_SAID, KEYS = "mark", 200, "123456789"
"""Prefix of such a marker, its largest length, and the keys that set one."""
STOP_KEYS = (b"q", b"Q", b"\x1b")


def marker_of(text: str) -> str:
    """Return the marker with a client's text.

    Raises
    ------
    ValueError
        the text is empty, too long, or not printable
    """
    marker = f"{SAID} {text.strip()}"
    if not marker.isprintable() or not len(SAID) + 1 < len(marker) <= MOST_SAID:
        raise ValueError(f"expected a text of 1 to {MOST_SAID - len(SAID) - 1} printable characters")
    return marker


@dataclass(frozen=True)
class BitMark:
    """Marker `text`, set when all bits of `mask` become 1 in frames with identifier `can_id`.

    `mask` applies to the frame's data as a little-endian word; `length` is the PDO's.
    """

    signal: str
    can_id: int
    length: int
    mask: int
    text: str


def bit_mark(argument: str, rig: Rig) -> BitMark:
    """Return the `BitMark` of ``SIGNAL:MASK=TEXT``, as in ``motor.statusword:0x400=target reached``.

    Raises
    ------
    ValueError
        the form is wrong, no PDO of the rig carries the signal, or the signal has no such bits
    """
    place, equals, text = argument.partition("=")
    name, colon, bits = place.rpartition(":")
    try:
        mask = int(bits, 16) if equals and colon else 0
    except ValueError:
        mask = 0
    if mask <= 0:
        raise ValueError(
            f"{argument!r}: expected SIGNAL:MASK=TEXT with a mask of bits, as in motor.statusword:0x400=there"
        )
    signals = {
        signal.name: (pdo.layout, start, entry.bits)
        for pdo in rig.pdos()
        for signal, start, entry in zip(pdo.signals, pdo.layout.starts, pdo.layout.entries, strict=False)
    }
    if name not in signals:
        raise ValueError(f"{argument!r}: no PDO of the rig carries the signal {name!r}{nearest(name, signals)}")
    layout, start, size = signals[name]
    if mask >= 1 << size:
        raise ValueError(f"{argument!r}: {name} has {size} bits; the mask {mask:#x} has more")
    try:
        return BitMark(name, layout.cob_id, layout.length, mask << start, marker_of(text))
    except ValueError as error:
        raise ValueError(f"{argument!r}: {error}") from None


class BitMarks:
    """Finds the rising bits of each `BitMark` in recorded frames.

    Marks whose signals are on another bus of the rig are ignored: each bus has its own recording.
    """

    def __init__(self, marks: Sequence[BitMark], rig: Rig) -> None:
        here = {signal.name for pdo in rig.pdos() for signal in pdo.signals}
        self._marks = {mark: True for mark in marks if mark.signal in here}  # bits set at the start are no change

    def edges(self, frames: Records) -> list[tuple[int, str]]:
        """Return the markers of a batch: time stamp and text for each frame in which the bits become 1."""
        markers = []
        for mark, before in self._marks.items():
            some = frames[(frames["can_id"] == mark.can_id) & (frames["length"] == mark.length)]
            if len(some):
                now = (some["word"].astype(np.uint64) & np.uint64(mark.mask)) == np.uint64(mark.mask)
                rises = now & ~np.concatenate(([before], now[:-1]))
                markers += [(int(t_ns), mark.text) for t_ns in some["t_ns"][rises]]
                self._marks[mark] = bool(now[-1])
        return sorted(markers)


class StruckKeys:
    """Keys struck on the terminal during a run, passed from the keyboard's thread to the run.

    1 to 9 set markers, which the run takes in its next supervision step; q or Escape requests the safe
    state.
    """

    def __init__(self, now_ns: Callable[[], int]) -> None:
        self.stop = False
        """Whether q, Escape, or a key that sends Escape first was struck."""
        self._now_ns = now_ns
        self._struck: deque[tuple[int, str]] = deque()

    def strike(self, strokes: bytes) -> None:
        """Store the markers of these strokes with the present time, and whether a stroke stops the run."""
        self.strike_early(strokes)
        for digit in strokes.decode("ascii", "replace"):
            if digit in KEYS:
                self._struck.append((self._now_ns(), marker_of(digit)))

    def strike_early(self, strokes: bytes) -> None:
        """Store whether one of these strokes stops the run; strokes before the run set no markers."""
        self.stop |= any(key in strokes for key in STOP_KEYS)

    def read_markers(self) -> Iterator[tuple[int, str]]:
        """Yield the time [ns] and the marker of each stroke that was not taken yet."""
        while self._struck:
            yield self._struck.popleft()
