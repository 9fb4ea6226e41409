"""What is marked in the recording while the host runs, besides its course: keys of the terminal,
``coulombus mark``, bits of signals.

None of these markers can be taken for one of the run's own.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from coulombus.rigs.errors import nearest
from coulombus.rigs.rig import Rig
from coulombus.wire.frame import Records

__all__ = ["BitMark", "BitMarks", "StruckKeys", "bit_mark", "marker_of"]

SAID, MOST_SAID, KEYS = "mark", 200, "123456789"
"""How such a marker begins; how long it is at most; the keys that set one."""
STOP_KEYS = (b"q", b"Q", b"\x1b")


def marker_of(text: str) -> str:
    """Return the marker of what somebody says.

    Raises
    ------
    ValueError
        Nothing is said, too much, or what cannot be printed.
    """
    marker = f"{SAID} {text.strip()}"
    if not marker.isprintable() or not len(SAID) + 1 < len(marker) <= MOST_SAID:
        raise ValueError(f"expected a text of 1 to {MOST_SAID - len(SAID) - 1} printable characters")
    return marker


@dataclass(frozen=True)
class BitMark:
    """Frames of the identifier `can_id` in which all bits of `mask` become 1 set the marker `text`.

    `mask` is of the frame's data as a little-endian word; `length` is the PDO's.
    """

    signal: str
    can_id: int
    length: int
    mask: int
    text: str


def bit_mark(given: str, rig: Rig) -> BitMark:
    """Return what ``SIGNAL:MASK=TEXT`` says, as in ``motor.statusword:0x400=target reached``.

    Raises
    ------
    ValueError
        it is not of that form, the signal is in no PDO of the rig, or has no such bits
    """
    place, equals, text = given.partition("=")
    name, colon, bits = place.rpartition(":")
    try:
        mask = int(bits, 16) if equals and colon else 0
    except ValueError:
        mask = 0
    if mask <= 0:
        raise ValueError(
            f"{given!r}: expected SIGNAL:MASK=TEXT with a mask of bits, as in motor.statusword:0x400=there"
        )
    known = {
        signal.name: (pdo.layout, start, entry.bits)
        for pdo in rig.pdos()
        for signal, start, entry in zip(pdo.signals, pdo.layout.starts, pdo.layout.entries, strict=False)
    }
    if name not in known:
        raise ValueError(f"{given!r}: no PDO of the rig carries the signal {name!r}{nearest(name, known)}")
    layout, start, size = known[name]
    if mask >= 1 << size:
        raise ValueError(f"{given!r}: {name} has {size} bits; the mask {mask:#x} has more")
    try:
        return BitMark(name, layout.cob_id, layout.length, mask << start, marker_of(text))
    except ValueError as error:
        raise ValueError(f"{given!r}: {error}") from None


class BitMarks:
    """Looks for the bits of those `BitMark` in what is recorded whose signals the rig has: of several
    buses each is recorded by itself.
    """

    def __init__(self, marks: Sequence[BitMark], rig: Rig) -> None:
        here = {signal.name for pdo in rig.pdos() for signal in pdo.signals}
        self._marks = {mark: True for mark in marks if mark.signal in here}  # set from the start on is no change

    def edges(self, frames: Records) -> list[tuple[int, str]]:
        """Return the markers of a batch: of each frame in which the bits have become 1, its stamp
        and the text.
        """
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
    """The keys of the terminal during a run, whose thread strikes them: 1 to 9 are markers, which the
    run takes when it looks next, and q or Escape asks for the safe state.
    """

    def __init__(self, now_ns: Callable[[], int]) -> None:
        self.stop = False
        """Whether q or Escape was struck; every key that sends Escape first stops, too."""
        self._now_ns = now_ns
        self._struck: deque[tuple[int, str]] = deque()

    def strike(self, strokes: bytes) -> None:
        """Keep what these strokes mark, with the present time, and whether one of them stops."""
        self.strike_early(strokes)
        for digit in strokes.decode("ascii", "replace"):
            if digit in KEYS:
                self._struck.append((self._now_ns(), marker_of(digit)))

    def strike_early(self, strokes: bytes) -> None:
        """Keep whether one of these strokes stops; they came before the run, and mark nothing of it."""
        self.stop |= any(key in strokes for key in STOP_KEYS)

    def take(self) -> Iterator[tuple[int, str]]:
        """Yield the time [ns] and the marker of each that has not been taken."""
        while self._struck:
            yield self._struck.popleft()
