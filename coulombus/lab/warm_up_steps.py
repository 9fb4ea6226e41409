"""Process of `coulombus.lab.warm_up`: ``python -m coulombus.lab.warm_up_steps GROUP PARENT``.

It compiles the kernels of one group in steps, and prints the number of functions compiled so far
after each step.

Two groups of which neither comes after the other have no kernel in common, except one law and
`wire.recvmsg.receive`, with the same types (`tests/lab/test_warm_up.py`).
"""

from __future__ import annotations

import os
import socket
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from types import MappingProxyType

import numpy as np

from coulombus.host.cycle.controllers import Controllers
from coulombus.host.laws.laws import BUILTIN_LAWS, load_law
from coulombus.host.laws.plane.plane_laws import PLANE_LAWS, load_plane_law
from coulombus.host.realtime.log_rings import take_log, take_trace
from coulombus.host.realtime.process import new_buffers
from coulombus.host.realtime.process import warm_up as load_plane
from coulombus.host.realtime.shared_memory import SharedPlane
from coulombus.kernels.compile_notice import compiled
from coulombus.kernels.decorator import CACHE_DIR, Entry
from coulombus.kernels.kernel_cache import damaged, empty, leave_lock_to_parent
from coulombus.kernels.records import new_records
from coulombus.lab.set_up import set_up
from coulombus.node import own_time
from coulombus.node.device import Device
from coulombus.node.record import new_nodes
from coulombus.node.servo402 import servo_address
from coulombus.recording.export.text_rows import TextRows, texts_of, times_of
from coulombus.recording.pcapng_reader import read_pcapng
from coulombus.recording.pcapng_writer import PcapngWriter
from coulombus.recording.trace import TraceRow
from coulombus.rigs.kinematics.load_mechanism import compile_mechanism
from coulombus.rigs.kinematics.mechanisms import MECHANISMS
from coulombus.rigs.rig import Rig, load_rig
from coulombus.sim_bus.can_bus.arbiter import new_bus, start_frame
from coulombus.sim_bus.can_bus.error_path import detailed_address
from coulombus.sim_bus.network.virtual_rig import VirtualRig
from coulombus.sim_bus.rig.plant_step import course_of
from coulombus.sim_bus.rig.records import PlantRecord
from coulombus.sim_bus.rig.stand_ins import stand_ins
from coulombus.sim_bus.server.rig_server import SimServer
from coulombus.system.realtime import die_with_parent
from coulombus.system.stop_signals import ignore
from coulombus.wire.address import BusAddress
from coulombus.wire.frame import frames, new_queue

__all__ = ["GROUPS", "main"]

RIG, ARM_RIG, MODE = "bench", "plane", "hybrid"


def _load_plane(rig: Rig) -> None:
    """Compile the host's data plane, and what reads its logs."""
    controllers = Controllers(rig, MODE)
    shared = SharedPlane.create(len(controllers.each))
    controllers.adopt(shared.axes)
    ours, its = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours, its:
        load_plane(shared, new_buffers([its.fileno()], shared), controllers.law_function, controllers.arm)
    take_log(shared.plane, shared.ring, frames(1))
    take_trace(shared.plane, shared.trace, new_records(TraceRow))
    shared.close()


def _nodes() -> Iterator[None]:
    """Compile the nodes' kernels."""
    rig = load_rig(RIG)
    out, nodes = new_queue(), new_nodes(1)
    for stand_in in stand_ins(rig.one_axis()):
        device = Device(stand_in.served.description, stand_in.node_id, stand_in.profile, nodes[0])
        device.power_on(0, out)
    servo_address()
    yield
    Entry(own_time.on_time).load(nodes, 0, 0, out)
    Entry(own_time.on_frame).load(nodes, 0, 0, 0, 0, 0, out)
    Entry(own_time.confinement_changed).load(nodes, 0, 0, 0, out)


def _host() -> Iterator[None]:
    """Compile the host's data plane."""
    yield from ()
    _load_plane(load_rig(RIG))


def _bus() -> Iterator[None]:
    """Compile the laws, the reader of recordings, the rows of an export, the plants, and the bus bit by bit."""
    for name in BUILTIN_LAWS:
        load_law(name)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "frame.pcapng"
        with PcapngWriter(path, attachments={}) as writer:
            writer.write(frames(1))
        read_pcapng(path)
    rows = TextRows()
    rows.add("%s %s", [times_of(np.full(1, 10**9)), texts_of(np.zeros(1), False, {})])
    rows.joined(np.zeros(1))
    yield
    plants = new_records(PlantRecord)
    for detailed in (0, 1):
        plants["detail"]["on"] = detailed
        course_of(plants)
    yield
    bus, out = new_bus(1_000_000), new_queue()
    detailed_address()
    yield
    Entry(start_frame).load(bus[0], out, 0)


def _server() -> Iterator[None]:
    """Compile the emulation's loop in real time."""
    yield from ()
    SimServer(load_rig(RIG), BusAddress("coulombus", f"warm-up-{os.getpid()}")).close()


def _loop() -> Iterator[None]:
    """Compile the loop in virtual time."""
    yield from ()
    _load_loop(load_rig(RIG))


def _load_loop(rig: Rig) -> None:
    """Compile the loop in virtual time for a rig of this kind."""
    world = VirtualRig(rig, MODE)
    set_up(world)
    world.start_host()
    world.wait_ns(1)


def _arm() -> Iterator[None]:
    """Compile laws, mechanisms, plant and data plane of an arm in the plane."""
    for name in PLANE_LAWS:
        load_plane_law(name).along((0.0, 1e-3), np.zeros((2, 2)))
    yield
    for mechanism in MECHANISMS.values():
        compile_mechanism(mechanism, guarded=False)
    plants = new_records(PlantRecord)
    plants["plane"]["on"] = 1
    course_of(plants)
    yield
    _load_plane(load_rig(ARM_RIG))


def _arm_loop() -> Iterator[None]:
    """Compile the loop in virtual time for an arm in the plane."""
    yield from ()
    _load_loop(load_rig(ARM_RIG))


GROUPS: Mapping[str, Callable[[], Iterator[None]]] = MappingProxyType(
    {
        "bus": _bus,
        "nodes": _nodes,
        "server": _server,
        "host": _host,
        "loop": _loop,
        "arm": _arm,
        "arm_loop": _arm_loop,
    }
)
"""The groups' functions, which yield between their steps."""


def main(group: str, parent: int) -> None:
    """Run the steps of a group."""
    ignore()
    die_with_parent(parent)
    leave_lock_to_parent()
    try:
        for _ in GROUPS[group]():
            print(compiled(), flush=True)
        print(compiled(), flush=True)
    except Exception as error:
        if CACHE_DIR is None or not damaged(error):
            raise
        empty(CACHE_DIR)
        sys.exit(f"coulombus: the compiled code in {CACHE_DIR} was damaged and is removed; start again")


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
