"""What a server of a bus compiles, or loads, before the bus is there: nothing waits for it later.

The first start of all compiles for more than a minute. Its parts are compiled one by one, so that
processes that start at the same time share them (`compiled.decorator.compile_together`).
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np

from coulombus.compiled.decorator import Entry, compile_together
from coulombus.compiled.records import Record, Records
from coulombus.eds.cia301 import CobId, NmtCommand
from coulombus.eds.cia305 import UNCONFIGURED, LssService, LssState
from coulombus.node import core, outbox, own_time
from coulombus.sim_bus.copper.attempt import attempt
from coulombus.sim_bus.copper.cut import divide
from coulombus.sim_bus.copper.faults import NO_FRAME, fire
from coulombus.sim_bus.copper.noise import next_noise
from coulombus.sim_bus.copper.outcome import end_attempt
from coulombus.sim_bus.network.kernel import Host, World, end_closely, refresh, run
from coulombus.sim_bus.network.network import VirtualNetwork
from coulombus.sim_bus.rig.course import CourseFunction
from coulombus.sim_bus.server.beside import Beside, collect, leave, settle
from coulombus.sim_bus.server.clients import Clients, hand_out, take
from coulombus.sim_bus.server.paced import serve
from coulombus.wire.clock import own_ns, to_bus
from coulombus.wire.frame import Queue, data_word

__all__ = ["compile_loop", "warm_up"]

Work: TypeAlias = tuple[Callable[..., Any], tuple[Any, ...]]
"""A kernel, and arguments of its types."""


def warm_up(world: VirtualNetwork) -> None:
    """Let a world that nobody looks at do what the real one will: what is compiled, or loaded, at
    its first call takes a second.
    """
    world.power_on()
    for row, device in enumerate(world.devices):
        node_id = row + 1 if device.node_id == UNCONFIGURED else device.node_id
        for request in (
            (LssService.SWITCH_STATE_GLOBAL, LssState.CONFIGURATION),
            (LssService.CONFIGURE_NODE_ID, node_id),
            (LssService.SWITCH_STATE_GLOBAL, LssState.WAITING),
        ):
            device.service(0, CobId.LSS_RX, 8, data_word(bytes(request)), world.out)
        rx = CobId.SDO_RX + device.node_id
        # upload and download of 1017h, upload of 6041h, for which what is measured is brought up to
        # date
        for word in (0x0000_0000_0010_1740, 0x0000_0064_0010_172B, 0x0000_0000_0060_4140):
            device.service(0, rx, 8, word, world.out)
    for row in range(len(world.devices)):
        for command in (NmtCommand.START, NmtCommand.STOP, NmtCommand.RESET_NODE, NmtCommand.RESET_COMMUNICATION):
            world.nmt_command(row, command)
        world.power_off(row)
    for node in world.nodes[:1]:
        for function, arguments in _rare(world.bus, node, world.out):
            Entry(function).load(*arguments)


def _rare(bus: Records, node: Record, out: Queue) -> list[Work]:
    """Return what a cut cable, a clock that drifts, SDO blocks and faults need."""
    return [
        (divide, (bus, out)),
        (outbox.put, (node, 0, 0, 0, np.zeros(1, np.int64))),
        (outbox.forget, (node, 0)),
        (own_ns, (node, 0)),
        (to_bus, (node, out, 0)),
        (fire, (bus[0], 0, 0, NO_FRAME)),
        (next_noise, (bus[0], 0)),
    ]


def compile_loop(
    pace: Record,
    clients: Clients,
    beside: Beside,
    world: World,
    host: Host,
    course: CourseFunction,
) -> bool:
    """Compile the parts of `sim_bus.server.paced.serve`, those first that take long and have
    nothing in common. Return whether another process, which started at the same time, compiles the
    whole.
    """
    w, cable, bus, out, frame = world.state, world.bus[0], world.bus, world.out, (0, 0, 0, 0)
    parts: list[Work] = [
        (attempt, (cable, out, 0)),
        *((core.set_nmt, (node, 0, 0, 0, out)) for node in world.nodes[:1]),
        (end_attempt, (cable, out, world.log, 0)),
        (collect, (beside, world, course, pace)),
        (leave, (beside, world, course, pace, 0, 0)),
        (take, (w, pace, bus, clients, out, 0, 0)),
        (hand_out, (w, pace, bus, world.log, clients)),
    ]
    for node in world.nodes[:1]:
        parts += [
            (core.on_time, (node, 0, out)),
            (own_time.on_time, (node, 0, out)),
            (own_time.on_frame, (node, *frame, out)),
        ]
    parts += [
        (end_closely, (world, course, cable)),
        (refresh, (w, world.nodes, world.axes, world.deadlines, world.wants)),
        (run, (world, host, None, course, 1)),
        (settle, (beside, world, course, pace)),
    ]
    return compile_together(serve, parts)
