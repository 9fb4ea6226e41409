"""Content of a log: its frames, its buses, and the number of omitted rows by reason.

Frames and omitted rows add up to all rows of the file.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Protocol, TypeAlias

from coulombus.recording.logs.stamps import LATEST_NS
from coulombus.wire.can_flags import CAN_EFF_FLAG, CAN_ERR_FLAG
from coulombus.wire.data_word import data_word
from coulombus.wire.frame import Frame, Records, new_records

__all__ = [
    "BUS_ERROR",
    "CUT",
    "EVENT",
    "FD",
    "MALFORMED",
    "SHORT",
    "Log",
    "Row",
    "RowReader",
    "data_of",
    "identifier",
    "read_rows",
]

Row: TypeAlias = tuple[int, int, int, bytes, str]
"""Stamp [ns], identifier with Linux's flags, length, data, name of the bus."""

MALFORMED = "no frame of this format"
SHORT = "fewer data bytes than the length says"
CUT = "the file ends within it"
EVENT = "no frame, but an event of the tool or the adapter (status, statistics)"
FD = "a CAN FD frame"

BUS_ERROR = CAN_ERR_FLAG | 0x080
"""Identifier of an error frame without details."""
LONGEST_DATA, STANDARD, EXTENDED = 8, 0x7FF, 0x1FFF_FFFF


@dataclass
class Log:
    """Frames of a log in the file's order, and the omitted rows."""

    unit: str = "row"
    """The format's name for a record: row, object."""
    rows: list[tuple[int, int, int, int, int]] = field(default_factory=list)
    buses: dict[str, int] = field(default_factory=dict)
    """Name of a bus -> its number, the `source` of its frames."""
    losses: dict[str, list[int]] = field(default_factory=dict)
    """Reason -> number of omitted rows, and the line of the first."""
    remarks: list[str] = field(default_factory=list)
    """Further sentences on the file."""

    def add(self, row: Row) -> None:
        """Add a frame.

        Raises
        ------
        ValueError
            A value is impossible in a classical CAN frame.
        """
        t_ns, can_id, length, data, bus = row
        if not 0 <= length <= LONGEST_DATA or len(data) > LONGEST_DATA:
            raise ValueError(f"got {length} data bytes, expected at most {LONGEST_DATA}")
        if abs(t_ns) > LATEST_NS:
            raise ValueError(f"got the stamp {t_ns} ns, expected one before the year 2262")
        self.rows.append((t_ns, can_id, length, data_word(data), self.buses.setdefault(bus, len(self.buses))))

    def lose(self, why: str, line: int = 0, count: int = 1) -> None:
        """Count omitted rows; `line` is the number of the first."""
        self.losses.setdefault(why, [0, line])[0] += count

    def frames(self) -> Records:
        """Return the frames as records of `Frame`."""
        frames = new_records(Frame, len(self.rows))
        frames[:] = self.rows
        return frames

    def all_remarks(self, path: str) -> list[str]:
        """Return sentences on omitted rows."""
        texts = []
        for why, (count, line) in self.losses.items():
            rows = f"1 {self.unit} was" if count == 1 else f"{count} {self.unit}s were"
            place = f" (the first is line {line})" if line else ""
            texts.append(f"{path}: {rows} left out: {why}{place}")
        return [*texts, *(f"{path}: {text}" for text in self.remarks)]


class RowReader(Protocol):
    """Reads the lines of a format."""

    def row(self, text: str, ended: bool) -> Row | str | None:
        """Return the frame of a line, the reason for its omission, or None if the line is not a row.

        `ended`: whether the line has its line end; without it the frame must still be complete.

        Raises
        ------
        ValueError, IndexError
            The line is malformed.
        """


def read_rows(lines: Iterable[tuple[str, bool]], rows: RowReader) -> Log:
    """Read a log line by line; each line comes with whether it has its line end."""
    log = Log()
    for number, (text, ended) in enumerate(lines, 1):
        if not text.strip():
            continue
        try:
            outcome = rows.row(text.rstrip("\r"), ended)
            if isinstance(outcome, tuple):
                log.add(outcome)
                continue
        except (ValueError, IndexError):
            outcome = MALFORMED
        if outcome is not None:
            log.lose(outcome if ended else CUT, number)
    return log


def identifier(value: int, extended: bool) -> int:
    """Return an identifier with Linux's flag.

    Raises
    ------
    ValueError
        It has more bits than 11 or 29.
    """
    if not 0 <= value <= (EXTENDED if extended else STANDARD):
        raise ValueError(f"got the identifier {value:X}, expected at most {29 if extended else 11} bits")
    return value | CAN_EFF_FLAG if extended else value


def data_of(tokens: list[str], length: int, base: int = 16) -> bytes | None:
    """Return the data bytes at the beginning of the tokens; None if there are too few or the last is truncated.

    Raises
    ------
    ValueError
        A token is not a byte.
    """
    digits = tokens[:length]
    if len(digits) < length or (base == 16 and any(len(digit) != 2 for digit in digits)):
        return None
    return bytes(int(digit, base) for digit in digits)
