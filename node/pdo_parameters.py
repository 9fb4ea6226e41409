"""PDO parameters of a node, 1400h-1BFFh: allowed writes, and the record (CiA 301, 7.5.2.35-38).

The procedure to change a map: destroy the PDO (bit 31 of its COB-ID), set the count to 0, write the
entries, set the count, create the PDO again. A write outside the procedure is aborted, a write that
changes nothing is accepted. PDOs beyond `node.record.MAX_PDOS` of a direction have their objects
but cannot be made valid.
"""

from __future__ import annotations

import numpy as np

from coulombus.eds.cia301 import DATA_TYPES, DUMMY_TYPES, Abort, predefined, restricted
from coulombus.eds.pdo import (
    COB_ID_EXTENDED,
    COB_ID_INVALID,
    COB_ID_NO_RTR,
    COMMUNICATION,
    EVENT_UNIT_NS,
    INHIBIT_UNIT_NS,
    MAPPING,
    PDO_BITS,
    Direction,
    Entry,
    PdoLayout,
    entry_of,
    fill,
)
from coulombus.kernels.records import Record
from coulombus.node.dictionary import Dictionary
from coulombus.node.kinds import PROFILES
from coulombus.node.profile import Profile, SdoAbort
from coulombus.node.record import MAX_PDOS

__all__ = ["Pdos", "restricted"]

CHANGING = frozenset(row.index for profile in PROFILES for row in profile.objects if row.changing)
"""Objects that change all the time: with an event timer, their change is no event."""

_READABLE, _WRITABLE = ("ro", "rw", "rwr", "const"), ("wo", "rw", "rww")
_SYNC_MAX, _RTR_MIN, _EVENT_MIN = 240, 252, 254


