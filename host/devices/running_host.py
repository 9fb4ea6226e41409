"""Detection of a running host on a bus.

Services for devices are refused there, because a hand may be on the handle.
"""

from __future__ import annotations

from coulombus.eds.cia301 import CobId, NmtState
from coulombus.host.errors import SafetyTrip
from coulombus.host.run.control_socket import host_runs
from coulombus.wire.address import BusAddress
from coulombus.wire.bus_link import FrameLink

__all__ = ["FILTERS", "LISTEN_S", "check_alone", "who_is_at_work"]

LISTEN_S = 0.3
"""Time of listening: every host sends a SYNC within it."""
NODES = range(1, 128)
HOST_ID = 127
"""The host's node id in all packaged rigs."""
FILTERS = (
    *((CobId.SYNC, 0x7FF), (CobId.SDO_TX, 0x780), (CobId.SDO_RX, 0x780)),
    *((CobId.HEARTBEAT, 0x780), (CobId.LSS_TX, 0x7FE)),
)
"""Receive filters of a service for devices: SYNC, SDO, heartbeats, LSS, and no PDOs."""


def who_is_at_work(link: FrameLink, address: BusAddress, listen_s: float = LISTEN_S) -> str:
    """Return the evidence for a host on the bus; "" without any.

    A host of this machine has a control socket. Any host sends SDO requests in bring-up, and SYNC and its
    heartbeat (OPERATIONAL, node `HOST_ID`) in the cycle.
    """
    if host_runs(address):
        return "its control socket answers"
    while link.receive(link.now_ns()) is not None:  # older frames: their host may have ended since
        pass
    until_ns = link.now_ns() + round(listen_s * 1e9)
    while (frame := link.receive(until_ns)) is not None:
        if frame.can_id == CobId.SYNC:
            return "SYNC was heard"
        if frame.can_id == CobId.HEARTBEAT + HOST_ID and frame.data[:1] == bytes((NmtState.OPERATIONAL,)):
            return f"the heartbeat of node {HOST_ID} was heard, a host's, which is OPERATIONAL"
        if frame.can_id - CobId.SDO_RX in NODES or frame.can_id - CobId.SDO_TX in NODES:
            return "SDO transfers were heard"
    return ""


def check_alone(link: FrameLink, address: BusAddress, *, beside: bool = False) -> str:
    """Refuse a bus with a running host; with `beside`, return the evidence instead.

    Raises
    ------
    SafetyTrip
        (exit status 7) a host runs on the bus, and `beside` is False
    """
    host = who_is_at_work(link, address)
    if host and not beside:
        raise SafetyTrip(
            f"a host is on bus {address}: {host}; end it first (coulombus stop --bus {address}), or say --beside-host"
        )
    return host
