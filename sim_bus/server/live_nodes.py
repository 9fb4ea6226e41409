"""``coulombus node``: any EDS as a live node, on an existing bus or on its own bus.

The node has everything in the description: every object with its default, PDOs, SDO, NMT,
heartbeat, EMCY, LSS. It has no further behaviour, and each value stays as last written, unless the
file is one of our own devices' or a kind is selected. The kind "auto" is chosen by the file's
objects (`node.kinds.of_description`); limits relaxed for it (`node.relaxed_eds`) are reported.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Literal

from coulombus.eds.cia301 import CobId
from coulombus.eds.cia305 import UNCONFIGURED
from coulombus.eds.own_devices import identity_from_1018h
from coulombus.eds.reader import Description, read_eds
from coulombus.node.device import Device
from coulombus.node.drive402 import DRIVE402
from coulombus.node.hardware.io_file import read_io_file
from coulombus.node.hardware.pump import Pump
from coulombus.node.hardware.watchdog import Guard
from coulombus.node.kinds import of_description, of_identity
from coulombus.node.profile import Profile
from coulombus.node.relaxed_eds import completed, opened
from coulombus.node.standstill import Reason, StandstillWatch
from coulombus.node.store import FileStore, Store
from coulombus.sim_bus.network.network import Heard, VirtualNetwork
from coulombus.sim_bus.rig.shaft_load import Load, holding_pm, switch_counts
from coulombus.sim_bus.server.server import BusServer
from coulombus.sim_bus.server.sim_command import PRIORITY, run_sim
from coulombus.system.errors import CoulombusError
from coulombus.system.exit import printed, say, show
from coulombus.system.quoting import shell
from coulombus.wire.address import BusAddress

__all__ = ["LiveNodes", "NodeError", "run_nodes"]

BIT_RATE = 1_000_000
NO_OPTIONS = Load()
LOOK_NS = 100_000_000
"""Interval of the looks at drives that may rest for a reason."""


class NodeError(CoulombusError, ValueError):
    """Incompatible options; the text says what to do."""

    exit_status = 2


@dataclass
class LiveNodes:
    """Descriptions that become nodes, and their options.

    Attributes
    ----------
    eds : sequence of (path, node id); None: the node id of the file, a DCF
    kind : behaviour of all nodes; None: that of our own devices for their files, none for other
        files; "auto": as each file allows
    load : what each drive drives, unless `io` is given
    io : the I/O file of the converters behind a single node; None: a simulated rig, or nothing
    on_begin : called with the new server, before the nodes are switched on
    opened : changes of the nodes from their files, by file
    bit_rate : expected bit rate of the bus [bit/s]; 0: that of the DCFs, else 1 Mbit/s if it is
        served here
    node_ids : of the nodes
    switches : places of the switches on the axes of drives, as in the record; None: those of
        the load
    """

    eds: Sequence[tuple[Path, int | None]]
    kind: Profile | Literal["auto"] | None = None
    store: Path | None = None
    processing_us: float = 20.0
    as_json: bool = False
    bit_rate: int = 0
    io: Path | None = None
    load: Load = NO_OPTIONS
    descriptions: list[Description] = field(default_factory=list)
    told: set[tuple[str, int]] = field(default_factory=set)
    server: BusServer | None = None
    node_ids: list[int] = field(default_factory=list)
    opened: list[tuple[str, ...]] = field(default_factory=list)
    kinds: list[Profile] = field(default_factory=list)
    pump: Pump | None = None
    switches: tuple[float, float, float, float] | None = None
    on_begin: Callable[[BusServer], None] | None = None
    _watches: list[StandstillWatch] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.descriptions = [read_eds(path) for path, _ in self.eds]
        self._commission()
        ids = self.node_ids
        if len(set(ids) - {UNCONFIGURED}) < len(ids) - ids.count(UNCONFIGURED):
            raise NodeError(f"node ids {', '.join(map(str, ids))}: each node needs an id of its own")
        if self.store is not None and len(ids) > 1:
            raise NodeError(f"--store {self.store}: one file keeps one node; start a `coulombus node` for each")
        if self.store is not None and (
            (self.store.exists() and not self.store.is_file()) or not self.store.absolute().parent.is_dir()
        ):
            raise NodeError(f"--store {self.store}: expected a file in an existing directory")
        for (path, _), description in zip(self.eds, self.descriptions, strict=True):
            if description.diagnoses:
                number = len(description.diagnoses)
                diagnoses = f"{number} diagnos{'i' if number == 1 else 'e'}s"
                text = f"{diagnoses}, read tolerantly; see `coulombus eds check {shell(str(path))}`"
                say(f"coulombus: {path}: {text}")
        if self.io is not None and len(ids) > 1:
            raise NodeError(f"--io {self.io}: one file is for one node; start a `coulombus node` for each")
        self._open()
        self._watches = [StandstillWatch() for _ in ids]
        if self.io is not None:
            plan = read_io_file(self.io, self.descriptions[0], self.kinds[0])
            self.pump = Pump(plan, Guard, self._report_hardware)
        make_store = Store if self.store is None else partial(FileStore, self.store)
        for device in self._devices(
            VirtualNetwork(capacity=len(ids)), make_store, tell=False
        ):  # refused before a bus is opened
            for text in device.unreadable:
                say(f"coulombus: {text}; the PDO is not valid at start, everything else is served")

    def _open(self) -> None:
        """Determine the kind of each file, and relax limits that contradict it."""
        served = []
        for description in self.descriptions:
            if self.kind == "auto":
                profile = of_description(description)
            else:
                profile = of_identity(identity_from_1018h(description)) if self.kind is None else self.kind
            reading = completed(description, profile)
            remarks = reading.remarks
            if self.kind == "auto":
                reading = opened(reading.description, profile)
                remarks += reading.remarks
            self.kinds.append(profile)
            served.append(reading.description)
            self.opened.append(remarks)
            for text in (*remarks, *_one_sided(reading.description, profile)):
                say(f"coulombus: {text}")
        self.descriptions = served
        if self.load != NO_OPTIONS and not any(self._has_load(profile) for profile in self.kinds):
            names = ", ".join(profile.name for profile in self.kinds)
            raise NodeError(f"a load is for a drive without --io, and got kind {names}; take --kind drive, or no load")

    def _has_load(self, profile: Profile) -> bool:
        return self.io is None and profile.behaviour is DRIVE402.behaviour

    def _commission(self) -> None:
        """Determine node ids and bit rate: options take precedence over a DCF."""
        for (path, node_id), description in zip(self.eds, self.descriptions, strict=True):
            served_id = node_id or description.node_id
            if not served_id:
                raise NodeError(f"{path} has no node id ([DeviceComissioning] of a DCF has one); give --node-id")
            self.node_ids.append(served_id)
            if served_id != description.node_id and description.node_id:
                remark = f"is a DCF for the node id {description.node_id} and is served as {served_id}"
                say(
                    f"coulombus: {path}: {remark}; which identifiers go with it tells `coulombus eds check {shell(str(path))}`"
                )
        rates = {description.bit_rate for description in self.descriptions} - {0}
        if len(rates) > 1 and not self.bit_rate:
            listed = " and ".join(map(str, sorted(rates)))
            raise NodeError(f"the DCFs tell of {listed} bit/s, but a bus has one bit rate; give --bitrate")
        self.bit_rate = self.bit_rate or max(rates, default=0)

    def place_switches(self, places: tuple[float, float, float, float]) -> None:
        """Place the switches of every drive's axis: negative limit, home from and to, positive limit [counts].

        Raises
        ------
        NodeError
            No node is a drive.
        """
        if not any(kind.behaviour is DRIVE402.behaviour for kind in self.kinds):
            raise NodeError("--switches: no node is a drive; give --kind drive")
        self.switches = places

    def make_world(self, bit_rate: int, trial: bool) -> VirtualNetwork:
        """Return the network with only the nodes; a trial network stores and reports nothing."""
        network = VirtualNetwork(bit_rate, capacity=len(self.eds))
        if trial:
            self.add_to(network)
            return network
        devices = self._devices(network, lambda: Store() if self.store is None else FileStore(self.store))
        row_of = {CobId.HEARTBEAT + device.node_id: row for row, device in enumerate(devices)}
        row_of |= {CobId.SDO_TX + device.node_id: row for row, device in enumerate(devices)}
        row_of = {can_id: row for can_id, row in row_of.items() if devices[row].node_id != UNCONFIGURED}
        heard = set(row_of)
        if UNCONFIGURED in self.node_ids:  # such a node boots with any id from an LSS master
            heard |= {CobId.HEARTBEAT + node_id for node_id in range(1, 128)}

        def hear(frame: Heard) -> None:
            row = row_of.get(frame.can_id, frame.source)
            if row in range(len(devices)):
                self._heard(devices[row], row, frame)

        network.station(heard, hear)
        return network

    def add_to(self, network: VirtualNetwork) -> list[Device]:
        """Add the nodes to a network, without their `store`; they are off, and report nothing."""
        return self._devices(network, Store)

    def _devices(self, network: VirtualNetwork, store: Callable[[], Store], *, tell: bool = True) -> list[Device]:
        devices = []
        for node_id, description, profile in zip(self.node_ids, self.descriptions, self.kinds, strict=True):
            node_store = store()
            devices.append(network.add(description, node_id, profile, store=node_store))
            self._check_kind(devices[-1])
            if self._has_load(profile):
                network.attach_load(len(network.devices) - 1, self.load.plant(devices[-1].dictionary))
                devices[-1].record["switch_counts"] = switch_counts(devices[-1].dictionary)
            if self.switches is not None:
                devices[-1].record["switch_counts"] = self.switches
            devices[-1].record["processing_ns"] = round(self.processing_us * 1e3)
            if isinstance(node_store, FileStore) and node_store.foreign:
                raise NodeError(f"--store {node_store.diagnosis}; choose another file; this one is not overwritten")
            if tell and isinstance(node_store, FileStore) and node_store.diagnosis:
                say(f"coulombus: {node_store.diagnosis}")
        return devices

    def begin(self, server: BusServer) -> None:
        """Connect the nodes, and their converters, to the server's loop."""
        self.server = server
        if self.pump is not None:
            self.pump.attach(server.world.devices[0])
            server.world.at(0, self._pump)
        if any(map(self._has_load, self.kinds)):
            server.world.at(0, self._watch)
        if self.on_begin is not None:
            self.on_begin(server)

    def _watch(self, network: VirtualNetwork) -> None:
        """Look at the drives, report what keeps one from moving, and schedule the next look."""
        for row, device in enumerate(network.devices):
            if network.axis_of[row] >= 0:
                plant = network.plant[int(network.axis_of[row])]
                reason = self._watches[row].update(device.record, device.dictionary, holding_pm(plant))
                if reason is not None:
                    self._report_standstill(device, row, reason)
        self._again(network, LOOK_NS, self._watch)

    def _again(self, network: VirtualNetwork, period_ns: int, action: Callable[[VirtualNetwork], None]) -> int:
        """Schedule the next of a periodic action; return the number of periods missed, which are skipped."""
        assert self.server is not None
        late = max(self.server.now_ns() - network.t_ns, 0) // period_ns
        network.at(network.t_ns + (late + 1) * period_ns, action)
        return late

    def _report_standstill(self, device: Device, row: int, reason: Reason) -> None:
        if self.as_json:
            line = {"event": "standstill", "node_id": device.node_id, "reason": reason.name, "text": reason.text}
            with printed():
                show(json.dumps(line))
        say(f"coulombus: node {device.node_id} ({self.eds[row][0]}) does not move: {reason.text}")

    def _pump(self, network: VirtualNetwork) -> None:
        """Read and write the converters, and schedule the next period; missed periods are skipped."""
        pump = self.pump
        assert pump is not None
        pump.period(network.t_ns)
        pump.skipped += self._again(network, pump.period_ns, self._pump)

    def _report_hardware(self, text: str) -> None:
        if self.as_json:
            assert self.pump is not None
            line = {"event": "hardware", "ok": not self.pump.failure, "text": text}
            with printed():
                show(json.dumps(line))
        say(f"coulombus: {text}")

    def _heard(self, device: Device, row: int, frame: Heard) -> None:
        """Report the first boot-up of a node, and another node with the same id."""
        if frame.source == row:
            if frame.can_id == CobId.HEARTBEAT + device.node_id:
                self._report("ready", device, row, frame)
        else:
            self._report("duplicate", device, row, frame)

    def _check_kind(self, device: Device) -> None:
        """Refuse a selected kind if the file lacks its required objects."""
        if self.kind in (None, "auto"):
            return
        profile, objects = device.profile, device.dictionary
        names = [f"{index:04X}h:{subindex:02X}" for index, subindex in profile.missing(objects)]
        if not any(terminal.key in objects for terminal in profile.terminals):
            names += [f"{index:04X}h" for index in sorted({terminal.index for terminal in profile.terminals})]
        if names:
            where, name = device.description.path, profile.name
            raise NodeError(f"{where}: got no {', '.join(names)}, which kind {name} acts on; take --kind generic")

    def _report(self, event: str, device: Device, row: int, frame: Heard) -> None:
        if (event, row) in self.told or self.server is None:
            return
        self.told.add((event, row))
        server, node_id, path = self.server, device.node_id, self.eds[row][0]
        if self.as_json:
            line: dict[str, object] = {"event": event, "node_id": node_id, "eds": str(path), "bus": str(server.address)}
            if event == "ready":
                line |= {"bitrate_bit_s": server.bit_rate, "serves_bus": serves(server)}
                line |= {"kind": device.profile.name, "opened": self.opened[row]}
            else:
                line |= {"can_id": frame.can_id, "data": frame.data.hex()}
            with printed():  # the node is ready, even if nobody reads this
                show(json.dumps(line))
        elif event == "ready":
            with printed():
                show(f"node {node_id} ({path}) is on bus {server.address}; Ctrl-C ends it")
        if event == "duplicate":
            text = f"another node on bus {server.address} has the node id {node_id}: it sent {frame.can_id:03X}h"
            say(f"coulombus: {text} {frame.data.hex(' ')}; give one of them another id")


