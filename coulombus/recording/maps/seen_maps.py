"""Meaning of a PDO's bytes: by observed SDO configuration, an EDS file, a rig, or the default maps of CiA 402 and 404."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

from coulombus.eds.cia301 import predefined
from coulombus.eds.description import Description, EdsError
from coulombus.eds.eds_folder import fitting
from coulombus.eds.pdo import COMMUNICATION, MAPPING, PDO_COUNT, PdoLayout, read_layout
from coulombus.rigs.rig import Rig

__all__ = ["SEEN", "Field", "Map", "MappedNode", "Objects", "identified", "maps_of", "maps_of_rig"]

SEEN = "SDO seen in the log"
"""Source of a map that SDO transfers of the log have."""
RANKS = ("assumed", "rig", "EDS", SEEN)
"""Sources of a map, the best last."""
PDOS = 8
"""PDOs of a node without an EDS file."""
Maps: TypeAlias = Mapping[str, Mapping[int, tuple[int, ...]]]
DEFAULTS_402: Maps = {
    "rpdo": {1: (0x60400010,), 2: (0x60400010, 0x60600008), 3: (0x60400010, 0x607A0020), 4: (0x60400010, 0x60FF0020)},
    "tpdo": {1: (0x60410010,), 2: (0x60410010, 0x60610008), 3: (0x60410010, 0x60640020), 4: (0x60410010, 0x606C0020)},
}
"""CiA 402-3's generic maps of the first PDOs, for a drive with unknown maps."""
DEFAULTS_404: Maps = {
    "rpdo": {},
    "tpdo": {1: (0x91300120, 0x61500108)} | {number: (0x91300020 | number << 8,) for number in (2, 3, 4)},
}
"""Generic maps of a measuring device (CiA 404): the process values of its channels, the first with its status."""
DEFAULTS: Mapping[int, Maps] = {402: DEFAULTS_402, 404: DEFAULTS_404}
"""Default maps by the profile, the low half of the device type (1000h)."""


Objects: TypeAlias = dict[tuple[int, int], int]
"""Values of a node's objects by (index, sub-index), from SDO transfers."""


@dataclass
class MappedNode:
    """The data that determine a node's PDO maps."""

    number: int
    objects: Objects = field(default_factory=dict, kw_only=True)
    device_type: int = field(default=0, kw_only=True)
    """Object 1000h; 0: unknown."""

    @property
    def identity(self) -> tuple[int, int]:
        """Vendor id and product code (1018h:01, :02); 0 if unknown."""
        return self.objects.get((0x1018, 1), 0), self.objects.get((0x1018, 2), 0)

    @property
    def revision(self) -> int:
        """Revision number (1018h:03); 0 if unknown."""
        return self.objects.get((0x1018, 3), 0)


@dataclass(frozen=True)
class Field:
    """An object in a PDO."""

    index: int
    subindex: int
    start: int
    bits: int


@dataclass(frozen=True)
class Map:
    """A PDO: its node, number and fields.

    `source` is "SDO seen in the log", "EDS", "rig" or "assumed"; `transmission` is None if the type is
    unknown; `event_ns` and `inhibit_ns` are 0 if event timer or inhibit time
    is unknown.
    """

    can_id: int
    node: int
    direction: str
    number: int
    fields: tuple[Field, ...]
    source: str
    transmission: int | None = None
    event_ns: int = 0
    inhibit_ns: int = 0

    @property
    def synchronous(self) -> bool | None:
        """Whether it follows SYNC; None: unknown."""
        return None if self.transmission is None else self.transmission <= 240

    @property
    def each_sync(self) -> bool | None:
        """Whether it follows each SYNC; None: unknown, or it comes after some of them (types 0 and 2 to 240)."""
        return None if self.synchronous and self.transmission != 1 else self.synchronous

    @property
    def name(self) -> str:
        """Its usual name, as TPDO1."""
        return f"{self.direction.upper()}{self.number}"

    @property
    def length(self) -> int:
        """Data bytes; 0 if its fields are unknown."""
        return (sum(mapped.bits for mapped in self.fields) + 7) // 8

    def find(self, low: int) -> Iterator[tuple[int, Field]]:
        """Yield (axis from 0, field) of an object of CiA 402 by its distance from 6000h."""
        for mapped in self.fields:
            if 0x6000 <= mapped.index < 0xA000 and (mapped.index - 0x6000) % 0x800 == low:
                yield (mapped.index - 0x6000) // 0x800, mapped


def identified(
    nodes: Mapping[int, MappedNode], descriptions: Mapping[int, Description], candidates: tuple[Description, ...]
) -> dict[int, Description]:
    """Return the candidate of each node that has no EDS file yet and whose identity (1018h) one fits."""
    fits = {
        node.number: fitting(candidates, node.identity, node.revision)
        for node in nodes.values()
        if node.number not in descriptions and any(node.identity)
    }
    return {number: description for number, description in fits.items() if description is not None}


