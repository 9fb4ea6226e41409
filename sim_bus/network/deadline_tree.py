"""Lookup tables of a loop over many devices: the next deadline, and the receivers of a frame.

`deadlines` is a tournament tree of int64 [ns]: ``deadlines[leaves + i]`` is the time of the next
`on_time` of device `i`, every inner place the earlier of its two children ``2 k`` and ``2 k + 1``,
so ``deadlines[1]`` is the earliest of all. `wants` has a row for each 11-bit identifier: the number
of devices that receive such a frame, and their rows, in order. Both follow the node records: the
loop updates the deadline of each device that it has called, `look_again` updates everything after
Python has changed the records.

    n : the `NodeRecord` of a device
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from coulombus.kernels.decorator import inlined, kernel
from coulombus.kernels.records import Integers, Records
from coulombus.node.core import ROUTE_NONE
from coulombus.node.record import NodeRecord
from coulombus.wire.clock import NEVER_NS, bus_ns

__all__ = ["IDENTIFIERS", "keep_deadline", "look_again", "new_deadlines", "new_wants", "next_device"]

IDENTIFIERS = 2048


def new_deadlines(devices: int) -> npt.NDArray[np.int64]:
    """Return the tree of `devices` devices without deadlines."""
    leaves = 1
    while leaves < devices:
        leaves *= 2
    return np.full(2 * leaves, NEVER_NS, np.int64)


def new_wants(devices: int) -> npt.NDArray[np.int16]:
    """Return the table of `devices` devices that receive nothing."""
    return np.zeros((IDENTIFIERS, devices + 1), np.int16)


@inlined
def keep_deadline(deadlines: Integers, i: int, n: NodeRecord) -> None:
    """Update the tree with the deadline of device `i`, whose record is `n`."""
    t = n.next_ns if n.powered else NEVER_NS
    if n.clock_on != 0:
        t = bus_ns(n, t)
    at = (deadlines.shape[0] >> 1) + i
    if deadlines[at] != t:
        deadlines[at] = t
        at >>= 1
        while at >= 1:
            earlier = min(deadlines[2 * at], deadlines[2 * at + 1])
            if deadlines[at] == earlier:
                break
            deadlines[at] = earlier
            at >>= 1


@inlined
def next_device(deadlines: Integers) -> int:
    """Return the device with the earliest deadline, the first device of equals."""
    leaves: int = deadlines.shape[0] >> 1
    at = 1
    while at < leaves:
        at *= 2
        if deadlines[at] > deadlines[at + 1]:
            at += 1
    return at - leaves


@kernel
def look_again(nodes: Records, deadlines: Integers, wants: Integers) -> None:
    """Update both tables from the records of all devices."""
    for i in range(nodes.shape[0]):
        keep_deadline(deadlines, i, nodes[i])
        if nodes[i].rerouted:
            nodes[i].rerouted = 0
            _reroute(nodes[i].route, i, wants)


@kernel
def _reroute(route: Integers, i: int, wants: Integers) -> None:
    for can_id in range(IDENTIFIERS):
        row = wants[can_id]
        count = row[0]
        at = 1
        while at <= count and row[at] < i:
            at += 1
        listed = at <= count and row[at] == i
        if route[can_id] != ROUTE_NONE and not listed:
            for k in range(count, at - 1, -1):
                row[k + 1] = row[k]
            row[at] = i
            row[0] = count + 1
        elif route[can_id] == ROUTE_NONE and listed:
            for k in range(at, count):
                row[k] = row[k + 1]
            row[0] = count - 1
