"""PDO layouts from an EDS's communication and mapping parameters (CiA 301, sections 7.5.2.35 to 7.5.2.38).

A map is read correctly or refused: a dropped or misread entry would shift every field after it, and
a shifted torque is a wrong torque. Internal times are nanoseconds; 1800h:3 counts 100 us and
1800h:5 counts 1 ms.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Literal

from coulombus.eds.cia301 import DATA_TYPES, DUMMY_TYPES, MAX_FIELDS, predefined
from coulombus.eds.reader import Description, EdsError, Variable

if TYPE_CHECKING:
    from coulombus.kernels.records import Record  # needs numpy

__all__ = [
    "COMMUNICATION",
    "COMMUNICATION_RANGES",
    "MAPPING",
    "MAPPING_RANGES",
    "PDO_BITS",
    "PDO_COUNT",
    "Entry",
    "PdoLayout",
    "entry_of",
    "fill",
    "layouts",
    "read_layout",
    "unreadable",
]

Direction = Literal["rpdo", "tpdo"]

PDO_BITS = 64
COB_ID_INVALID = 1 << 31
COB_ID_NO_RTR = 1 << 30
COB_ID_EXTENDED = 1 << 29
INHIBIT_UNIT_NS = 100_000
EVENT_UNIT_NS = 1_000_000

COMMUNICATION = {"rpdo": 0x1400, "tpdo": 0x1800}
MAPPING = {"rpdo": 0x1600, "tpdo": 0x1A00}
PDO_COUNT = 512
COMMUNICATION_RANGES, MAPPING_RANGES = (
    tuple(range(first, first + PDO_COUNT) for first in parameters.values()) for parameters in (COMMUNICATION, MAPPING)
)
"""Indices of the communication and of the mapping parameters: of RPDOs, of TPDOs."""
REALS = {32: "<f", 64: "<d"}
DIAGRAM_COLUMNS = 110
NAME_COLUMNS = 34


@dataclass(frozen=True)
class Entry:
    """A mapped field; `kind` "real" means an IEEE 754 pattern. Dummy entries have index 0001h to
    0007h.
    """

    index: int
    subindex: int
    bits: int
    signed: bool
    kind: Literal["int", "real"]
    name: str
    unit: str = ""
    """Unit of the number, if the file has one."""

    @property
    def dummy(self) -> bool:
        """Whether the entry is a gap: bits that carry no object."""
        return self.index in DUMMY_TYPES

    def number(self, word: int, start: int) -> int | float:
        """Return the field at bit `start` of a data word: an integer, or an IEEE 754 number."""
        raw = word >> start & (1 << self.bits) - 1
        if self.kind == "real":
            value: float = struct.unpack(REALS[self.bits], raw.to_bytes(self.bits // 8, "little"))[0]
            return value
        return raw - (1 << self.bits) if self.signed and raw >> (self.bits - 1) else raw


@dataclass(frozen=True)
class PdoLayout:
    """A PDO from the device's point of view (it receives an RPDO); `cob_id` is -1 if the PDO is not valid."""

    number: int
    direction: Direction
    cob_id: int
    transmission: int
    inhibit_ns: int
    event_ns: int
    sync_start: int
    rtr_allowed: bool
    entries: tuple[Entry, ...]

    @cached_property
    def length(self) -> int:
        """Number of data bytes; a partly used last byte counts."""
        return (sum(entry.bits for entry in self.entries) + 7) // 8

    @cached_property
    def starts(self) -> tuple[int, ...]:
        """First bit of each entry."""
        return tuple(sum(entry.bits for entry in self.entries[:i]) for i in range(len(self.entries)))

    def diagram(self, columns: int = DIAGRAM_COLUMNS) -> str:
        """Draw the bits in the codec's order, the last byte on the left; split into several blocks if
        they are wider than `columns`.

        ::

            bit  63            48 47                            16 15             0
                +----------------+--------------------------------+----------------+
                | 6077:00        | 6064:00                        | 6041:00        |
                | torque         | position actual value          | statusword     |
                +----------------+--------------------------------+----------------+
        """
        return _diagram(self, columns)


def layouts(description: Description, node_id: int) -> tuple[PdoLayout, ...]:
    """Return every PDO that the EDS describes, RPDOs first.

    Raises
    ------
    EdsError
        A default map or identifier cannot be read safely; nothing is guessed, dropped or shifted.
    """
    return tuple(read_layout(description, node_id, direction, number) for direction, number in _described(description))


