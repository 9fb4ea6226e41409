"""Compiled queue of SDO block upload segments before they enter the bus queue.

A block is up to 127 frames at once, more than its share of the bus queue. So the segments wait in
the node's own ring buffer, and leave it a few at a time: every `POLL_NS`, while fewer than `AHEAD`
frames of all stations wait for the bus. At 1 Mbit/s a frame of eight bytes lasts 110 to 135 us, so
the bus never waits for them, and other stations keep their places.

In the kernels: `n` the node's record (`node.record`), `k` a number
from 0, `out` the queue of frames to send.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from coulombus.kernels.decorator import kernel
from coulombus.node.constants import FAR_FUTURE_NS, OUTBOX, SDO_TIMEOUT_NS
from coulombus.node.record import NodeRecord
from coulombus.wire.frame import Queue, push

__all__ = ["AHEAD", "POLL_NS", "drain", "forget", "put"]

AHEAD = 3
POLL_NS = 100_000


@kernel
def put(n: NodeRecord, t_ns: int, channel: int, can_id: int, words: npt.NDArray[np.int64]) -> int:
    """Queue the segments `words` of the SDO server `channel`; return 0 if there is no room for all of them."""
    if n.outbox_count + words.shape[0] > OUTBOX:
        return 0
    if n.outbox_count == 0:
        n.outbox_next_ns = t_ns
    for word in words:
        k = (n.outbox_first + n.outbox_count) % OUTBOX
        n.outbox_channel[k] = channel
        n.outbox_id[k] = can_id
        n.outbox_word[k] = word
        n.outbox_count += 1
    n.next_ns = min(n.next_ns, t_ns + 1)
    return 1


@kernel
def forget(n: NodeRecord, channel: int) -> None:
    """Remove the queued segments of the SDO server `channel` (-1: of all)."""
    kept = 0
    for j in range(n.outbox_count):
        k = (n.outbox_first + j) % OUTBOX
        if channel >= 0 and n.outbox_channel[k] != channel:
            into = (n.outbox_first + kept) % OUTBOX
            n.outbox_channel[into] = n.outbox_channel[k]
            n.outbox_id[into] = n.outbox_id[k]
            n.outbox_word[into] = n.outbox_word[k]
            kept += 1
    n.outbox_count = kept
    if kept == 0:
        n.outbox_next_ns = FAR_FUTURE_NS


@kernel
def drain(n: NodeRecord, t_ns: int, out: Queue) -> None:
    """Move segments to the frame queue as far as there is room; a transfer with progress is not late."""
    room = min(AHEAD - out.count - out.waiting, n.outbox_count)
    for _ in range(room):
        k = n.outbox_first
        push(out, n.station, t_ns + n.processing_ns, n.outbox_id[k], 8, n.outbox_word[k])
        n.sdo_deadline_ns[n.outbox_channel[k]] = t_ns + SDO_TIMEOUT_NS
        n.outbox_first = (k + 1) % OUTBOX
        n.outbox_count -= 1
    n.outbox_next_ns = t_ns + POLL_NS if n.outbox_count > 0 else FAR_FUTURE_NS
