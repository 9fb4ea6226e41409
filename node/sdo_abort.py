"""Abort of an SDO service by a device."""

from __future__ import annotations

from coulombus.eds.cia301 import abort_text

__all__ = ["SdoAbort"]


class SdoAbort(Exception):
    """An SDO service is aborted; the client receives `code`."""

    def __init__(self, code: int) -> None:
        super().__init__(abort_text(code))
        self.code = code
