"""Full check of an EDS file: the reader's diagnoses, and the consistency of its PDOs.

The reader looks at one object at a time. This module compares the PDO parameters with each other
and with the objects that they map (CiA 301, sections 7.5.2.35 to 7.5.2.38). A PDO with an
ambiguous or impossible layout is refused, with the reason: it is not valid at start.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from coulombus.eds.cia301 import CobId, predefined, restricted
from coulombus.eds.description import Description, Diagnosis, EdsError
from coulombus.eds.pdo import COB_ID_INVALID, COMMUNICATION, MAPPING, PDO_COUNT, Direction, PdoLayout, read_layout

__all__ = ["EdsReport", "check"]

MANDATORY = (0x1000, 0x1001, 0x1018)
NOT_READABLE, NOT_WRITABLE = ("wo", "rww"), ("ro", "const", "rwr")
_KEYWORD = {"rpdo": "RPDO", "tpdo": "TPDO"}
SDO = 0x1200
SERVICES = {
    (0x1005, 0): "SYNC",
    (0x1012, 0): "TIME",
    (0x1014, 0): "EMCY",
    (SDO, 1): "an SDO request",
    (SDO, 2): "its response",
}


@dataclass(frozen=True)
class EdsReport:
    """Defects of a file. `refusals` lists PDOs without a safe reading, each as
    ``file:line: what; what to do``.

    Such a PDO is not valid when the device starts; everything else of the file can be used.
    """

    description: Description
    diagnoses: tuple[Diagnosis, ...]
    refusals: tuple[str, ...]
    pdos: tuple[PdoLayout, ...]


def check(description: Description, node_id: int = 1) -> EdsReport:
    """Check the file's PDOs against its objects; the identifiers are those of the node `node_id`."""
    diagnoses = list(description.diagnoses)
    for index in MANDATORY:
        if not description.has(index):
            text = f"{index:04X}h is not described, which every CANopen device has"
            diagnoses.append(Diagnosis(description.path, 1, "warning", text, "a device without it"))
    diagnoses += _identifiers(description, node_id)
    refusals: list[str] = []
    pdos: list[PdoLayout] = []
    directions: tuple[Direction, ...] = ("rpdo", "tpdo")
    for direction in directions:
        for number in range(1, PDO_COUNT + 1):
            diagnoses += _parameters(description, direction, number)
            if not description.has(COMMUNICATION[direction] + number - 1):
                continue
            try:
                pdo = read_layout(description, node_id, direction, number)
            except EdsError as error:
                refusals.append(str(error))
                continue
            pdos.append(pdo)
            diagnoses += _identifier(description, pdo, node_id, pdos[:-1])
            diagnoses += _mapped(description, pdo)
    diagnoses.sort(key=lambda diagnosis: diagnosis.line)
    return EdsReport(description, tuple(diagnoses), tuple(refusals), tuple(pdos))


def _warn(description: Description, index: int, subindex: int, text: str, assumed: str) -> Diagnosis:
    """Return a warning at the line of an object, or of the nearest existing line."""
    entry = description.objects[index]
    variable = entry.variables.get(subindex) or next(iter(entry.variables.values()), None)
    return Diagnosis(description.path, variable.line if variable else 1, "warning", text, assumed)


def _identifiers(description: Description, node_id: int) -> Iterator[Diagnosis]:
    """Check the identifiers of the services against the pre-defined connection set."""
    for (index, subindex), what in SERVICES.items():
        if not description.has(index, subindex):
            continue
        first, name = predefined(index, subindex, 0), f"{index:04X}h:{subindex}"
        usual = f"$NODEID+0x{first:X}" if predefined(index, subindex, 1) != first else f"0x{first:X}"
        if _undefined(description, index, subindex):
            yield _warn(description, index, subindex, f"{name} has no default", usual)
        value = description.default(index, subindex, node_id)
        if isinstance(value, int) and not value & 0x7FF:
            yield _warn(description, index, subindex, f"{name} is 0x{value:X}, the identifier of NMT", f"no {what}")
        elif isinstance(value, int) and index == 0x1014 and value & 0x1FFFFFFF == CobId.SYNC:
            text = f"{name} is 0x{value:X}, the identifier of SYNC: a host cannot tell whose fault it is"
            yield _warn(description, index, subindex, text, usual)
        elif isinstance(value, int) and index == 0x1014 and value & COB_ID_INVALID:
            yield _warn(description, index, subindex, f"{name} is 0x{value:X}: bit 31 switches EMCY off", "no EMCY")
        elif index == SDO and isinstance(value, int) and value != predefined(index, subindex, node_id):
            text = f"{name} is 0x{value:X} for node {node_id}, not {usual} as CiA 301 has {what}"
            yield _warn(description, index, subindex, text, "that identifier")


