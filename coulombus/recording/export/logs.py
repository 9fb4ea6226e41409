"""Write logs of frames for other programs: candump's, Vector's .asc and .blf.

Lines are built as columns of characters, some thousand frames at a time.
"""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Sequence
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from coulombus.kernels.records import Records
from coulombus.recording.export.errors import ExportError
from coulombus.recording.logs.stamps import WALL_CLOCK_NS
from coulombus.recording.sample_groups import Array, Integers
from coulombus.wire.frame import CAN_EFF_FLAG, CAN_ERR_FLAG, CAN_RTR_FLAG

__all__ = ["AscWriter", "BlfWriter", "CandumpWriter"]

HEX = np.frombuffer(b"0123456789ABCDEF", np.uint8)
STANDARD, EXTENDED = 0x7FF, 0x1FFF_FFFF
CONTAINER = 128 << 10


class _Lines:
    """Characters of many lines, column by column; absent characters are dropped."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._columns: list[Array] = []
        self._present: list[Array] = []

    def text(self, text: str, present: Any = True) -> None:
        """Add the same text to the lines that are `present`."""
        for character in text.encode():
            self._append(np.full(self._count, character, np.uint8), present)

    def decimal(self, values: Integers, digits: int, least: int = 1) -> None:
        """Add decimal numbers with at least `least` digits."""
        digits = min(digits, max(least, len(str(values.max(initial=0)))))
        for place in range(digits - 1, -1, -1):
            rest = values // 10**place
            self._append((rest % 10 + ord("0")).astype(np.uint8), (rest > 0) | (place < least))

    def hexadecimal(self, values: Integers, digits: int, present: Any = True) -> None:
        """Add hexadecimal numbers with a fixed number of digits."""
        for place in range(digits - 1, -1, -1):
            self._append(HEX[values >> 4 * place & 15], present)

    def padded(self, values: Integers, width: int) -> None:
        """Add hexadecimal numbers without leading zeros, one digit at least."""
        for place in range(width - 1, -1, -1):
            self._append(HEX[values >> 4 * place & 15], (values >> 4 * place > 0) | (place == 0))

    def _append(self, column: Array, present: Any) -> None:
        self._columns.append(column)
        self._present.append(np.broadcast_to(np.asarray(present, bool), self._count))

    def bytes(self) -> bytes:
        """Return the lines."""
        characters: Array = np.stack(self._columns, 1)[np.stack(self._present, 1)]
        return characters.tobytes()


def _byte(frames: Records, k: int) -> Integers:
    byte: Integers = frames["word"] >> 8 * k & 0xFF
    return byte


def _require_not_before(t_ns: Integers, begin_ns: int, begin: str) -> None:
    """Refuse stamps before the one from which a format counts.

    Raises
    ------
    ExportError
        A stamp is earlier.
    """
    early = np.flatnonzero(t_ns < begin_ns)
    if len(early):
        away_s = (begin_ns - int(t_ns[early[0]])) / 1e9
        raise ExportError(
            f"{len(early)} frames have stamps before {begin}, from which this format counts; the first of them is "
            f"{away_s:g} s early: split the recording where its stamps go back, or export with --to candump"
        )


def _interfaces(buses: Sequence[str]) -> list[str]:
    """Return the name of each bus for candump's log: ``can0`` for the address ``socketcan:can0``
    and for an unnamed bus, ``can1`` for a numeric channel.
    """
    plain = [re.sub(r"\s", "_", name.rpartition(":")[2]) or "can0" for name in buses]
    return [f"can{name}" if name.isdigit() else name for name in plain]


def _channels(buses: Sequence[str]) -> Integers:
    """Return the number of each bus, from 1: that of its name (``1`` is 1, ``can0`` is 1) if these differ."""
    names = list(dict.fromkeys(buses))
    ends = [re.search(r"\d{1,4}$", name) for name in names]
    numbers = [int(end[0]) + (end[0] != name) if end else 1 for name, end in zip(names, ends, strict=True)]
    if len(set(numbers)) < len(numbers) or 0 in numbers:
        numbers = list(range(1, len(names) + 1))
    number_of = dict(zip(names, numbers, strict=True))
    return np.array([number_of[name] for name in buses], np.int64)


class _FrameWriter:
    """A file of frames whose stamps count from `start_ns`."""

    def __init__(self, path: Path, start_ns: int) -> None:
        self._file, self._start_ns = path.open("wb"), start_ns

    def abandon(self) -> None:
        """Close the file after an error."""
        self._file.close()

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class CandumpWriter(_FrameWriter):
    """``candump -L``: ``(1436509052.249713) can0 123#DEADBEEF``.

    No direction letter follows the data, as some programs write it: tshark would read it as data.
    Stamps are truncated to microseconds.
    """

    def add(self, frames: Records, buses: Sequence[str] = ("can0",)) -> None:
        """Write frames; `buses` are the names of their `source`."""
        can_id, length = frames["can_id"], frames["length"]
        error, remote = can_id & CAN_ERR_FLAG != 0, can_id & CAN_RTR_FLAG != 0
        _require_not_before(frames["t_ns"] + self._start_ns, 0, "1970")
        long = (can_id & CAN_EFF_FLAG != 0) | error
        t_us = (frames["t_ns"] + self._start_ns) // 1000
        lines = _Lines(len(frames))
        lines.text("(")
        lines.decimal(t_us // 10**6, 12, 10)
        lines.text(".")
        lines.decimal(t_us % 10**6, 6, 6)
        lines.text(") ")
        names = _interfaces(buses)
        for source in np.unique(frames["source"]).tolist():
            lines.text(f"{names[source]} ", frames["source"] == source)
        shown = np.where(error, can_id & (EXTENDED | CAN_ERR_FLAG), can_id & EXTENDED)
        lines.hexadecimal(shown, 8, long)
        lines.hexadecimal(can_id & STANDARD, 3, ~long)
        lines.text("#")
        lines.text("R", remote)
        lines.hexadecimal(length, 1, remote & (length > 0))
        for k in range(8):
            lines.hexadecimal(_byte(frames, k), 2, ~remote & (k < length))
        lines.text("\n")
        self._file.write(lines.bytes())


class AscWriter(_FrameWriter):
    """Vector's .asc: times from the first frame, in microseconds; identifiers in hexadecimal."""

    def __init__(self, path: Path, start_ns: int) -> None:
        super().__init__(path, start_ns)
        self._first_ns: int | None = None

    def add(self, frames: Records, buses: Sequence[str] = ("can0",)) -> None:
        """Write frames; `buses` are the names of their `source`."""
        if self._first_ns is None:
            self._first_ns = int(frames["t_ns"][0])
            begin = datetime.fromtimestamp((self._start_ns + self._first_ns) // 10**6 / 1e3, UTC)
            date = f"{begin:%a %b %d %H:%M:%S}.{begin.microsecond // 1000:03d} {begin:%Y}"
            head = f"date {date}\nbase hex  timestamps absolute\ninternal events logged\n"
            self._file.write(f"{head}Begin Triggerblock {date}\n   0.000000 Start of measurement\n".encode())
        can_id, length = frames["can_id"], frames["length"]
        error, remote = can_id & CAN_ERR_FLAG != 0, can_id & CAN_RTR_FLAG != 0
        _require_not_before(frames["t_ns"], self._first_ns, "the first frame")
        t_us = (frames["t_ns"] - self._first_ns) // 1000
        extended = can_id & CAN_EFF_FLAG != 0
        lines = _Lines(len(frames))
        lines.text("   ")
        lines.decimal(t_us // 10**6, 10)
        lines.text(".")
        lines.decimal(t_us % 10**6, 6, 6)
        lines.text(" ")
        lines.decimal(_channels(buses)[frames["source"]], 5)
        lines.text("  ErrorFrame", error)
        lines.text("  ", ~error)
        lines.hexadecimal(can_id & EXTENDED, 8, extended & ~error)
        lines.hexadecimal(can_id & STANDARD, 3, ~extended & ~error)
        lines.text("x", extended & ~error)
        lines.text("             Rx   ", ~error)
        lines.text("d ", ~remote & ~error)
        lines.text("r ", remote & ~error)
        lines.hexadecimal(length, 1, ~error)
        for k in range(8):
            has_byte = ~remote & ~error & (k < length)
            lines.text(" ", has_byte)
            lines.hexadecimal(_byte(frames, k), 2, has_byte)
        lines.text("\n")
        self._file.write(lines.bytes())

    def close(self) -> None:
        """Write the file's end."""
        self._file.write(b"End TriggerBlock\n")
        self._file.close()


_BASE = [("signature", "S4"), ("header", "<u2"), ("version", "<u2"), ("size", "<u4"), ("kind", "<u4")]
_STAMP = [("unit", "<u4"), ("client", "<u2"), ("object", "<u2"), ("t_ns", "<u8")]
MESSAGE = np.dtype(
    [*_BASE, *_STAMP, ("channel", "<u2"), ("flags", "u1"), ("dlc", "u1"), ("can_id", "<u4"), ("data", "<i8")]
)
_ERROR = [("channel", "<u2"), ("length", "<u2"), ("flags", "<u4"), ("ecc", "u1"), ("position", "u1"), ("dlc", "<u2")]
_ERROR += [("bits", "<u4"), ("can_id", "<u4"), ("more", "<u4"), ("data", "<i8")]
ERROR = np.dtype([*_BASE, *_STAMP, *_ERROR])
CAN_MESSAGE, LOG_CONTAINER, CAN_ERROR_EXT = 1, 10, 73
FILE_HEADER = struct.Struct("<4sLBBBBBBBBQQLL8H8H72x")
NANOSECONDS, ZLIB, REMOTE, EXTENDED_BLF = 2, 2, 0x80, 1 << 31


class BlfWriter(_FrameWriter):
    """Vector's .blf: objects of CAN messages in compressed containers, stamps in nanoseconds from
    the file's start.
    """

    def __init__(self, path: Path, start_ns: int) -> None:
        super().__init__(path, start_ns)
        self._first_ns: int | None = None
        self._last_ns = 0
        self._objects, self._bytes = 0, FILE_HEADER.size
        self._file.write(bytes(FILE_HEADER.size))

    def add(self, frames: Records, buses: Sequence[str] = ("can0",)) -> None:
        """Write frames; `buses` are the names of their `source`."""
        if self._first_ns is None:  # the header has wall-clock time in whole milliseconds
            first_ns = int(frames["t_ns"][0] + self._start_ns) // 10**6 * 10**6
            self._first_ns = first_ns if first_ns >= WALL_CLOCK_NS else 0
        self._last_ns = int(frames["t_ns"][-1] + self._start_ns)
        error = frames["can_id"] & CAN_ERR_FLAG != 0
        edges = [0, *(np.flatnonzero(np.diff(error)) + 1).tolist(), len(frames)]
        frames = frames.copy()
        frames["source"] = _channels(buses)[frames["source"]]
        content = b"".join(self._some(frames[a:b], self._first_ns, bool(error[a])) for a, b in pairwise(edges) if a < b)
        for at in range(0, len(content), CONTAINER):
            self._container(content[at : at + CONTAINER])
        self._objects += len(frames)

    def _some(self, frames: Records, first_ns: int, error: bool) -> bytes:
        rows = np.zeros(len(frames), ERROR if error else MESSAGE)
        rows["signature"], rows["header"], rows["version"] = b"LOBJ", 32, 1
        rows["size"], rows["kind"] = rows.itemsize, CAN_ERROR_EXT if error else CAN_MESSAGE
        rows["unit"] = NANOSECONDS
        _require_not_before(frames["t_ns"] + self._start_ns, first_ns, "the file's start")
        rows["t_ns"] = frames["t_ns"] + self._start_ns - first_ns
        rows["channel"], rows["dlc"], rows["data"] = frames["source"], frames["length"], frames["word"]
        can_id = frames["can_id"]
        rows["can_id"] = (can_id & EXTENDED) | np.where(can_id & CAN_EFF_FLAG, EXTENDED_BLF, 0)
        if not error:
            rows["flags"] = np.where(can_id & CAN_RTR_FLAG, REMOTE, 0)
        return rows.tobytes()

    def _container(self, content: bytes) -> None:
        packed = zlib.compress(content, 1)
        size = 32 + len(packed)
        head = struct.pack("<4sHHLL", b"LOBJ", 16, 1, size, LOG_CONTAINER)
        self._file.write(head + struct.pack("<H6xL4x", ZLIB, len(content)) + packed + bytes(size % 4))
        self._bytes += 32 + len(content)

    def close(self) -> None:
        """Write the header, which contains the file's length."""
        size = self._file.tell()
        self._file.seek(0)
        times = (*_system_time(self._first_ns or 0), *_system_time(self._last_ns))
        fields = (b"LOGG", FILE_HEADER.size, 5, 0, 0, 0, 2, 6, 8, 1, size, self._bytes, self._objects, 0)
        self._file.write(FILE_HEADER.pack(*fields, *times))
        self._file.close()


def _system_time(t_ns: int) -> Sequence[int]:
    """Return Windows' SYSTEMTIME of a wall-clock stamp; zeros for a stamp relative to the run's start."""
    if t_ns < WALL_CLOCK_NS:
        return (0,) * 8
    t = datetime.fromtimestamp(t_ns // 10**9, UTC)
    return (t.year, t.month, t.isoweekday() % 7, t.day, t.hour, t.minute, t.second, t_ns // 10**6 % 1000)
