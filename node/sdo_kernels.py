"""Compiled part of a node's SDO servers: uploads of numbers, and the segments of blocks, without Python.

**Uploads** (`answer_upload`): nearly all requests of a running network. The core answers a request to
the first server for a readable number of one to four bytes in a slot of `values`, while no transfer is
open; Python (`node.sdo_service`) answers every other request, in the same way. The record has a table
of these objects, sorted by index and sub-index.

**Block download** (`collect_segment`): Python opens a server's row of the record while the server
receives a block in order. The segments are then stored in order. Python handles the block's last
segment, a gap, a repetition, an abort and a frame after the transfer's deadline. It takes the collected
segments first, so its answers are the same as if it had received every frame.

**Block upload** (`queue_segments`, `send_segments`): a block is up to 127 frames at once, more than its
share of the bus queue. So the segments wait in the node's own ring buffer, and leave it a few at a
time: every `POLL_NS`, while fewer than `AHEAD` frames of all stations wait for the bus. At 1 Mbit/s a
frame of eight bytes lasts 110 to 135 us, so the bus never waits for them, and other stations keep their
places.

    n : the node's record (`node.record`)    k : a number from 0    out : the queue of frames to send
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from coulombus.kernels.decorator import kernel
from coulombus.node.reactions import measure
from coulombus.node.record import OUTBOX, SDO_TIMEOUT_NS, NodeRecord
from coulombus.wire.clock import NEVER_NS
from coulombus.wire.frame import Queue, push

__all__ = ["AHEAD", "POLL_NS", "answer_upload", "collect_segment", "forget_segments", "queue_segments", "send_segments"]

_UPLOAD = 0x40
_MEASURED = 0x2000 << 8


@kernel
def _row(n: NodeRecord, key: int) -> int:
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
def answer_upload(n: NodeRecord, t_ns: int, can_id: int, length: int, word: int, out: Queue) -> bool:
    """Answer the request if the table has its object; tell whether it was answered."""
    if can_id != n.sdo_rx_id or length != 8 or word & 0xFF != _UPLOAD or n.sdo_deadline_ns[0] != NEVER_NS:
        return False
    key = (word >> 8 & 0xFFFF) << 8 | word >> 24 & 0xFF
    row = _row(n, key)
    if row < 0:
        return False
    if key >= _MEASURED:
        measure(n, t_ns)
    size = n.fast_size[row]
    value = n.values[n.fast_slot[row]] & ((1 << 8 * size) - 1)
    head = 0x43 | (4 - size) << 2 | (word & 0xFFFFFF00)
    push(out, n.station, t_ns + n.processing_ns, n.sdo_tx_id, 8, head | value << 32)
    return True


_LAST_OR_ABORT = 0x80


@kernel
def collect_segment(n: NodeRecord, t_ns: int, can_id: int, length: int, word: int) -> bool:
    """Store the frame if it is the next segment of an open block, and not its last; tell whether it was."""
    if length != 8 or word & _LAST_OR_ABORT:
        return False
    for k in range(n.sdo_used):
        if n.segments_id[k] != can_id:
            continue
        number, deadline_ns = word & 0x7F, n.sdo_deadline_ns[k]
        if number != n.segments_next[k] or number >= n.segments_last[k]:
            return False
        if deadline_ns == NEVER_NS or t_ns > deadline_ns:
            return False
        n.segments_word[k, n.segments_count[k]] = word
        n.segments_count[k] += 1
        n.segments_next[k] = number + 1
        n.sdo_deadline_ns[k] = t_ns + SDO_TIMEOUT_NS  # next_ns is not later than the old deadline
        return True
    return False


AHEAD = 3
POLL_NS = 100_000


@kernel
def queue_segments(n: NodeRecord, t_ns: int, channel: int, can_id: int, words: npt.NDArray[np.int64]) -> int:
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
def forget_segments(n: NodeRecord, channel: int) -> None:
    """Remove the queued segments of the SDO server `channel` (-1: of all)."""
    left = 0
    for j in range(n.outbox_count):
        k = (n.outbox_first + j) % OUTBOX
        if channel >= 0 and n.outbox_channel[k] != channel:
            into = (n.outbox_first + left) % OUTBOX
            n.outbox_channel[into] = n.outbox_channel[k]
            n.outbox_id[into] = n.outbox_id[k]
            n.outbox_word[into] = n.outbox_word[k]
            left += 1
    n.outbox_count = left
    if left == 0:
        n.outbox_next_ns = NEVER_NS


@kernel
def send_segments(n: NodeRecord, t_ns: int, out: Queue) -> None:
    """Move segments to the frame queue as far as there is room; a transfer with progress is not late."""
    room = min(AHEAD - out.count - out.waiting, n.outbox_count)
    for _ in range(room):
        k = n.outbox_first
        push(out, n.station, t_ns + n.processing_ns, n.outbox_id[k], 8, n.outbox_word[k])
        n.sdo_deadline_ns[n.outbox_channel[k]] = t_ns + SDO_TIMEOUT_NS
        n.outbox_first = (k + 1) % OUTBOX
        n.outbox_count -= 1
    n.outbox_next_ns = t_ns + POLL_NS if n.outbox_count > 0 else NEVER_NS
