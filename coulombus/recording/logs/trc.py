"""PEAK's .trc: versions 1.0 to 1.3 have fixed columns, 2.0 and 2.1 name theirs.

Columns: N number, O offset [ms], T type, B bus, I identifier, d direction, R reserved, l length,
L DLC, D data.
"""

from __future__ import annotations

from coulombus.recording.logs.log import BUS_ERROR, EVENT, FD, SHORT, Row, data_of, identifier, stamp_ns
from coulombus.wire.can_flags import CAN_RTR_FLAG

__all__ = ["TrcRows"]

FIXED = {"1.0": "NOILD", "1.1": "NOTILD", "1.2": "NOBTILD", "1.3": "NOBTIRLD"}
FRAMES, REMOTES, ERRORS = ("DT", "Rx", "Tx"), ("RR",), ("ER", "Error")
FD_FRAMES = ("FD", "FB", "FE", "BI")
STATUS_ID = "FFFFFFFF"
DAY_NS = 86_400 * 10**9
EPOCH_DAYS = 25_569
"""Days from 1899-12-30, from which the file's start counts, to 1970."""
EXTENDED_DIGITS = 4  # an identifier of more digits is extended


class TrcRows:
    """Lines of a .trc file."""

    def __init__(self) -> None:
        self._columns = FIXED["1.0"]
        self._start_ns = 0

    def row(self, text: str, ended: bool) -> Row | str | None:
        """See `log.LineFormat`."""
        if text.lstrip().startswith(";"):
            if ended:
                self._head(text.strip()[1:])
            return None
        tokens = text.split()
        t_ns = self._start_ns + stamp_ns(self._of(tokens, "O"), 10**6)
        kind = self._of(tokens, "T") if "T" in self._columns else "Rx"
        if kind in FD_FRAMES:
            return FD
        bus = self._of(tokens, "B") if "B" in self._columns else ""
        if kind in ERRORS:
            return t_ns, BUS_ERROR, 0, b"", bus
        digits = self._of(tokens, "I")
        if kind not in FRAMES + REMOTES or digits == STATUS_ID:
            return EVENT
        can_id = identifier(int(digits, 16), len(digits) > EXTENDED_DIGITS)
        at = self._columns.find("l") if "l" in self._columns else self._columns.find("L")
        length, data = min(int(tokens[at], 16), 8), tokens[self._columns.find("D") :]
        if kind in REMOTES or data == ["RTR"]:
            return t_ns, can_id | CAN_RTR_FLAG, length, b"", bus
        content = data_of(data, length)
        return SHORT if content is None else (t_ns, can_id, length, content, bus)

    def _of(self, tokens: list[str], column: str) -> str:
        return tokens[self._columns.index(column)]

    def _head(self, text: str) -> None:
        name, _, value = text.partition("=")
        if name == "$FILEVERSION":
            self._columns = FIXED.get(value, self._columns)
        elif name == "$COLUMNS":
            self._columns = value.replace(",", "").replace(" ", "")
        elif name == "$STARTTIME":
            self._start_ns = stamp_ns(value, DAY_NS) - EPOCH_DAYS * DAY_NS
            self._start_ns = round(self._start_ns / 1000) * 1000