def unreadable(description: Description, node_id: int) -> dict[int, str]:
    """Return why a PDO cannot be read safely, by the index of its communication parameter; such a PDO is not
    valid at start.
    """
    reasons = {}
    for direction, number in _described(description):
        try:
            read_layout(description, node_id, direction, number)
        except EdsError as error:
            reasons[COMMUNICATION[direction] + number - 1] = str(error)
    return reasons


def _described(description: Description) -> Iterator[tuple[Direction, int]]:
    directions: tuple[Direction, ...] = ("rpdo", "tpdo")
    for direction in directions:
        for number in range(1, PDO_COUNT + 1):
            if description.has(COMMUNICATION[direction] + number - 1):
                yield direction, number


def read_layout(description: Description, node_id: int, direction: Direction, number: int) -> PdoLayout:
    """Return one PDO; EdsError as in `layouts`.

    Without a default in the EDS: the value of `eds.cia301.predefined`, no timers.
    """
    if not 1 <= node_id <= 127:
        raise ValueError(f"node id {node_id}; expected 1 to 127")
    index = COMMUNICATION[direction] + number - 1
    cob_id = _number(description, index, 1, node_id, predefined(index, 1, node_id)) or 0
    can_id = cob_id & 0x1FFFFFFF
    line = description.variable(index, 1).line if description.has(index, 1) else 1
    valid = not cob_id & COB_ID_INVALID and can_id != 0  # identifier 0 is NMT's: some files write it for "not used"
    if valid and (cob_id & COB_ID_EXTENDED or can_id > 0x7FF):
        text = f"{index:04X}h:1 has the identifier 0x{can_id:X}"
        raise _refuse(description, line, text, "expected 0x001 to 0x7FF, or bit 31 set for a PDO that is not valid")
    return PdoLayout(
        number=number,
        direction=direction,
        cob_id=can_id if valid else -1,
        transmission=_number(description, index, 2, node_id, predefined(index, 2, node_id)) or 0,
        inhibit_ns=(_number(description, index, 3, node_id, 0) or 0) * INHIBIT_UNIT_NS,
        event_ns=(_number(description, index, 5, node_id, 0) or 0) * EVENT_UNIT_NS,
        sync_start=_number(description, index, 6, node_id, 0) or 0,
        rtr_allowed=not cob_id & COB_ID_NO_RTR,
        entries=_entries(description, node_id, direction, number),
    )


def fill(record: Record, layout: PdoLayout, slot_of: Callable[[int, int], int]) -> None:
    """Write a layout into one record of `eds.codec.PDO`.

    `slot_of` returns the slot of (index, sub-index); dummy entries get slot -1 without a call.
    """
    for name in ("cob_id", "transmission", "inhibit_ns", "event_ns", "sync_start", "rtr_allowed", "length"):
        record[name] = getattr(layout, name)
    if len(layout.entries) > MAX_FIELDS:
        raise ValueError(f"{len(layout.entries)} fields in a PDO; at most {MAX_FIELDS} fit into {PDO_BITS} bits")
    record["count"] = len(layout.entries)
    record["slot"] = -1
    for name in ("start", "bits", "signed"):
        record[name] = 0
    if layout.entries:
        slots, starts, bits, signed = (record[name] for name in ("slot", "start", "bits", "signed"))
        for i, (entry, start) in enumerate(zip(layout.entries, layout.starts, strict=True)):
            slots[i] = -1 if entry.dummy else slot_of(entry.index, entry.subindex)
            starts[i], bits[i], signed[i] = start, entry.bits, entry.signed


def entry_of(variable: Variable, bits: int = 0) -> Entry:
    """Return the entry that maps `variable`, in `bits` bits if its data type has no fixed width (0: the
    type's).
    """
    data_type = DATA_TYPES.get(variable.data_type)
    real = data_type is not None and data_type.kind == "real"
    signed = data_type is not None and data_type.signed and not real
    return Entry(
        *(variable.index, variable.subindex, bits or variable.bits, signed, "real" if real else "int"),
        variable.name,
        variable.unit,
    )


def _refuse(description: Description, line: int, text: str, expected: str) -> EdsError:
    return EdsError(f"{description.path}:{line}: {text}; {expected}")


