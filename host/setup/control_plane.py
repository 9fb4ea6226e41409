"""The control plane of a host in real time, on its own connection to each of its buses."""

from __future__ import annotations

import select
import time
from collections import deque
from collections.abc import Callable
from typing import TypeVar

from coulombus.eds.cia301 import CobId
from coulombus.host.errors import SafetyTrip
from coulombus.rigs.rig import Rig
from coulombus.wire.address import BusAddress, BusUnavailable
from coulombus.wire.bus_link import BusFrame, BusLink

__all__ = ["RealControlPlane"]

T = TypeVar("T")

KEPT = 256
"""Largest number of frames that wait for `receive`; beyond it, the oldest are dropped."""


class RealControlPlane:
    """The control plane of `rig` on the buses at `addresses`, in the order of `Rig.channels`.

    Implements `host.setup.bringup.ControlPlane`.

    It receives only SDO responses, EMCY and heartbeats; the data plane receives the PDOs. What it sends to
    a node goes to the node's bus, and all else to every bus.

    Raises
    ------
    coulombus.wire.address.BusUnavailable
        a bus does not exist; later: it disappeared, or accepts no frame. The others serve further calls.
    """

    def __init__(self, rig: Rig, *addresses: BusAddress) -> None:
        self.sdo_timeout_s = rig.host.sdo_timeout_s
        self._links: list[BusLink] = []
        self._link_of: dict[int, BusLink] = {}  # by the identifier of a frame to a node
        host_id = rig.host.node_id
        self._foreign = {CobId.SYNC: "SYNC", CobId.HEARTBEAT + host_id: f"the heartbeat of node {host_id}"}
        self._nmt: dict[int, int] = {}
        self._waiting: deque[BusFrame] = deque(maxlen=KEPT)
        self._own: dict[BusLink, set[int]] = {}
        try:
            for channel, address in zip(rig.channels, addresses, strict=True):
                self._join(rig, channel, address)
        except BaseException:
            self.close()
            raise

    def _join(self, rig: Rig, channel: str, address: BusAddress) -> None:
        nodes = [node for node in rig.nodes if node.channel == channel]
        identifiers = {base + node.node_id for base in (CobId.SDO_TX, CobId.HEARTBEAT) for node in nodes}
        identifiers |= {node.emcy_id for node in nodes}
        link = BusLink(address, _filters(identifiers | set(self._foreign)))
        self._links.append(link)
        self._own[link] = identifiers
        for node in nodes:
            for base in (CobId.SDO_RX, CobId.HEARTBEAT):  # the latter for node guarding
                self._link_of[base + node.node_id] = link

    def check_alone(self, until_s: float) -> None:
        """Listen for another host until `time.monotonic()` is `until_s`; then filter SYNC out, which this
        host sends itself.

        Raises
        ------
        SafetyTrip
            another host is on the bus
        """
        while (heard := self._next(round(until_s * 1e9))) is not None:
            link, frame = heard
            if frame.can_id in self._foreign:
                raise SafetyTrip(
                    f"another host is on bus {link.address}: {self._foreign[frame.can_id]} was heard; "
                    f"end it first (coulombus stop --bus {link.address})"
                )
            self._note(frame)
        for link in self._links:
            link.set_filters(_filters(self._own[link]))

    def _next(self, until_ns: int) -> tuple[BusLink, BusFrame] | None:
        """Return the next frame of any bus, and its bus; None at `until_ns`."""
        while True:
            for link in self._links:
                frame = self._tried(link, lambda link=link: link.receive(0))  # type: ignore[misc]
                if frame is not None:
                    return link, frame
            left_ns = until_ns - self.now_ns()
            if left_ns <= 0:
                return None
            select.select(self._links, [], [], left_ns / 1e9)

    def _tried(self, link: BusLink, what: Callable[[], T]) -> T:
        """Call `what`; a bus that fails is left out from then on, unless it is the only one."""
        try:
            return what()
        except BusUnavailable:
            if len(self._links) > 1:
                self._links.remove(link)
                link.close()
            raise

    # a link, for the SDO client

    def now_ns(self) -> int:
        """Return the monotonic time."""
        return time.monotonic_ns()

    def send(self, can_id: int, data: bytes = b"", length: int | None = None) -> None:
        """Send a frame."""
        link = self._link_of.get(can_id & 0x7FF)
        if link is not None and link not in self._links:
            raise BusUnavailable(f"bus {link.address}: lost")
        lost: BusUnavailable | None = None
        for to in self._links[:] if link is None else [link]:
            try:
                self._tried(to, lambda to=to: to.send(can_id, data, length))  # type: ignore[misc]
            except BusUnavailable as error:  # the others have it all the same
                lost = error
        if lost is not None:
            raise lost

    def receive(self, until_ns: int) -> BusFrame | None:
        """Return the next frame, or None if none arrives until `until_ns`."""
        if self._waiting:
            return self._waiting.popleft()
        heard = self._next(until_ns)
        if heard is None:
            return None
        self._note(heard[1])
        return heard[1]

    def wait_ns(self, duration_ns: int) -> None:
        """Wait; arriving frames are kept for `receive`.

        Raises
        ------
        coulombus.wire.address.BusUnavailable
            the bus disappeared
        """
        until_ns = self.now_ns() + duration_ns
        while (heard := self._next(until_ns)) is not None:
            self._note(heard[1])
            self._waiting.append(heard[1])

    def _note(self, frame: BusFrame) -> None:
        if frame.can_id & ~0x7F == CobId.HEARTBEAT and len(frame.data) == 1:
            self._nmt[frame.can_id & 0x7F] = frame.data[0] & 0x7F

    def nmt_state(self, node_id: int) -> int | None:
        """Return the NMT state in the node's last heartbeat; None before the first."""
        return self._nmt.get(node_id)

    def close(self) -> None:
        """Leave the buses."""
        for link in self._links:
            link.close()


def _filters(can_ids: set[int]) -> list[tuple[int, int]]:
    return [(can_id, 0x7FF) for can_id in sorted(can_ids)]
