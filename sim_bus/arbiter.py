"""The wire: one frame at a time, the lowest identifier first, each for exactly as long as its bits take.

`BUS` is the wire's state. A frame that waits in the queue starts when the bus is free and it is ready; of all that are
ready at that instant the one with the lowest arbitration field goes (ISO 11898-1, 10.4.2.5: base before extended, data before remote,
first come first served among equals). Receivers have the frame at its end of frame, `end_ns`; the bus is free again three
bits of inter-frame space later, at `free_ns`.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from eds.compiled import inlined
from wire.bits import data_frame_bits
from wire.frame import CAN_EFF_FLAG, CAN_RTR_FLAG, Records, new_records

__all__ = ["BUS", "FAR_NS", "INTER_FRAME_BITS", "arbitration_key", "end_frame", "new_bus", "start_frame", "start_ns"]

FAR_NS = 1 << 62
INTER_FRAME_BITS = 3

BUS = np.dtype(
    [
        ("bit_rate", np.int64),  # bit/s; 0: a frame takes no time here (another bus carries it)
        ("busy", np.int64),
        ("end_ns", np.int64),
        ("free_ns", np.int64),
        ("t_ns", np.int64),  # the frame on the wire, fields as in FRAME
        ("can_id", np.int64),
        ("length", np.int64),
        ("word", np.int64),
        ("source", np.int64),
        ("frames", np.int64),  # counters
        ("bits", np.int64),
    ],
    align=True,
)


def new_bus(bitrate_bit_s: int) -> Records:
    """Return an idle bus as an array of one record."""
    bus = new_records(BUS)
    bus["bit_rate"] = bitrate_bit_s
    return bus


@inlined
def arbitration_key(can_id: int) -> int:
    """Return the arbitration field as a number: the lower one wins the bus.

    The bits of the field in their order on the wire, 32 of them: base identifier (11), RTR or SRR, IDE, identifier extension (18), RTR.
    """
    if can_id & CAN_EFF_FLAG:
        base = (can_id >> 18) & 0x7FF
        remote = 1 if can_id & CAN_RTR_FLAG else 0
        return (base << 21) | (0b11 << 19) | ((can_id & 0x3FFFF) << 1) | remote
    remote = 1 if can_id & CAN_RTR_FLAG else 0
    return ((can_id & 0x7FF) << 21) | (remote << 20)


@inlined
def start_ns(bus: Any, queue: Any, count: int) -> int:
    """Return when the next waiting frame can start, `FAR_NS` when none waits."""
    if count == 0:
        return FAR_NS
    first = queue[0].t_ns
    for i in range(1, count):
        first = min(first, queue[i].t_ns)
    return max(first, bus.free_ns)


@inlined
def start_frame(bus: Any, queue: Any, header: Any, now_ns: int) -> None:
    """Arbitrate among the frames that are ready at `now_ns` and put the winner on the wire."""
    best = -1
    best_key = 0
    count = header[0].count
    for i in range(count):
        if queue[i].t_ns <= now_ns:
            key = arbitration_key(queue[i].can_id)
            if best < 0 or key < best_key:
                best = i
                best_key = key
    frame = queue[best]
    bits = data_frame_bits(frame.can_id, frame.length, frame.word)
    bus.can_id = frame.can_id
    bus.length = frame.length
    bus.word = frame.word
    bus.source = frame.source
    bus.t_ns = now_ns
    bus.end_ns = bus.free_ns = now_ns
    if bus.bit_rate > 0:
        bus.end_ns = now_ns + (bits - INTER_FRAME_BITS) * 1_000_000_000 // bus.bit_rate
        bus.free_ns = now_ns + bits * 1_000_000_000 // bus.bit_rate
    bus.busy = 1
    bus.frames += 1
    bus.bits += bits
    for i in range(best, count - 1):  # keep the order: first come first served among equals
        into, out = queue[i], queue[i + 1]
        into.t_ns = out.t_ns
        into.can_id = out.can_id
        into.length = out.length
        into.word = out.word
        into.source = out.source
    header[0].count = count - 1


@inlined
def end_frame(bus: Any, log: Any, row: int) -> None:
    """Take the frame off the wire and write it to `log[row]`, stamped with its end of frame."""
    bus.busy = 0
    frame = log[row]
    frame.t_ns = bus.end_ns
    frame.can_id = bus.can_id
    frame.length = bus.length
    frame.word = bus.word
    frame.source = bus.source
