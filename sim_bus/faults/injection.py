"""Injection of faults on a virtual bus, from a file or while it runs: table rows, devices, and the records of strikes."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from coulombus.eds.cia301 import NmtCommand
from coulombus.host.cycle.step import SOURCE_HOST
from coulombus.sim_bus.can_bus.cable_cut import APART, MENDING, SEVERAL, WHOLE, join, merged_faults, split, wire_of
from coulombus.sim_bus.can_bus.fault_confinement import CanState
from coulombus.sim_bus.can_bus.faults import NO_FRAME, fire, plan_alarm
from coulombus.sim_bus.can_bus.noise import renew, seeded
from coulombus.sim_bus.can_bus.records import CLIENT_ROWS, CLIENTS, MAX_FAULTS, STATIONS, ErrorKind, Stage
from coulombus.sim_bus.can_bus.stations import detach, refresh
from coulombus.sim_bus.faults.fault_file import FaultError, FaultPlan
from coulombus.sim_bus.faults.fault_kinds import AnyFault, Drift, NodeFault, OtherNodeId
from coulombus.sim_bus.faults.rows import Injected, begin_enabled, install, restart_usually, result_of
from coulombus.sim_bus.network.device_faults import OF_MECHANICS, device_faults_of, inject, renumber
from coulombus.sim_bus.network.network import TAP
from coulombus.wire.clock import NEVER_NS, set_clock

if TYPE_CHECKING:
    from coulombus.sim_bus.network.network import VirtualNetwork

__all__ = ["Injection", "controllers_of", "stations_of"]


def stations_of(world: VirtualNetwork) -> tuple[dict[str, int], dict[int, int]]:
    """Return the stations of a bus by name and by node id: of a rig ``motor``, ``brake``, sensors
    (``AXIS.motor`` with several axes), of other nodes the node id as text; and ``host``.

    If the host is another process, it is one of the clients, and ``host`` means all clients.
    """
    node_ids = {world.devices[row].node_id: row for row in world.rows.values()}
    return {**world.rows, "host": SOURCE_HOST if world.has_host else CLIENTS}, node_ids


@dataclass
class _Standing:
    """A fault in a row of the table.

    Attributes
    ----------
    line : of the file; None: it was injected while the bus ran
    where : the node, or "bus"
    node_id : of the node before it booted with another
    began, ended : whether Python's part acts; whether the fault is over
    """

    fault: AnyFault
    line: int | None
    where: str
    since_ns: int
    node_id: int = 0
    began: bool = False
    ended: bool = False

    @property
    def place(self) -> str:
        """Origin of the fault, for a marker."""
        return "injected" if self.line is None else f"line {self.line}"


class Injection:
    """Faults on the bus of `world`: those of `plan` from now on, and those that `add` injects later.

    Times count from the injection. `on_fault` is called with the time and a text for each strike, before the frames
    around it are delivered. A plan removes the bus's silent analyser (`sim_bus.network.network.TAP`).

    Raises
    ------
    coulombus.sim_bus.faults.fault_file.FaultError
        the file names a node that is not on this bus, or the bus takes no time
    """

    def __init__(
        self,
        world: VirtualNetwork,
        plan: FaultPlan | None,
        seed: int,
        on_fault: Callable[[int, str], None] | None = None,
    ) -> None:
        self._world, self._on_fault, self._seed = world, on_fault, seed
        self._bus = world.bus[0]
        self._entries: list[_Standing] = []  # by row
        self._past: list[Injected] = []
        self._drifts: dict[int, int] = {}  # by station: the fault that causes its clock drift
        self._later: list[tuple[int, int]] = []
        self._before: Any = None
        if plan is None:
            self._bus.noise.state = seeded(seed)
            restart_usually(self._bus, stations_of(world)[0])
        else:
            if int(self._bus.bit_rate) == 0:
                raise FaultError(
                    f"{plan.path}: a bus without bit times has no faults; leave --unpaced and socketcan out"
                )
            detach(self._bus, TAP)
            world.keep_sent()
            self._install(plan, range(len(plan.file.fault)))
        world.injection = self

    def _install(self, plan: FaultPlan, rows: Sequence[int], where: str = "") -> None:
        """Write the faults of a plan to rows of the table, and schedule them from now on."""
        now_ns, live = self._world.t_ns, bool(where)
        later = install(self._bus, plan, self._seed, *stations_of(self._world), now_ns, rows if live else None)
        if later and not len(self._world.axes):
            key = ("fault", plan.faults[later[0][0]], "after")
            raise plan.mistake(key, "this bus has no rig whose drive is enabled; leave it out")
        self._later += later
        for n, (row, fault) in enumerate(zip(rows, plan.file.fault, strict=True)):
            line = None if live else plan.lines[n]
            entry = _Standing(fault, line, where or str(getattr(fault, "node", "bus")), now_ns)
            self._entries[row : row + 1] = [entry]
            if fault.kind == "drift" and self._bus.faults[row].station == CLIENTS:
                key = ("fault", plan.faults[n], "node")
                raise plan.mistake(key, "the host is another process here, with a clock of its own")
            if fault.kind == "second_master":
                rpdo = self._world.nodes[stations_of(self._world)[1][_id_of(self._world, fault.node)]]["rpdo"][0]
                if rpdo["cob_id"] >= 0:
                    self._bus.faults[row].can_id, self._bus.faults[row].length = rpdo["cob_id"], rpdo["length"]
            if fault.after == "start":
                self._plan(row, now_ns + round(fault.at_s * 1e9))

    def add(self, plan: FaultPlan, where: str) -> str:
        """Inject the one fault of `plan` at `where`, from now on, and return its text.

        Raises
        ------
        FaultError
            it acts already, or cannot act on this bus
        """
        (fault,) = plan.file.fault
        self._check(fault, where)
        self.report()
        row = next((row for row, entry in enumerate(self._entries) if entry.ended), len(self._entries))
        if row == MAX_FAULTS:
            raise FaultError(f"{row} faults act already; clear some")
        if row < len(self._entries):
            self._past.append(self._result(row))
        for wire in self._wires():
            wire.faults[row : row + 1] = np.zeros(1, wire.faults.dtype)
        self._install(plan, (row,), where)
        if self._bus.cut:
            far = self._world.bus[1]
            for faults in (far.faults, self._before):
                faults[row] = self._bus.faults[row]
            far.fault_count = self._bus.fault_count
            plan_alarm(far, self._world.t_ns)
            refresh(far)
        lasts_s = getattr(fault, "duration_s", None)
        text = f"inject {fault.kind} on {where}" + (f" for {lasts_s:g} s" if lasts_s is not None else "")
        self._mark(self._world.t_ns, text)
        return text

    def _check(self, fault: AnyFault, where: str) -> None:
        """Refuse a fault that acts already, or cannot act here."""
        for entry in self._standing():
            cut = entry.fault.kind == fault.kind == "cut"
            if cut or (entry.fault.kind, entry.where) == (fault.kind, where):
                since_s = (self._world.t_ns - entry.since_ns) * 1e-9
                raise FaultError(f"{fault.kind} on {entry.where} acts already, since {since_s:.1f} s; clear it first")
        if isinstance(fault, NodeFault):
            row = stations_of(self._world)[1].get(_id_of(self._world, fault.node), -1)
            possible = device_faults_of(self._world, row) if row >= 0 else (fault.kind,)
            if fault.kind not in possible:
                why = ": it has no mechanics" if fault.kind in OF_MECHANICS else ""
                raise FaultError(f"{where} cannot have the fault {fault.kind}{why}; it has {', '.join(possible)}")
        elif fault.kind != "other_node_id" and (int(self._bus.bit_rate) == 0 or self._bus.cut == SEVERAL):
            raise FaultError(f"{fault.kind} is a fault of the wire, and the bits of this bus are not simulated here")

    def _wires(self) -> list[Any]:
        """Return the bus, or the halves of the cut cable."""
        return list(self._world.bus[: 2 if self._bus.cut in (APART, MENDING) else 1])

    def _standing(self) -> list[_Standing]:
        """Return the faults that act, or will."""
        self._discard_ended()
        return [entry for entry in self._entries if not entry.ended]

    def standing(self) -> list[dict[str, Any]]:
        """Return the faults that act, or will, for JSON."""
        now_ns = self._world.t_ns
        return [
            {
                "fault": entry.fault.kind,
                "on": entry.where,
                "since_s": (now_ns - entry.since_ns) * 1e-9,
                "for_s": getattr(entry.fault, "duration_s", None),
            }
            for entry in self._standing()
        ]

    def clear(self, kind: str = "", where: str = "") -> list[str]:
        """End the faults of a kind, or of a place, or all; return their texts."""
        texts = []
        self._expire()
        for row, entry in enumerate(self._entries):
            if not entry.ended and kind in ("", entry.fault.kind) and where in ("", entry.where):
                self._end(row)
                texts.append(f"clear {entry.fault.kind} on {entry.where}")
                self._mark(self._world.t_ns, texts[-1])
        self._discard_ended()
        return texts

    def _expire(self) -> None:
        """Note the faults whose time is over, and those that have struck once."""
        for row, entry in enumerate(self._entries):
            f = self._bus.faults[row]
            once = entry.fault.kind == "reset" and entry.fault.on is None and f.fired > 0
            cut = entry.fault.kind == "cut" and (self._bus.cut == WHOLE and f.fired > 0 and not f.framed)
            timed = entry.fault.kind != "cut" and f.from_ns < NEVER_NS and f.until_ns <= self._world.t_ns
            if timed and not entry.ended:
                self._stop(row)  # its own event may be due at this very time
            entry.ended = entry.ended or once or cut or timed

    def _end(self, row: int) -> None:
        """End a fault now."""
        entry, now_ns = self._entries[row], self._world.t_ns
        self._stop(row)
        entry.ended = True
        self._later = [(other, after_ns) for other, after_ns in self._later if other != row]
        for wire in self._wires():
            f = wire.faults[row]
            f.until_ns, f.active = min(int(f.until_ns), now_ns), 0
            if entry.fault.kind == "cut" and self._bus.cut == APART and self._bus.cut_row == row:
                f.next_ns = self._bus.mend_ns = now_ns
            else:
                f.next_ns = NEVER_NS
            renew(wire, now_ns)
            plan_alarm(wire, now_ns)
            refresh(wire)

    def _discard_ended(self) -> None:
        """Free the last rows of the table: a bus without faults is fast."""
        self._expire()
        if self._bus.cut in (APART, MENDING) or not (self._entries and self._entries[-1].ended):
            return
        self.report()  # the strikes of their rows
        while self._entries and self._entries[-1].ended:
            self._past.append(self._result(len(self._entries) - 1))
            self._entries.pop()
        self._bus.fault_count = len(self._entries)
        refresh(self._bus)

    def _result(self, row: int) -> Injected:
        rows = merged_faults(self._world.bus, self._before) if self._bus.cut in (APART, MENDING) else self._bus.faults
        return result_of(rows[row], self._entries[row].fault.kind, self._entries[row].line)

    def _plan(self, row: int, t_ns: int) -> None:
        """Schedule Python's part of a fault: a reset, a drifting clock, a fault of a device."""
        entry = self._entries[row]
        fault = entry.fault

        def begin(_: VirtualNetwork) -> None:
            if not entry.ended:
                self._start(row)

        def end(_: VirtualNetwork) -> None:
            if not entry.ended:
                self._stop(row)
                entry.ended = entry.line is None

        if fault.kind == "reset" and fault.on is None:
            self._world.at(t_ns, lambda world: None if entry.ended else self._reset(world, row))
        elif isinstance(fault, Drift | NodeFault | OtherNodeId):
            self._world.at(t_ns, begin)
            if fault.duration_s is not None:
                self._world.at(t_ns + round(fault.duration_s * 1e9), end)

    def _start(self, row: int) -> None:
        """Begin Python's part of a fault."""
        entry = self._entries[row]
        world, fault, station = self._world, entry.fault, int(self._bus.faults[row].station)
        entry.began = True
        if isinstance(fault, Drift):
            self._drift(row, round(fault.ppm * 1e3), begins=True)
            return
        fire(self._bus, row, world.t_ns, NO_FRAME)
        if isinstance(fault, OtherNodeId):
            entry.node_id = world.devices[station].node_id
            renumber(world, station, fault.node_id)
        else:
            inject(world, station, fault.kind, True)

    def _stop(self, row: int) -> None:
        """End Python's part of a fault, if it has begun."""
        entry, station = self._entries[row], int(self._bus.faults[row].station)
        if not entry.began:
            return
        entry.began = False
        if isinstance(entry.fault, Drift):
            self._drift(row, 0)
        elif isinstance(entry.fault, OtherNodeId):
            renumber(self._world, station, entry.node_id)
        elif isinstance(entry.fault, NodeFault):
            inject(self._world, station, entry.fault.kind, False)

    def enabled(self, t_ns: int) -> None:
        """Start the faults that count from Operation Enabled, which the drive has entered."""
        if not self._later:
            return
        begin_enabled(self._bus, self._later, t_ns)
        for row, after_ns in self._later:
            self._plan(row, t_ns + after_ns)
        self._later = []

    def _cut(self, row: int) -> None:
        """Cut the cable, or repair it; one cut at a time, and only while the wire is idle."""
        near, now, fault = self._bus, self._world.t_ns, self._bus.faults[row]
        out = self._world.out
        if near.cut == WHOLE and near.stage != Stage.FREE:  # the frame on the wire ends first
            fault.next_ns = now
            plan_alarm(near, now)
        elif near.cut == WHOLE:
            if not fault.framed:
                fire(near, row, now, NO_FRAME)
            self._before = split(self._world.bus, out, row, now)
            self._mark(now, f"the cable is cut ({self._entries[row].place})")
        elif near.cut_row == row and now >= near.mend_ns:
            near.cut = MENDING
            if self._world.bus[1].stage == Stage.FREE:
                self.report()
                join(self._world.bus, out, self._before, now)
                self._mark(now, f"the cable is repaired ({self._entries[row].place})")

    def _mark(self, t_ns: int, text: str) -> None:
        if self._on_fault is not None:
            self._on_fault(t_ns, text)

    def act(self) -> None:
        """Perform the parts of a fault that the bus cannot: reset nodes, cut the cable."""
        calls, self._bus.fault_calls = int(self._bus.fault_calls), 0
        for row, entry in enumerate(self._entries):
            if calls >> row & 1:
                if entry.fault.kind == "cut":
                    self._cut(row)
                else:
                    self._reset(self._world, row, count=False)

    def _reset(self, world: VirtualNetwork, row: int, *, count: bool = True) -> None:
        """Reset a node at once; its pending frames are dropped."""
        station = int(self._bus.faults[row].station)
        if count:
            fire(self._bus, row, world.t_ns, NO_FRAME)
        if 0 <= station < len(world.devices):
            world.withdraw(station)
            world.nmt_command(station, NmtCommand.RESET_NODE)

    def _drift(self, row: int, ppb: int, *, begins: bool = False) -> None:
        """Let a node's clock run fast or slow from now on."""
        world, station = self._world, int(self._bus.faults[row].station)
        if begins:
            fire(self._bus, row, world.t_ns, NO_FRAME)
            self._drifts[station] = row
        elif self._drifts[station] != row:  # the next drift has begun at the same time
            return
        if station == SOURCE_HOST:
            world.set_host_clock(ppb)
        else:
            set_clock(world.nodes[station], world.t_ns, ppb)

    def report(self) -> None:
        """Report the injections since the last call."""
        halves = self._world.bus.view(np.ndarray)  # a recarray looks each field up in Python
        if self._on_fault is not None:
            columns = [halves[name] for name in ("told_ns", "told_row", "told_id")]
            strikes: list[tuple[int, int, int]] = []
            for half, count in enumerate(halves["told"]):
                strikes += zip(*(column[half, :count].tolist() for column in columns), strict=True)
            for entry in sorted(strikes):
                self._report_strike(*entry)
        halves["told"] = 0

    def _report_strike(self, t_ns: int, row: int, can_id: int) -> None:
        what = "" if can_id == NO_FRAME else f" {can_id & 0x1FFFFFFF:X}h"
        if row < len(self._entries):
            entry = self._entries[row]
            self._mark(t_ns, f"fault {entry.fault.kind}{what} ({entry.place})")

    def results(self) -> list[dict[str, Any]]:
        """Return the result of each fault, those of the file first, for JSON."""
        now = [self._result(row) for row in range(len(self._entries))]
        return [asdict(result) for result in sorted((*now, *self._past), key=lambda result: result.line or math.inf)]


def _id_of(world: VirtualNetwork, node: str | int) -> int:
    """Return the node id of a node, which has it already or by its name."""
    return node if isinstance(node, int) else world.devices[world.rows[node]].node_id


def controllers_of(world: VirtualNetwork) -> dict[str, dict[str, Any]]:
    """Return the CAN controllers' states and counters by node, for JSON.

    If clients act as the host: their worst state, and the sums.
    """
    stations, _ = stations_of(world)
    counters = ("retransmissions", "arbitration_lost", "dropped", "passives", "bus_offs", "restarts")
    out = {}
    for name, station in stations.items():
        rows = range(CLIENT_ROWS.start, CLIENT_ROWS.stop) if station == CLIENTS else (station % STATIONS,)
        each = [wire_of(world.bus, row).stations[row] for row in rows]
        out[name] = {
            "state": CanState(max(int(c.state) for c in each)).name.lower().replace("_", "-"),
            **{key: max(int(c[key]) for c in each) for key in ("tec", "rec")},
            **{key: sum(int(c[key]) for c in each) for key in counters},
            "errors": {kind.name.lower(): sum(int(c.errors[kind]) for c in each) for kind in ErrorKind},
        }
    return out
