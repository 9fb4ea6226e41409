"""Objects that change by themselves, such as a clock or a counter: their changes say nothing about a write."""

from __future__ import annotations

from collections.abc import Collection

from coulombus.conformance.tester.objects import LONGEST
from coulombus.conformance.tester.unit import MS, Unit
from coulombus.conformance.tester.verdict import CaseFailed, TransferAborted, where
from coulombus.eds.reader import Variable

__all__ = ["keeps_own_value", "running", "unchanged"]

_READS = 20
_TEXTS = (0x0009, 0x000B)


def running(unit: Unit, variables: Collection[Variable]) -> list[Variable]:
    """Return those of the variables that change without a write.

    All are read for twice the response time-out, or until each has changed. Constants and texts do not change.
    """
    places = {(v.index, v.subindex): v for v in variables if v.access != "const" and v.data_type not in _TEXTS}
    still = {place: v for place, v in places.items() if place not in unit.running}
    before = {place: _value(unit, v) for place, v in still.items()}
    pause_ns = max(2 * unit.timing.answer_ns // _READS, MS)
    for _ in range(_READS):
        if not still:
            break
        unit.pause(pause_ns)
        for place, v in list(still.items()):
            if _value(unit, v) != before[place]:
                unit.running.add(place)
                del still[place]
    return [v for place, v in places.items() if place in unit.running]


def _value(unit: Unit, variable: Variable) -> bytes | None:
    try:
        return unit.sdo.upload_up_to(variable.index, variable.subindex, LONGEST)
    except TransferAborted:
        return None


def unchanged(unit: Unit, variable: Variable, before: bytes) -> None:
    """Fail if a refused write has changed an object that does not change by itself."""
    name = where(variable.index, variable.subindex)
    if unit.read(variable.index, variable.subindex) != before and not running(unit, [variable]):
        raise CaseFailed(f"{name} has changed although it was refused", cause="a value that is refused is taken")


def keeps_own_value(unit: Unit, variable: Variable, value: bytes) -> str | None:
    """Fail unless an object keeps its own written value, or changes by itself.

    Returns
    -------
    The remark on an object that changes by itself, None if it keeps its value. A slow counter may
    step between write and read: it is written a second time.
    """
    index, subindex = variable.index, variable.subindex
    again = unit.read(index, subindex)
    if again == value:
        return None
    if not running(unit, [variable]):
        unit.put(index, subindex, value)
        if unit.read(index, subindex) != value:
            text = f"was {value.hex()}, and {again.hex()} after writing that"
            raise CaseFailed(f"{where(index, subindex)} {text}", cause="an object does not keep its own value")
    return f"{where(index, subindex)} runs"
