"""The device under test according to its EDS: objects, defaults, kind."""

from __future__ import annotations

import re
from collections.abc import Iterator
from functools import cached_property

from coulombus.conformance.tester.verdict import NotApplicable, where
from coulombus.eds.cia301 import DATA_TYPES, CobId
from coulombus.eds.convert import eds_text
from coulombus.eds.data import READ_ONLY
from coulombus.eds.reader import Description, Value, Variable

__all__ = ["DescribedDevice", "is_signed"]

_OBJ_FLAGS = re.compile(r"(?ims)^\[([0-9a-f]{4})(?:sub([0-9a-f]{1,2}))?\]([^\[]*?)^ObjFlags\s*=\s*(\w+)")


class DescribedDevice:
    """The EDS of a device, and its node-id."""

    def __init__(self, description: Description, node_id: int) -> None:
        self.description, self.node_id = description, node_id

    def has(self, index: int, subindex: int = 0) -> bool:
        """Return whether the EDS describes an object."""
        return self.description.has(index, subindex)

    def need(self, index: int, subindex: int = 0) -> Variable:
        """Return an object's description; without one the case does not apply."""
        if not self.has(index, subindex):
            raise NotApplicable(f"the EDS has no {where(index, subindex)}")
        return self.description.variable(index, subindex)

    def need_writable(self, index: int, subindex: int = 0) -> Variable:
        """Return the description of an object that can be written, and a communication parameter
        read back.

        Without one the case does not apply.
        """
        variable = self.need(index, subindex)
        if variable.access == "wo" and index < 0x2000:
            raise NotApplicable(f"{where(index, subindex)} is wo in the EDS: it cannot be read back")
        if variable.access in READ_ONLY:
            raise NotApplicable(f"{where(index, subindex)} is {variable.access} in the EDS")
        return variable

    def variable(self, index: int, subindex: int = 0) -> Variable:
        """Return an object's description."""
        return self.description.variable(index, subindex)

    def variables(self, first: int = 0x1000, last: int = 0xFFFF) -> Iterator[Variable]:
        """Yield all variables of the EDS in a range of indices; sub-index 255 is none."""
        for index in sorted(self.description.objects):
            if first <= index <= last:
                for subindex, variable in self.description.objects[index].variables.items():
                    if subindex != 0xFF:
                        yield variable

    def default(self, variable: Variable) -> Value:
        """Return a default of the EDS, or None."""
        return self.description.default(variable.index, variable.subindex, self.node_id)

    @cached_property
    def flags(self) -> dict[tuple[int, int], int]:
        """ObjFlags of the EDS: bit 0 refuses a write on download, bit 1 a read on scan (CiA
        306-1).
        """
        flags = {}
        for index, subindex, _, value in _OBJ_FLAGS.findall(eds_text(self.description)):
            try:
                flags[int(index, 16), int(subindex or "0", 16)] = int(value, 0)
            except ValueError:  # already reported by the reader
                continue
        return flags

    @cached_property
    def granularity(self) -> int:
        """[DeviceInfo] Granularity: unit [bits] of the entries of a PDO's map; 0: no map can be written.

        One bit if the file has no value from 0 to 64.
        """
        entry = {key.lower(): value for key, value in self.description.info.items()}.get("granularity", "").strip()
        try:
            bits = int(entry, 0)
        except ValueError:
            return 1
        return bits if 0 <= bits <= 64 else 1

    def width(self, index: int, subindex: int) -> int:
        """Return the bytes of an object; 0 if the EDS does not describe it."""
        return (self.variable(index, subindex).bits + 7) // 8 if self.has(index, subindex) else 0

    @property
    def is_drive(self) -> bool:
        """Return whether it is a drive of CiA 402, with controlword and statusword."""
        kind = self.default(self.variable(0x1000)) if self.has(0x1000) else None
        profile = isinstance(kind, int) and kind & 0xFFFF == 402
        return profile and self.has(0x6040) and self.has(0x6041)

    def default_sdo_id(self, subindex: int, otherwise: int) -> int:
        """Return an identifier of the first SDO server; without a default `otherwise` + node-id."""
        value = self.description.default(0x1200, subindex, self.node_id) if self.has(0x1200, subindex) else None
        return value & 0x7FF if isinstance(value, int) and value & 0x7FF else otherwise + self.node_id

    def default_sync_id(self) -> int:
        """Return the identifier of SYNC."""
        value = self.description.default(0x1005, 0, self.node_id) if self.has(0x1005) else None
        return value & 0x7FF if isinstance(value, int) and value & 0x7FF else CobId.SYNC


def is_signed(variable: Variable) -> bool:
    """Return whether the variable is a signed integer."""
    kind = DATA_TYPES.get(variable.data_type)
    return bool(kind and kind.signed and kind.kind == "int")
