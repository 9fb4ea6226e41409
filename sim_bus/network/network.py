"""CANopen network in virtual time: a bit-true bus, any number of devices, and stations in Python.

It is for tests, conformance runs and fuzzers. Nothing sleeps, no thread runs, and the same calls
give the same frames to the nanosecond::

    from coulombus.eds.cia301 import NmtCommand
    from coulombus.sim_bus.network.network import VirtualNetwork

    network = VirtualNetwork(bitrate_bit_s=500_000)
    device = network.add("eds/motor.eds", 5)              # any EDS; profile=DRIVE402 or BRAKE404 for ours
    tester = network.station()                            # hears every frame; station({0x585}): only this identifier
    network.power_on()                                    # all devices; they send their boot-ups
    network.wait_ns(10_000_000)
    assert tester.take(0x705)[0].data == b"\\0"

    tester.send(0x000, bytes((NmtCommand.START, 5)))      # now; at_ns=... for later
    tester.send(0x605, bytes.fromhex("4017100000000000"))
    assert tester.wait_for(0x585, timeout_ns=10_000_000) is not None
    device[0x6064, 0]                                     # read an object, or write it as the device itself does

A station can answer at once: ``network.station(on_frame=lambda frame: ...)`` is called with each
`Heard` at its end of frame, and may `send`. ``network.at(t_ns, action)`` calls ``action(network)``
at a time; `run_until` takes a condition that ends it earlier. Devices are switched with `power_on`
and `power_off`; ``network.canopen()`` is a `canopen.Network` on this bus (its SDO requests let
virtual time pass). The constructor's ``on_frames`` receives every batch of sent frames as FRAME
records, for recordings.

Cost: a frame costs nothing for devices that do not receive it, and a frame that no Python station
hears does not enter Python. So name a station's identifiers where speed matters. A device whose EDS
is refused raises `eds.reader.EdsError`.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Collection, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, Self

import numpy as np

from coulombus.eds.cia301 import NmtCommand
from coulombus.eds.cia305 import UNCONFIGURED
from coulombus.eds.reader import Description, read_eds
from coulombus.host.cycle.records import LawFunction, PlaneFunctions
from coulombus.host.cycle.step import SOURCE_HOST
from coulombus.kernels.decorator import Entry
from coulombus.kernels.records import RecordArray, Records
from coulombus.node.device import Device
from coulombus.node.kinds import GENERIC
from coulombus.node.profile import Profile
from coulombus.node.record import new_nodes
from coulombus.rigs.arguments import a_number, path_text
from coulombus.sim_bus.can_bus.arbiter import new_bus
from coulombus.sim_bus.can_bus.cable_cut import divide, wire_of
from coulombus.sim_bus.can_bus.error_path import detailed_address
from coulombus.sim_bus.can_bus.stations import attach, detach
from coulombus.sim_bus.can_bus.tx_queue import withdraw
from coulombus.sim_bus.network.attached_axes import AttachedAxes, with_load, without_mechanics
from coulombus.sim_bus.network.deadline_tree import IDENTIFIERS, new_deadlines, new_wants
from coulombus.sim_bus.network.event_loop import (
    LOG_FRAMES,
    MOST_DEVICES,
    WORLD,
    Exit,
    HostCycle,
    World,
    run,
)
from coulombus.sim_bus.network.python_stations import Heard, Station
from coulombus.sim_bus.rig.coupling import brake_torque
from coulombus.sim_bus.rig.plant_step import CourseFunction, course_of
from coulombus.sim_bus.rig.records import PlantRecord, RigAxis
from coulombus.system.stop_signals import InterruptsHeld
from coulombus.wire.clock import NEVER_NS, own_ns, to_bus
from coulombus.wire.frame import Queue, data_bytes, data_word, frames, new_queue, push

if TYPE_CHECKING:
    from coulombus.sim_bus.network.canopen_station import CanopenNetwork

__all__ = ["Heard", "Station", "VirtualNetwork"]

CAPACITY = 16
OBSTACLE_Nm = 1e6
FIRST_STATION, MOST_STATIONS = 192, 62
"""Station numbers of Python's stations: devices have their rows, clients of a bus in real time start at
128, the host is -1.
"""
TAP = 254
"""A station that only acknowledges, so that a device alone on the bus does not repeat one frame for ever; a
fault file removes it.
"""


class FaultSource(Protocol):
    """The network's interface to the faults on the bus (`sim_bus.faults.injection.Injection`)."""

    def act(self) -> None:
        """Perform the parts of a fault that the bus cannot."""

    def report(self) -> None:
        """Report the injections since the last call."""

    def enabled(self, t_ns: int) -> None:
        """Handle the drive's entry into Operation Enabled."""

    def results(self) -> list[dict[str, Any]]:
        """Return the result of each fault."""