def _parameters(description: Description, direction: Direction, number: int) -> Iterator[Diagnosis]:
    """Report which of a PDO's two objects, or which of their defaults, is missing."""
    parameter, mapping = COMMUNICATION[direction] + number - 1, MAPPING[direction] + number - 1
    name = f"{_KEYWORD[direction]}{number}"
    if description.has(mapping) and not description.has(parameter):
        text = f"{mapping:04X}h is the map of {name}, which has no {parameter:04X}h"
        yield _warn(description, mapping, 0, text, f"no {name}")
    if not description.has(parameter):
        return
    if not description.has(mapping):
        yield _warn(description, parameter, 0, f"{name} has no {mapping:04X}h", "nothing is mapped")
    if not description.has(parameter, 1) or _undefined(description, parameter, 1):
        first = predefined(parameter, 1, 0)
        assumed = "a PDO that is not valid" if first == COB_ID_INVALID else f"$NODEID+0x{first:X}"
        yield _warn(description, parameter, 1, f"{parameter:04X}h:1 has no default", assumed)
    if not description.has(parameter, 2) or _undefined(description, parameter, 2):
        yield _warn(description, parameter, 2, f"{parameter:04X}h:2 has no default", "transmission type 255")


def _undefined(description: Description, index: int, subindex: int) -> bool:
    variable = description.variable(index, subindex)
    return variable.default is None and not variable.unreadable


def _identifier(description: Description, pdo: PdoLayout, node_id: int, others: list[PdoLayout]) -> Iterator[Diagnosis]:
    """Report doubtful identifiers of a PDO."""
    index = COMMUNICATION[pdo.direction] + pdo.number - 1
    if not description.has(index, 1):
        return
    default = description.default(index, 1, node_id)
    what = f"{index:04X}h:1"
    if default == 0:
        yield _warn(description, index, 1, f"{what} is 0, the identifier of NMT", "a PDO that is not valid")
    if pdo.cob_id < 0:
        return
    if restricted(pdo.cob_id):
        text = f"{what} is 0x{pdo.cob_id:X} for node {node_id}, which CiA 301 keeps for other services"
        yield _warn(description, index, 1, text, "that identifier")
    twin = next((o for o in others if o.cob_id == pdo.cob_id and "tpdo" in (o.direction, pdo.direction)), None)
    if twin is not None:
        other = COMMUNICATION[twin.direction] + twin.number - 1
        text = f"{what} is 0x{pdo.cob_id:X} for node {node_id}, and so is {other:04X}h:1"
        yield _warn(description, index, 1, text, "both")


def _mapped(description: Description, pdo: PdoLayout) -> Iterator[Diagnosis]:
    """Report mapped objects that the file declares as not mappable."""
    mapping = MAPPING[pdo.direction] + pdo.number - 1
    if description.has(mapping, 0) and _undefined(description, mapping, 0):
        yield _warn(description, mapping, 0, f"{mapping:04X}h:0 has no default", "nothing is mapped")
    for subindex, entry in enumerate(pdo.entries, 1):
        what = f"{mapping:04X}h:{subindex} maps {entry.index:04X}h:{entry.subindex}"
        if entry.dummy:
            if entry.index not in description.dummies:
                text = f"{what}, which [DummyUsage] does not allow"
                yield _warn(description, mapping, subindex, text, "a gap")
            continue
        variable = description.variable(entry.index, entry.subindex)
        refused = NOT_WRITABLE if pdo.direction == "rpdo" else NOT_READABLE
        if not variable.pdo_mappable:
            yield _warn(description, mapping, subindex, f"{what}, which has no PDOMapping=1", "that it is mapped")
        if variable.access in refused:
            text = f"{what}, whose AccessType is {variable.access}"
            yield _warn(description, mapping, subindex, text, "that it is mapped")
