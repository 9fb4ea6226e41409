"""Kernels that a bus server compiles, or loads, before the bus exists, so that nothing waits for them later."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np

from coulombus.eds.cia301 import CobId, NmtCommand
from coulombus.eds.cia305 import UNCONFIGURED, LssService, LssState
from coulombus.kernels.decorator import Entry
from coulombus.kernels.records import RecordArray
from coulombus.node.record import NodeRecord
from coulombus.node.sdo_kernels import forget_segments, queue_segments
from coulombus.sim_bus.can_bus.cable_cut import divide
from coulombus.sim_bus.can_bus.faults import NO_FRAME, fire
from coulombus.sim_bus.can_bus.noise import next_noise
from coulombus.sim_bus.can_bus.records import BusRecord
from coulombus.sim_bus.network.network import VirtualNetwork
from coulombus.wire.clock import own_ns, to_bus
from coulombus.wire.frame import Queue, data_word

__all__ = ["warm_up"]

Work: TypeAlias = tuple[Callable[..., Any], tuple[Any, ...]]
"""A kernel, and arguments of its types."""


def warm_up(world: VirtualNetwork) -> None:
    """Run a trial world through the work of the real one: a kernel that is compiled, or loaded, at its first
    call takes a second.
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
        # upload and download of 1017h, upload of 6041h, which updates the measurements
        for word in (0x0000_0000_0010_1740, 0x0000_0064_0010_172B, 0x0000_0000_0060_4140):
            device.service(0, rx, 8, word, world.out)
    for row in range(len(world.devices)):
        for command in (NmtCommand.START, NmtCommand.STOP, NmtCommand.RESET_NODE, NmtCommand.RESET_COMMUNICATION):
            world.nmt_command(row, command)
        world.power_off(row)
    for node in world.nodes[:1]:
        for function, arguments in _rare(world.bus, node, world.out):
            Entry(function).load(*arguments)


def _rare(bus: RecordArray[BusRecord], node: NodeRecord, out: Queue) -> list[Work]:
    """Return the kernels for a cut cable, a drifting clock, SDO blocks and faults."""
    return [
        (divide, (bus, out)),
        (queue_segments, (node, 0, 0, 0, np.zeros(1, np.int64))),
        (forget_segments, (node, 0)),
        (own_ns, (node, 0)),
        (to_bus, (node, out, 0)),
        (fire, (bus[0], 0, 0, NO_FRAME)),
        (next_noise, (bus[0], 0)),
    ]
