"""The PDO maps of a log without a rig, learned while it is read."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from coulombus.eds.cia301 import DUMMY_TYPES, PDO_NAMES, CobId
from coulombus.eds.description import Description
from coulombus.eds.eds_folder import EdsFiles
from coulombus.eds.own_devices import is_another
from coulombus.eds.pdo import PDO_BITS, Entry, PdoLayout, entry_of
from coulombus.eds.sdo_channel import SdoChannel
from coulombus.eds.sdo_frames import where
from coulombus.kernels.records import Records
from coulombus.recording.maps.seen_maps import Field, Map, MappedNode, Objects, identified, maps_of
from coulombus.rigs.rig import Rig
from coulombus.rigs.signals import RigPdo, Signal
from coulombus.wire.can_flags import CAN_EFF_FLAG, CAN_ERR_FLAG, CAN_RTR_FLAG
from coulombus.wire.data_word import data_bytes

__all__ = ["LEARNED", "LogMaps", "pdo_without_map"]

LEARNED = 4096
"""Frames per step of learning PDO maps."""

Integers = npt.NDArray[np.int64]
SDO_TX, SDO_RX, HEARTBEAT = int(CobId.SDO_TX), int(CobId.SDO_RX), int(CobId.HEARTBEAT)
SIGNED_402 = frozenset(
    {
        *(0x42, 0x43, 0x44, 0x60, 0x61, 0x62, 0x63, 0x64, 0x6B, 0x6C, 0x71, 0x74, 0x77, 0x78, 0x7A, 0x7C),
        *(0xB0, 0xB1, 0xB2, 0xF4, 0xFF),
    }
)
"""Signed objects of CiA 402, by their distance from 6000h (each axis 800h further)."""


class LogMaps:
    """Learns PDO maps from SDO configuration, EDS files and the profiles' defaults (`seen_maps`).

    Parameters
    ----------
    eds
        EDS files of nodes, or files to be matched by identity.
    """

    def __init__(self, eds: EdsFiles | None = None) -> None:
        files = eds or EdsFiles()
        self._descriptions, self._candidates = dict(files.of_nodes), files.candidates
        self._nodes: dict[int, MappedNode] = {}
        self._channels: dict[int, SdoChannel] = defaultdict(lambda: SdoChannel(None))
        self._maps: dict[int, Map] = {}
        self._stale = bool(files.of_nodes)
        self._frames = self._row = self._set_at = 0
        self._begins: dict[int, int] = {}
        """First frame with the present map, by identifier."""
        self._misfit: set[int] = set()
        self._came: set[int] = set()

    def add_frames(self, frames: Records) -> bool:
        """Learn from frames; return whether a map is new or changed, or a PDO comes for the first time."""
        can_id, length = np.ascontiguousarray(frames["can_id"]), np.ascontiguousarray(frames["length"])
        function = can_id & (0x780 | CAN_RTR_FLAG | CAN_EFF_FLAG | CAN_ERR_FLAG)
        boots = (function == HEARTBEAT) & (length == 1) & (frames["word"] == 0)
        transfers = ((function == SDO_TX) | (function == SDO_RX)) & (length == 8)
        for row in np.flatnonzero(boots | transfers).tolist():
            number, self._row = int(can_id[row]) & 0x7F, self._frames + row
            if boots[row]:
                self._boot(number)
            elif number:
                self._transfer(number, data_bytes(int(frames["word"][row]), 8), function[row] == SDO_TX)
        came = {int(key) for key in np.unique(can_id) if key < 0x800}
        first = came - self._came
        self._came |= came
        self._see({key & 0x7F for key in came if key & 0x780 in (SDO_TX, HEARTBEAT)})
        self._frames += len(frames)
        changed = self.learn()
        changed |= any(pdo_without_map(key) or self.pdo(key) for key in first)
        return self._misfits(can_id, length) or changed

    def _see(self, numbers: set[int]) -> None:
        for number in numbers - {0} - self._nodes.keys():
            self._nodes[number] = MappedNode(number)
            self._stale = True

    def _boot(self, number: int) -> None:
        if number in self._nodes:  # it has its stored values again
            self._nodes[number].objects.clear()
            self._stale = True

    def _transfer(self, number: int, data: bytes, from_server: bool) -> None:
        channel = self._channels[number]
        channel.row(data, from_server)
        transfer = channel.completed
        if transfer is not None and transfer.kind == "expedited" and transfer.place is not None:
            self._set(number, transfer.place, int.from_bytes(transfer.joined.content, "little"))

    def _set(self, number: int, at: tuple[int, int], value: int) -> None:
        self._see({number})
        node = self._nodes[number]
        if at == (0x1000, 0):
            node.device_type = value
        if node.objects.get(at) != value:
            node.objects[at] = value
            self._stale, self._set_at = True, self._row

    def hold(self, number: int, objects: Objects) -> None:
        """Take the values that a node's objects have now; `learn` makes maps of them."""
        for place, value in objects.items():
            self._set(number, place, value)

    def learn(self) -> bool:
        """Renew the maps, without frames those of the EDS files; return whether one is new or changed."""
        if not self._stale:
            return False
        self._stale = False
        self._descriptions |= identified(self._nodes, self._descriptions, self._candidates)
        nodes = {n: MappedNode(n) for n in self._descriptions if n not in self._nodes} | self._nodes
        maps = maps_of(nodes, self._descriptions, {})
        changed = False
        for can_id, new in maps.items():
            old = self._maps.get(can_id)
            if old is None or (old.node, old.fields) != (new.node, new.fields):
                changed = True
                if old is not None and old.fields:
                    self._begins[can_id] = self._set_at
        self._maps |= maps  # a map that is unknown after a boot-up was valid until then
        return changed

    def _misfits(self, can_id: Integers, length: Integers) -> bool:
        """Remove assumed maps that frames contradict; return whether any was removed."""
        misfits = [
            pdo_map.can_id
            for pdo_map in self._maps.values()
            if pdo_map.source == "assumed"
            and pdo_map.can_id not in self._misfit
            and (length[can_id == pdo_map.can_id] != pdo_map.length).any()
        ]
        self._misfit.update(misfits)
        return bool(misfits)

    def pdo(self, can_id: int) -> Map | None:
        """Return the PDO of an identifier, None if unknown."""
        return self._maps.get(can_id)

    def identity(self, node: int) -> tuple[int, int]:
        """Return vendor id and product code of a node (1018h:01, :02); 0 if unknown."""
        return self._nodes[node].identity if node in self._nodes else (0, 0)

    def begin(self, can_id: int) -> int:
        """Return the first frame of the map that `pdo` returns; 0 if the PDO had no other map."""
        return self._begins.get(can_id, 0)

    def pdos(self) -> tuple[RigPdo, ...]:
        """Return every PDO with a known map, in the order of the identifiers (see `rig_pdo`);
        assumed maps only if PDOs were received and fit.
        """
        maps = [pdo_map for _, pdo_map in sorted(self._maps.items()) if pdo_map.fields]
        fits = (
            pdo_map for pdo_map in maps if pdo_map.source != "assumed" or pdo_map.can_id in self._came - self._misfit
        )
        return tuple(self.rig_pdo(pdo_map) for pdo_map in fits)

    def received_pdos(self) -> tuple[RigPdo, ...]:
        """Return the PDOs that came, in the order of their identifiers; a PDO without a map has no signals."""
        mapped = {pdo.layout.cob_id: pdo for pdo in self.pdos()}
        pdos = (mapped.get(can_id) or pdo_without_map(can_id) for can_id in sorted(self._came))
        return tuple(pdo for pdo in pdos if pdo is not None)

    def other_devices(self, rig: Rig) -> bool:
        """Return whether a node of the bus is another device than the rig's (1018h)."""
        return any(is_another(node.description, self.identity(node.node_id)) for node in rig.nodes)

    def rig_pdo(self, pdo_map: Map) -> RigPdo:
        """Return a PDO as in a rig: the node is a number, a signal is named by its PDO and object,
        ``"5.TPDO1.6064h:00"``, and its values are raw.
        """
        description = self._descriptions.get(pdo_map.node)
        node = self._nodes.get(pdo_map.node)
        profile = 0 if node is None else node.device_type & 0xFFFF
        entries = tuple(_entry(field, description, profile) for field in pdo_map.fields if field.bits)
        whole = sum(entry.bits for entry in entries) <= PDO_BITS  # a map of more was never accepted
        return _pdo(pdo_map.node, pdo_map.direction, pdo_map.number, pdo_map.can_id, entries if whole else ())


