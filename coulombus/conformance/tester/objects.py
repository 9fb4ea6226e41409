"""Choose objects of the EDS for the cases: harmless to write, long, or free to differ from the default."""

from __future__ import annotations

from coulombus.conformance.tester.unit import Unit
from coulombus.conformance.tester.verdict import NotApplicable, TransferAborted
from coulombus.eds.cia301 import Abort
from coulombus.eds.data import READ_ONLY, is_output
from coulombus.eds.reader import Variable

__all__ = [
    "ABSENT_NOW",
    "LONGEST",
    "NOT_NOW",
    "OTHER_ID",
    "READ_ONLY",
    "REFUSED",
    "is_command",
    "is_output",
    "is_parameter",
    "keeps",
    "long_object",
    "long_objects",
    "long_texts",
    "volatile",
]

LONGEST = 2000
"""Objects of more bytes (a whole EDS as 1021h) would take seconds by segments.

Their transfers are only begun.
"""

REFUSED = (
    *(Abort.VALUE, Abort.VALUE_HIGH, Abort.VALUE_LOW, Abort.ACCESS, Abort.READ_ONLY, Abort.GENERAL),
    *(Abort.PARAMETER_INCOMPATIBLE, Abort.INTERNAL_INCOMPATIBLE),
    *(Abort.CANNOT_STORE, Abort.LOCAL_CONTROL, Abort.DEVICE_STATE),
)
"""Abort codes for a value that is invalid, or invalid now: CiA 301 leaves the choice if it names no code."""

NOT_NOW = (Abort.CANNOT_STORE, Abort.LOCAL_CONTROL, Abort.DEVICE_STATE, Abort.NO_DATA)
"""Abort codes of an access that the present state does not allow."""

ABSENT_NOW = (Abort.NO_DATA, Abort.NO_SUBINDEX)
"""Abort codes for an entry of a list that is empty now."""

OTHER_ID = 0x6DA
"""Identifier outside the pre-defined connection set, and not restricted."""

_COMMANDS = (0x1003, 0x1010, 0x1011, 0x1023, 0x1F50, 0x1F51, 0x1F80)
"""Objects whose write is a command; only the cases that test them write them."""

_TEXTS = (0x0009, 0x000B)

_CHANGING = (0x1001, 0x1002, 0x1003, 0x1010, 0x1011, 0x1013, 0x1020, 0x1023, 0x1024, 0x1025, 0x1026)


def is_command(variable: Variable) -> bool:
    """Return whether a write is a command rather than a parameter."""
    return variable.index in _COMMANDS or 0x1600 <= variable.index < 0x1800 or 0x1A00 <= variable.index < 0x1C00


def is_parameter(variable: Variable) -> bool:
    """Return whether the object must have its default after a reset: not a process value, counter or serial number."""
    process = variable.index >= 0x2000 and variable.access == "ro"
    serial = variable.index == 0x1018 and variable.subindex == 4
    return variable.index >= 0x1000 and variable.index not in _CHANGING and not process and not serial


def keeps(variable: Variable) -> bool:
    """Return whether the variable may be written with its own value at any time."""
    fixed = 0x1800 <= variable.index < 0x1A00 and variable.subindex in (3, 6)  # while the PDO is valid
    fixed |= variable.index == 0x1019  # while 1006h runs
    return variable.access in ("rw", "rwr", "rww") and not is_command(variable) and not fixed


def volatile(unit: Unit) -> tuple[int, int, int]:
    """Return (index, sub-index, value) of a communication parameter that can be changed without
    side effects, and another value.
    """
    for index, subindex, value in ((0x1017, 0, 2500), (0x1015, 0, 250), (0x100C, 0, 250), (0x1029, 1, 1)):
        if unit.has(index, subindex) and unit.variable(index, subindex).access == "rw":
            return index, subindex, value
    raise NotApplicable("the EDS has no harmless communication parameter that can be written")


def long_objects(unit: Unit) -> list[tuple[Variable, bytes]]:
    """Return the objects with more than four bytes (and at most `LONGEST`), with their content."""
    objects, aborted = [], []
    for variable in unit.variables():
        if variable.access == "wo" or 0 < variable.bits <= 32:
            continue
        try:
            content = unit.sdo.upload_up_to(variable.index, variable.subindex, LONGEST)
        except TransferAborted as abort:
            aborted.append(abort)
            continue
        if content is not None and len(content) > 4:
            objects.append((variable, content))
    if not objects and any(abort.code not in NOT_NOW for abort in aborted):
        raise next(abort for abort in aborted if abort.code not in NOT_NOW)
    if not objects:
        raise NotApplicable("the device has no object of more than four bytes")
    return objects


def long_object(unit: Unit, at_least: int = 5) -> tuple[Variable, bytes]:
    """Return the shortest constant object of at least this size: a constant or a text, else an
    object with two equal readings.
    """
    objects = [pair for pair in long_objects(unit) if len(pair[1]) >= at_least]
    still = [pair for pair in objects if pair[0].access == "const" or pair[0].data_type in _TEXTS]
    still = still or [pair for pair in objects if unit.read(pair[0].index, pair[0].subindex) == pair[1]]
    if not still:
        raise NotApplicable(f"the device has no object of {at_least} bytes that holds still")
    return min(still, key=lambda pair: len(pair[1]))


def long_texts(unit: Unit) -> list[Variable]:
    """Return the writable strings of the manufacturer."""
    variables = [v for v in unit.variables(0x2000) if v.access == "rw" and v.data_type in (0x0009, 0x000A)]
    if not variables:
        raise NotApplicable("the EDS has no writable string from 2000h on")
    return variables
