"""A virtual bus with simulated nodes in a thread of this process, for tests.

The compiled loop runs without Python's global lock, as in `coulombus emulate`. A thread leaves no
process, whatever ends the test; `close` removes the socket's file, and `remove_stale` those of
killed processes.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterable
from contextlib import suppress
from pathlib import Path
from secrets import token_hex
from typing import TypeVar

from coulombus.eds.cia305 import UNCONFIGURED
from coulombus.eds.description import Value, object_key
from coulombus.lab.bus_log import BusLog, inject
from coulombus.node.device import Device
from coulombus.node.kinds import named
from coulombus.node.profile import Key
from coulombus.rigs.rig import load_rig
from coulombus.sim_bus.faults.fault_file import FaultPlan
from coulombus.sim_bus.network.network import CAPACITY, VirtualNetwork
from coulombus.sim_bus.server.live_nodes import BIT_RATE, LiveNodes
from coulombus.sim_bus.server.precompile import warm_up
from coulombus.sim_bus.server.rig_server import SimServer
from coulombus.sim_bus.server.server import BusServer
from coulombus.sim_bus.server.socket_file import locked, refuse_live
from coulombus.wire.address import BusAddress, BusUnavailable, bus_names, parse_address, socket_path

__all__ = ["BusNode", "ServedBus", "empty_bus", "remove_stale", "rig_bus"]

PREFIX = "test-"
PATIENCE_S = 2.0
CALL_S = 60.0
"""Longest wait for the bus's thread, on a machine that does other work."""

_T = TypeVar("_T")


def empty_bus() -> ServedBus:
    """Serve a bus without nodes."""

    def make_world(bit_rate: int, trial: bool) -> VirtualNetwork:
        return VirtualNetwork(bit_rate, capacity=1 if trial else CAPACITY)

    return ServedBus(lambda address: BusServer(make_world, address, BIT_RATE))


def rig_bus(rig_name: str, seed: int = 0) -> ServedBus:
    """Serve the bus of a rig with its nodes and mechanics, and return it after their boot-ups.

    Raises
    ------
    coulombus.rigs.rig.RigError
        there is no such rig, or its file has mistakes
    ValueError
        it has several buses
    """
    rig = load_rig(rig_name)
    if len(rig.channels) > 1:
        raise ValueError(f"rig {rig_name} has the buses {', '.join(rig.channels)}; a test's rig has one bus")
    bus = ServedBus(lambda address: SimServer(rig, address, mode=rig.modes[-1], seed=seed))
    try:
        bus.await_boot(node.node_id for node in rig.nodes)
    except BaseException:
        bus.close()
        raise
    return bus


class ServedBus:
    """A bus under a new name, until `close`.

    Parameters
    ----------
    make : returns the server of an address

    Attributes
    ----------
    address : of the bus
    channel : its name, for ``can.Bus(interface="coulombus", channel=...)``
    log : everything that was on the bus
    """

    def __init__(self, make: Callable[[BusAddress], BusServer]) -> None:
        self.channel = f"{PREFIX}{os.getpid()}-{token_hex(4)}"
        self.address = parse_address(f"coulombus:{self.channel}")
        self._server = make(self.address)
        self.log = BusLog(self._server.world, self._flush, PATIENCE_S)
        self._server.keep_frames()
        self._failure: BaseException | None = None
        ready = threading.Event()
        self._thread = threading.Thread(target=self._run, args=(ready,), name=str(self.address), daemon=True)
        self._thread.start()
        try:
            ready.wait()
        except BaseException:  # an interrupt: the test has no bus to end yet
            self.close()
            raise

    def _run(self, ready: threading.Event) -> None:
        try:
            self._server.run(ready=ready.set)
        except BaseException as error:  # raised where the test asks next
            self._failure = error
        finally:
            ready.set()

    def call(self, action: Callable[[], _T]) -> _T:
        """Return the result of `action` in the bus's thread, between two events.

        Raises
        ------
        RuntimeError
            the bus has ended
        """
        if not self._thread.is_alive():
            raise RuntimeError(f"bus {self.address} has ended") from self._failure
        return self._server.call(action).result(CALL_S)

    def _flush(self) -> None:
        if self._thread.is_alive():
            self.call(lambda: None)

    def add(self, eds: Path, node_id: int | None = None, kind: str | None = None) -> BusNode:
        """Add a node of an EDS file, switched on, and return it after its boot-up.

        `node_id` and `kind` are those of ``coulombus node``.

        Raises
        ------
        coulombus.eds.description.EdsError
            the file is no EDS
        ValueError
            no such kind, or the file lacks its objects; the node id is taken
        """
        nodes = LiveNodes(((eds, node_id),), "auto" if kind in (None, "auto") else named(kind))
        warm_up(nodes.make_world(self._server.bit_rate, True))

        def switch_on() -> Device:
            (device,) = nodes.add_to(self._server.world)
            self._server.world.power_on()
            return device

        node = BusNode(self, self.call(switch_on))
        self.await_boot(nodes.node_ids)
        return node

    def await_boot(self, node_ids: Iterable[int]) -> None:
        """Wait until nodes have sent their boot-up; a node without a node id sends none."""
        for node_id in node_ids:
            if node_id != UNCONFIGURED:
                self.log.assert_said(f"heartbeat boot-up node {node_id}")

    def inject(self, plan: FaultPlan, seed: int = 0) -> None:
        """Inject faults; their times count from now."""
        self.call(lambda: inject(self._server.world, plan, seed, self.log))

    def power(self, device: Device, on: bool) -> None:
        """Switch a device on or off."""
        world = self._server.world
        row = world.devices.index(device)
        self.call(lambda: world.power_on(row) if on else world.power_off(row))

    def close(self) -> None:
        """End the bus, and its clients' connections with it; may be called again."""
        if self._thread.is_alive():
            self._server.stop()
        self._thread.join()
        self._server.close()


class BusNode:
    """A node on a served bus: ``node["6041:00"]`` is an object's value, read or written behind the bus's back."""

    def __init__(self, bus: ServedBus, device: Device) -> None:
        self._bus, self.device = bus, device

    def _key(self, name: str) -> Key:
        key = object_key(name, self.device.description)
        if isinstance(key, str):
            raise KeyError(f"{name}: expected {key}")
        return key

    def __getitem__(self, name: str) -> Value:
        """Return an object's present value; `name` is ``"6041:00"`` or the object's name in the EDS."""
        key = self._key(name)
        return self._bus.call(lambda: self.device[key])

    def __setitem__(self, name: str, value: Value) -> None:
        """Set an object; TPDOs on events follow."""
        key = self._key(name)
        self._bus.call(lambda: self.device.__setitem__(key, value))

    def power_off(self) -> None:
        """Switch the node off."""
        self._bus.power(self.device, on=False)

    def power_on(self) -> None:
        """Switch the node on again."""
        self._bus.power(self.device, on=True)


def remove_stale() -> None:
    """Remove the socket files of killed processes' test buses."""
    for name in bus_names():
        if name.startswith(PREFIX):
            path = socket_path(name)
            with locked(path.parent), suppress(BusUnavailable):
                if refuse_live(path, parse_address(f"coulombus:{name}")):
                    path.unlink()
