"""Frames processed one by one in Python: NMT, EMCY, heartbeats, guarding, SDO, and requests of LSS."""

from __future__ import annotations

from collections.abc import Iterator

from coulombus.eds.cia301 import CobId
from coulombus.explain.bus import EMCY, HEARTBEAT, NMT, SDO_RX, SDO_TX, Bus
from coulombus.explain.frames import REMOTE, Block
from coulombus.explain.nodes import Nodes
from coulombus.explain.sdo_transfers import SdoTransfers

__all__ = ["RareFrames"]


class RareFrames:
    """Passes these frames to `Nodes` and `SdoTransfers`, and what becomes overdue between them, in the order of time."""

    def __init__(self, bus: Bus) -> None:
        self.bus = bus
        self.nodes, self.sdo = Nodes(bus), SdoTransfers(bus)

    def parts(self, block: Block) -> Iterator[Block]:
        """Process the block's rare frames, and yield it in parts.

        The knowledge of nodes and PDO maps is the same for all other frames of a part.
        """
        keys = tuple(self._keys(block))
        self.nodes.begin(block)
        start, before = 0, -1
        for row, t_ns, key, word, length in block.merged(*keys):
            if self.bus.stale and 0 <= before < row - 1:  # other frames stand between
                yield block.part(start, before + 1 - block.first_row)
                self.bus.renew()
                start = before + 1 - block.first_row
            self.note_overdue(block, t_ns)
            if SDO_TX < key <= SDO_RX + 0x7F:
                self.sdo.frame(row, t_ns, key, word, length)
            else:
                self.nodes.frame(block, row, t_ns, key, word, length)
            before = row
        if self.bus.stale and before >= 0:
            yield block.part(start, before + 1 - block.first_row)
            self.bus.renew()
            start = before + 1 - block.first_row
        if len(block.t_ns):
            self.note_overdue(block, int(block.t_ns[-1]))
        self.nodes.end(block)
        self.bus.renew()
        yield block.part(start, len(block.t_ns))

    def note_overdue(self, block: Block | None, t_ns: int) -> None:
        """Note what became overdue before a time [ns]; `block`: the frames of that time, if they are not yet processed."""
        self.nodes.note_overdue(block, t_ns)
        self.sdo.note_overdue(t_ns)

    def _keys(self, block: Block) -> Iterator[int]:
        for key in block.groups:
            bare = key & ~REMOTE
            function, number = bare & 0x780, bare & 0x7F
            mapped = function == EMCY and key in self.bus.maps
            if (
                key in (NMT, CobId.LSS_RX)
                or (number and function == HEARTBEAT)
                or (number and key == bare and function in (SDO_TX, SDO_RX, EMCY) and not mapped)
            ):
                yield key
