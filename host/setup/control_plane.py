"""The control plane of a bus in real time, on its own connection."""

from __future__ import annotations

import time
from collections import deque

from coulombus.eds.cia301 import CobId
from coulombus.host.errors import SafetyTrip
from coulombus.rigs.rig import Rig
from coulombus.wire.address import BusAddress
from coulombus.wire.bus_link import BusFrame, BusLink

__all__ = ["RealControlPlane"]

KEPT = 256
"""Largest number of frames that wait for `receive`; beyond it, the oldest are dropped."""


class RealControlPlane:
    """The control plane of `rig` on the bus at `address`.

    Implements `host.setup.bringup.ControlPlane`.

    It receives only SDO responses, EMCY and heartbeats; the data plane receives the PDOs.

    Raises
    ------
    coulombus.wire.address.BusUnavailable
        the bus does not exist; later: it disappeared, or accepts no frame
    """

    def __init__(self, rig: Rig, address: BusAddress) -> None:
        self._address = address
        self.sdo_timeout_s = rig.host.sdo_timeout_s
        nodes = [node.node_id for node in rig.nodes]
        self._own = {base + node for base in (CobId.SDO_TX, CobId.HEARTBEAT) for node in nodes}
        self._own |= {node.emcy_id for node in rig.nodes}
        host_id = rig.host.node_id
        self._foreign = {CobId.SYNC: "SYNC", CobId.HEARTBEAT + host_id: f"the heartbeat of node {host_id}"}
        self._nmt: dict[int, int] = {}
        self._waiting: deque[BusFrame] = deque(maxlen=KEPT)
        self._link = BusLink(address, _filters(self._own | set(self._foreign)))

    def check_alone(self, until_s: float) -> None:
        """Listen for another host until `time.monotonic()` is `until_s`; then filter SYNC out, which this
        host sends itself.

        Raises
        ------
        SafetyTrip
            another host is on the bus
        """
        while (frame := self._link.receive(round(until_s * 1e9))) is not None:
            if frame.can_id in self._foreign:
                raise SafetyTrip(
                    f"another host is on bus {self._address}: {self._foreign[frame.can_id]} was heard; "
                    f"end it first (coulombus stop --bus {self._address})"
                )
            self._note(frame)
        self._link.set_filters(_filters(self._own))

    # a link, for the SDO client

    def now_ns(self) -> int:
        """Return the monotonic time."""
        return time.monotonic_ns()

    def send(self, can_id: int, data: bytes = b"", length: int | None = None) -> None:
        """Send a frame."""
        self._link.send(can_id, data, length)

    def receive(self, until_ns: int) -> BusFrame | None:
        """Return the next frame, or None if none arrives until `until_ns`."""
        if self._waiting:
            return self._waiting.popleft()
        frame = self._link.receive(until_ns)
        if frame is not None:
            self._note(frame)
        return frame

    def wait_ns(self, duration_ns: int) -> None:
        """Wait; arriving frames are kept for `receive`.

        Raises
        ------
        coulombus.wire.address.BusUnavailable
            the bus disappeared
        """
        until_ns = self.now_ns() + duration_ns
        while (frame := self._link.receive(until_ns)) is not None:
            self._note(frame)
            self._waiting.append(frame)

    def _note(self, frame: BusFrame) -> None:
        if frame.can_id & ~0x7F == CobId.HEARTBEAT and len(frame.data) == 1:
            self._nmt[frame.can_id & 0x7F] = frame.data[0] & 0x7F

    def nmt_state(self, node_id: int) -> int | None:
        """Return the NMT state in the node's last heartbeat; None before the first."""
        return self._nmt.get(node_id)

    def close(self) -> None:
        """Leave the bus."""
        self._link.close()


def _filters(can_ids: set[int]) -> list[tuple[int, int]]:
    return [(can_id, 0x7FF) for can_id in sorted(can_ids)]
