"""Communication objects of a node, 1000h-1FFFh: what may be written, and the record that follows.

They stand in the Python dictionary; after a valid write `refresh` brings the record, the PDO records and the routes of
the identifiers up to them. Each object is a row of `_CHECKS` and `_REFRESHES`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from eds.cia301 import Abort
from node import core
from node.dictionary import Dictionary, SdoAbort
from node.mapping import Pdos, restricted
from node.records import FAR_FUTURE_NS, MAX_CONSUMERS, MAX_HISTORY, MAX_PDOS
from wire.frame import Records

__all__ = ["Communication"]

SYNC_PRODUCER = 1 << 30
EXTENDED = 1 << 29
INVALID = 1 << 31
SHORTEST_SYNC_US = 100
"""The shortest period of 1006h that a node produces."""


class Communication:
    """The communication objects of the node in row `i`."""

    def __init__(self, dictionary: Dictionary, nodes: Records, rpdo: Records, tpdo: Records, i: int) -> None:
        self._dictionary = dictionary
        self._node = nodes[i]
        self._rpdo = rpdo[i]
        self._tpdo = tpdo[i]
        self.pdos = Pdos(dictionary, nodes, rpdo, tpdo, i)

    @property
    def sdo_rx(self) -> int:
        """Identifier of the requests to the SDO server."""
        return self._dictionary.number(0x1200, 1, 0x600 + self._dictionary.node_id) & 0x7FF

    @property
    def sdo_tx(self) -> int:
        """Identifier of the responses of the SDO server."""
        return self._dictionary.number(0x1200, 2, 0x580 + self._dictionary.node_id) & 0x7FF

    def collect(self, index: int) -> None:
        """Bring what the core keeps (1003h) to the dictionary before it is read."""
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
            check(self, subindex, value)
        else:
            self.pdos.check(index, subindex, value)

    def refresh(self, index: int, subindex: int, t_ns: int) -> None:
        """Bring the record up to an object that was written at `t_ns`."""
        refresh = _REFRESHES.get(index)
        if refresh is not None:
            refresh(self, subindex, t_ns)
        place = self.pdos.locate(index)
        if place is not None:
            self.pdos.refresh(place[0], place[1], t_ns)
        self._route()

    def refresh_all(self, t_ns: int) -> None:
        """Bring the record up to all communication objects (power-on, reset)."""
        for refresh in _REFRESHES.values():
            refresh(self, 0, t_ns)
        self.pdos.refresh_all(t_ns)
        self._route()

    def _check_sync_id(self, subindex: int, value: int) -> None:
        before = self._dictionary.number(0x1005)
        producing = before & value & SYNC_PRODUCER
        if value & EXTENDED or value & 0x1FFFF800 or restricted(value & 0x7FF):
            raise SdoAbort(Abort.VALUE)
        if producing and (before ^ value) & 0x7FF:
            raise SdoAbort(Abort.DEVICE_STATE)  # the identifier stands while SYNC is produced

    def _check_period(self, subindex: int, value: int) -> None:
        if 0 < value < SHORTEST_SYNC_US:
            raise SdoAbort(Abort.VALUE)

    def _check_overflow(self, subindex: int, value: int) -> None:
        if value == 1 or value > 240:
            raise SdoAbort(Abort.VALUE)
        if self._dictionary.number(0x1006):
            raise SdoAbort(Abort.DEVICE_STATE)

    def _check_emcy_id(self, subindex: int, value: int) -> None:
        before = self._dictionary.number(0x1014)
        if value & EXTENDED or value & 0x1FFFF800 or (not value & INVALID and restricted(value & 0x7FF)):
            raise SdoAbort(Abort.VALUE)
        if not before & INVALID and not value & INVALID and (before ^ value) & 0x7FF:
            raise SdoAbort(Abort.VALUE)  # to be made invalid before the identifier changes

    def _check_history(self, subindex: int, value: int) -> None:
        if value:
            raise SdoAbort(Abort.VALUE)

    def _check_consumer(self, subindex: int, value: int) -> None:
        node_id, time_ms = value >> 16 & 0xFF, value & 0xFFFF
        if value >> 24 or (node_id > 127 and time_ms):
            raise SdoAbort(Abort.VALUE)
        if not node_id or not time_ms:
            return
        for other in range(1, MAX_CONSUMERS + 1):
            entry = self._dictionary.number(0x1016, other)
            if other != subindex and entry & 0xFFFF and entry >> 16 & 0xFF == node_id:
                raise SdoAbort(Abort.PARAMETER_INCOMPATIBLE)

    def _refresh_sync(self, subindex: int, t_ns: int) -> None:
        node, number = self._node, self._dictionary.number
        cob_id, period_ns = number(0x1005, 0, 0x80), number(0x1006) * 1000
        producer_ns = period_ns if cob_id & SYNC_PRODUCER else 0
        if node["sync_producer_ns"] != producer_ns:
            node["sync_producer_ns"] = producer_ns
            node["sync_next_ns"] = t_ns + producer_ns if producer_ns else FAR_FUTURE_NS
            node["sync_counter"] = 0
        node["sync_id"] = cob_id & 0x7FF
        if node["sync_overflow"] != number(0x1019):
            node["sync_overflow"] = number(0x1019)
            for k in range(MAX_PDOS):
                node["tpdo_count"][k] = -1 if self._tpdo[k]["sync_start"] and node["sync_overflow"] else 0

    def _refresh_emcy(self, subindex: int, t_ns: int) -> None:
        cob_id = self._dictionary.number(0x1014, 0, 0x80 + self._dictionary.node_id)
        self._node["emcy_id"] = -1 if cob_id & INVALID else cob_id & 0x7FF
        self._node["emcy_inhibit_ns"] = self._dictionary.number(0x1015) * 100_000

    def _refresh_history(self, subindex: int, t_ns: int) -> None:
        if self._dictionary.number(0x1003) == 0:
            self._node["history_count"] = 0

    def _refresh_consumers(self, subindex: int, t_ns: int) -> None:
        for k in range(MAX_CONSUMERS):
            if subindex in (0, k + 1):
                entry = self._dictionary.number(0x1016, k + 1)
                watched = entry >> 16 & 0xFF and entry & 0xFFFF
                self._node["consumer_id"][k] = entry >> 16 & 0xFF if watched else 0
                self._node["consumer_ns"][k] = (entry & 0xFFFF) * 1_000_000 if watched else 0
                self._node["consumer_state"][k] = 0

    def _refresh_heartbeat(self, subindex: int, t_ns: int) -> None:
        period_ns = self._dictionary.number(0x1017) * 1_000_000
        self._node["heartbeat_ns"] = period_ns
        self._node["heartbeat_next_ns"] = t_ns + period_ns if period_ns else FAR_FUTURE_NS

    def _refresh_error_behaviour(self, subindex: int, t_ns: int) -> None:
        self._node["error_behaviour"] = self._dictionary.number(0x1029, 1)

    def _route(self) -> None:
        """Write which identifier means what; where two claim one, the later line wins."""
        node = self._node
        route, rtr = node["route"], node["rtr_route"]
        route[:] = core.ROUTE_NONE
        rtr[:] = core.ROUTE_NONE
        for k in range(MAX_CONSUMERS):
            if node["consumer_ns"][k]:
                route[0x700 + int(node["consumer_id"][k])] = core.ROUTE_CONSUMER + k
        node["rpdo_next"][:] = -1
        for k in reversed(range(MAX_PDOS)):
            can_id = int(self._rpdo[k]["cob_id"])
            if can_id >= 0 and self._rpdo[k]["count"]:
                if core.ROUTE_PDO <= route[can_id] < core.ROUTE_CONSUMER:
                    node["rpdo_next"][k] = int(route[can_id]) - core.ROUTE_PDO
                route[can_id] = core.ROUTE_PDO + k
            if self._tpdo[k]["cob_id"] >= 0:
                rtr[int(self._tpdo[k]["cob_id"])] = core.ROUTE_PDO + k
        route[int(node["sync_id"])] = core.ROUTE_SYNC
        route[self.sdo_rx] = core.ROUTE_SDO
        route[0x000] = core.ROUTE_NMT


_CHECKS: Mapping[int, Callable[[Communication, int, int], None]] = {
    0x1003: Communication._check_history,
    0x1005: Communication._check_sync_id,
    0x1006: Communication._check_period,
    0x1014: Communication._check_emcy_id,
    0x1016: Communication._check_consumer,
    0x1019: Communication._check_overflow,
}

_REFRESHES: Mapping[int, Callable[[Communication, int, int], None]] = {
    0x1003: Communication._refresh_history,
    0x1005: Communication._refresh_sync,
    0x1006: Communication._refresh_sync,
    0x1014: Communication._refresh_emcy,
    0x1015: Communication._refresh_emcy,
    0x1016: Communication._refresh_consumers,
    0x1017: Communication._refresh_heartbeat,
    0x1019: Communication._refresh_sync,
    0x1029: Communication._refresh_error_behaviour,
}
