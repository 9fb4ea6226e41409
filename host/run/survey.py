"""Who is on a bus, and what they say of themselves: identity, modes, rated values, units.

Nothing is written to any device.

Every node id is asked for its device type (1000h) once; whoever answers is asked for the rest.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass

import can
import canopen

from coulombus.eds.cia301 import CobId
from coulombus.host.errors import SafetyTrip
from coulombus.wire.address import BusAddress, BusUnavailable

__all__ = ["ASKED", "TOLD", "Answers", "survey"]

ASKED = (
    *((0x1000, 0), (0x1018, 1), (0x1018, 2), (0x1018, 3)),
    *((0x6502, 0), (0x6075, 0), (0x6076, 0), (0x608F, 1), (0x608F, 2), (0x6410, 1)),
    *((0x6301, 1), (0x6302, 1), (0x6131, 1), (0x6132, 1)),
)
"""Numbers: device type, identity; a drive's modes, rated current and torque, encoder.

Units of CiA 404.
"""
TOLD = ((0x1008, 0), (0x1009, 0), (0x100A, 0))
"""Texts: the device's name, its hardware's and its software's version."""
NODES = range(1, 128)
LISTEN_S, ANSWER_S, PACE_S = 0.3, 0.3, 1e-3
UPLOAD = 0x40


@dataclass(frozen=True)
class Answers:
    """What one node said; an object that it does not have is missing."""

    node_id: int
    numbers: Mapping[tuple[int, int], int]
    texts: Mapping[tuple[int, int], str]

    @property
    def identity(self) -> tuple[int, int]:
        """Vendor id and product code, 1018h:01 and :02; 0 where it tells none."""
        return self.numbers.get((0x1018, 1), 0), self.numbers.get((0x1018, 2), 0)

    @property
    def profile(self) -> int:
        """The CANopen profile that 1000h tells, 402 for a drive."""
        return self.numbers.get((0x1000, 0), 0) & 0xFFFF

    def __str__(self) -> str:
        name = " ".join(self.texts[place] for place in TOLD if place in self.texts)
        vendor, product = self.identity
        return f"node {self.node_id}: {name or 'no name'}, CiA {self.profile}, 1018h {vendor:#010x} {product:#010x}"


def survey(address: BusAddress) -> tuple[Answers, ...]:
    """Return what each node of a bus says, by node ids.

    Raises
    ------
    BusUnavailable
        no such bus
    SafetyTrip
        a host is cycling there: whoever holds the handle is not to be disturbed
    """
    network = canopen.Network(bus=_open(address))
    heard: set[int] = set()
    network.subscribe(CobId.SYNC, lambda can_id, data, stamp: heard.add(can_id))
    for node_id in NODES:
        network.subscribe(CobId.SDO_TX + node_id, lambda can_id, data, stamp: heard.add(can_id))
    try:
        network.connect()
        time.sleep(LISTEN_S)
        if heard:
            what = "SYNC was" if CobId.SYNC in heard else "SDO transfers were"
            raise SafetyTrip(f"a host is on bus {address}: {what} heard; end it first (coulombus stop --bus {address})")
        for node_id in NODES:
            network.send_message(CobId.SDO_RX + node_id, bytes((UPLOAD, 0x00, 0x10, 0, 0, 0, 0, 0)))
            time.sleep(PACE_S)
        time.sleep(ANSWER_S)
        there = sorted(can_id - CobId.SDO_TX for can_id in heard if can_id != CobId.SYNC)
        return tuple(_asked(network, node_id) for node_id in there)
    except can.CanError as error:
        raise BusUnavailable(f"bus {address}: {error}") from None
    finally:
        with suppress(can.CanError, OSError):
            network.disconnect()


def _open(address: BusAddress) -> can.BusABC:
    filters = [{"can_id": can_id, "can_mask": mask, "extended": False} for can_id, mask in FILTERS]
    try:
        return can.Bus(interface=address.kind, channel=address.name, can_filters=filters)
    except (can.CanError, OSError) as error:
        raise BusUnavailable(str(error)) from None


FILTERS = ((CobId.SYNC, 0x7FF), (CobId.SDO_TX, 0x780))


def _asked(network: canopen.Network, node_id: int) -> Answers:
    node = network.add_node(node_id, canopen.ObjectDictionary())
    node.sdo.RESPONSE_TIMEOUT = ANSWER_S
    found = {}
    for place in (*ASKED, *TOLD):
        with suppress(canopen.SdoAbortedError, canopen.SdoCommunicationError):
            found[place] = bytes(node.sdo.upload(*place))
    numbers = {place: int.from_bytes(found[place], "little") for place in ASKED if 0 < len(found.get(place, b"")) <= 4}
    texts = {place: _text(found[place]) for place in TOLD if _text(found.get(place, b""))}
    return Answers(node_id, numbers, texts)


def _text(raw: bytes) -> str:
    return "".join(letter for letter in raw.decode("ascii", "replace") if letter.isprintable()).strip()[:60]
