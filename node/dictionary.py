"""Object dictionary of a node: the EDS's objects and their values.

An object that the core uses, or that a PDO maps, is in a slot of the record's `values`; every
other object is stored here. `slot` moves an object into a slot when a PDO maps it. Access rights,
lengths and limits are those of the EDS; a violation is a `SdoAbort` with CiA 301's code. `eds.data.encode`
returns a value's bytes for SDO; `decode` returns the value of a client's bytes.
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from coulombus.eds.cia301 import DATA_TYPES, Abort, DataType, predefined
from coulombus.eds.cia305 import UNCONFIGURED
from coulombus.eds.codec import real_bits, real_value
from coulombus.eds.own_devices import MANUFACTURER, VENDOR_ID
from coulombus.eds.pdo import COB_ID_INVALID, unreadable
from coulombus.eds.reader import Description, Object, Value, Variable
from coulombus.node.profile import CoreObject, Key, SdoAbort
from coulombus.node.record import SPARE_SLOTS
from coulombus.node.slots import FIRST_FREE

__all__ = ["Dictionary", "DictionaryState", "decode"]

MAX_STRING = 4096
MAX_DOMAIN = 4 << 20
"""Largest number of bytes that a client may write to a string or domain: CiA 301 sets no limit, memory
does.
"""

MAP_OFFSET = 0x200
"""Offset from a PDO's communication parameter to its mapping parameter."""

_HISTORY = 0x1003  # its entries exist or not, and belong to the core
_OCTETS = DATA_TYPES[0x000A]
_INTEGERS = ("bool", "int")
_NUMBERS = (*_INTEGERS, "real", "time")
_WIDEST = 0xFFFFFFFF  # largest number that a core gets: of a time in ms, an int64 holds the ns


class DictionaryState(NamedTuple):
    """Objects without a slot, the slots of the others, and the next free slot."""

    store: Mapping[Key, Value]
    slots: Mapping[Key, int]
    following: int


