"""Recognises a text log by its content, and reads its lines by its format's row in `formats.FORMATS`."""

from __future__ import annotations

import codecs
import difflib
import re
from base64 import b64decode
from collections.abc import Iterable
from dataclasses import dataclass

from coulombus.recording.logs.formats import (
    DATA,
    ERROR,
    FORMATS,
    GROUPS,
    REMOTE,
    TRC_VERSIONS,
    Format,
    LineForm,
    trc_lines,
)
from coulombus.recording.logs.log import BUS_ERROR, CUT, MALFORMED, SHORT, Log, Row, data_of, identifier
from coulombus.recording.logs.stamps import DAY_NS
from coulombus.wire.can_flags import CAN_ERR_FLAG, CAN_RTR_FLAG

__all__ = ["FormatMatch", "LineReader", "read_rows", "recognise", "refusal"]

KINDS = (DATA, REMOTE, ERROR)
LONGEST_DATA, BITS = 8, 0x1FFF_FFFF
BASES = {"hex": 16, "dec": 10}
MOST_LINES = 100
"""Lines of the file's beginning by which its format is recognised."""
SHOWN = 60
"""Characters of a line in a message."""


class LineReader:
    """The lines of one log.

    Attributes
    ----------
    heads : int
        Number of head lines read.
    without_time : int
        Number of frames without a stamp, which have the time 0.
    relative : bool
        The stamps are times since the previous row, and are added up.
    """

    def __init__(self, log_format: Format) -> None:
        self.format = log_format
        self.heads = self.without_time = 0
        self.relative = False
        self._stamp, self._base = log_format.stamp, log_format.base
        self._use(log_format.lines)
        self._offset_ns = self._turns_ns = self._last_ns = 0
        """Start of the stamps; turns of their clock; the last stamp."""
        self._start_ns = 0
        self._first = ""
        """The first stamp."""
        self._previous = ""
        """The previous head line, in lower case."""

    @property
    def may_differ(self) -> bool:
        """Whether the stamps have the form of times since the previous row (`Format.differences`)."""
        differences = self.format.differences
        return differences is not None and differences.fullmatch(self._first) is not None

    def row(self, text: str, ended: bool) -> Row | str | None:
        """Return the frame of a line, the reason for its omission, or None if the line is not a row.

        `ended`: whether the line has its line end; without it the frame must still be complete.

        Raises
        ------
        ValueError, IndexError
            The line is malformed.
        """
        if not ended and self._is_head(text.strip(), ended):
            return None
        for fullmatch, kind, is_open in self._lines:
            match = fullmatch(text)
            if match is None:
                continue
            self._previous = ""
            if kind in KINDS:
                return self._row(kind, match.group(*GROUPS), ended, is_open)
            if self.relative and match["stamp"]:
                self._time(match["stamp"])
            return kind
        return None if self._is_head(text.strip(), ended) else MALFORMED

    def _row(self, kind: str, columns: tuple[str, ...], ended: bool, is_open: bool) -> Row | str:
        stamp, bus, digits, extended, length, data, end = columns
        t_ns = 0 if stamp is None else self._time(stamp)
        if not ended and not end and (is_open or (self._base != 16 and data)):
            return SHORT
        if kind == ERROR:
            can_id = CAN_ERR_FLAG | int(digits, self._base) & BITS if digits else BUS_ERROR
        else:
            can_id = identifier(int(digits, self._base), bool(extended))
        count = min(int(length, 16), LONGEST_DATA) if length else None
        content: bytes | None = b""
        if kind == REMOTE:
            can_id |= CAN_RTR_FLAG
        else:
            content = self._content(data, count)
            if content is None:
                return SHORT
            count = len(content)
        self.without_time += stamp is None
        return t_ns, can_id, count or 0, content or b"", bus

    def _time(self, stamp: str) -> int:
        t_ns = self._stamp(stamp)
        self._first = self._first or stamp
        if self.relative:
            self._last_ns = t_ns = t_ns + self._last_ns
        elif self.format.wrap_ns:
            t_ns += self._turns_ns
            if self._last_ns - t_ns > self.format.least_drop_ns:
                self._turns_ns += self.format.wrap_ns
                t_ns += self.format.wrap_ns
            self._last_ns = t_ns
        return t_ns + self._offset_ns

    def _content(self, data: str, count: int | None) -> bytes | None:
        """Return the data bytes; None if there are fewer than `count`."""
        separator = self.format.separator
        if count is None and self._base == 16:
            content = bytes.fromhex(data if "." not in data else data.replace(".", ""))
        elif count is None:
            content = bytes(map(int, data.split()))
        elif separator == "":
            content = bytes.fromhex(data)
        elif separator == "base64":
            content = b64decode(data, validate=True)
        elif separator == ",":
            return data_of(data[1:].split(","), count, self._base)
        else:
            return _spaced(data, count, self._base)
        return None if count not in (None, len(content)) else content

    def _is_head(self, text: str, ended: bool) -> bool:
        """Return whether a line is a head line, or the beginning of one at the file's end; take its settings."""
        lower, previous = text.lower(), self._previous
        heads = self.format.heads
        if not ended:
            opening = self.format.opening
            heads += (opening[1],) if opening[0] and previous.startswith(opening[0]) else ()
            if self._first and self.format.example.startswith(text):  # a row may begin so, too
                return False
            return lower.startswith(self.format.heads) or any(head.startswith(lower) for head in heads)
        if not heads or not lower.startswith(heads):
            return False
        self._previous = lower
        self.heads += 1
        if setting := self.format.settings.search(text):
            self._set(setting.groupdict())
        return True

    def _set(self, settings: dict[str, str | None]) -> None:
        if base := settings.get("base"):
            self._base = BASES[base.lower()]
        if start := settings.get("start"):
            self._start_ns = self._offset_ns = self.format.start(start)
        if mode := settings.get("mode"):
            self.relative = mode.lower() == "relative"
            self._offset_ns = self._start_ns // DAY_NS * DAY_NS if mode.lower() == "system" else self._start_ns
        columns = settings.get("columns") or TRC_VERSIONS.get(settings.get("version") or "", "")
        if columns:
            self._use(trc_lines(columns.replace(",", "").replace(" ", "")))

    def _use(self, lines: tuple[LineForm, ...]) -> None:
        self._lines = [(line.pattern.fullmatch, line.kind, line.is_open) for line in lines]


