"""Reads the lines of a text log by its format's row in `formats.FORMATS`."""

from __future__ import annotations

from base64 import b64decode

from coulombus.recording.logs.formats import DATA, ERROR, GROUPS, REMOTE, TRC_VERSIONS, Format, LineForm, trc_lines
from coulombus.recording.logs.log import BUS_ERROR, MALFORMED, SHORT, Row, data_of, identifier
from coulombus.recording.logs.stamps import DAY_NS
from coulombus.wire.can_flags import CAN_ERR_FLAG, CAN_RTR_FLAG

__all__ = ["LineReader"]

KINDS = (DATA, REMOTE, ERROR)
LONGEST_DATA, BITS = 8, 0x1FFF_FFFF
BASES = {"hex": 16, "dec": 10}


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
        """See `log.RowReader`."""
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
