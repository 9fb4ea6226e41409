"""The PDO maps of a log without a rig, as far as it has been gone through."""

from __future__ import annotations

from coulombus.eds.cia301 import DATA_TYPES
from coulombus.eds.codec import get_field
from coulombus.eds.sdo_frames import where
from coulombus.explain.bus import Bus
from coulombus.explain.eds_files import EdsFiles
from coulombus.explain.frames import Pieces
from coulombus.explain.rare import RareFrames
from coulombus.explain.seen_maps import Map
from coulombus.wire.frame import Records

__all__ = ["LogMaps"]

SIGNED_402 = frozenset(
    {
        *(0x42, 0x43, 0x44, 0x60, 0x61, 0x62, 0x63, 0x64, 0x6B, 0x6C, 0x71, 0x74, 0x77, 0x78, 0x7A, 0x7C),
        *(0xB0, 0xB1, 0xB2, 0xF4, 0xFF),
    }
)
"""Signed objects of CiA 402, by their distance from 6000h (each axis 800h further)."""


class LogMaps:
    """Learns PDO maps from SDO configuration, EDS files and CiA 402's defaults (`seen_maps`).

    Parameters
    ----------
    eds
        EDS files of nodes, or of which each node takes the one that fits.
    """

    def __init__(self, eds: EdsFiles | None = None) -> None:
        files = eds or EdsFiles()
        self._bus = Bus(dict(files.of_nodes), {}, {}, files.candidates)
        self._rare, self._pieces = RareFrames(self._bus), Pieces()

    def take(self, frames: Records) -> None:
        """Learn from frames."""
        for block in self._pieces.all_of(frames):
            self._rare.take(block)
        self._bus.renew()

    def pdo(self, can_id: int) -> Map | None:
        """Return the PDO of an identifier, None where nothing is known of it."""
        return self._bus.maps.get(can_id)

    def values(self, known: Map, word: int, length: int) -> dict[str, int]:
        """Return the values of the mapped objects that the frame has, signed where EDS file or CiA 402 says so."""
        description = self._bus.describe(known.node)
        values = {}
        for field in known.fields:
            if field.start + field.bits > 8 * length or field.index < 0x1000:
                continue
            signed = 0x6000 <= field.index < 0xA000 and (field.index - 0x6000) % 0x800 in SIGNED_402
            if description is not None and description.has(field.index, field.subindex):
                kind = DATA_TYPES.get(description.variable(field.index, field.subindex).data_type)
                signed = kind is not None and kind.signed and kind.kind == "int"
            values[where(field.index, field.subindex)] = int(get_field(word, field.start, field.bits, int(signed)))
        return values