class VirtualNetwork:
    """A bus in virtual time with its devices and stations.

    Parameters
    ----------
    bitrate_bit_s : any number; 0: a frame takes no time; several: a bus each (`VirtualNetwork.place`)
    capacity : largest number of devices, at most 127
    on_frames : called with each batch of frames (FRAME records, end-of-frame stamps) after they
    were sent
    """

    def __init__(
        self,
        bitrate_bit_s: int | Sequence[int] = 1_000_000,
        *,
        capacity: int = CAPACITY,
        on_frames: Callable[[Records], None] | None = None,
        mechanics: AttachedAxes | None = None,
    ) -> None:
        rates = tuple(bitrate_bit_s) if isinstance(bitrate_bit_s, tuple | list) else (bitrate_bit_s,)
        for rate in rates:
            a_number(rate, "bitrate_bit_s", "500_000", whole=True)
            if rate < 0:
                raise ValueError(f"bitrate_bit_s {rate}; expected bit/s, as in 500_000, or 0: frames take no time")
        if not 0 <= capacity <= MOST_DEVICES:
            raise ValueError(f"capacity {capacity}; expected 0 to {MOST_DEVICES} devices")
        self.exits = dict.fromkeys(Exit, 0)
        self.devices: list[Device] = []
        self.injection: FaultSource | None = None
        self.opened: tuple[str, ...] = ()
        """Changes of the devices from their EDS files, a line each (`node.relaxed_eds`)."""
        self.rows: dict[str, int] = {}
        """Row of each device by its name, here its node id."""
        self.on_frames = on_frames
        self._stations: list[Station] = []
        self._script: list[tuple[int, int, Callable[[Any], None]]] = []
        self._planned = 0

        self.nodes = new_nodes(capacity)
        self.bus = new_bus(*rates)
        self._out = new_queue()
        self._log = frames(LOG_FRAMES)
        self._listening = np.zeros(IDENTIFIERS, np.int8)
        self._world = np.zeros(1, WORLD)  # read often in Python: a recarray looks each field up in Python
        w = self._world[0]
        w["script_ns"], w["force_end_ns"], w["stale"], w["host_elsewhere"] = NEVER_NS, NEVER_NS, 1, mechanics is None
        m = mechanics or without_mechanics(capacity)
        self.axis_of = m.axis_of
        self._attach(m.axes, m.plant)
        state = self._world.view(np.recarray)[0]
        world = World(
            state,
            self.bus,
            self._out,
            self._log,
            self.nodes,
            new_deadlines(capacity),
            new_wants(capacity),
            self._listening,
            m.axes,
            m.axis_of,
            m.plant,
            m.f_h,
            m.truth,
        )
        self._arguments = (world, m.host, m.law_function, course_of(m.plant), m.arm)
        for wire in self.bus[: len(rates)]:
            for station in (TAP, *([] if mechanics is None else [SOURCE_HOST])):
                attach(wire, station)
        self._run = Entry(run)

    @property
    def arguments(self) -> tuple[World, HostCycle, LawFunction, CourseFunction, PlaneFunctions | None]:
        """Arguments of `sim_bus.network.event_loop.run`.

        Python may have changed the records since the last run.
        """
        self._world["stale"] = 1
        return self._arguments

    @property
    def out(self) -> Queue:
        """Frames requested since the bus last read the queue: the argument of `wire.frame.push`."""
        return self._out

    # participants

    def add(self, eds: Description | str | Path, node_id: int, profile: Profile = GENERIC, **options: Any) -> Device:
        """Add a switched-off device to the bus, and return it; `options` are those of
        `node.device.Device`.

        Raises
        ------
        coulombus.eds.reader.EdsError
            the file is no EDS
        ValueError
            the network has no room, or the node id is taken or out of range
        """
        row = len(self.devices)
        if row >= len(self.nodes):
            raise ValueError(f"the network has room for {row} devices; make it with capacity={min(2 * row + 2, 127)}")
        if node_id != UNCONFIGURED and any(device.node_id == node_id for device in self.devices):
            raise ValueError(f"node id {node_id} is taken")
        a_number(node_id, "node_id", "5", whole=True)
        description = eds if isinstance(eds, Description) else read_eds(Path(path_text(eds, "eds", 'add("my.eds", 5)')))
        self.devices.append(Device(description, node_id, profile, self.nodes[row], **options))
        self.rows[str(node_id)] = row
        return self.devices[row]

    def attach_load(self, row: int, plant: RecordArray[PlantRecord]) -> None:
        """Put a plant that no hand holds on the shaft of the drive in a row (`sim_bus.rig.shaft_load`), from now on."""
        world, host, law_function, _, arm = self._arguments
        world = with_load(world, row, plant)
        self._arguments = (world, host, law_function, course_of(world.plant), arm)
        self._attach(world.axes, world.plant)

    def _attach(self, axes: RecordArray[RigAxis], plants: RecordArray[PlantRecord]) -> None:
        self.axes, self.plant = axes, plants
        # plain arrays: a recarray looks each field up in Python
        self._axes = axes.view(np.ndarray)
        self._outputs = self.nodes.view(np.ndarray), plants.view(np.ndarray)

    def block(self, row: int, blocked: bool = True) -> None:
        """Hold the axis of the device in a row with an obstacle, or free it."""
        self.plant[int(self.axis_of[row])]["obstacle_Nm"] = OBSTACLE_Nm if blocked else 0.0

    def place(self, station: int, bus: int) -> None:
        """Put a device, by its row, or another station, by its number, on one of several buses; it is off."""
        self.bus["stations"]["half"][:, station] = bus

    def station(
        self, can_ids: Collection[int] | None = None, on_frame: Callable[[Heard], None] | None = None
    ) -> Station:
        """Add a station that hears the frames `can_ids` (11-bit identifiers; None: every frame) of other
        stations.

        `on_frame` is called with each of them at its end of frame; without it they are collected in
        `Station.heard`.
        """
        if len(self._stations) >= MOST_STATIONS:
            raise ValueError(f"the network has {MOST_STATIONS} stations already")
        identifiers = None if can_ids is None else frozenset(can_ids)
        station = Station(self, FIRST_STATION + len(self._stations), identifiers, on_frame)
        self._stations.append(station)
        attach(self.bus[0], station.number)
        if identifiers is None:
            self._listening[:] = 1
            self._world["listen_all"] = 1
        else:
            self._listening[list(identifiers)] = 1
        return station

    def canopen(self, sdo_timeout_s: float = 1.0) -> CanopenNetwork:
        """Return a `canopen.Network` on this bus.

        Add nodes to it, and let time pass with `wait_ns`.
        """
        from coulombus.sim_bus.network.canopen_station import CanopenNetwork  # canopen loads for half a second

        return CanopenNetwork(self, sdo_timeout_s)

    # time

    @property
    def t_ns(self) -> int:
        """Present time in ns."""
        return int(self._world["t_ns"][0])

    @property
    def has_host(self) -> bool:
        """Whether the host is part of this process."""
        return False

    def keep_sent(self) -> None:
        """Store the host's requested frames from now on: a fault may drop them on the bus."""
        self._world["keep_sent"] = 1

    def set_host_clock(self, ppb: int) -> None:
        """Let the host's clock run fast by `ppb` (1e-9) from now on; a network without a host has none."""

    @property
    def plain(self) -> bool:
        """Whether the network has only devices and a host: no station, no fault, no script entry."""
        return not (self._stations or self._script) and self.injection is None

    def wait_ns(self, duration_ns: int) -> None:
        """Let `duration_ns` pass."""
        self.run_until(self.t_ns + duration_ns)

    def run_until(self, t_ns: int, condition: Callable[[], bool] | None = None) -> None:
        """Run to `t_ns`, or until `condition` holds after an exit of the kernel."""
        self._world["until_ns"] = t_ns
        self._actuate()
        self._run.load(*self._arguments)  # a signal may end it here: compiling may take half a minute
        with InterruptsHeld() as interrupts:
            while True:
                reason = Exit(self._run(*self.arguments))
                self.exits[reason] += 1
                self.answer(reason)
                interrupts.pass_on()
                if reason is Exit.UNTIL or (condition is not None and condition()):
                    return

    def load_detail(self) -> None:
        """Compile the bus's detailed path, or load it from the cache, before a frame needs it."""
        self.bus["detailed"] = detailed_address()

    def at(self, t_ns: int, action: Callable[[Self], None]) -> None:
        """Schedule `action(network)` at the virtual time `t_ns`, as a script entry."""
        heapq.heappush(self._script, (t_ns, self._planned, action))
        self._planned += 1
        self._world["script_ns"] = self._script[0][0]

    # the kernel's exits

    def answer(self, why: int) -> None:
        """Handle an exit of the kernel (`sim_bus.network.event_loop.Exit`), at the present time."""
        if why == Exit.SERVICE:
            self._serve()
        elif why == Exit.LOG:
            self.flush()
        elif why == Exit.DETAIL:
            self.load_detail()
        elif why == Exit.FAULT and self.injection is not None:
            self.injection.act()
        elif why == Exit.SCRIPT:
            _, _, action = heapq.heappop(self._script)
            self._world["script_ns"] = self._script[0][0] if self._script else NEVER_NS
            action(self)
        self._actuate()

    def _actuate(self) -> None:
        """Apply device outputs that a service or a script has changed from now on: the plants are at the present
        time.
        """
        if not len(self._axes):
            return
        motors, brakes = self._axes["motor"], self._axes["brake"]
        outputs, plant = self._outputs
        plant["reverse_A"] = outputs["out_reverse_A"][brakes]
        plant["motor_pm"] = outputs["out_torque_pm"][motors]
        plant["brake_Nm"] = outputs["out_brake_Nm"][brakes]
        for a in np.flatnonzero(self._axes["foreign"]).tolist():
            self.plant[a].brake_Nm = brake_torque(self.axes[a], self.nodes[int(brakes[a])])

    def _serve(self) -> None:
        """Pass the last frame of the log to the devices' services and to its receiving stations."""
        w = self._world[0]
        frame = self._log[int(w["log_count"]) - 1]
        t_ns, can_id = int(frame["t_ns"]), int(frame["can_id"])
        length, word, source = int(frame["length"]), int(frame["word"]), int(frame["source"])
        self.serve(w["service"][: int(w["services"])].tolist(), t_ns, can_id, length, word)
        if w["control_plane"]:
            self._control_plane(t_ns, can_id, data_bytes(word, length))
        if (
            w["heard"] and not wire_of(self.bus, source).half
        ):  # Python's stations are in the first half, on the first bus
            heard = Heard(t_ns, can_id, length, data_bytes(word, length), source)
            for station in self._stations:
                if station.number != source and (station.can_ids is None or can_id in station.can_ids):
                    station.hear(heard)

    def serve(self, rows: Collection[int], t_ns: int, can_id: int, length: int, word: int) -> None:
        """Pass a frame to the services of the devices in some rows."""
        for row in rows:
            self._by_its_clock(row, self.devices[row].service, t_ns, can_id, length, word)

    def _control_plane(self, t_ns: int, can_id: int, data: bytes) -> None:
        """Process a frame for the host's control plane; a network without a host has none."""

    def flush(self) -> None:
        """Deliver the frames sent since the last call."""
        count = int(self._world["log_count"][0])
        self._world["log_count"] = 0
        if self.injection is not None:
            self.injection.report()
        self.hand_over(count)

    def hand_over(self, count: int) -> None:
        """Deliver the first log rows to the recorder."""
        if self.on_frames is not None and count:
            self.on_frames(self._log[:count])

    # the devices

    def power_on(self, device: int | None = None) -> None:
        """Switch all devices on, or the device of a row; a device that is on stays on."""
        for row, node in enumerate(self.devices):
            if device in (None, row) and not node.record["powered"]:
                attach(wire_of(self.bus, row), row)
                self._by_its_clock(row, node.power_on, self.t_ns)

    def power_off(self, device: int) -> None:
        """Switch the device of a row off; its pending frames are dropped."""
        self.devices[device].power_off()
        self.withdraw(device)
        detach(wire_of(self.bus, device), device)

    def withdraw(self, device: int) -> None:
        """Remove the pending frames of the device of a row."""
        if self.bus[0].cut:
            divide(self.bus, self._out)
        withdraw(wire_of(self.bus, device), self._out, device)

    def nmt_command(self, device: int, command: NmtCommand | int) -> None:
        """Let the device of a row process an NMT command addressed to it."""
        self._by_its_clock(device, self.devices[device].nmt_command, self.t_ns, command)

    def _by_its_clock(self, row: int, act: Callable[..., None], t_ns: int, *arguments: Any) -> None:
        """Call a device's `act` at its local time (`node.own_time`)."""
        node, first = self.devices[row].record, int(self._out["count"])
        if not node["clock_on"]:
            act(t_ns, *arguments, self._out)
        else:
            act(int(own_ns(node, t_ns)), *arguments, self._out)
            to_bus(node, self._out, first)

    def send(self, can_id: int, data: bytes = b"", length: int | None = None) -> None:
        """Queue a frame of the host's control plane; `length` gives the DLC of a remote frame."""
        size = len(data) if length is None else length
        push(self._out, SOURCE_HOST, self.t_ns, can_id, size, data_word(data))