class Dictionary:
    """Objects of `description` for the node `node_id`; `values` are the slots of its record, `core` the
    objects that its core uses.
    """

    def __init__(
        self, description: Description, node_id: int, core: Sequence[CoreObject], values: npt.NDArray[np.int64]
    ) -> None:
        self.description = description
        self.node_id = node_id
        self.values = values
        self._ours = description.default(0x1018, 1, node_id) == VENDOR_ID if description.has(0x1018, 1) else False
        self._slots = {row.key: row.slot for row in core if self._is_meant(row)}
        slots = set(self._slots.values())
        self._absent = {row.slot: row.absent for row in core if row.slot not in slots}
        self._next = max(FIRST_FREE, *(row.slot + 1 for row in core), 0)
        self._store: dict[Key, Value] = {}
        self.reset(0x0000, 0xFFFF)

    def reset(self, first: int, last: int) -> None:
        """Set the objects from index `first` to `last` to the EDS's defaults."""
        for slot, absent in self._absent.items():
            self.values[slot] = absent
        for key, default, raw in self._defaults.rows:
            if first <= key[0] <= last:
                place = self._slots.get(key)
                if place is None:
                    self._store[key] = default
                elif raw is None:
                    self[key] = default
                else:
                    self.values[place] = raw

    @property
    def _defaults(self) -> _Defaults:
        """Defaults for the present node id, computed once per description."""
        cache = self.description.derived.setdefault(_Defaults, {})
        if self.node_id not in cache:
            cache[self.node_id] = _Defaults.from_description(self.description, self.node_id)
        defaults: _Defaults = cache[self.node_id]
        return defaults

    @property
    def unreadable(self) -> Mapping[int, str]:
        """Index of a PDO's communication parameter -> why the EDS's default is unreadable: the PDO is not valid,
        and maps nothing.
        """
        return self._defaults.unreadable

    def state(self) -> DictionaryState:
        """Return the objects without a slot, and the slots of the others."""
        return DictionaryState({**self._store}, {**self._slots}, self._next)

    def adopt(self, state: DictionaryState) -> None:
        """Adopt the state of a dictionary of the same file, besides the values in the slots."""
        self._store, self._slots, self._next = {**state.store}, {**state.slots}, state.following

    def find(self, index: int, subindex: int) -> Variable:
        """Return the variable, or abort: no such object, no such sub-index."""
        entry: Object | None = self.description.objects.get(index)
        if entry is None:
            raise SdoAbort(Abort.NO_OBJECT)
        variable = entry.variables.get(subindex)
        if variable is None:
            raise SdoAbort(Abort.NO_SUBINDEX)
        return variable

    def __contains__(self, key: Key) -> bool:
        return key in self._store or key in self._slots  # each object is in one of them

    def __getitem__(self, key: Key) -> Value:
        """Return the present value; KeyError if the EDS has no such object."""
        slot = self._slots.get(key)
        if slot is not None:
            return self._in_slot(key, slot)
        if key not in self._store:
            self.description.variable(*key)  # raises, and names the missing object
        return self._store[key]

    def _in_slot(self, key: Key, slot: int) -> int | float:
        raw, kind = int(self.values[slot]), data_type(self.description.variable(*key))
        if kind.kind == "real":
            return real_value(raw, kind.bits)
        return raw & 0xFFFFFFFFFFFFFFFF if kind.bits == 64 and not kind.signed else raw

    def __setitem__(self, key: Key, value: Value) -> None:
        """Set the value as the device itself does: without checks of access right and limit, without side
        effects.
        """
        variable = self.description.variable(*key)
        slot = self._slots.get(key)
        if slot is None:
            self._store[key] = value
        else:
            self.values[slot] = _raw(data_type(variable), value)

    def number(self, index: int, subindex: int = 0, fallback: int = 0) -> int:
        """Return an integer object, within +-FFFFFFFFh, or `fallback` if the EDS does not have it."""
        key = (index, subindex)
        slot = self._slots.get(key)
        value = self._store.get(key) if slot is None else self._in_slot(key, slot)
        return max(-_WIDEST, min(value, _WIDEST)) if isinstance(value, int) else fallback

    def own_number(self, index: int, subindex: int, fallback: int) -> int:
        """Return an integer object of 2000h to 5FFFh as our files define it; `fallback` in another vendor's
        file.
        """
        return self.number(index, subindex, fallback) if self._ours else fallback

    def real(self, index: int, subindex: int, fallback: float) -> float:
        """Return a numeric object, or `fallback` if the EDS does not have it."""
        if (index, subindex) not in self:
            return fallback
        value = self[index, subindex]
        return float(value) if isinstance(value, (int, float)) else fallback

    def high(self, index: int, subindex: int, fallback: int) -> int:
        """Return the largest value that the EDS allows for an object; `fallback` if it sets no limit."""
        high = self.description.variable(index, subindex).high if (index, subindex) in self else None
        return fallback if high is None else int(high)

    def _is_meant(self, row: CoreObject) -> bool:
        """Tell whether the object exists and is the object that the core expects at this index."""
        ours = self._ours or row.named or row.index not in MANUFACTURER
        kinds = _NUMBERS if row.named else _INTEGERS  # a slot has the bit pattern of a REAL
        return ours and self.description.has(*row.key) and data_type(self.description.variable(*row.key)).kind in kinds

    def _is_number(self, key: Key) -> bool:
        """Tell whether an object has a numeric type, whichever type CiA specifies."""
        return data_type(self.description.variable(*key)).kind in _NUMBERS

    def slot(self, index: int, subindex: int) -> int:
        """Return the slot of a numeric object of up to 64 bits; move the object there if necessary."""
        key = (index, subindex)
        if key not in self._slots:
            self.find(index, subindex)
            if not self._is_number(key):
                raise SdoAbort(Abort.NOT_MAPPABLE)
            if self._next >= self.values.shape[0]:
                raise SdoAbort(Abort.INTERNAL_INCOMPATIBLE)
            value = self._store.pop(key)
            self._slots[key] = self._next
            self._next += 1
            self[key] = value
        return self._slots[key]

    def expedited(self) -> list[tuple[int, int, int]]:
        """Return the objects that can be uploaded in four bytes and have a slot, sorted: (index x 256 +
        sub-index, slot, bytes).

        For this purpose objects are moved into slots as long as more than `SPARE_SLOTS` are left.
        """
        derived = self.description.derived
        if _expedited not in derived:
            derived[_expedited] = _expedited(self.description)
        rows = []
        for key, size in derived[_expedited]:
            if key in self._slots or self._next < len(self.values) - SPARE_SLOTS:
                rows.append((key[0] << 8 | key[1], self.slot(*key), size))
        return rows

    def check_read(self, index: int, subindex: int) -> Variable:
        """Abort unless a client may read the object."""
        variable = self.find(index, subindex)
        if variable.access == "wo":
            raise SdoAbort(Abort.WRITE_ONLY)
        return variable

    def check_write(self, index: int, subindex: int, size: int | None) -> int:
        """Abort unless a client may write `size` bytes (None: unknown) to the object; return the largest
        allowed number.
        """
        variable = self.find(index, subindex)
        if variable.access in ("ro", "const"):
            raise SdoAbort(Abort.READ_ONLY)
        kind = data_type(variable)
        longest = (kind.bits + 7) // 8 or (MAX_DOMAIN if kind.kind == "domain" else MAX_STRING)
        if size is not None and size > longest:
            raise SdoAbort(Abort.TOO_LONG)
        if size is not None and kind.bits and size < longest:
            raise SdoAbort(Abort.TOO_SHORT)
        return longest


