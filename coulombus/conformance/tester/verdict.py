"""Exceptions that end a case: failed, not applicable, or left open by the standard."""

from __future__ import annotations

from coulombus.eds.cia301 import abort_text
from coulombus.eds.sdo_frames import where

__all__ = ["CaseFailed", "LeftOpen", "NoAnswer", "NotApplicable", "TransferAborted", "left_open", "where"]


def left_open(what: str, clause: str) -> str:
    """Return the remark on a behaviour that a standard leaves open, with its `clause`."""
    return f"the standard leaves it open: {what} ({clause})"


class NotApplicable(Exception):
    """The device lacks the subject of the case; the text names it."""


class LeftOpen(NotApplicable):
    """The standard neither demands nor forbids the device's behaviour: no verdict."""

    def __init__(self, what: str, clause: str) -> None:
        super().__init__(left_open(what, clause))


class CaseFailed(Exception):
    """The device violated the requirement of the case; the text describes its behaviour.

    Parameters
    ----------
    cause
        The fault behind the failure, with the same text in all affected cases. Empty: the text.
    clause
        Clause of the violated requirement. Empty: the clause of the case.
    """

    def __init__(self, text: str, *, cause: str = "", clause: str = "") -> None:
        super().__init__(text)
        self.cause, self.clause = cause or text, clause


class NoAnswer(CaseFailed):
    """The device did not respond in time."""


class TransferAborted(CaseFailed):
    """The server aborted an SDO transfer; a failure unless the case expected it."""

    def __init__(self, index: int, subindex: int, code: int, what: str) -> None:
        super().__init__(f"{what} {where(index, subindex)} was aborted with {abort_text(code)}")
        self.index, self.subindex, self.code = index, subindex, code
