"""Frames processed one by one in Python: NMT, EMCY, heartbeats, guarding and SDO."""

from __future__ import annotations

from collections.abc import Iterator

from coulombus.explain.bus import EMCY, HEARTBEAT, NMT, SDO_RX, SDO_TX, Bus
from coulombus.explain.frames import REMOTE, Block
from coulombus.explain.nodes import Nodes
from coulombus.explain.sdo_transfers import SdoTransfers

__all__ = ["RareFrames"]


class RareFrames:
    """Passes these frames to `Nodes` and `SdoTransfers` in bus order."""

    def __init__(self, bus: Bus) -> None:
        self.bus = bus
        self.nodes, self.sdo = Nodes(bus), SdoTransfers(bus)

    def take(self, block: Block) -> None:
        """Process a block."""
        for row, t_ns, key, word, length in block.of(*self._keys(block)):
            if SDO_TX < key <= SDO_RX + 0x7F:
                self.sdo.frame(row, t_ns, key, word, length)
            else:
                self.nodes.frame(block, row, t_ns, key, word, length)
        self.nodes.seen(block)
        if len(block.t_ns):
            self.sdo.look(int(block.t_ns[-1]))

    def look(self, t_ns: int) -> None:
        """Note overdue events at a time."""
        self.nodes.look(t_ns)
        self.sdo.look(t_ns)

    def end(self, t_ns: int) -> None:
        """Note clues of the whole log."""
        self.sdo.end(t_ns)

    def _keys(self, block: Block) -> Iterator[int]:
        for key in block.groups:
            bare = key & ~REMOTE
            function, number = bare & 0x780, bare & 0x7F
            mapped = function == EMCY and key in self.bus.maps
            if (
                key == NMT
                or (number and function == HEARTBEAT)
                or (number and key == bare and function in (SDO_TX, SDO_RX, EMCY) and not mapped)
            ):
                yield key