def _number(description: Description, index: int, subindex: int, node_id: int, assumed: int | None) -> int | None:
    """Return a parameter's default, or `assumed` if the EDS gives none."""
    if not description.has(index, subindex):
        return assumed
    variable = description.variable(index, subindex)
    if variable.unreadable:
        raise _refuse(description, variable.line, variable.unreadable, "correct it, a PDO parameter is never guessed")
    value = description.default(index, subindex, node_id)
    if value is None:
        return assumed
    if not isinstance(value, int):
        text = f"{index:04X}h:{subindex} has the default {value!r}"
        raise _refuse(description, variable.line, text, "expected an unsigned number")
    return value


def _entries(description: Description, node_id: int, direction: Direction, number: int) -> tuple[Entry, ...]:
    index = MAPPING[direction] + number - 1
    if not description.has(index):
        return ()
    mapping = description.objects[index]
    words = {sub: _number(description, index, sub, node_id, None) for sub in mapping.variables if 0 < sub <= MAX_FIELDS}
    count = _number(description, index, 0, node_id, None)
    line = next(iter(mapping.variables.values())).line if mapping.variables else 1
    if count is None:
        if any(words.values()):
            text = f"{index:04X}h:0 has no default, yet entries are mapped"
            raise _refuse(description, line, text, "expected the number of mapped entries")
        count = 0
    if count > MAX_FIELDS:
        raise _refuse(description, line, f"{index:04X}h:0 is {count}", "expected 0 to 64 entries (no multiplexed PDO)")
    entries = []
    for subindex in range(1, count + 1):
        word = words.get(subindex)
        if not word:
            text = f"{index:04X}h:0 says {count} entries, but entry {subindex} has no default"
            raise _refuse(description, line, text, "expected an object to map")
        entries.append(_entry(description, word, mapping.variables[subindex]))
    used = sum(entry.bits for entry in entries)
    if used > PDO_BITS:
        raise _refuse(description, line, f"{index:04X}h maps {used} bits", "at most 64 fit into a PDO")
    return tuple(entries)


def _entry(description: Description, word: int, place: Variable) -> Entry:
    index, subindex, bits = word >> 16, word >> 8 & 0xFF, word & 0xFF
    what = f"{place.index:04X}h:{place.subindex} maps {index:04X}h:{subindex} in {bits} bits"
    if not 1 <= bits <= PDO_BITS:
        raise _refuse(description, place.line, what, "expected 1 to 64 bits")
    if index in DUMMY_TYPES:
        _check_width(description, place, what, index, bits)
        return Entry(index, subindex, bits, DATA_TYPES[index].signed, "int", "dummy")
    if not description.has(index, subindex):
        raise _refuse(description, place.line, f"{what}, which the file does not describe", "describe it or unmap it")
    variable = description.variable(index, subindex)
    if variable.data_type not in DATA_TYPES:
        raise _refuse(description, place.line, f"{what}, whose DataType is not known", "give its DataType")
    _check_width(description, place, what, variable.data_type, bits)
    return entry_of(variable, bits)


def _check_width(description: Description, place: Variable, what: str, code: int, bits: int) -> None:
    data_type = DATA_TYPES[code]
    whole_byte = data_type.kind == "bool" and bits == 8  # some devices send a BOOLEAN as a byte: the value is the same
    if data_type.bits not in (0, bits) and not whole_byte:
        text = f"{what}, but {data_type.name} has {data_type.bits}"
        raise _refuse(description, place.line, text, "expected the same width in the map and in the object")


def _diagram(pdo: PdoLayout, columns: int) -> str:
    if not pdo.entries:
        return "(nothing is mapped)"
    blocks: list[list[str]] = []
    for entry, start in reversed(list(zip(pdo.entries, pdo.starts, strict=True))):
        label = "-" if entry.dummy else f"{entry.index:04X}:{entry.subindex:02X}"
        last, first = str(start + entry.bits - 1), str(start) if entry.bits > 1 else ""
        name = entry.name[:NAME_COLUMNS]
        width = max(min(entry.bits, 32), len(label) + 2, len(last) + len(first) + 1, len(name) + 2)
        if not blocks or len(blocks[-1][0]) + width >= columns - 1:
            blocks.append(["bit  ", "    ", "    ", "    "])
        block = blocks[-1]
        block[0] += last + first.rjust(width - len(last)) + " "
        block[1] += "+" + "-" * width
        block[2] += "|" + f" {label}".ljust(width)
        block[3] += "|" + f" {name}".ljust(width)
    return "\n".join(
        line.rstrip()
        for bits, rule, label, name in blocks
        for line in (bits, rule + "+", label + "|", name + "|", rule + "+")
    )
