"""The PDOs that a device's EDS file allows: identifier, transmission type, event timer, mapping.

Identifiers are those of the pre-defined connection set for the first four PDOs of each direction,
if the device lets them be set, else the device's own. A further axis of a drive takes its own PDOs, if the file has any
(65 to 68 for the second, or those whose default maps hold its objects). If such a PDO has no identifier, it takes that
of PDO 1 to 4, because bring-up makes the first axis' PDOs invalid. A TPDO follows SYNC (transmission type 1) if it can;
otherwise the device's event timer sends it.

A device can map objects although its EDS file denies it. The rig file acknowledges each of them in ``host.accept``; the
device's answer at bring-up decides.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import count

from coulombus.eds.cia301 import CobId
from coulombus.eds.drive_axis import axis_of, pdo_numbers
from coulombus.eds.pdo import COMMUNICATION, MAPPING, PDO_COUNT, Entry, read_layout
from coulombus.eds.reader import Description, EdsError, Variable
from coulombus.rigs.signals import Direction, Node

__all__ = ["ON_SYNC", "PdoParameters", "mapping_sentence", "records_of", "with_accepted", "writable"]


FIRST = {"rpdo": CobId.RPDO1, "tpdo": CobId.TPDO1}
PREDEFINED = 4
ON_SYNC, ON_EVENT = 1, 255
INVALID, NO_RTR = 1 << 31, 1 << 30


def writable(variable: Variable) -> bool:
    """Return whether an object can be written by SDO."""
    return variable.access not in ("ro", "const")


@dataclass(frozen=True)
class PdoParameters:
    """Settings that an EDS file allows for a PDO.

    Attributes
    ----------
    identifier : 11 bits
    room : number of entries for a new map; 0: fixed map
    settable : its identifier can be written, so that it can be invalid while it is remapped
    entries : its default map; empty if absent or unreadable
    transmission : its future transmission type
    event_ns : future event timer of a TPDO that does not follow SYNC; 0: none
    deadline : an RPDO's deadline can be set (1400h:05)
    """

    direction: Direction
    number: int
    identifier: int
    room: int
    settable: bool
    entries: tuple[Entry, ...]
    transmission: int
    event_ns: int
    no_rtr: bool
    deadline: bool


def records_of(
    description: Description,
    node_id: int,
    direction: Direction,
    period_ns: int,
    transmission: int,
    drive_axis: int = 1,
) -> tuple[PdoParameters, ...]:
    """Return the usable PDOs of a device, cached per EDS file.

    Parameters
    ----------
    transmission : requested type, used if possible
    drive_axis : number of the drive's axis
    """
    cache = description.derived.setdefault(records_of, {})
    key = node_id, direction, period_ns, transmission, drive_axis
    if key not in cache:
        cache[key] = tuple(_records_of(description, *key))
    records: tuple[PdoParameters, ...] = cache[key]
    return records


def _records_of(
    description: Description, node_id: int, direction: Direction, period_ns: int, preferred: int, drive_axis: int
) -> Iterator[PdoParameters]:
    first = COMMUNICATION[direction]
    indices = sorted(index for index in description.objects if first <= index < first + PDO_COUNT)
    of_axis = [index for index in indices if _belongs(description, node_id, direction, index - first + 1, drive_axis)]
    taken: set[int] = set()
    for place, index in enumerate(of_axis or indices):
        number, mapping = index - first + 1, index - first + MAPPING[direction]
        if not (description.has(index, 1) and description.has(mapping, 0)):
            continue
        identity = description.variable(index, 1)
        default = description.default(index, 1, node_id)
        word = default if isinstance(default, int) else 0
        identifier = word & 0x1FFFFFFF
        if writable(identity):
            if number <= PREDEFINED:
                identifier = FIRST[direction] + 0x100 * (number - 1) + node_id
            elif of_axis and not identifier and place < PREDEFINED and not _keeps(description, first + place):
                identifier = FIRST[direction] + 0x100 * place + node_id
        elif word & INVALID:
            continue
        if not 0 < identifier <= 0x7FF or (of_axis and identifier in taken):
            continue
        transmission = _transmission(description, index, preferred, direction)
        if transmission is None:
            continue
        taken.add(identifier)
        event_ns = _event_ns(description, index, node_id, period_ns) if direction == "tpdo" else 0
        yield PdoParameters(
            direction,
            number,
            identifier,
            _room(description, mapping),
            writable(identity),
            _default_map(description, node_id, direction, number),
            transmission,
            event_ns if transmission != ON_SYNC else 0,
            bool(word & NO_RTR),
            direction == "rpdo" and description.has(index, 5),
        )


def _belongs(description: Description, node_id: int, direction: Direction, number: int, drive_axis: int) -> bool:
    """Return whether a PDO belongs to a further axis of a drive, by its number or its map."""
    return drive_axis > 1 and (
        number in pdo_numbers(drive_axis)
        or any(axis_of(entry.index) == drive_axis for entry in _default_map(description, node_id, direction, number))
    )


def _keeps(description: Description, index: int) -> bool:
    """Return whether a PDO keeps its identifier because it cannot be made invalid."""
    return description.has(index, 1) and not writable(description.variable(index, 1))


def _transmission(description: Description, index: int, preferred: int, direction: Direction) -> int | None:
    """Return the future transmission type of a PDO; None if it is sent on request only."""
    if not description.has(index, 2):
        return 255
    variable = description.variable(index, 2)
    if writable(variable):
        choices = (
            (preferred, ON_EVENT, ON_EVENT - 1) if direction == "tpdo" else (preferred, ON_EVENT, ON_EVENT - 1, ON_SYNC)
        )
        return next((kind for kind in choices if variable.admits(kind)), None)
    kind = variable.default if isinstance(variable.default, int) else ON_EVENT
    return None if kind in (252, 253) else kind


def _event_ns(description: Description, index: int, node_id: int, period_ns: int) -> int:
    """Return the event timer of a TPDO that does not follow SYNC: the cycle in whole milliseconds, or the device's own."""
    if not description.has(index, 5):
        return 0
    variable = description.variable(index, 5)
    if writable(variable):
        milliseconds = max(1, period_ns // 1_000_000)
        return milliseconds * 1_000_000 if variable.admits(milliseconds) else 0
    return variable.default * 1_000_000 if isinstance(variable.default, int) else 0


def _room(description: Description, mapping: int) -> int:
    """Return the number of entries for a new map of the PDO; 0 if its map is fixed."""
    variables = description.objects[mapping].variables
    if not writable(variables[0]):
        return 0
    return next(sub - 1 for sub in count(1) if sub not in variables or not writable(variables[sub]))


def _default_map(description: Description, node_id: int, direction: Direction, number: int) -> tuple[Entry, ...]:
    try:
        return read_layout(description, node_id, direction, number).entries
    except EdsError:
        return ()


SENTENCE = re.compile(r"(?P<node>[\w.]+): (?P<index>[0-9A-F]{4})h(?::(?P<sub>[0-9A-F]{1,2}))? can be mapped")


def mapping_sentence(name: str, index: int, subindex: int) -> str:
    """Return the sentence of ``host.accept`` that acknowledges a mapping; `name` is the device's."""
    place = f"{index:04X}h:{subindex:X}" if subindex else f"{index:04X}h"
    return f"{name}: {place} can be mapped"


def with_accepted(description: Description, name: Node, sentences: Iterable[str]) -> Description:
    """Return the EDS file of a device with PDOMapping=1 for the objects that `sentences` name."""
    objects = dict(description.objects)
    for sentence in sentences:
        match = SENTENCE.fullmatch(sentence)
        if match is None or match["node"] != name:
            continue
        index, subindex = int(match["index"], 16), int(match["sub"] or "0", 16)
        if not description.has(index, subindex):
            continue
        entry = objects[index]
        variable = replace(entry.variables[subindex], pdo_mappable=True)
        objects[index] = replace(entry, variables={**entry.variables, subindex: variable})
    return description if objects == description.objects else replace(description, objects=objects)