def maps_of_rig(rig: Rig) -> dict[int, Map]:
    """Return the maps of a rig by identifier."""
    maps = {}
    for pdo in rig.pdos():
        layout = pdo.layout
        fields = _fields_of(layout)
        maps[layout.cob_id] = Map(
            layout.cob_id,
            pdo.node_id,
            layout.direction,
            layout.number,
            fields,
            "rig",
            transmission=layout.transmission,
            event_ns=layout.event_ns if layout.direction == "tpdo" else 0,
            inhibit_ns=layout.inhibit_ns if layout.direction == "tpdo" else 0,
        )
    return maps


def maps_of(
    nodes: Mapping[int, MappedNode], descriptions: Mapping[int, Description], fixed: Mapping[int, Map]
) -> dict[int, Map]:
    """Return the maps of a bus by identifier; SDO configuration takes precedence over EDS, rig and defaults.

    Of two maps with one identifier, that of the better source counts, then that of the sender (a
    TPDO), then that of the lower node id and number.
    """
    maps: dict[int, Map] = dict(fixed)
    for number in sorted(nodes):
        node, description = nodes[number], descriptions.get(number)
        for direction in ("rpdo", "tpdo"):
            for pdo in _numbers(node, description, direction):
                pdo_map = _map(node, description, direction, pdo)
                if pdo_map is None:
                    continue
                if pdo_map.source != "assumed":
                    for can_id in [c for c, m in maps.items() if _same(m, pdo_map) and c != pdo_map.can_id]:
                        del maps[can_id]
                if pdo_map.can_id > 0 and (pdo_map.can_id not in maps or _rank(pdo_map) > _rank(maps[pdo_map.can_id])):
                    maps[pdo_map.can_id] = pdo_map
    return maps


def _numbers(node: MappedNode, description: Description | None, direction: str) -> list[int]:
    """Return the numbers of the PDOs that a node may have: the first eight, those of its EDS file, those seen."""
    first = COMMUNICATION[direction]
    described: list[int] = []
    if description is not None:
        key = ("pdo numbers", direction)
        if key not in description.derived:
            description.derived[key] = [n for n in range(1, PDO_COUNT + 1) if description.has(first + n - 1)]
        described = description.derived[key]
    seen = {index - first + 1 for index, _ in node.objects if first <= index < first + PDO_COUNT}
    return sorted({*range(1, PDOS + 1), *described, *seen})


def _rank(pdo_map: Map) -> tuple[bool, int, bool]:
    return bool(pdo_map.fields), RANKS.index(pdo_map.source), pdo_map.direction == "tpdo"


def _same(first: Map, second: Map) -> bool:
    return (first.node, first.direction, first.number) == (second.node, second.direction, second.number)


def _map(node: MappedNode, description: Description | None, direction: str, number: int) -> Map | None:
    communication, mapping = COMMUNICATION[direction] + number - 1, MAPPING[direction] + number - 1
    objects = node.objects
    cob_id = objects.get((communication, 1))
    transmission = objects.get((communication, 2))
    sends = direction == "tpdo"
    event_ns = objects.get((communication, 5), 0) * 1_000_000 if sends else 0
    inhibit_ns = objects.get((communication, 3), 0) * 100_000 if sends else 0
    fields: tuple[Field, ...] = ()
    source = SEEN
    count = objects.get((mapping, 0))
    words = [objects.get((mapping, sub)) for sub in range(1, (count or 0) + 1)] if (count or 0) <= 64 else []
    seen = [word for word in words if word is not None]
    if count and len(seen) == count:
        fields = _fields(seen)
    if not fields and description is not None:
        source = "EDS"
        try:
            layout = read_layout(description, node.number, "rpdo" if direction == "rpdo" else "tpdo", number)
        except (EdsError, KeyError):
            layout = None
        if layout is not None and description.has(communication):
            fields = () if count == 0 else _fields_of(layout)  # seen to be emptied
            cob_id = (layout.cob_id if layout.cob_id >= 0 else 1 << 31) if cob_id is None else cob_id
            transmission = layout.transmission if transmission is None else transmission
            if sends and (communication, 5) not in objects:
                event_ns = layout.event_ns
            if sends and (communication, 3) not in objects:
                inhibit_ns = layout.inhibit_ns
    usual = DEFAULTS.get(node.device_type & 0xFFFF, {}).get(direction, {})
    if description is not None and description.has(communication):
        usual = {}  # the file describes the PDO: nothing is assumed of it, be its map empty or unreadable
    if not fields and number in usual and count is None:
        fields, source = _fields(list(usual[number])), "assumed"
    if not fields and cob_id is None and not any((communication, sub) in objects for sub in (2, 3, 5)):
        return None
    if cob_id is None:
        cob_id = predefined(communication, 1, node.number) or 1 << 31
    can_id = -1 if cob_id & 1 << 31 else cob_id & 0x7FF
    return Map(can_id, node.number, direction, number, fields, source, transmission, event_ns, inhibit_ns)


def _fields_of(layout: PdoLayout) -> tuple[Field, ...]:
    return tuple(
        Field(entry.index, entry.subindex, start, entry.bits)
        for entry, start in zip(layout.entries, layout.starts, strict=True)
    )


def _fields(words: list[int]) -> tuple[Field, ...]:
    fields, start = [], 0
    for word in words:
        bits = word & 0xFF
        fields.append(Field(word >> 16 & 0xFFFF, word >> 8 & 0xFF, start, bits))
        start += bits
    return tuple(fields)
