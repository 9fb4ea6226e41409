"""A device whose clock runs fast or slow (`wire.clock`), compiled.

`on_frame`, `on_time` and `confinement_changed` are those of `node.core` for such a device: it is
told its own time, and what it sends is ready at the bus's. Its `next_ns` is in its own time.

In the kernels: `n` the node's record (`node.record`), `out` the queue of frames to send.
"""

from __future__ import annotations

from coulombus.kernels.decorator import kernel
from coulombus.node import core
from coulombus.node.record import NodeRecord
from coulombus.wire.clock import own_ns, to_bus
from coulombus.wire.frame import Queue

__all__ = ["confinement_changed", "on_frame", "on_time"]


@kernel
def on_frame(n: NodeRecord, t_ns: int, can_id: int, length: int, data: int, out: Queue) -> int:
    """As `node.core.on_frame`, at `t_ns` of the bus."""
    first, own = out.count, own_ns(n, t_ns)
    due = core.on_frame(n, own, can_id, length, data, out)
    to_bus(n, out, first)
    return int(due)


@kernel
def on_time(n: NodeRecord, t_ns: int, out: Queue) -> None:
    """As `node.core.on_time`, at `t_ns` of the bus."""
    first, own = out.count, own_ns(n, t_ns)
    core.on_time(n, own, out)
    to_bus(n, out, first)


@kernel
def confinement_changed(n: NodeRecord, t_ns: int, confinement: int, out: Queue) -> None:
    """As `node.core.confinement_changed`, at `t_ns` of the bus."""
    first, own = out.count, own_ns(n, t_ns)
    core.confinement_changed(n, own, confinement, out)
    to_bus(n, out, first)
