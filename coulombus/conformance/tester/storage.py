"""Parameters at the beginning and the end of a run, and what it stores: set, and reported before and after."""

from __future__ import annotations

from collections.abc import Collection

from coulombus.conformance.tester.registry import FROM_DEFAULTS
from coulombus.conformance.tester.unit import Unit
from coulombus.conformance.tester.verdict import CaseFailed, where

__all__ = ["Parameters", "begin", "end", "intention"]

Parameters = dict[tuple[int, int], bytes]
"""Communication parameters that a run changes, with the device's values."""

_CHANGED = ((0x1005, 0), (0x1006, 0), (0x100C, 0), (0x100D, 0), (0x1014, 0), (0x1015, 0), (0x1017, 0), (0x1019, 0))


def _from_defaults(unit: Unit, numbers: Collection[str]) -> bool:
    return unit.able(0x1011) and not FROM_DEFAULTS.isdisjoint(numbers)


def intention(unit: Unit, numbers: Collection[str]) -> str:
    """Return a sentence on the effect of these cases on the device's parameters."""
    if FROM_DEFAULTS.isdisjoint(numbers):
        return "it keeps the parameters that it has stored, and begins with them"
    if unit.able(0x1011):
        return "it begins from its defaults (1011h:01) and ends with them: what it has stored is lost"
    text = "it cannot load its defaults (no 1011h:01 on command): it begins with the parameters that it holds"
    return f"{text}, and nothing is stored in it" if unit.has(0x1010) else text


def begin(unit: Unit, numbers: Collection[str]) -> tuple[str, Parameters]:
    """Load the device's defaults if a case needs them and 1011h:01 can do it.

    Return a sentence on it, and the initial parameters.
    """
    text = "the run began with the parameters that the device held"
    if _from_defaults(unit, numbers):
        try:
            unit.sign(0x1011, 1, b"load")
            unit.from_defaults = True
            text = "the run began from the device's defaults (1011h:01)"
        except CaseFailed as why:
            text = f"{text}, for it did not load its defaults: {why}"
        unit.stored = False
        unit.reset()
    elif not FROM_DEFAULTS.isdisjoint(numbers):
        text += ", for it has no 1011h:01 on command"
    parameters = _held(unit)
    sync = int.from_bytes(parameters.get((0x1005, 0), b""), "little") & 0x7FF
    unit.sync_id = sync or unit.sync_id
    return text, parameters


def _held(unit: Unit) -> Parameters:
    parameters = {}
    for place in _CHANGED:
        if unit.has(*place) and unit.variable(*place).access != "wo":
            try:
                parameters[place] = unit.read(*place)
            except CaseFailed:
                continue
    return parameters


def end(unit: Unit, before: Parameters) -> str:
    """Return a sentence on the device's final parameters, by their values after its last reset."""
    if unit.stays_stored:
        return f"what the run stored stays in the device: {unit.stays_stored}"
    after = _held(unit)
    for place, data in before.items():
        if after.get(place, data) != data:
            text = f"{where(*place)} is {after[place].hex()} at the end, and was {data.hex()} at the beginning"
            return f"the device has not the parameters with which the run began: {text}"
    how = "with its defaults (1011h:01)" if unit.from_defaults or unit.ever_stored else "with what it held before"
    return f"the device was reset, and ends {how}" + ("" if unit.ever_stored else "; nothing was stored in it")
