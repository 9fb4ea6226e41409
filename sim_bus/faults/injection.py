"""Injection of a fault file on a virtual bus: table rows, resets, and the records of injections."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from coulombus.eds.cia301 import NmtCommand
from coulombus.host.cycle.step import SOURCE_HOST
from coulombus.sim_bus.can_bus.bus_state import ErrorKind, Stage
from coulombus.sim_bus.can_bus.cable_cut import MENDING, WHOLE, join, merged_faults, split, wire_of
from coulombus.sim_bus.can_bus.fault_confinement import CanState
from coulombus.sim_bus.can_bus.faults import NO_FRAME, fire, plan_alarm
from coulombus.sim_bus.can_bus.records import STATIONS
from coulombus.sim_bus.can_bus.stations import detach
from coulombus.sim_bus.can_bus.targets import CLIENT_ROWS, CLIENTS
from coulombus.sim_bus.faults.fault_file import FaultError, FaultPlan
from coulombus.sim_bus.faults.rows import begin_enabled, injections, install
from coulombus.sim_bus.network.network import TAP
from coulombus.wire.clock import set_clock

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


class Injection:
    """Injects the faults of `plan` on the bus of `world`, from now on: its times count from now.

    `on_fault` is called with the time and a text for each injection, before the frames around it
    are delivered.

    Raises
    ------
    coulombus.sim_bus.faults.fault_file.FaultError
        the file names a node that is not on this bus, or the bus takes no time
    """

    def __init__(
        self, world: VirtualNetwork, plan: FaultPlan, seed: int, on_fault: Callable[[int, str], None] | None = None
    ) -> None:
        if int(world.bus["bit_rate"][0]) == 0:
            raise FaultError(f"{plan.path}: a bus without bit times has no faults; leave --unpaced and socketcan out")
        self.plan, self._world, self._on_fault = plan, world, on_fault
        self._bus = world.bus[0]
        self._drifts: dict[int, int] = {}  # by station: the fault that causes its clock drift
        detach(self._bus, TAP)
        world.keep_sent()
        now_ns = world.t_ns
        self._later = install(self._bus, plan, seed, *stations_of(world), now_ns)
        if self._later and not len(world.axes):
            key = ("fault", plan.faults[self._later[0][0]], "after")
            raise plan.mistake(key, "this bus has no rig whose drive is enabled; leave it out")
        for row, fault in enumerate(plan.file.fault):
            if fault.after == "start":
                self._plan(row, now_ns + round(fault.at_s * 1e9))
            if fault.kind == "drift" and self._bus.faults[row].station == CLIENTS:
                raise plan.mistake(
                    ("fault", plan.faults[row], "node"), "the host is another process here, with a clock of its own"
                )
        world.injection = self

    def _plan(self, row: int, t_ns: int) -> None:
        """Schedule Python's part of a fault: a reset, a drifting clock."""
        fault = self.plan.file.fault[row]
        if fault.kind == "reset" and fault.on is None:
            self._world.at(t_ns, lambda world: self._reset(world, row))
        elif fault.kind == "drift":
            self._world.at(t_ns, lambda world: self._drift(row, round(fault.ppm * 1e3), begins=True))
            if fault.duration_s is not None:
                self._world.at(t_ns + round(fault.duration_s * 1e9), lambda world: self._drift(row, 0))

    def enabled(self, t_ns: int) -> None:
        """Start the faults that count from Operation Enabled, which the drive has entered."""
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
            self._mark(now, f"the cable is cut (line {self.plan.lines[row]})")
        elif near.cut_row == row and now >= near.mend_ns:
            near.cut = MENDING
            if self._world.bus[1].stage == Stage.FREE:
                self.tell()
                join(self._world.bus, out, self._before, now)
                self._mark(now, f"the cable is repaired (line {self.plan.lines[row]})")

    def _mark(self, t_ns: int, text: str) -> None:
        if self._on_fault is not None:
            self._on_fault(t_ns, text)

    def act(self) -> None:
        """Perform the parts of a fault that the bus cannot: reset nodes, cut the cable."""
        calls, self._bus.fault_calls = int(self._bus.fault_calls), 0
        for row in range(len(self.plan.file.fault)):
            if calls >> row & 1:
                if self.plan.file.fault[row].kind == "cut":
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

    def tell(self) -> None:
        """Report the injections since the last call."""
        halves = self._world.bus.view(np.ndarray)  # a recarray looks each field up in Python
        if self._on_fault is not None:
            columns = [halves[name] for name in ("told_ns", "told_row", "told_id")]
            strikes: list[tuple[int, int, int]] = []
            for half, count in enumerate(halves["told"]):
                strikes += zip(*(column[half, :count].tolist() for column in columns), strict=True)
            for entry in sorted(strikes):
                self._tell_strike(*entry)
        halves["told"] = 0

    def _tell_strike(self, t_ns: int, row: int, can_id: int) -> None:
        what = "" if can_id == NO_FRAME else f" {can_id & 0x1FFFFFFF:X}h"
        self._mark(t_ns, f"fault {self.plan.file.fault[row].kind}{what} (line {self.plan.lines[row]})")

    def results(self) -> list[dict[str, Any]]:
        """Return the result of each fault of the file, for JSON."""
        rows = merged_faults(self._world.bus, self._before) if self._bus.cut else self._bus.faults
        return [asdict(result) for result in injections(rows, self.plan)]


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
