"""python-can's .csv: ``timestamp,arbitration_id,extended,remote,error,dlc,data``, the data in base64."""

from __future__ import annotations

from base64 import b64decode

from coulombus.recording.logs.log import MALFORMED, SHORT, Row, clock_us, identifier, stamp_ns
from coulombus.wire.can_flags import CAN_ERR_FLAG, CAN_RTR_FLAG

__all__ = ["HEAD", "CsvRows"]

HEAD = "timestamp,arbitration_id,extended,remote,error,dlc,data"
COLUMNS = HEAD.count(",") + 1


class CsvRows:
    """Lines of python-can's CSV file."""

    def row(self, text: str, ended: bool) -> Row | str | None:
        """See `log.LineFormat`."""
        if text.strip() == HEAD or (not ended and HEAD.startswith(text)):
            return None
        fields = text.split(",")
        if len(fields) != COLUMNS:
            return SHORT if fields[0].replace(".", "").isdigit() else MALFORMED
        stamp, digits, extended, remote, error, dlc, packed = fields
        t_ns, length, data = clock_us(stamp_ns(stamp)), int(dlc), b64decode(packed, validate=True)
        if error == "1":
            can_id = CAN_ERR_FLAG | identifier(int(digits, 16), extended=True) & 0x1FFF_FFFF
        else:
            can_id = identifier(int(digits, 16), extended == "1")
        if remote == "1":
            return t_ns, can_id | CAN_RTR_FLAG, length, b"", ""
        return (t_ns, can_id, length, data, "") if len(data) == length else SHORT