def _spaced(data: str, count: int, base: int) -> bytes | None:
    """Return data bytes between spaces; None if there are fewer than `count`."""
    if base == 16:
        try:
            content = bytes.fromhex(data)
        except ValueError:  # text that looks like a byte may stand behind the data
            pass
        else:
            return content[:count] if len(content) >= count else None
    return data_of(data.split(), count, base)


def read_rows(lines: Iterable[tuple[str, bool]], rows: LineReader) -> Log:
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


@dataclass(frozen=True)
class FormatMatch:
    """How well the first lines fit a format: numbers of frames, of other lines that fit, and of lines that do not fit;
    the first of these (else the first line) with its number, counted from 1; and the text's line end.
    """

    format: Format
    end: bytes
    frames: int = 0
    others: int = 0
    misfits: int = 0
    line: int = 0
    text: str = ""

    @property
    def fits(self) -> bool:
        """Whether the text is a log of this format."""
        return self.frames + self.others > 0 and self.frames + self.others >= self.misfits


def recognise(start: bytes, suffix: str) -> FormatMatch:
    """Return the format that a text's beginning fits best: by frames, then by other lines, then by the name's ending.

    A last line without its line end, which may be truncated, is no misfit.
    """
    end = b"\r" if b"\r" in start and b"\n" not in start else b"\n"  # serial adapters end lines with the former
    lines = [line.decode("utf-8", "replace") for line in start.removeprefix(codecs.BOM_UTF8).split(end)]
    matches = []
    for log_format in FORMATS:
        match = _judge(log_format, lines, end)
        if match.frames and not match.misfits:
            return match
        matches.append(match)
    return max(matches, key=lambda match: _rank(match, suffix))


def _judge(log_format: Format, lines: list[str], end: bytes) -> FormatMatch:
    reader = LineReader(log_format)
    frames = others = misfits = first = 0
    for number, text in enumerate(lines[:MOST_LINES], 1):
        if not text.strip():
            continue
        ended = number < len(lines)
        try:
            outcome = reader.row(text.rstrip("\r"), ended)
        except (ValueError, IndexError):
            outcome = MALFORMED
        if isinstance(outcome, tuple):
            frames += 1
        elif outcome == MALFORMED:
            misfits += ended
            first = first or number * ended
        elif outcome is not None:
            others += ended
    first = first or next((number for number, text in enumerate(lines, 1) if text.strip()), 1)
    return FormatMatch(log_format, end, frames, others + reader.heads, misfits, first, lines[first - 1].strip())


def _rank(match: FormatMatch, suffix: str) -> tuple[int, int, bool, float]:
    alike = difflib.SequenceMatcher(None, _shape(match.text), _shape(match.format.example)).ratio()
    return match.frames, match.others, suffix == match.format.suffix, alike


def _shape(text: str) -> str:
    """Return a text with one character for all digits and letters: what makes lines of a format alike."""
    return re.sub(r"[0-9A-Za-z]+", "0", text[:SHOWN])


def refusal(path: str, match: FormatMatch) -> str:
    """Return the error's text for a file that fits no format; `match` is that of the nearest."""
    text = match.text if len(match.text) <= SHOWN else f"{match.text[:SHOWN]}..."
    return (
        f"{path}:{match.line}: {text!r} is no line of a log format that is known; the nearest is {match.format.name}, "
        f"with lines as {match.format.example.strip()!r}"
    )
