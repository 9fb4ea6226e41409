"""Communication objects of a node, 1000h-1FFFh: allowed writes, and the record that follows them.

The Python dictionary holds the objects; after a valid write `refresh` updates the record, the PDO
records and the routes of the identifiers. Each object is a row of `_REFRESHES`, and of `_CHECKS` (CiA 301,
section 7.5.2). PDO parameters have their own rules in `node.pdo_parameters`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from coulombus.eds.cia301 import Abort, CobId
from coulombus.eds.pdo import COMMUNICATION
from coulombus.node import core, guarding
from coulombus.node.dictionary import Dictionary
from coulombus.node.pdo_parameters import Pdos, restricted
from coulombus.node.profile import Profile, SdoAbort
from coulombus.node.record import MAX_CONSUMERS, MAX_HISTORY, MAX_SDO_SERVERS, NodeRecord
from coulombus.wire.clock import NEVER_NS

__all__ = ["PRODUCER", "SDO_SERVERS", "Communication"]

INVALID = CONSUMER = 1 << 31
PRODUCER = 1 << 30
EXTENDED = 1 << 29
SHORTEST_SYNC_US = 100
"""Shortest period of 1006h that a node can produce."""

SDO_SERVERS = range(0x1200, 0x1200 + MAX_SDO_SERVERS)

_IDENTIFIER = 0x7FF
_NMT_MASTER = 0x01


def _identifier(value: int) -> None:
    """Abort unless bits 0-29 of a COB-ID are an 11-bit identifier that may be configured."""
    if value & EXTENDED or value & 0x1FFFF800 or restricted(value & _IDENTIFIER):
        raise SdoAbort(Abort.VALUE)


def _sync_id(objects: Dictionary, index: int, subindex: int, value: int) -> None:
    before = objects.number(index)
    _identifier(value)
    if before & value & PRODUCER and (before ^ value) & _IDENTIFIER:
        raise SdoAbort(Abort.DEVICE_STATE)  # fixed while SYNC is produced


def _time_id(objects: Dictionary, index: int, subindex: int, value: int) -> None:
    before = objects.number(index)
    _identifier(value)
    if before & value & (CONSUMER | PRODUCER) and (before ^ value) & _IDENTIFIER:
        raise SdoAbort(Abort.DEVICE_STATE)  # fixed while TIME is consumed or produced


def _period(objects: Dictionary, index: int, subindex: int, value: int) -> None:
    if 0 < value < SHORTEST_SYNC_US:
        raise SdoAbort(Abort.VALUE)


def _overflow(objects: Dictionary, index: int, subindex: int, value: int) -> None:
    if value == 1 or value > 240:
        raise SdoAbort(Abort.VALUE)
    if objects.number(0x1006):
        raise SdoAbort(Abort.DEVICE_STATE)


def _emcy_id(objects: Dictionary, index: int, subindex: int, value: int) -> None:
    before = objects.number(index)
    if value & 0x7FFFF800 or (not value & INVALID and restricted(value & _IDENTIFIER)):  # bit 30 is reserved
        raise SdoAbort(Abort.VALUE)
    if not before & INVALID and not value & INVALID and (before ^ value) & _IDENTIFIER:
        raise SdoAbort(Abort.VALUE)  # it must be made invalid before the identifier changes


def _history(objects: Dictionary, index: int, subindex: int, value: int) -> None:
    if value:
        raise SdoAbort(Abort.VALUE)


def _consumer(objects: Dictionary, index: int, subindex: int, value: int) -> None:
    node_id, time_ms = value >> 16 & 0xFF, value & 0xFFFF
    if value >> 24 or (node_id > 127 and time_ms):
        raise SdoAbort(Abort.VALUE)
    if not node_id or not time_ms:
        return
    for other in range(1, MAX_CONSUMERS + 1):
        entry = objects.number(index, other)
        if other != subindex and entry & 0xFFFF and entry >> 16 & 0xFF == node_id:
            raise SdoAbort(Abort.PARAMETER_INCOMPATIBLE)


def _sdo_server(objects: Dictionary, index: int, subindex: int, value: int) -> None:
    if subindex not in (1, 2):
        return
    before = objects.number(index, subindex)
    if value & EXTENDED or value & 0x1FFFF800 or (not value & INVALID and restricted(value & _IDENTIFIER)):
        raise SdoAbort(Abort.VALUE)
    if not before & INVALID and not value & INVALID and (before ^ value) & _IDENTIFIER:
        raise SdoAbort(Abort.VALUE)
    for other in SDO_SERVERS:
        entry = objects.number(other, 1, INVALID)
        if subindex == 1 and other != index and not (value | entry) & INVALID and not (entry ^ value) & _IDENTIFIER:
            raise SdoAbort(Abort.PARAMETER_INCOMPATIBLE)  # a request would have two responses


def _startup(objects: Dictionary, index: int, subindex: int, value: int) -> None:
    if value & _NMT_MASTER:
        raise SdoAbort(Abort.VALUE)  # a device without an NMT master


_CHECKS: Mapping[int, Callable[[Dictionary, int, int, int], None]] = {
    0x1003: _history,
    0x1005: _sync_id,
    0x1006: _period,
    0x1012: _time_id,
    0x1014: _emcy_id,
    0x1016: _consumer,
    0x1019: _overflow,
    0x1F80: _startup,
    **dict.fromkeys(SDO_SERVERS, _sdo_server),
}
"""Index -> function that raises `SdoAbort` unless the value may be written now."""


class Communication:
    """The communication objects of a node, by its record."""

    def __init__(self, dictionary: Dictionary, node: NodeRecord, profile: Profile) -> None:
        self._dictionary = dictionary
        self._node = node
        self.pdos = Pdos(dictionary, node, profile)
        self._no_heartbeat = False
        described = dictionary.description.objects  # looked up often, and an EDS has one or two servers
        self._servers = [(k, index) for k, index in enumerate(SDO_SERVERS) if k == 0 or index in described]

    def sdo_servers(self) -> list[tuple[int, int, int]]:
        """Return the valid SDO servers: (number from 0, identifier of the requests, of the responses)."""
        number, node_id = self._dictionary.number, self._dictionary.node_id
        servers = []
        for k, index in self._servers:
            default = (CobId.SDO_RX + node_id, CobId.SDO_TX + node_id) if k == 0 else (INVALID, INVALID)
            rx, tx = number(index, 1, default[0]), number(index, 2, default[1])
            if not (rx | tx) & INVALID and rx & 0x7FF and tx & 0x7FF:
                servers.append((k, rx & 0x7FF, tx & 0x7FF))
        return servers

    def collect(self, index: int) -> None:
        """Copy the core's data (1003h) to the dictionary before it is read."""
        if index != 0x1003 or (index, 0) not in self._dictionary:
            return
        count = int(self._node["history_count"])
        self._dictionary[index, 0] = count
        for k in range(MAX_HISTORY):
            if (index, k + 1) in self._dictionary:
                self._dictionary[index, k + 1] = int(self._node["history"][k]) if k < count else 0

    def check(self, index: int, subindex: int, value: int) -> None:
        """Abort unless `value` may be written to a communication object now."""
        check = _CHECKS.get(index)
        if check is not None:
            check(self._dictionary, index, subindex, value)
        else:
            self.pdos.check(index, subindex, value)
        self._check_receiver(index, subindex, value)

    def _check_receiver(self, index: int, subindex: int, value: int) -> None:
        """Abort if two services would receive one identifier, which `_route` assigns to one of them; RPDOs may
        share an identifier.
        """
        route = _RECEIVERS.get(index)
        if route is None or subindex != (route in (core.ROUTE_SDO, core.ROUTE_PDO)):
            return
        listens = {core.ROUTE_SYNC: True, core.ROUTE_TIME: bool(value & CONSUMER)}.get(route, not value & INVALID)
        other = int(self._node["route"][value & 0x7FF])
        if core.ROUTE_PDO <= other < core.ROUTE_CONSUMER:
            other = core.ROUTE_PDO
        if listens and other not in (core.ROUTE_NONE, route):
            raise SdoAbort(Abort.PARAMETER_INCOMPATIBLE)

    def refresh(self, index: int, subindex: int, t_ns: int) -> None:
        """Update the record after an object was written at `t_ns`."""
        refresh = _REFRESHES.get(index)
        if refresh is not None:
            refresh(self, subindex, t_ns)
        place = self.pdos.locate(index)
        if place is None or self.pdos.refresh(place[0], place[1], t_ns):
            self._route()

    def stop_heartbeat(self, t_ns: int, stopped: bool) -> None:
        """Send no heartbeat from now on, as a faulty device, whatever 1017h is; or send them again."""
        if stopped != self._no_heartbeat:
            self._no_heartbeat = stopped
            self._refresh_heartbeat(0, t_ns)

    def refresh_all(self, t_ns: int) -> None:
        """Update the record from all communication objects (power-on, reset)."""
        for refresh in _REFRESHES.values():
            refresh(self, 0, t_ns)
        self.pdos.refresh_all(t_ns)
        self._route()

    def _refresh_sync(self, subindex: int, t_ns: int) -> None:
        node, number = self._node, self._dictionary.number
        cob_id, period_ns = number(0x1005, 0, CobId.SYNC), number(0x1006) * 1000
        producer_ns = period_ns if cob_id & PRODUCER and cob_id & 0x7FF else 0
        if node["sync_producer_ns"] != producer_ns:
            node["sync_producer_ns"] = producer_ns
            node["sync_next_ns"] = t_ns + producer_ns if producer_ns else NEVER_NS
            node["sync_counter"] = 0
        node["sync_id"] = cob_id & 0x7FF
        node["sync_window_ns"] = number(0x1007) * 1000
        if node["sync_overflow"] != number(0x1019):
            node["sync_overflow"] = number(0x1019)
            for k in range(int(node["tpdo_used"])):
                node["tpdo_count"][k] = -1 if node["tpdo"][k]["sync_start"] and node["sync_overflow"] else 0

    def _refresh_emcy(self, subindex: int, t_ns: int) -> None:
        cob_id = self._dictionary.number(0x1014, 0, INVALID)  # a device without 1014h sends none
        self._node["emcy_id"] = -1 if cob_id & INVALID or not cob_id & 0x7FF else cob_id & 0x7FF  # 0 is NMT's
        inhibit_ns = self._dictionary.number(0x1015) * 100_000
        self._node["emcy_inhibit_ns"] = inhibit_ns
        self._node["emcy_ready_ns"] = min(int(self._node["emcy_ready_ns"]), t_ns + inhibit_ns)

    def _refresh_history(self, subindex: int, t_ns: int) -> None:
        if self._dictionary.number(0x1003) == 0:
            self._node["history_count"] = 0

    def _refresh_consumers(self, subindex: int, t_ns: int) -> None:
        node = self._node
        entries = [self._dictionary.number(0x1016, k + 1) for k in range(MAX_CONSUMERS)]
        watched = [entry if entry >> 16 & 0xFF and entry & 0xFFFF else 0 for entry in entries]
        ids, times_ns, states = node["consumer_id"], node["consumer_ns"], node["consumer_state"]
        for k in range(MAX_CONSUMERS) if subindex == 0 else (subindex - 1,):
            ids[k] = watched[k] >> 16 & 0xFF
            times_ns[k] = (watched[k] & 0xFFFF) * 1_000_000
            states[k] = 0
        node["consumers_used"] = max((k + 1 for k, entry in enumerate(watched) if entry), default=0)

    def _refresh_heartbeat(self, subindex: int, t_ns: int) -> None:
        period_ns = 0 if self._no_heartbeat else self._dictionary.number(0x1017) * 1_000_000
        self._node["heartbeat_ns"] = period_ns
        self._node["heartbeat_next_ns"] = t_ns + period_ns if period_ns else NEVER_NS
        self._refresh_guarding(0, t_ns)

    def _refresh_guarding(self, subindex: int, t_ns: int) -> None:
        node, number = self._node, self._dictionary.number
        node["guard_on"] = number(0x1017) == 0
        node["guard_life_ns"] = min(number(0x100C) * number(0x100D) * 1_000_000, NEVER_NS) if node["guard_on"] else 0
        guarding.restart(node)

    def _refresh_time(self, subindex: int, t_ns: int) -> None:
        self._node["time_id"] = self._dictionary.number(0x1012) & 0x7FF

    def _refresh_error_behaviour(self, subindex: int, t_ns: int) -> None:
        self._node["error_behaviour"] = self._dictionary.number(0x1029, 1)
        self._node["device_error_behaviour"] = self._dictionary.number(0x1029, 2, 1)

    def _route(self) -> None:
        """Write the route of each identifier; if two claim the same identifier, the later line wins."""
        node = self._node
        node["rerouted"] = 1
        route, rtr = node["route"].view(np.ndarray), node["rtr_route"].view(np.ndarray)
        route[:] = core.ROUTE_NONE
        rtr[:] = core.ROUTE_NONE
        for k in range(int(node["consumers_used"])):
            if node["consumer_ns"][k]:
                route[CobId.HEARTBEAT + int(node["consumer_id"][k])] = core.ROUTE_CONSUMER + k
        node["rpdo_next"][:] = -1
        for k in reversed(range(int(node["rpdo_used"]))):
            can_id = int(node["rpdo"][k]["cob_id"])
            if can_id >= 0:
                if core.ROUTE_PDO <= route[can_id] < core.ROUTE_CONSUMER:
                    node["rpdo_next"][k] = int(route[can_id]) - core.ROUTE_PDO
                route[can_id] = core.ROUTE_PDO + k
        for k in range(int(node["tpdo_used"])):
            if node["tpdo"][k]["cob_id"] >= 0:
                rtr[int(node["tpdo"][k]["cob_id"])] = core.ROUTE_PDO + k
        rtr[CobId.HEARTBEAT + int(node["node_id"])] = core.ROUTE_GUARD
        if self._dictionary.number(0x1012) & CONSUMER:
            route[int(node["time_id"])] = core.ROUTE_TIME
        route[int(node["sync_id"])] = core.ROUTE_SYNC
        for _, rx, _ in self.sdo_servers():
            route[rx] = core.ROUTE_SDO
        route[CobId.LSS_RX] = core.ROUTE_LSS
        route[0x000] = core.ROUTE_NMT


_RECEIVERS: Mapping[int, int] = {
    0x1005: core.ROUTE_SYNC,
    0x1012: core.ROUTE_TIME,
    **dict.fromkeys(SDO_SERVERS, core.ROUTE_SDO),
    **dict.fromkeys(range(COMMUNICATION["rpdo"], COMMUNICATION["rpdo"] + 512), core.ROUTE_PDO),
}
"""Objects with the COB-ID of a received frame (from 1200h on in sub-index 1) -> route of the frame."""

_REFRESHES: Mapping[int, Callable[[Communication, int, int], None]] = {
    0x1003: Communication._refresh_history,
    0x1005: Communication._refresh_sync,
    0x1006: Communication._refresh_sync,
    0x1007: Communication._refresh_sync,
    0x100C: Communication._refresh_guarding,
    0x100D: Communication._refresh_guarding,
    0x1012: Communication._refresh_time,
    0x1014: Communication._refresh_emcy,
    0x1015: Communication._refresh_emcy,
    0x1016: Communication._refresh_consumers,
    0x1017: Communication._refresh_heartbeat,
    0x1019: Communication._refresh_sync,
    0x1029: Communication._refresh_error_behaviour,
}
