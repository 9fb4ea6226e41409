"""candump's two formats: the log (``candump -L``, ``-l``) and its console output.

::

    (1436509052.249713) can0 123#DEADBEEF        a log; R or T may stand behind the data
    (1436509052.249713) can0 20000040#00...      an error frame: CAN_ERR_FLAG and its classes
      can0  123   [4]  DE AD BE EF               a console; -t puts a stamp in front, -x RX or TX
"""

from __future__ import annotations

import re
from datetime import UTC, datetime

from coulombus.recording.logs.log import FD, MALFORMED, SHORT, Row, data_of, identifier, stamp_ns
from coulombus.wire.can_flags import CAN_ERR_FLAG, CAN_RTR_FLAG

__all__ = ["CandumpRows"]

LOG = re.compile(r"\s*\(([^()]*)\)\s+(\S+)\s+([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})#(\S*)(\s+[RTrt])?\s*", re.ASCII)
CONSOLE = re.compile(
    r"\s*(?:\(([^()]*)\)\s+)?(\S+)\s+(?:[RT]X\s+\S+\s+\S+\s+)?([0-9A-Fa-f]{3}|[0-9A-Fa-f]{8})\s+\[(\d+)\](.*)",
    re.ASCII,
)
REMOTE = re.compile(r"[Rr](\d?)(?:_[0-9A-Fa-f])?")
ERROR_FLAG, BITS = 0x2000_0000, 0x1FFF_FFFF
SHORT_DIGITS = 3  # of an 11-bit identifier


class CandumpRows:
    """Lines of candump, each in either format."""

    def __init__(self) -> None:
        self.without_time = 0
        """Frames of the console without a stamp."""

    def row(self, text: str, ended: bool) -> Row | str | None:
        """See `log.LineFormat`."""
        if match := LOG.fullmatch(text):
            if not ended and not match[5]:
                return MALFORMED  # its data may be truncated at any byte
            return _log_row(match)
        if match := CONSOLE.fullmatch(text):
            row = _console_row(match)
            self.without_time += match[1] is None and isinstance(row, tuple)
            return row
        return None if text.startswith("\t") else MALFORMED  # candump -e explains an error frame there


def _log_row(match: re.Match[str]) -> Row | str:
    stamp, bus, digits, data = match.groups()[:4]
    t_ns, can_id = stamp_ns(stamp), _can_id(digits)
    if data.startswith("#"):
        return FD
    if remote := REMOTE.fullmatch(data):
        return t_ns, can_id | CAN_RTR_FLAG, int(remote[1] or "0"), b"", bus
    content = bytes.fromhex(data.partition("_")[0].replace(".", ""))
    return t_ns, can_id, len(content), content, bus


def _console_row(match: re.Match[str]) -> Row | str:
    stamp, bus, digits, length, rest = match.groups()
    can_id, count = _can_id(digits), int(length)
    if len(length) > 1:  # candump prints the length of CAN FD frames in two digits
        return FD
    t_ns = 0 if stamp is None else _time_ns(stamp)
    if "remote request".startswith(rest.strip()) and rest.strip():
        whole = rest.strip() == "remote request"
        return (t_ns, can_id | CAN_RTR_FLAG, count, b"", bus) if whole else SHORT
    data = data_of(rest.split(), count)
    return SHORT if data is None else (t_ns, can_id, count, data, bus)


def _can_id(digits: str) -> int:
    value = int(digits, 16)
    if value & ERROR_FLAG and len(digits) > SHORT_DIGITS:
        return CAN_ERR_FLAG | value & BITS
    return identifier(value, len(digits) > SHORT_DIGITS)


def _time_ns(text: str) -> int:
    """Return the stamp of a console line: seconds, or with ``-t A`` date and time, read as UTC."""
    if "-" not in text.strip("-"):
        return stamp_ns(text)
    moment = datetime.fromisoformat(text).replace(tzinfo=UTC)
    return int(moment.replace(microsecond=0).timestamp()) * 10**9 + moment.microsecond * 1000
