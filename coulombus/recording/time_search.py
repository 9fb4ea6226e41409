"""Spans of a recording, as ``3:5``, ``2.5:`` or ``:10``; and a time found in a long one without reading it.

The time is found by bisection over the stamps of the packets: in recordings of this project, they rise. A packet is found from any offset by
the shape of its block and of those behind it (`recording.pcapng_blocks`).
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from numbers import Real
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np

from coulombus.recording.pcapng_blocks import ENHANCED_PACKET, next_block
from coulombus.recording.pcapng_packets import Integers, Interface, decode_packets
from coulombus.rigs.arguments import WrongCall
from coulombus.system.errors import CoulombusError

__all__ = ["ALL", "WHOLE", "Span", "SpanError", "Window", "checked_span", "offset_before", "parse_span"]

Span: TypeAlias = tuple[float | None, float | None]
"""Begin and end [s]; None: open."""
WHOLE: Span = (None, None)

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


class SpanError(CoulombusError):
    """There is nothing to show; the text has the reason and the remedy."""

    exit_status = 2


def parse_span(text: str) -> Span:
    """Return begin and end [s] of ``A:B``; None for an omitted one.

    Raises
    ------
    ValueError
        It is not a span, or ends before it begins.
    """
    begin, colon, end = text.partition(":")
    try:
        span = float(begin) if begin else None, float(end) if end else None
        right = bool(colon) and (span[0] is None or span[1] is None or span[0] < span[1])
    except ValueError:
        right = False
    if not right:
        raise ValueError(f"{text!r}: expected A:B in s, as in 3:5, 2.5: or :10, and B after A")
    return span


def checked_span(span: Any) -> Span:
    """Return a checked span from a script: two times [s], None for an open end.

    Raises
    ------
    coulombus.rigs.arguments.WrongCall
        It is something else.
    """
    if isinstance(span, (tuple, list)) and len(span) == 2 and all(time is None or _is_time(time) for time in span):
        begin, end = (None if time is None else float(time) for time in span)
        return begin, end
    meant: Span = (3.0, 5.0)
    if isinstance(span, str):
        with suppress(ValueError):
            meant = parse_span(span)
    raise WrongCall(f"span is {span!r}: expected begin and end in s, as in span={meant!r}; None leaves an end open")


def _is_time(value: Any) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)


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


def offset_before(
    path: str | Path, start: int, byte_order: str, interfaces: Sequence[Interface], window: Window
) -> int:
    """Return the offset of a block, at or after `start`, behind which everything of the window stands.

    Parameters
    ----------
    start : offset of a block before the window
    byte_order, interfaces : of the file's section
    """
    with Path(path).open("rb") as file:
        begin, end = start, os.fstat(file.fileno()).st_size
        while end - begin > CLOSE:
            middle = (begin + end) // 2 // 4 * 4
            file.seek(middle)
            packet = _packet(file.read(PROBED), byte_order, interfaces)
            if packet is not None and window.is_behind(packet[1]):
                begin = middle + packet[0]
            else:
                end = middle
    return begin


def _packet(data: bytes, byte_order: str, interfaces: Sequence[Interface]) -> tuple[int, int] | None:
    """Return offset and stamp of the first packet in a part of a file."""
    place, chain = next_block(data, 0, byte_order, LONGEST), _Chain(data, byte_order)
    while place is not None:
        if place % 4 == 0 and chain.holds(place):
            break
        place = next_block(data, place + 1, byte_order, LONGEST)
    while place is not None and place + 12 <= len(data):
        kind, length = chain.head(place)
        if length < 12 or place + length > len(data):
            return None
        if kind == ENHANCED_PACKET:
            words = np.frombuffer(data, "<u4", length // 4, place)
            stamps_ns = decode_packets(words, np.zeros(1, np.int64), byte_order, interfaces, 0).stamps_ns
            if len(stamps_ns):
                return place, int(stamps_ns[0])
        place += length
    return None


class _Chain:
    """The blocks of a part of a file."""

    def __init__(self, data: bytes, byte_order: str) -> None:
        self._data, self._order = data, "little" if byte_order == "<" else "big"

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
