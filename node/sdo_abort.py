"""How a device says no: the abort of an SDO service."""

from __future__ import annotations

from coulombus.eds.cia301 import abort_text

__all__ = ["SdoAbort"]


class SdoAbort(Exception):
    """An SDO service is aborted; `code` goes to the client."""

    def __init__(self, code: int) -> None:
        super().__init__(abort_text(code))
        self.code = code
