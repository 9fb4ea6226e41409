"""Conversion of a fault plan to rows of the bus's tables: its faults, and its stations' controllers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from coulombus.rigs.toml_lines import Key
from coulombus.sim_bus.can_bus.fault_confinement import MANUAL
from coulombus.sim_bus.can_bus.faults import FaultKind, plan_alarm
from coulombus.sim_bus.can_bus.noise import seeded
from coulombus.sim_bus.can_bus.records import ALL, CLIENT_ROWS, CLIENTS, STATIONS, BusRecord, FaultRecord
from coulombus.sim_bus.can_bus.stations import refresh
from coulombus.sim_bus.faults.fault_file import FaultPlan
from coulombus.sim_bus.faults.fault_kinds import (
    BASES,
    BIT_NAMES,
    OF_NO_NODE,
    RESTART_MS,
    AnyFault,
    Babble,
    Cut,
    Delay,
    Drift,
    Flip,
    Lasting,
    NodeFault,
    Noise,
    OnFrame,
    OtherNodeId,
    Reset,
    SecondMaster,
    SlowSdo,
    Trigger,
)
from coulombus.wire.clock import NEVER_NS
from coulombus.wire.frame import CAN_EFF_FLAG, CAN_RTR_FLAG, data_word

__all__ = ["Injected", "begin_enabled", "install", "restart_usually", "result_of"]

HOST_ROW = 255
_TABLED = {"slow_sdo": FaultKind.DELAY, "second_master": FaultKind.BABBLE}
"""What the bus does for kinds that are no `FaultKind`."""
SOURCE_HOST = -1


@dataclass(frozen=True)
class Injected:
    """Result of a fault of the file."""

    kind: str
    line: int | None  # None: it was injected while the bus ran
    times: int
    first_s: float | None
    last_s: float | None


class _StationNumbers:
    """Station numbers of the nodes named in a file."""

    def __init__(self, plan: FaultPlan, stations: Mapping[str, int], node_ids: Mapping[int, int]) -> None:
        self.plan, self.stations, self.node_ids = plan, stations, node_ids

    def station(self, name: str | int | None, key: Key) -> int:
        """Return the station of a node, `ALL` for None."""
        if name is None:
            return ALL
        row = self.node_ids.get(name) if isinstance(name, int) else self.stations.get(name)
        if row is None:
            names = ", ".join([*self.stations, *map(str, self.node_ids)])
            raise self.plan.mistake(key, f"there is no node {name!r} on this bus; it has {names}")
        return row

    def node_id(self, name: str | int, key: Key) -> int:
        """Return the node id of a node."""
        if isinstance(name, int):
            return name
        station = self.station(name, key)
        for node_id, other in self.node_ids.items():
            if other == station:
                return node_id
        raise self.plan.mistake(key, f"'{name}' has no node id; name the sender with sender = \"{name}\"")


def _match(row: FaultRecord, on: Trigger, nodes: _StationNumbers, key: Key) -> None:
    flags = (CAN_EFF_FLAG if on.extended else 0) | (CAN_RTR_FLAG if on.remote else 0)
    if on.can_id is not None:
        if on.can_id > 0x7FF:
            flags |= CAN_EFF_FLAG
        row.match_id, row.match_mask = on.can_id | flags, 0xFFFFFFFF
    elif on.frame is not None:
        name = on.frame.upper()
        row.match_id, row.match_mask = BASES[name] | flags, 0xFFFFFFFF
        if name not in OF_NO_NODE:
            if on.node is None:
                row.match_mask = 0xFFFFFF80
            else:
                row.match_id |= nodes.node_id(on.node, (*key, "node"))
    row.framed, row.nth, row.every = 1, on.nth, on.every
    row.match_source = nodes.station(on.sender, (*key, "sender"))


def _at_one_time(a: Lasting, b: Lasting) -> bool:
    """Tell whether two faults may last at the same time.

    The time of Operation Enabled is unknown in advance.
    """
    if a.after != b.after:
        return True
    first, second = sorted((a, b), key=lambda fault: fault.at_s)
    return first.duration_s is None or round((first.at_s + first.duration_s) * 1e9) > round(second.at_s * 1e9)


def _refuse_twice(plan: FaultPlan, nodes: _StationNumbers) -> None:
    """Refuse duplicates in a file: two settings of a node's controller, or two drifts of a node's clock at
    one time.
    """
    entries: dict[int, int] = {}
    for n, controller in enumerate(plan.file.controller):
        key = ("controller", plan.controllers[n], "node")
        station = nodes.station(controller.node, key)
        if station in entries:
            line = plan.document.line(("controller", plan.controllers[entries[station]]))
            raise plan.mistake(
                key, f"{controller.node!r} has a [[controller]] in line {line} already; put all of it there"
            )
        entries[station] = n
    for n, fault in enumerate(plan.file.fault):
        for m, other in enumerate(plan.file.fault[:n]):
            if isinstance(fault, Drift) and isinstance(other, Drift):
                clocks = {
                    nodes.station(drift.node, ("fault", plan.faults[k], "node"))
                    for k, drift in ((m, other), (n, fault))
                }
                if len(clocks) == 1 and _at_one_time(fault, other):
                    text = f"the clock of {fault.node!r} drifts by line {plan.lines[m]} already; let one end before the other begins"
                    raise plan.mistake(("fault", plan.faults[n], "node"), text)


def install(
    bus: BusRecord,
    plan: FaultPlan,
    seed: int,
    stations: Mapping[str, int],
    node_ids: Mapping[int, int],
    now_ns: int = 0,
    into: Sequence[int] | None = None,
) -> list[tuple[int, int]]:
    """Write the faults of a file to the bus's table: its first rows, or those in `into`.

    Return (row, nanoseconds) of the faults that count from Operation Enabled.

    Parameters
    ----------
    bus : the record of `sim_bus.can_bus.records.BusRecord`
    seed : of the noise, if the file has none
    stations, node_ids : stations by name and by node id
    now_ns : present time of the bus, from which the faults' times count
    into : rows of faults that are injected while the bus runs: on all frames if none are selected

    Raises
    ------
    FaultError
        a named node is not on this bus, or the file has duplicates
    """
    nodes = _StationNumbers(plan, stations, node_ids)
    _refuse_twice(plan, nodes)
    places = range(len(plan.file.fault)) if into is None else into
    if into is None or plan.file.seed is not None:
        bus.noise.state = seeded(plan.file.seed if plan.file.seed is not None else seed)
    later = []
    for n, fault in enumerate(plan.file.fault):
        row, key = bus.faults[places[n]], ("fault", plan.faults[n])
        row.kind = int(_effect(fault))
        row.nth, row.every, row.most = 1, 0, 0
        row.match_source = row.station = ALL
        duration = getattr(fault, "duration_s", None)
        _what(row, fault, nodes, key)
        if isinstance(fault, OnFrame):
            row.most = fault.most
            if fault.on is not None:
                _match(row, fault.on, nodes, (*key, "on"))
            elif duration is not None or into is not None:
                row.every = 1
        elif isinstance(fault, Cut):
            row.most, row.lasts_ns = fault.most, NEVER_NS if duration is None else round(duration * 1e9)
            duration = None
            if fault.on is not None:
                _match(row, fault.on, nodes, (*key, "on"))
        length_ns = NEVER_NS if duration is None else round(duration * 1e9)
        if fault.after == "enabled":
            row.from_ns = row.next_ns = NEVER_NS
            row.until_ns = length_ns
            later.append((places[n], round(fault.at_s * 1e9)))
        else:
            _begin(row, now_ns + round(fault.at_s * 1e9), length_ns)
    bus.fault_count = max(int(bus.fault_count), *(row + 1 for row in places), 0)
    if into is None:
        restart_usually(bus, stations)
    for n, controller in zip(plan.controllers, plan.file.controller, strict=True):
        place: Key = ("controller", n)
        station = nodes.station(controller.node, (*place, "node"))
        if station == CLIENTS and controller.listen_only:
            raise plan.mistake(
                (*place, "listen_only"), "here each client says itself whether it listens only; leave it out"
            )
        c, rows = bus.stations, _rows(station)
        c["restart_ns"][rows] = MANUAL if controller.restart_ms == "manual" else round(controller.restart_ms * 1e6)
        for name in ("one_shot", "loopback", "queue_limit"):
            c[name][rows] = getattr(controller, name)
        if station != CLIENTS:
            c["listen_only"][rows] = controller.listen_only
    plan_alarm(bus, now_ns)
    refresh(bus)
    return later


def restart_usually(bus: BusRecord, stations: Mapping[str, int]) -> None:
    """Let the stations' controllers recover from bus-off after `RESTART_MS`."""
    for station in stations.values():
        bus.stations["restart_ns"][_rows(station)] = RESTART_MS * 1_000_000


