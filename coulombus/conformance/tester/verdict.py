"""How a case ends before its end: it failed, it cannot be applied to this device, or the standard
leaves open what the device does.
"""

from __future__ import annotations

from coulombus.eds.cia301 import abort_text
from coulombus.eds.sdo_frames import where

__all__ = ["CaseFailed", "LeftOpen", "NoAnswer", "NotApplicable", "TransferAborted", "left_open", "where"]


def left_open(what: str, clause: str) -> str:
    """Return the remark on what a standard does not decide; `clause` says where it does not."""
    return f"the standard leaves it open: {what} ({clause})"


class NotApplicable(Exception):
    """The device does not have what the case is about; the text says what."""


class LeftOpen(NotApplicable):
    """The device does what the standard neither demands nor forbids: the case judges nothing."""

    def __init__(self, what: str, clause: str) -> None:
        super().__init__(left_open(what, clause))


class CaseFailed(Exception):
    """The device did not do what the case asks for; the text says what it did instead.

    Parameters
    ----------
    cause
        The fault behind the failure, in words that every case which meets it has alike. Empty: the
        text.
    clause
        Where the standard demands what is missing. Empty: the clause of the case.
    """

    def __init__(self, text: str, *, cause: str = "", clause: str = "") -> None:
        super().__init__(text)
        self.cause, self.clause = cause or text, clause


class NoAnswer(CaseFailed):
    """The device did not answer in time."""


class TransferAborted(CaseFailed):
    """The server aborted an SDO transfer; a failure unless the case expected it."""

    def __init__(self, index: int, subindex: int, code: int, what: str) -> None:
        super().__init__(f"{what} {where(index, subindex)} was aborted with {abort_text(code)}")
        self.index, self.subindex, self.code = index, subindex, code
