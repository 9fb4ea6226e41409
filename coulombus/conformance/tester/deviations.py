"""Judge values that differ from the EDS's defaults after a reset."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

from coulombus.conformance.tester.described_device import is_signed
from coulombus.conformance.tester.objects import ABSENT_NOW, LONGEST, NOT_NOW, READ_ONLY, is_command, is_output
from coulombus.conformance.tester.running import running
from coulombus.conformance.tester.unit import Unit, encode
from coulombus.conformance.tester.verdict import CaseFailed, NotApplicable, TransferAborted, left_open, where
from coulombus.eds.reader import Variable

__all__ = ["deviation", "judge_deviations"]

_SHOWN = 5
_OF_THE_MAKER = 0x2000


def deviation(unit: Unit, v: Variable) -> str | None:
    """Return the deviation of an object from its default, if any."""
    default = unit.default(v)
    if default is None or v.access == "wo" or v.unreadable:
        return None
    try:
        data = unit.sdo.upload_up_to(v.index, v.subindex, LONGEST)
    except TransferAborted as abort:
        return None if abort.code in (*ABSENT_NOW, *NOT_NOW) else str(abort)
    if data is None:
        return None
    expected = encode(v, default)
    if not v.bits:
        data, expected = data.rstrip(b"\0"), expected.rstrip(b"\0")
        same = data == expected or not expected
    else:
        same = data == expected
    return None if same else f"{where(v.index, v.subindex)} is {_shown(v, data)}; the EDS says {_shown(v, expected)}"


def _shown(v: Variable, data: bytes) -> str:
    if not v.bits:
        return repr(data)
    return f"{int.from_bytes(data, 'little', signed=is_signed(v))} ({data[::-1].hex().upper()}h)"


def judge_deviations(unit: Unit, texts: Mapping[tuple[int, int], str]) -> str:
    """Judge objects whose value after a reset is not the EDS's default.

    Parameters
    ----------
    texts : by index and sub-index, actual and expected value

    Returns
    -------
    A remark on cases that the standard leaves open: an object that changes by itself, or an object
    from 2000h up that keeps its value over a reset without being stored, such as an operating time.

    Raises
    ------
    CaseFailed
        Any other object.
    NotApplicable
        Only user-storable objects deviate, in a device that cannot load its defaults.
    """
    left = {place: (unit.variable(*place), text) for place, text in texts.items()}
    remarks = []
    for v in running(unit, [v for v, _ in left.values()]):
        remarks.append(f"{left.pop((v.index, v.subindex))[1]}, and it runs")
    stored = {place: left.pop(place) for place, (v, _) in list(left.items()) if _may_be_stored(unit, v)}
    for v in _kept_without_a_store(unit, [v for v, _ in left.values()]):
        remarks.append(f"{left.pop((v.index, v.subindex))[1]}, and a reset keeps what is written to it")
    if left:
        raise CaseFailed(_list([text for _, text in left.values()]))
    if stored:
        text = _list([text for _, text in stored.values()])
        raise NotApplicable(f"{text}. It may have been stored, and 1011h:01 does not load the defaults on command")
    if not remarks:
        return ""
    return left_open(_list(remarks), "CiA 301, 7.5.2.14: which objects have a default to restore, the maker decides")


def _list(texts: list[str]) -> str:
    return "; ".join(texts[:_SHOWN]) + (f"; and {len(texts) - _SHOWN} more" if len(texts) > _SHOWN else "")


def _may_be_stored(unit: Unit, v: Variable) -> bool:
    return unit.has(0x1010) and not unit.from_defaults and v.access not in READ_ONLY


def _kept_without_a_store(unit: Unit, variables: Iterable[Variable]) -> list[Variable]:
    """Return the manufacturer's and profile's parameters that keep a default written before a
    reset; the end of the case writes their values back.
    """
    written = []
    for v in variables:
        if v.index < _OF_THE_MAKER or v.access not in ("rw", "rwr") or is_output(v) or is_command(v):
            continue
        try:
            before = unit.read(v.index, v.subindex)
            unit.put(v.index, v.subindex, encode(v, unit.default(v)))
        except TransferAborted:
            continue
        unit.undo_later(v.index, v.subindex, before)
        written.append(v)
    if written:
        unit.reset()
    return [v for v in written if deviation(unit, v) is None]
