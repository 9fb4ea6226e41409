"""Compiled expedited SDO uploads: nearly all requests of a running network, answered without Python.

The core answers a request to the first server for a readable number of one to four bytes in a slot
of `values`, while no transfer is open; Python (`node.sdo_service`) answers every other request, in
the same way. The record has a table of these objects, sorted by index and sub-index.

In the kernels: `n` the node's record (`node.record`), `out` the queue of frames to send.
"""

from __future__ import annotations

from coulombus.kernels.decorator import kernel
from coulombus.node.constants import FAR_FUTURE_NS
from coulombus.node.reactions import measure
from coulombus.node.record import NodeRecord
from coulombus.wire.frame import Queue, push

__all__ = ["answer"]

_UPLOAD = 0x40
_MEASURED = 0x2000 << 8


@kernel
def _place(n: NodeRecord, key: int) -> int:
    """Return the row of `key` (index and sub-index) in the table, or -1."""
    low, high = 0, n.fast_count
    while low < high:
        middle = (low + high) >> 1
        if n.fast_key[middle] < key:
            low = middle + 1
        else:
            high = middle
    return low if low < n.fast_count and n.fast_key[low] == key else -1


@kernel
def answer(n: NodeRecord, t_ns: int, can_id: int, length: int, data: int, out: Queue) -> bool:
    """Answer the request if the table has its object; tell whether it was answered."""
    if can_id != n.sdo_rx_id or length != 8 or data & 0xFF != _UPLOAD or n.sdo_deadline_ns[0] != FAR_FUTURE_NS:
        return False
    key = (data >> 8 & 0xFFFF) << 8 | data >> 24 & 0xFF
    place = _place(n, key)
    if place < 0:
        return False
    if key >= _MEASURED:
        measure(n, t_ns)
    size = n.fast_size[place]
    value = n.values[n.fast_slot[place]] & ((1 << 8 * size) - 1)
    head = 0x43 | (4 - size) << 2 | (data & 0xFFFFFF00)
    push(out, n.station, t_ns + n.processing_ns, n.sdo_tx_id, 8, head | value << 32)
    return True
