"""Assignment of node ids and bit rates by LSS, with a check for free ids and for the boot-up."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from coulombus.eds.cia301 import CobId, NmtCommand
from coulombus.host.devices.lss import Identity, LssMaster
from coulombus.host.devices.scan import scan
from coulombus.host.errors import DeviceMismatch, NodeMissing
from coulombus.wire.bus_link import BusFrame, FrameLink

__all__ = ["BOOT_S", "AssignedId", "check_free", "give", "only"]

BOOT_S = 5.0
"""Longest wait for a device's boot-up with its new node id."""
LAST = 127


@dataclass(frozen=True)
class AssignedId:
    """Result of an assignment to a device.

    Attributes
    ----------
    before : its earlier node id; None without one
    booted : whether its boot-up with the new id was heard; None if it need not boot
    boot_s : longest wait for the boot-up [s]
    """

    identity: Identity
    node_id: int | None
    before: int | None
    bit_s: int | None
    stored: bool
    booted: bool | None
    boot_s: float = BOOT_S

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            **self.identity._asdict(),
            "node_id": self.node_id,
            "before": self.before,
            "bitrate_bit_s": self.bit_s,
            "stored": self.stored,
            "booted": self.booted,
        }

    def __str__(self) -> str:
        parts = []
        if self.node_id is not None:
            was = "none" if self.before is None else str(self.before)
            parts.append(f"node id {self.node_id} (was {was})")
        if self.bit_s is not None:
            parts.append(f"{self.bit_s} bit/s from the next power-on")
        parts.append("stored" if self.stored else "not stored: it forgets it when it is switched off")
        if self.booted is not None:
            later = ": it has the id from its next power-on" if self.stored else ""
            parts.append("booted" if self.booted else f"no boot-up within {self.boot_s:g} s{later}")
        return f"{self.identity}: {', '.join(parts)}"


def only(identities: Sequence[Identity]) -> Identity:
    """Return the only device without a node id.

    Raises
    ------
    NodeMissing
        (exit status 5) there is no such device
    DeviceMismatch
        (3) there are several
    """
    if not identities:
        raise NodeMissing(
            "no device without a node id answers; one that has an id is named by --device (`scan` tells it)"
        )
    if len(identities) > 1:
        names = ", ".join(map(str, identities))
        raise DeviceMismatch(f"{len(identities)} devices have no node id ({names}); name one by --device, or say --all")
    return identities[0]


def check_free(link: FrameLink, ids: Sequence[int], show: Callable[[str], None]) -> None:
    """Refuse node ids that are out of range or in use on the bus.

    Raises
    ------
    DeviceMismatch
        (exit status 3)
    """
    if ids and ids[-1] > LAST:
        raise DeviceMismatch(f"{len(ids)} devices from {ids[0]} on need the node id {ids[-1]}; the last one is {LAST}")
    show("looking which node ids are free")
    ids_there = {answers.node_id for answers in scan(link, numbers=())} & set(ids)
    if ids_there:
        raise DeviceMismatch(f"a node on the bus has the node id {min(ids_there)} already; choose another one")


def give(
    master: LssMaster,
    link: FrameLink,
    identity: Identity,
    node_id: int | None,
    *,
    bit_s: int | None = None,
    store: bool = False,
    boot_s: float = BOOT_S,
) -> AssignedId:
    """Assign node id and bit rate to a device; wait up to `boot_s` for its boot-up with a new node id.

    Raises
    ------
    NodeMissing
        (exit status 5) no device has this identity, or it does not answer
    LssRefused, AnswerUntrusted
        (6) the device refused a setting, or its answer is not valid
    """
    master.select(identity)
    before = master.node_id()
    if node_id is not None:
        master.set_node_id(node_id)
    if bit_s is not None:
        master.set_bit_rate(bit_s)
    if store:
        master.store()
    master.wait_state()  # a device without a node id boots now
    booted = None
    if node_id is not None and node_id != before:
        if before is not None:
            link.send(CobId.NMT, bytes((NmtCommand.RESET_COMMUNICATION, before)))
        booted = _boots(link, node_id, boot_s)
    return AssignedId(identity, node_id, before, bit_s, store, booted, boot_s)


def _boots(link: FrameLink, node_id: int, boot_s: float) -> bool:
    def boot_up(frame: BusFrame) -> bool:
        return frame.can_id == CobId.HEARTBEAT + node_id and frame.data == b"\0"

    until_ns = link.now_ns() + round(boot_s * 1e9)
    while (frame := link.receive(until_ns)) is not None:
        if boot_up(frame):
            return True
    return False
