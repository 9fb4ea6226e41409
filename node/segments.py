"""Compiled reception of SDO block download segments: Python runs only at a block's beginning and end.

Python (`node.sdo_service`) opens a server's row of the record while the server receives a block in
order. `collect` then stores the segments in order. Python handles the block's last segment, a gap,
a repetition, an abort and a frame after the transfer's deadline. It takes the collected segments
first, so its answers are the same as if it had received every frame.

In the kernels: `n` the node's record (`node.record`), `k` a number from 0.
"""

from __future__ import annotations

from coulombus.kernels.decorator import kernel
from coulombus.node.constants import FAR_FUTURE_NS, SDO_TIMEOUT_NS
from coulombus.node.record import NodeRecord

__all__ = ["collect"]

_LAST_OR_ABORT = 0x80


@kernel
def collect(n: NodeRecord, t_ns: int, can_id: int, length: int, data: int) -> bool:
    """Store the frame if it is the next segment of an open block, and not its last; tell whether it was."""
    if length != 8 or data & _LAST_OR_ABORT:
        return False
    for k in range(n.sdo_used):
        if n.segments_id[k] != can_id:
            continue
        number, deadline_ns = data & 0x7F, n.sdo_deadline_ns[k]
        if number != n.segments_next[k] or number >= n.segments_last[k]:
            return False
        if deadline_ns == FAR_FUTURE_NS or t_ns > deadline_ns:
            return False
        n.segments_word[k, n.segments_count[k]] = data
        n.segments_count[k] += 1
        n.segments_next[k] = number + 1
        n.sdo_deadline_ns[k] = t_ns + SDO_TIMEOUT_NS  # next_ns is not later than the old deadline
        return True
    return False
