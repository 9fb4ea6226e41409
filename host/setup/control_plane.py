"""The slow side of a bus in real time: `canopen` over python-can, on a socket of its own."""

from __future__ import annotations

import time
from collections.abc import Iterable
from contextlib import suppress
from typing import Any

import can
import canopen

from coulombus.eds.cia301 import CobId
from coulombus.host.errors import HostError, SafetyTrip
from coulombus.rigs.rig import Rig
from coulombus.wire.address import BusAddress, BusUnavailable

__all__ = ["RealControlPlane"]


class _Errors(can.Listener):
    """Takes the receiving thread's errors, which would end in a traceback otherwise."""

    def __init__(self) -> None:
        self.error: Exception | None = None

    def on_message_received(self, msg: can.Message) -> None:
        pass

    def on_error(self, exc: Exception) -> None:
        self.error = exc

    def stop(self) -> None:
        pass


def _open(address: BusAddress, can_ids: Iterable[int]) -> can.BusABC:
    filters: Any = [{"can_id": can_id, "can_mask": 0x7FF, "extended": False} for can_id in sorted(can_ids)]
    try:
        if address.is_virtual:
            from coulombus.wire.can_interface import CoulombusBus

            return CoulombusBus(address.name, can_filters=filters)
        return can.Bus(interface="socketcan", channel=address.name, can_filters=filters)
    except (can.CanError, OSError) as error:
        raise BusUnavailable(str(error)) from None


class RealControlPlane:
    """The control plane of `rig` on the bus at `address`.

    Implements `host.setup.bringup.ControlPlane`.

    It takes SDO responses, EMCY and heartbeats only: the PDOs are the data plane's.

    Raises
    ------
    coulombus.wire.address.BusUnavailable
        no such bus
    """

    def __init__(self, rig: Rig, address: BusAddress) -> None:
        self._address = address
        self.sdo_timeout_s = rig.host.sdo_timeout_s
        self._host_id = rig.host.node_id
        nodes = [node.node_id for node in rig.nodes]
        self._own = {base + node for base in (CobId.SDO_TX, CobId.HEARTBEAT) for node in nodes}
        self._own |= {node.emcy_id for node in rig.nodes}
        self._foreign = {CobId.SYNC: "SYNC", CobId.HEARTBEAT + self._host_id: f"the heartbeat of node {self._host_id}"}
        self.heard: str | None = None
        self._nmt: dict[int, int] = {}
        bus = _open(address, self._own | set(self._foreign))
        self.network = canopen.Network(bus=bus)
        self._errors = _Errors()
        self.network.listeners.append(self._errors)
        self.network.NOTIFIER_CYCLE = 0.1
        for can_id in self._foreign:
            self.network.subscribe(can_id, self._hear)
        for node in nodes:
            self.network.subscribe(CobId.HEARTBEAT + node, self._heartbeat)
        self.network.connect()

    def _hear(self, can_id: int, data: bytearray, stamp: float) -> None:
        self.heard = self._foreign[can_id]

    def _heartbeat(self, can_id: int, data: bytearray, stamp: float) -> None:
        if len(data) == 1:
            self._nmt[can_id & 0x7F] = data[0] & 0x7F

    def check_alone(self, until_s: float) -> None:
        """Listen until `time.monotonic()` is `until_s`.

        Then listen no more for SYNC, which this host is to send.

        Raises
        ------
        SafetyTrip
            another host is on the bus
        """
        while self.heard is None and time.monotonic() < until_s:
            time.sleep(0.01)
        if self.heard is not None:
            raise SafetyTrip(
                f"another host is on bus {self._address}: {self.heard} was heard; end it first (coulombus stop --bus {self._address})"
            )
        for can_id in self._foreign:
            self.network.unsubscribe(can_id, self._hear)
        bus = self.network.bus
        bus.set_filters([{"can_id": can_id, "can_mask": 0x7FF, "extended": False} for can_id in sorted(self._own)])

    @property
    def lost(self) -> str | None:
        """Why nothing is received any more, None while all is well."""
        return None if self._errors.error is None else str(self._errors.error)

    def wait_ns(self, duration_ns: int) -> None:
        """Let time pass; frames are received by `canopen`'s thread."""
        time.sleep(duration_ns * 1e-9)

    def nmt_state(self, node_id: int) -> int | None:
        """Return the NMT state that the node's last heartbeat told."""
        return self._nmt.get(node_id)

    def close(self) -> None:
        """Leave the bus."""
        with suppress(can.CanError, OSError, HostError):  # `disconnect` tells the thread's error again
            self.network.disconnect()