def _one_sided(description: Description, profile: Profile) -> Iterator[str]:
    """Yield a line if a module's file has no input, or no output, of its kind."""
    if profile.behaviour is DRIVE402.behaviour:
        return  # its measurements and its torque need no object
    for side, outputs in (("input", False), ("output", True)):
        rows = [row for row in profile.terminals if row.is_output == outputs]
        if rows and not any(description.has(*row.key) for row in rows):
            indices = ", ".join(f"{index:04X}h" for index in sorted({row.index for row in rows}))
            yield f"{description.path}: kind {profile.name} finds no {side} in the file ({indices})"


def serves(server: BusServer) -> bool:
    """Tell whether this process serves the virtual bus."""
    return server.address.is_virtual and not server.joined


def run_nodes(nodes: LiveNodes, address: BusAddress, seconds: float | None) -> None:
    """Serve the nodes until the time is over, or until a signal of `system.stop_signals`.

    End with the exit status.
    """

    def make() -> BusServer:
        server = BusServer(nodes.make_world, address, nodes.bit_rate or BIT_RATE, join=True)
        nodes.begin(server)
        return server

    def report_bus(server: BusServer, as_json: bool) -> None:
        for right in server.real_time.refused:
            say(f"coulombus: {right}")
        for (path, _), node_id in zip(nodes.eds, nodes.node_ids, strict=True):
            if node_id == UNCONFIGURED:
                say(f"coulombus: {path} waits on bus {address} for an LSS master to give it a node id")
        rate = f"{server.bit_rate / 1e6:g} Mbit/s"
        if serves(server):
            text = f"nobody served bus {address}: it is served here, at {rate}; others may join"
        elif server.joined and server.bit_rate and nodes.bit_rate not in (0, server.bit_rate):
            text = f"bus {address} runs at {rate}, as its server says, and not at {nodes.bit_rate / 1e6:g} Mbit/s"
        else:
            return
        say(f"coulombus: {text}")

    pump = nodes.pump
    try:
        if pump is not None:
            pump.open()
        priority = None if pump is None else PRIORITY
        run_sim(make, seconds, priority=priority, cpu=None, as_json=nodes.as_json, report_ready=report_bus)
    finally:
        if pump is not None:
            pump.close()
