"""How a case ends before its end: it failed, or it cannot be applied to this device."""

from __future__ import annotations

from coulombus.eds.cia301 import abort_text
from coulombus.eds.sdo_frames import where

__all__ = ["CaseFailed", "NoAnswer", "NotApplicable", "TransferAborted", "where"]


class NotApplicable(Exception):
    """The device does not have what the case is about; the text says what."""


class CaseFailed(Exception):
    """The device did not do what the case asks for; the text says what it did instead."""


class NoAnswer(CaseFailed):
    """The device did not answer in time."""


class TransferAborted(CaseFailed):
    """The server aborted an SDO transfer; a failure unless the case expected it."""

    def __init__(self, index: int, subindex: int, code: int, what: str) -> None:
        super().__init__(f"{what} {where(index, subindex)} was aborted with {abort_text(code)}")
        self.index, self.subindex, self.code = index, subindex, code
