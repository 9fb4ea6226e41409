"""Is somebody at work on this bus? Whoever holds the handle of a display is not to be disturbed."""

from __future__ import annotations

from coulombus.eds.cia301 import CobId, NmtState
from coulombus.host.errors import SafetyTrip
from coulombus.host.run.control_socket import host_runs
from coulombus.wire.address import BusAddress
from coulombus.wire.bus_link import FrameLink

__all__ = ["FILTERS", "LISTEN_S", "check_alone", "who_is_at_work"]

LISTEN_S = 0.3
"""A display has a SYNC at least so often."""
NODES = range(1, 128)
HOST_ID = 127
"""The host's node id in all packaged rigs."""
FILTERS = (
    *((CobId.SYNC, 0x7FF), (CobId.SDO_TX, 0x780), (CobId.SDO_RX, 0x780)),
    *((CobId.HEARTBEAT, 0x780), (CobId.LSS_TX, 0x7FE)),
)
"""What a service for devices takes of a bus: SYNC, SDO, heartbeats, LSS.

A flood of PDOs stays out.
"""


def who_is_at_work(link: FrameLink, address: BusAddress, listen_s: float = LISTEN_S) -> str:
    """Return what tells of a host on the bus, "" where nothing does.

    A host of this machine has its control socket. Another one sends SYNC in its cycle, its
    heartbeat (OPERATIONAL, of `HOST_ID`), and SDO requests before it.
    """
    if host_runs(address):
        return "its control socket answers"
    while link.receive(link.now_ns()) is not None:  # of before: it may have ended since
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
    """Refuse to go on where a host is at work; with `beside` only return what tells of it.

    Raises
    ------
    SafetyTrip
        (exit status 7) a host is there, and `beside` was not said
    """
    host = who_is_at_work(link, address)
    if host and not beside:
        raise SafetyTrip(
            f"a host is on bus {address}: {host}; end it first (coulombus stop --bus {address}), or say --beside-host"
        )
    return host
