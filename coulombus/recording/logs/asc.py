"""Vector's .asc, as CANoe, BUSMASTER and python-can write it.

::

    0.001000 1  181             Rx   d 8 50 02 00 00 00 00 00 00        a frame; x behind an extended identifier
    0.001200 1  ErrorFrame
    0.001300 CANFD   1 Rx        182       1 0 8  8 50 ... 0  0  3000 0   flags behind the data tell whether it is CAN FD
"""

from __future__ import annotations

import re

from coulombus.recording.logs.log import BUS_ERROR, EVENT, FD, SHORT, Row, data_of, identifier, stamp_ns
from coulombus.wire.can_flags import CAN_RTR_FLAG

__all__ = ["AscRows"]

STAMPED = re.compile(r"\s*(\d+[.,]\d+)(?:\s+(.*?))?\s*", re.ASCII)
START = "start of measurement"
BEGIN = re.compile(r"0?[.,]?0*\s*(.*)", re.ASCII)
"""Beginning of the line of `START`."""
NO_ROWS = (
    *("date ", "base ", "internal events logged", "no internal events logged", "//"),
    *("begin triggerblock", "end triggerblock", "previous log file", "measurement uuid"),
)
FLAG_FD, FLAG_REMOTE = 0x1000, 0x10
HEAD = 5  # channel, identifier, direction, kind, length
DATA_LENGTH = 8


class AscRows:
    """Lines of an .asc file; times count from the measurement's start."""

    def __init__(self) -> None:
        self._base = 16
        self._relative = False
        self._last_ns = 0
        self._begins = False
        """Whether the previous line began a measurement: `START` follows."""

    def row(self, text: str, ended: bool) -> Row | str | None:
        """See `log.LineFormat`."""
        begins, self._begins = self._begins, text.strip().lower().startswith("begin triggerblock")
        begun = BEGIN.fullmatch(text.strip().lower())
        if begins and not ended and begun and START.startswith(begun[1]):
            return None
        match = STAMPED.fullmatch(text)
        if match is None:
            return self._head(text.strip().lower(), ended)
        t_ns = stamp_ns(match[1])
        self._last_ns = t_ns = t_ns + self._last_ns if self._relative else t_ns
        rest = match[2] or ""
        if rest.lower() == START:
            return None
        tokens = rest.split()
        if tokens and tokens[0].upper() == "CANFD":
            return self._fd_row(t_ns, tokens[1:], ended)
        if not tokens or not tokens[0].isdigit():
            return EVENT if tokens else SHORT
        return self._row(t_ns, tokens, ended)

    def _head(self, text: str, ended: bool) -> str | None:
        """Process a line without a stamp: header, comment, or event."""
        if text.startswith("base "):
            self._base = 10 if " dec" in text else 16
            self._relative = "relative" in text
        known = text.startswith(NO_ROWS) or (not ended and any(line.startswith(text) for line in NO_ROWS))
        return None if known else EVENT

    def _row(self, t_ns: int, tokens: list[str], ended: bool) -> Row | str:
        bus = tokens[0]
        if len(tokens) > 1 and tokens[1].lower() == "errorframe":
            return t_ns, BUS_ERROR, 0, b"", bus
        if len(tokens) < HEAD - 1:
            return SHORT
        if tokens[2] not in ("Rx", "Tx"):
            return EVENT
        can_id, kind = self._can_id(tokens[1]), tokens[3].lower()
        if kind == "r":
            told = len(tokens) >= HEAD and tokens[4].isalnum() and len(tokens[4]) == 1
            if not told and not ended:
                return SHORT
            return t_ns, can_id | CAN_RTR_FLAG, min(int(tokens[4], 16), DATA_LENGTH) if told else 0, b"", bus
        if kind != "d":
            return EVENT
        if len(tokens) < HEAD:
            return SHORT
        length = min(int(tokens[4], 16), DATA_LENGTH)
        if not ended and self._base == 10 and length and len(tokens) <= HEAD + length:
            return SHORT  # its last byte may be truncated
        data = data_of(tokens[HEAD:], length, self._base)
        return SHORT if data is None else (t_ns, can_id, length, data, bus)

    def _fd_row(self, t_ns: int, tokens: list[str], ended: bool) -> Row | str:
        """Read a CANFD line: CAN FD controllers write it for every frame; the flags distinguish CAN FD frames."""
        if len(tokens) > 2 and tokens[2].lower() == "errorframe":
            return t_ns, BUS_ERROR, 0, b"", tokens[0]
        bus, can_id, rest = tokens[0], self._can_id(tokens[2]), tokens[3:]
        if rest and rest[0] not in ("0", "1"):  # a symbolic name
            rest = rest[1:]
        length, size = int(rest[2], self._base), int(rest[3])
        flags = rest[4 + size :][2:]
        if not flags or (len(flags) == 1 and not ended):
            return SHORT
        if int(flags[0], 16) & FLAG_FD:
            return FD
        if int(flags[0], 16) & FLAG_REMOTE or size < min(length, DATA_LENGTH):
            return t_ns, can_id | CAN_RTR_FLAG, min(length, DATA_LENGTH), b"", bus
        data = data_of(rest[4:], size, self._base)
        return SHORT if data is None else (t_ns, can_id, size, data, bus)

    def _can_id(self, text: str) -> int:
        extended = text[-1:].lower() == "x"
        return identifier(int(text[:-1] if extended else text, self._base), extended)
