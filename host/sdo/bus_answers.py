"""SDO responses of all nodes to one client, and detection of two devices with the same node id.

Bring-up, `sdo`, `scan` and the check of free node ids share this detection.
"""

from __future__ import annotations

from collections import defaultdict

from coulombus.eds.cia301 import CobId
from coulombus.eds.sdo_answers import SdoAnswers
from coulombus.wire.bus_link import BusFrame, FrameLink

__all__ = ["LENGTH", "BusAnswers"]

LENGTH = 8
"""Bytes of an SDO message (CiA 301, section 7.2.4.3)."""


class BusAnswers:
    """Requests of one client to each node, and the responses (`eds.sdo_answers`)."""

    def __init__(self) -> None:
        self._nodes: defaultdict[int, SdoAnswers] = defaultdict(SdoAnswers)

    def of(self, node_id: int) -> SdoAnswers:
        """Return the answers of one node."""
        return self._nodes[node_id]

    def hear(self, frame: BusFrame) -> None:
        """Handle a frame that no transfer waits for; only SDO responses of requested nodes count."""
        node_id = frame.can_id - CobId.SDO_TX
        if node_id in self._nodes and frame.length == LENGTH:
            self._nodes[node_id].take(frame.data)

    def listen(self, link: FrameLink, until_ns: int) -> None:
        """Handle all frames until `until_ns`: a second device may answer later."""
        while (frame := link.receive(until_ns)) is not None:
            self.hear(frame)

    @property
    def duplicate_node_ids(self) -> tuple[int, ...]:
        """The node ids with answers of two devices."""
        return tuple(node_id for node_id, answers in sorted(self._nodes.items()) if answers.duplicate_node_id)