class _Defaults(NamedTuple):
    """Initial values of a description's objects at one node id."""

    rows: tuple[tuple[Key, Value, int | None], ...]
    """Object, default, and for an integer the default as in a slot."""
    unreadable: Mapping[int, str]

    @classmethod
    def from_description(cls, description: Description, node_id: int) -> _Defaults:
        """Return the defaults: the EDS's, else CiA 301's, else the zero of the type."""
        unreadable_pdos = unreadable(description, 1 if node_id == UNCONFIGURED else node_id)
        rows = []
        for index, entry in description.objects.items():
            for subindex, variable in entry.variables.items():
                value = _default_value(description, index, subindex, node_id)
                if index in unreadable_pdos and subindex == 1:
                    value = value | COB_ID_INVALID if isinstance(value, int) else COB_ID_INVALID
                elif index - MAP_OFFSET in unreadable_pdos and subindex == 0:
                    value = 0
                kind = data_type(variable)
                whole = kind.kind in ("bool", "int") and isinstance(value, int)
                rows.append(((index, subindex), value, _raw(kind, value) if whole else None))
        return cls(tuple(rows), MappingProxyType(unreadable_pdos))


def _default_value(description: Description, index: int, subindex: int, node_id: int) -> Value:
    value = description.default(index, subindex, node_id)
    if value is not None:
        return value
    zero: dict[str, Value] = {"text": "", "unicode": "", "bytes": b"", "domain": b"", "real": 0.0}
    number = predefined(index, subindex, node_id) or 0
    return zero.get(data_type(description.variable(index, subindex)).kind, number)


def _expedited(description: Description) -> list[tuple[Key, int]]:
    """Return the objects that may be uploaded in four bytes, sorted, with their bytes."""
    rows = []
    for index, entry in sorted(description.objects.items()):
        for subindex, variable in sorted(entry.variables.items()):
            kind = data_type(variable)
            short = kind.kind in ("bool", "int", "real") and kind.bits <= 32
            if short and variable.access != "wo" and index != _HISTORY:
                rows.append(((index, subindex), (kind.bits + 7) // 8))
    return rows


def _raw(kind: DataType, value: Value) -> int:
    """Return a number as in a slot."""
    if kind.kind == "real":
        return real_bits(float(value or 0), kind.bits)
    raw = int(value or 0)
    return raw - (1 << 64) if raw > 0x7FFFFFFFFFFFFFFF else raw


def data_type(variable: Variable) -> DataType:
    """Return the variable's data type; an unknown type counts as an octet string."""
    return DATA_TYPES.get(variable.data_type, _OCTETS)


def decode(variable: Variable, data: bytes) -> Value:
    """Return the value of `data` (of the right length), within the EDS's limits, or abort."""
    kind = data_type(variable)
    value: int | float
    if kind.kind == "text":
        return data.decode("latin-1")
    if kind.kind == "unicode":
        return data.decode("utf-16-le", "replace")
    if kind.kind in ("bytes", "domain", "record"):
        return data
    if kind.kind == "real":
        value = struct.unpack("<f" if kind.bits == 32 else "<d", data)[0]
    else:
        value = int.from_bytes(data, "little", signed=kind.signed)
    if value > variable.largest or (kind.kind == "bool" and value > 1):
        raise SdoAbort(Abort.VALUE_HIGH)
    if variable.low is not None and value < variable.low:
        raise SdoAbort(Abort.VALUE_LOW)
    return value
