"""The identifiers of a log that is not CANopen: their frequency and J1939 names."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from coulombus.explain.frames import EXTENDED, REMOTE, Block

__all__ = ["IdentifierRow", "Identifiers"]

MOST = 4096
"""Maximum number of identifiers to count."""
EXTENDED_BIT = 1 << 31
GROUPS: Mapping[int, str] = MappingProxyType(
    {
        0: "torque/speed control", 59392: "acknowledgement", 59904: "request", 60160: "transport, data",
        60416: "transport, connection", 60928: "address claimed", 61184: "proprietary A",
        61441: "brake controller", 61442: "transmission controller", 61443: "engine controller 2",
        61444: "engine controller 1", 65215: "wheel speed", 65226: "DM1, active trouble codes",
        65227: "DM2, earlier trouble codes", 65248: "vehicle distance", 65253: "engine hours", 65257: "fuel consumption",
        65259: "component identification", 65262: "engine temperature", 65263: "engine fluids", 65265: "cruise control",
        65266: "fuel economy", 65269: "ambient conditions", 65270: "inlet and exhaust", 65271: "electrical power",
        65276: "dash display",
    }
)  # fmt: skip
"""Parameter groups of SAE J1939-71, -73, -21 and -81 by their number."""


@dataclass(frozen=True)
class IdentifierRow:
    """An identifier of the table."""

    can_id: int
    extended: bool
    frames: int
    period_ns: int
    """Mean interval; 0 for a single frame."""

    @property
    def group(self) -> int:
        """Parameter group number of J1939: the 29 bits without priority, source and, for formats
        below F0h, destination.
        """
        number = self.can_id >> 8 & 0x3FFFF
        return number if number >> 8 & 0xFF >= 0xF0 else number & 0x3FF00

    @property
    def source(self) -> int:
        """Source address of J1939."""
        return self.can_id & 0xFF

    @property
    def text(self) -> str:
        """The J1939 name; "" for an 11-bit identifier."""
        if not self.extended:
            return ""
        name = GROUPS.get(self.group, "proprietary B" if self.group >> 8 & 0xFF == 0xFF else "")
        return f"PGN {self.group} from {self.source}" + (f", {name}" if name else "")


class Identifiers:
    """Counts every identifier."""

    def __init__(self) -> None:
        self._seen: dict[int, list[int]] = {}  # frames, first and last time

    def add_frames(self, block: Block) -> None:
        """Process a block."""
        for key, group in block.groups.items():
            if key < REMOTE:
                self._count(key, group.t_ns)
        extended = block.groups.get(EXTENDED)
        if extended is not None:
            can_id = block.frames["can_id"][extended.rows - block.first_row] & 0x1FFFFFFF
            for value in np.unique(can_id).tolist():
                self._count(int(value) | EXTENDED_BIT, extended.t_ns[can_id == value])

    def _count(self, key: int, t_ns: np.ndarray) -> None:
        seen = self._seen.get(key)
        if seen is None:
            if len(self._seen) < MOST:
                self._seen[key] = [len(t_ns), int(t_ns[0]), int(t_ns[-1])]
            return
        seen[0], seen[2] = seen[0] + len(t_ns), int(t_ns[-1])

    def rows(self) -> tuple[IdentifierRow, ...]:
        """Return the table, the most frequent identifier first."""
        table = [
            IdentifierRow(key & ~EXTENDED_BIT, bool(key & EXTENDED_BIT), frames, (last - first) // max(frames - 1, 1))
            for key, (frames, first, last) in self._seen.items()
        ]
        return tuple(sorted(table, key=lambda row: (-row.frames, row.can_id)))