def _pdo(node: int, direction: str, number: int, can_id: int, entries: tuple[Entry, ...]) -> RigPdo:
    layout = PdoLayout(
        number=number,
        direction="tpdo" if direction == "tpdo" else "rpdo",
        cob_id=can_id,
        transmission=255,
        inhibit_ns=0,
        event_ns=0,
        sync_start=0,
        rtr_allowed=False,
        entries=entries,
    )
    pdo = f"{node}.{direction.upper()}{number}"
    signals = (
        Signal(f"{pdo}.{label}", e.index, e.subindex, 1.0, 0.0, "")
        for label, e in zip(_labels(entries), entries, strict=True)
    )
    return RigPdo(str(node), node, layout, tuple(signals))


def _labels(entries: tuple[Entry, ...]) -> Iterator[str]:
    """Yield the last part of each signal's name: its object, and a count from its second place in the PDO on."""
    count: Counter[str] = Counter()
    for number, entry in enumerate(entries, 1):
        label = f"gap{number}" if entry.dummy else where(entry.index, entry.subindex)
        count[label] += 1
        yield label if count[label] == 1 else f"{label}_{count[label]}"


def _entry(field: Field, description: Description | None, profile: int) -> Entry:
    """Return a field as a layout's entry: by its EDS file, else signed according to CiA 402 or 404."""
    index, subindex, bits = field.index, field.subindex, field.bits
    if description is not None and description.has(index, subindex) and index not in DUMMY_TYPES:
        entry = replace(entry_of(description.variable(index, subindex)), bits=bits)
        return entry if entry.kind == "int" or bits in (32, 64) else replace(entry, kind="int", signed=False)
    signed = 0x6000 <= index < 0xA000 and (index - 0x6000) % 0x800 in SIGNED_402
    if profile == 404:  # 7xxxh are INTEGER16, 9xxxh INTEGER32
        signed = index >> 12 in (7, 9)
    return Entry(index, subindex, bits, signed, "int", "")


def pdo_without_map(can_id: int) -> RigPdo | None:
    """Return the PDO of an identifier in the predefined connection set, without signals, or None."""
    name, node = PDO_NAMES.get(can_id & ~0x7F, ""), can_id & 0x7F
    if not name or not node:
        return None
    return _pdo(node, name[:4].lower(), int(name[4:]), can_id, ())