class Pdos:
    """The PDO parameters of a node, by its record."""

    def __init__(self, dictionary: Dictionary, node: Record, profile: Profile) -> None:
        self._dictionary = dictionary
        self._node = node
        self._profile = profile
        self._changing = CHANGING | {row.index for row in profile.objects if row.changing}
        self._missing_bytes = 0
        described = sorted(dictionary.description.objects)
        self._beyond = {
            direction: [index for index in described if first + MAX_PDOS <= index < first + 512]
            for direction, first in COMMUNICATION.items()
        }
        """Communication parameters for which the core has no room."""

    def locate(self, index: int) -> tuple[Direction, int, bool] | None:
        """Return (direction, number from 0, whether it is a mapping) of a PDO parameter, else None."""
        directions: tuple[Direction, ...] = ("rpdo", "tpdo")
        for direction in directions:
            for first, mapping in ((COMMUNICATION[direction], False), (MAPPING[direction], True)):
                if first <= index < first + 512:
                    return direction, index - first, mapping
        return None

    def _cob_id(self, direction: Direction, k: int) -> int:
        """Return the COB-ID (sub-index 1) of a PDO, or its default if the EDS does not have it; not valid if there
        is no such PDO.
        """
        index, objects = COMMUNICATION[direction] + k, self._dictionary
        usual = predefined(index, 1, objects.node_id) if objects.description.has(index) else None
        return objects.number(index, 1, COB_ID_INVALID if usual is None else usual)

    def _valid(self, direction: Direction, k: int) -> bool:
        return not self._cob_id(direction, k) & COB_ID_INVALID

    def _stands(self, direction: Direction, k: int) -> bool:
        """Tell whether a PDO is valid, so that its parameters are fixed until a client makes it invalid.

        If the file does not allow that (the COB-ID is read-only), the writable parameters can be written
        while the PDO is valid: its map by way of 0 entries.
        """
        index = COMMUNICATION[direction] + k
        cob_id = self._dictionary.description.variable(index, 1) if (index, 1) in self._dictionary else None
        fixed = cob_id is None or cob_id.access in ("ro", "const")
        return self._valid(direction, k) and not fixed

    def check(self, index: int, subindex: int, value: int) -> None:
        """Abort unless `value` may be written now."""
        place = self.locate(index)
        if place is None or value == self._dictionary[index, subindex]:
            return
        direction, k, mapping = place
        if mapping:
            if self._stands(direction, k):
                raise SdoAbort(Abort.DEVICE_STATE)
            if subindex == 0:
                self._check_count(direction, index, value)
            elif self._dictionary.number(index, 0):
                raise SdoAbort(Abort.DEVICE_STATE)
            elif value:
                self._entry(direction, value)
        elif subindex == 1:
            self._check_cob_id(direction, k, int(self._dictionary.number(index, 1)), value)
        elif subindex == 2:
            reserved = range(_SYNC_MAX + 1, _EVENT_MIN if direction == "rpdo" else _RTR_MIN)
            if value in reserved:
                raise SdoAbort(Abort.VALUE)
        elif subindex in (3, 6) and direction == "tpdo" and self._stands(direction, k):
            raise SdoAbort(Abort.DEVICE_STATE)  # fixed while the PDO exists

    def _check_cob_id(self, direction: Direction, k: int, before: int, value: int) -> None:
        can_id = value & 0x1FFFFFFF
        if value & COB_ID_EXTENDED or can_id > 0x7FF:
            raise SdoAbort(Abort.VALUE)
        if value & COB_ID_INVALID:
            return
        if restricted(can_id) or (not before & COB_ID_INVALID and (before ^ value) & 0x3FFFFFFF):
            raise SdoAbort(Abort.VALUE)
        if k >= MAX_PDOS:
            raise SdoAbort(Abort.INTERNAL_INCOMPATIBLE)
        for other in range(MAX_PDOS):
            same = self._cob_id(direction, other)
            if direction == "tpdo" and other != k and not same & COB_ID_INVALID and same & 0x7FF == can_id:
                raise SdoAbort(Abort.PARAMETER_INCOMPATIBLE)  # two TPDOs with one identifier collide on the bus

    def _check_count(self, direction: Direction, index: int, count: int) -> None:
        if count and (count > PDO_BITS or (index, count) not in self._dictionary):
            raise SdoAbort(Abort.PDO_LENGTH)
        words = [self._dictionary.number(index, sub) for sub in range(1, count + 1)]
        if sum(self._entry(direction, word).bits for word in words) > PDO_BITS:
            raise SdoAbort(Abort.PDO_LENGTH)

    def _entry(self, direction: Direction, word: int) -> Entry:
        """Return the entry of a client's mapping word, or abort."""
        index, subindex, bits = word >> 16, word >> 8 & 0xFF, word & 0xFF
        if index in self._dictionary.description.dummies:
            if direction == "tpdo" or bits != DATA_TYPES[index].bits:
                raise SdoAbort(Abort.NOT_MAPPABLE)
            return self._read_entry(word)
        variable = self._dictionary.find(index, subindex)
        access = _WRITABLE if direction == "rpdo" else _READABLE
        whole = bits == variable.bits or (variable.bits == 1 and bits == 8)
        if not variable.pdo_mappable or variable.access not in access or not whole:
            raise SdoAbort(Abort.NOT_MAPPABLE)
        self._dictionary.slot(index, subindex)
        return self._read_entry(word)

    def _read_entry(self, word: int) -> Entry:
        """Return the entry of a mapping word, whatever the EDS's own default maps."""
        key = Entry, word
        derived = self._dictionary.description.derived
        if key not in derived:
            index, subindex, bits = word >> 16, word >> 8 & 0xFF, word & 0xFF
            if index in DUMMY_TYPES:
                derived[key] = Entry(index, subindex, bits, DATA_TYPES[index].signed, "int", "dummy")
            else:
                derived[key] = entry_of(self._dictionary.description.variable(index, subindex), bits)
        entry: Entry = derived[key]
        return entry

    def _slot(self, index: int, subindex: int) -> int:
        """Return an entry's slot; text in a default map has none and is sent as zeros."""
        try:
            return self._dictionary.slot(index, subindex)
        except SdoAbort:
            return -1

    def layout(self, direction: Direction, k: int) -> PdoLayout:
        """Return the PDO as its parameters describe it now."""
        number = self._dictionary.number
        communication, mapping = COMMUNICATION[direction] + k, MAPPING[direction] + k
        cob_id = self._cob_id(direction, k)
        count = number(mapping, 0)
        return PdoLayout(
            number=k + 1,
            direction=direction,
            cob_id=cob_id & 0x7FF if self._exists(direction, k) else -1,
            transmission=number(communication, 2, 255),
            inhibit_ns=number(communication, 3) * INHIBIT_UNIT_NS if direction == "tpdo" else 0,
            event_ns=number(communication, 5) * EVENT_UNIT_NS,
            sync_start=number(communication, 6) if direction == "tpdo" else 0,
            rtr_allowed=not cob_id & COB_ID_NO_RTR,
            entries=tuple(self._read_entry(number(mapping, sub)) for sub in range(1, count + 1)),
        )

    def _exists(self, direction: Direction, k: int) -> bool:
        """Tell whether a PDO is valid and maps an object: count 0 disables the mapping."""
        cob_id = self._cob_id(direction, k)
        mapped = self._dictionary.number(MAPPING[direction] + k, 0)
        return bool(not cob_id & COB_ID_INVALID and cob_id & 0x7FF and mapped and k < MAX_PDOS)

    def refresh(self, direction: Direction, k: int, t_ns: int) -> bool:
        """Update the record of one PDO from its parameters; tell whether there was anything to do.

        A changed RPDO is new, and has received nothing; a TPDO is new if it did not exist, else its
        inhibit time continues. The record of a PDO that was not valid, and is not now, is not updated
        until the PDO becomes valid.
        """
        if k >= MAX_PDOS:
            return False
        record, node = self._node[direction][k], self._node
        if record["cob_id"] < 0 and not self._exists(direction, k):
            return False
        layout = self.layout(direction, k)
        existed = 0 <= record["cob_id"] == layout.cob_id
        counted = existed and record["transmission"] == layout.transmission
        fill(record, layout, self._slot)
        self._count(direction)
        if direction == "rpdo":
            acts = self._profile.acts
            node["rpdo_carries"][k] = sum(acts.get((e.index, e.subindex), 0) for e in layout.entries)
            node["rpdo_armed"][k] = node["rpdo_lost"][k] = 0
            node["rpdo_pending"] -= node["rpdo_waits"][k]
            node["rpdo_waits"][k] = 0
            return True
        record["length"] = max(0, record["length"] - self._missing_bytes)
        mask = 0
        for entry, start in zip(layout.entries, layout.starts, strict=True):
            if layout.event_ns == 0 or entry.index not in self._changing:
                mask |= ((1 << entry.bits) - 1) << start
        node["tpdo_mask"][k] = mask - (1 << 64) if mask >> 63 else mask
        if not counted:
            node["tpdo_count"][k] = -1 if layout.sync_start and node["sync_overflow"] else 0
        if not existed:
            node["tpdo_ns"][k] = t_ns - layout.inhibit_ns
            node["tpdo_due"][k] = 1
        return True

    def shorten(self, t_ns: int, missing_bytes: int) -> None:
        """Send every TPDO so many bytes too short, as a faulty device, whatever its map is; 0: as mapped."""
        if missing_bytes != self._missing_bytes:
            self._missing_bytes = missing_bytes
            for k in range(int(self._node["tpdo_used"])):
                self.refresh("tpdo", k, t_ns)

    def _count(self, direction: Direction) -> None:
        """Count the valid PDOs of a direction."""
        records, node = self._node[direction], self._node
        valid = np.flatnonzero(records["cob_id"] >= 0)
        node["rpdo_used" if direction == "rpdo" else "tpdo_used"] = int(valid[-1]) + 1 if len(valid) else 0
        if direction == "tpdo":
            node["tpdo_events"] = int(np.sum(records["transmission"][valid] >= _EVENT_MIN))

    def refresh_all(self, t_ns: int) -> None:
        """Update every PDO record from its parameters; make a valid PDO invalid if the core has no room for it."""
        directions: tuple[Direction, ...] = ("rpdo", "tpdo")
        for direction in directions:
            self._node[direction]["cob_id"] = -1
            for k in range(MAX_PDOS):
                if self._dictionary.description.has(COMMUNICATION[direction] + k):
                    self.refresh(direction, k, t_ns)
            self._count(direction)
            if direction == "rpdo":
                self._node["rpdo_pending"] = 0
                self._node["rpdo_waits"] = 0
            for index in self._beyond[direction]:
                if (index, 1) in self._dictionary:
                    self._dictionary[index, 1] = self._dictionary.number(index, 1) | COB_ID_INVALID
