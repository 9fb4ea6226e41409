"""Checks of the SDO cases: a writable text, and the permitted ends of a wrong transfer."""

from __future__ import annotations

from collections.abc import Callable

from coulombus.conformance.tester.objects import NOT_NOW, long_texts
from coulombus.conformance.tester.unit import Unit
from coulombus.conformance.tester.verdict import CaseFailed, NoAnswer, NotApplicable, TransferAborted, left_open, where
from coulombus.eds.cia301 import Abort
from coulombus.eds.reader import Variable

__all__ = ["LENGTHS", "judge_out_of_turn", "must_abort", "reads_back", "refused", "shown", "text_object", "untouched"]

TEXT = b"Coulombus writes a text of more than one segment, and of a length that is not theirs."

SHORTEST = 15
"""Least bytes of a text, three segments: a shorter one does not test segments."""

LENGTHS = (Abort.LENGTH, Abort.TOO_LONG, Abort.TOO_SHORT, Abort.MEMORY, Abort.GENERAL, *NOT_NOW)
"""Abort codes for a text of wrong length."""


def text_object(unit: Unit) -> tuple[int, int, bytes, bytes]:
    """Return a writable string: index, sub-index, its bytes, which are restored later, and a text that fits.

    An EDS does not state the maximum length of a string. It is found by trial, once in a run:
    `TEXT`, beginnings of it, and as many bytes as the string has.
    """
    reason = ""
    for variable in long_texts(unit):
        index, subindex = variable.index, variable.subindex
        before = unit.read(index, subindex)
        unit.undo_later(index, subindex, before)
        unit.dirty = True
        if (index, subindex) not in unit.rooms:
            unit.rooms[index, subindex] = _room(unit, variable, before)
        if unit.rooms[index, subindex] >= SHORTEST:
            return index, subindex, before, TEXT[: unit.rooms[index, subindex]]
        reason = f"{where(index, subindex)} has no room for {SHORTEST} bytes"
    raise NotApplicable(f"the device has no writable string of three segments: {reason}")


def _room(unit: Unit, variable: Variable, before: bytes) -> int:
    """Return the number of bytes of `TEXT` that fit into the string, 0 for fewer than `SHORTEST`.

    The string no longer has them on return.
    """
    index, subindex = variable.index, variable.subindex
    as_before: tuple[int, ...] = (len(before),) if SHORTEST <= len(before) < len(TEXT) else ()
    for length in (len(TEXT), *as_before, 57, 29, SHORTEST):
        try:
            unit.sdo.download_segmented(index, subindex, TEXT[:length])
        except TransferAborted as abort:
            if abort.code not in LENGTHS:
                raise
            continue
        held: bool = shown(unit.read(index, subindex)) == TEXT[:length]
        unit.sdo.download_segmented(index, subindex, before)
        if held:
            return length
    return 0


def shown(text: bytes) -> bytes:
    """Return a string without trailing zeros, which may pad a string of fixed length."""
    return text.rstrip(b"\0")


def untouched(unit: Unit, index: int, subindex: int, before: bytes) -> str:
    """Return a remark on the old text after an aborted download: none, or that a part was written.

    CiA 301 does not require atomic downloads: a device with little memory writes a long one in parts.
    """
    if shown(unit.read(index, subindex)) == shown(before):
        return ""
    return f"; {where(index, subindex)} has a part of what was aborted"


def refused(unit: Unit, transfer: Callable[[int, int, bytes], object], what: str, *, silence: bool = False) -> str:
    """Write a text wrongly by `transfer`: it is aborted (or, with `silence`, ignored).

    Return the code.
    """
    index, subindex, before, text = text_object(unit)
    try:
        transfer(index, subindex, text)
    except TransferAborted as abort:
        how = "ignored" if silence and abort.code == Abort.TIMEOUT else f"{unit.judge(abort):08X}h"
    except NoAnswer:
        if not silence:
            raise
        unit.sdo.abort(index, subindex)
        how = "ignored"
    else:
        raise CaseFailed(f"{where(index, subindex)} took {what}")
    return how + untouched(unit, index, subindex, before)


def reads_back(unit: Unit, index: int, subindex: int, text: bytes, after: str = "") -> None:
    """Fail unless a string has the text that was written to it."""
    if shown(unit.read(index, subindex)) != text:
        raise CaseFailed(f"{where(index, subindex)} does not read back{after}")


OUT_OF_TURN = (Abort.TOGGLE, Abort.TIMEOUT, Abort.COMMAND, Abort.BLOCK_SIZE, Abort.SEQUENCE, Abort.GENERAL)
"""Abort codes for a request out of turn."""


def judge_out_of_turn(unit: Unit, abort: TransferAborted) -> str:
    """Return a remark on the refusal of a request out of turn.

    CiA 301 names no code for it, so any of the protocol's is correct; a code that its table 22
    defines for something else is reported.
    """
    named = not unit.codes or abort.code in unit.codes
    code = f"{unit.judge(abort, OUT_OF_TURN):08X}h"
    return code if named else left_open(f"{code} for a request out of turn", "CiA 301, 7.2.4.2 and table 22")


def must_abort(unit: Unit, request: bytes, what: str, place: tuple[int, int] = (0x1000, 0)) -> str:
    """Send a request out of turn: it is aborted or ignored; return which.

    CiA 301 names abort codes, but does not require a response to an unexpected request; so a server
    may be silent if it works afterwards. `place` is the open transfer's object.
    """
    try:
        answer = unit.sdo.request(request, 0, 0, "unknown command")
    except TransferAborted as abort:
        return "ignored" if abort.code == Abort.TIMEOUT else judge_out_of_turn(unit, abort)
    except NoAnswer:
        unit.sdo.abort(*place)
        unit.read(0x1000, 0)
        return "ignored"
    raise CaseFailed(f"{what} is answered with {answer.hex(' ')}")
