"""Compiled device at its local time: its clock may run fast or slow (`wire.clock`).

`on_frame`, `on_time` and `confinement_changed` call those of `node.core`: the
core receives local time, and its frames are queued in bus time. Its `next_ns` is local time.

In the kernels: `nodes` the records of the nodes (`node.record`), `i` the row of the node, `out` the queue of frames to
send.
"""

from __future__ import annotations

from coulombus.kernels.decorator import inlined
from coulombus.kernels.records import RecordArray
from coulombus.node import core
from coulombus.node.record import NodeRecord
from coulombus.wire.clock import own_ns, to_bus
from coulombus.wire.frame import Queue

__all__ = ["confinement_changed", "on_frame", "on_time"]


@inlined
def on_frame(nodes: RecordArray[NodeRecord], i: int, t_ns: int, can_id: int, length: int, word: int, out: Queue) -> int:
    """Call `node.core.on_frame`, at the bus time `t_ns`."""
    n = nodes[i]
    first, node_ns = out.count, own_ns(n, t_ns)
    due = core.on_frame(n, node_ns, can_id, length, word, out)
    if n.clock_on:
        to_bus(n, out, first)
    return int(due)


@inlined
def on_time(nodes: RecordArray[NodeRecord], i: int, t_ns: int, out: Queue) -> None:
    """Call `node.core.on_time`, at the bus time `t_ns`."""
    n = nodes[i]
    first, node_ns = out.count, own_ns(n, t_ns)
    core.on_time(n, node_ns, out)
    if n.clock_on:
        to_bus(n, out, first)


@inlined
def confinement_changed(nodes: RecordArray[NodeRecord], i: int, t_ns: int, confinement: int, out: Queue) -> None:
    """Call `node.core.confinement_changed`, at the bus time `t_ns`."""
    n = nodes[i]
    first, node_ns = out.count, own_ns(n, t_ns)
    core.confinement_changed(n, node_ns, confinement, out)
    if n.clock_on:
        to_bus(n, out, first)