def _rows(station: int) -> slice:
    """Return the rows of a station, or of all stations that it stands for."""
    row = station % STATIONS
    return CLIENT_ROWS if station == CLIENTS else slice(row, row + 1)


def _begin(row: FaultRecord, from_ns: int, length_ns: int) -> None:
    row.from_ns = from_ns
    row.next_ns = NEVER_NS if row.framed else from_ns
    row.until_ns = min(from_ns + length_ns, NEVER_NS)


def begin_enabled(bus: BusRecord, later: list[tuple[int, int]], now_ns: int) -> None:
    """Start the faults that count from Operation Enabled at `now_ns`."""
    for n, after_ns in later:
        row = bus.faults[n]
        _begin(row, now_ns + after_ns, int(row.until_ns))
    plan_alarm(bus, now_ns)
    refresh(bus)


def _effect(fault: AnyFault) -> FaultKind:
    """Return what the bus does for a fault: nothing for one of a device, which Python performs."""
    if isinstance(fault, NodeFault | OtherNodeId):
        return FaultKind.DRIFT
    return _TABLED[fault.kind] if fault.kind in _TABLED else FaultKind[fault.kind.upper()]


def _what(row: FaultRecord, fault: object, nodes: _StationNumbers, key: Key) -> None:
    """Set the effect and the target of a fault."""
    for name in ("seen_by", "lost_for", "node"):
        if getattr(fault, name, None) is not None:
            row.station = nodes.station(getattr(fault, name), (*key, name))
    host = row.station in (SOURCE_HOST, CLIENTS)
    if host and isinstance(fault, Reset | NodeFault | OtherNodeId | SlowSdo | SecondMaster):
        act = "be reset" if isinstance(fault, Reset) else "have this fault"
        raise nodes.plan.mistake((*key, "node"), f"the host cannot {act}; expected a node of the rig")
    if isinstance(fault, Babble) and host:
        row.station = SOURCE_HOST  # on a bus of clients, a separate station
    if isinstance(fault, Flip | Noise) and row.station not in (ALL, CLIENTS):
        row.station %= STATIONS  # the row of the controller that sees it: the host's is the last
    if isinstance(fault, Flip):
        row.bit = BIT_NAMES[fault.bit] if isinstance(fault.bit, str) else fault.bit
    elif isinstance(fault, Cut):
        named_before: set[int] = set()
        for half, named in enumerate(fault.halves or ([], _behind(fault.node, nodes, (*key, "node")))):
            for k, node in enumerate(named):
                station = nodes.station(node, (*key, "halves", half, k))
                station = HOST_ROW if station == CLIENTS else station % STATIONS
                if station in named_before:
                    raise nodes.plan.mistake((*key, "halves", half, k), f"{node!r} is named twice; name each node once")
                named_before.add(station)
                row.far[station] = half
        if row.far[HOST_ROW]:
            row.far[CLIENT_ROWS] = 1
    elif isinstance(fault, Delay):
        row.delay_ns = round(fault.delay_us * 1e3)
    elif isinstance(fault, Noise):
        row.rate = fault.rate
    elif isinstance(fault, Babble):
        data = bytes.fromhex(fault.data)
        row.can_id = fault.can_id | (CAN_EFF_FLAG if fault.extended or fault.can_id > 0x7FF else 0)
        row.length, row.word = len(data), data_word(data)
        row.period_ns = round(fault.period_us * 1e3)
    elif isinstance(fault, SlowSdo):
        row.delay_ns = round(fault.delay_ms * 1e6)
        _match(row, Trigger.model_validate({"frame": "SDO RESPONSE", "node": fault.node, "every": 1}), nodes, key)
    elif isinstance(fault, SecondMaster):
        row.station = SOURCE_HOST
        row.can_id, row.length = BASES["RPDO1"] + nodes.node_id(fault.node, (*key, "node")), 8
        row.period_ns = round(fault.period_us * 1e3)


def _behind(node: str | int | None, nodes: _StationNumbers, key: Key) -> list[str | int]:
    """Return a node and those behind it on the cable, in the order of the rig."""
    rows = sorted(row for row in nodes.stations.values() if row >= 0)
    first = nodes.station(node, key)
    if first < 0:
        raise nodes.plan.mistake(key, "the host is at the cable's begin; name the node behind the cut")
    names = {row: name for name, row in nodes.stations.items()}
    return [names[row] for row in rows if row >= first]


def result_of(row: FaultRecord, kind: str, line: int | None) -> Injected:
    """Return the result of a fault; `line` as in `Injected`."""
    times = int(row.fired)
    seconds = (int(row.first_ns) * 1e-9, int(row.last_ns) * 1e-9) if times else (None, None)
    return Injected(kind, line, times, *seconds)
