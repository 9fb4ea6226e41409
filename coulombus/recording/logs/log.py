"""Content of a log: its frames, its buses, the number of omitted rows by reason, and remarks on its times.

Frames and omitted rows add up to all rows of the file.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from coulombus.kernels.records import Records, new_records
from coulombus.recording.logs.stamps import LATEST_NS
from coulombus.wire.can_flags import CAN_EFF_FLAG, CAN_ERR_FLAG
from coulombus.wire.data_word import data_word
from coulombus.wire.frame import Frame

__all__ = [
    "BUS_ERROR",
    "CUT",
    "DIFFERENCES",
    "EVENT",
    "FD",
    "MALFORMED",
    "SHORT",
    "Log",
    "Row",
    "are_differences",
    "data_of",
    "identifier",
    "time_remarks",
]

Row: TypeAlias = tuple[int, int, int, bytes, str]
"""Stamp [ns], identifier with Linux's flags, length, data, name of the bus."""

MALFORMED = "no frame of this format"
SHORT = "fewer data bytes than the length says"
CUT = "the file ends within it"
EVENT = "no frame, but an event of the tool or the adapter (status, statistics)"
FD = "a CAN FD frame"

Integers: TypeAlias = npt.NDArray[np.int64]

BUS_ERROR = CAN_ERR_FLAG | 0x080
"""Identifier of an error frame without details."""
LONGEST_DATA, STANDARD, EXTENDED = 8, 0x7FF, 0x1FFF_FFFF

LEAST_FRAMES = 3
"""Fewest frames of which a time axis is judged."""
BACK = 0.2
"""Share of stamps lower than the one before, from which on stamps are differences. Of a clock, few are."""
CLOCK_NS = 10_000_000
"""A single stamp so far from those around it is another clock's; frames of two channels swap by less."""

DIFFERENCES = "its stamps are times since the frame before (candump -t d) and were added up"


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


def are_differences(t_ns: Integers) -> bool:
    """Return whether stamps are times since the frame before: they rise and fall, or all but the first are equal."""
    steps = np.diff(t_ns)
    if len(t_ns) < LEAST_FRAMES:
        return False
    return bool(np.count_nonzero(steps < 0) >= BACK * len(steps) or (t_ns[1] > 0 and (steps[1:] == 0).all()))


def time_remarks(t_ns: Integers) -> list[str]:
    """Return sentences on the time axis of the frames, which are counted from 1.

    Parameters
    ----------
    t_ns : (N,) stamps in the file's order [ns]
    """
    if len(t_ns) < LEAST_FRAMES:
        return []
    if (t_ns == t_ns[0]).all():
        return [f"all {len(t_ns)} frames have the stamp {t_ns[0] / 1e9:g} s: it has no times; log with time stamps"]
    strays = _strays(t_ns)
    texts = []
    if len(strays):
        row = int(strays[0])
        away_s = max(abs(int(t_ns[row] - t_ns[row - 1])), abs(int(t_ns[row] - t_ns[row + 1]))) / 1e9
        texts.append(
            f"{_count(len(strays), 'frame has', 'frames have')} the stamp of another clock: frame {row + 1} is "
            f"{away_s:g} s from the frames around it; times and rates there are wrong"
        )
    in_line = np.delete(np.arange(len(t_ns)), strays)
    steps = np.diff(t_ns[in_line])
    back = np.flatnonzero(steps < 0)
    if len(back):
        row = int(in_line[back[0] + 1])
        texts.append(
            f"{_count(len(back), 'stamp goes', 'stamps go')} back: that of frame {row + 1} by {-steps[back[0]] / 1e9:g} s; "
            "a reset adapter, a counter that began again, or logs joined: split the log there"
        )
    return texts


def _strays(t_ns: Integers) -> Integers:
    """Return the rows of single stamps far outside of the stamps around them, which are in order."""
    before, here, after = t_ns[:-2], t_ns[1:-1], t_ns[2:]
    outside = np.maximum(before - here, here - after) > CLOCK_NS
    rows: Integers = np.flatnonzero(outside & (before <= after)) + 1
    return rows


def _count(number: int, singular: str, plural: str) -> str:
    return f"{number} {singular if number == 1 else plural}"
