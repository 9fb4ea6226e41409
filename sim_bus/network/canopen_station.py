"""`canopen`'s network as a participant of a virtual-time network; a module of its own, because `canopen` loads slowly."""

from __future__ import annotations

from typing import Any

import canopen

from coulombus.eds.cia301 import CobId
from coulombus.sim_bus.network.python_stations import Heard, StationBus
from coulombus.wire.frame import CAN_RTR_FLAG

__all__ = ["CanopenNetwork"]

SDO_ABORT = 0x80


class CanopenNetwork(canopen.Network):  # type: ignore[misc]  # canopen has no types
    """A `canopen` network without threads: its frames go to the virtual bus, and an SDO request lets time pass."""

    def __init__(self, bus: StationBus, sdo_timeout_s: float) -> None:
        super().__init__()
        self._virtual_bus, self._timeout_ns = bus, round(sdo_timeout_s * 1e9)
        self._station = bus.station(on_frame=self._hear)
        self._heard: set[int] = set()

    def _hear(self, frame: Heard) -> None:
        """Pass a frame to its subscribers."""
        self._heard.add(frame.can_id)
        self.notify(frame.can_id, bytearray(frame.data), frame.t_ns * 1e-9)

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        """Queue a frame; for an SDO request, run the bus until the node's response or the time-out."""
        self._station.send(can_id | (CAN_RTR_FLAG if remote else 0), bytes(data))
        if can_id & 0x780 == CobId.SDO_RX and data[0] != SDO_ABORT:  # an abort has no response
            self._await(can_id & 0x7F)

    def _await(self, node_id: int) -> None:
        """Wait for a response that the node's client accepts: it accepts a repeated frame once."""
        node, response = self.nodes.get(node_id), CobId.SDO_TX + node_id
        again = True
        while again:
            self._heard.clear()
            self._virtual_bus.run_until(self._virtual_bus.t_ns + self._timeout_ns, lambda: response in self._heard)
            remote = isinstance(node, canopen.RemoteNode)
            again = remote and node.sdo.responses.empty() and response in self._heard

    def send_periodic(self, can_id: int, data: bytes, period: float, remote: bool = False) -> Any:
        """Refuse: the kernel sends periodic frames."""
        raise NotImplementedError("periodic frames belong to the kernel: see coulombus.sim_bus.network.event_loop")
