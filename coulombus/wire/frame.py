"""A CAN frame as the kernels see it, and the queue in which frames wait.

All integers are int64. `word` holds the eight data bytes in little-endian order: byte 0 of the
frame is bits 0-7, as in the second half of Linux's 16-byte ``struct can_frame`` read on a
little-endian machine. `can_id` carries Linux's flags ``CAN_EFF_FLAG``, ``CAN_RTR_FLAG`` and
``CAN_ERR_FLAG``.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
import numpy.typing as npt

from coulombus.kernels.decorator import inlined, kernel
from coulombus.kernels.records import Record, RecordArray, Records, dtype_of, new_records
from coulombus.wire import can_flags
from coulombus.wire.can_flags import CAN_EFF_FLAG, CAN_ERR_FLAG, CAN_RTR_FLAG
from coulombus.wire.data_word import data_bytes, data_word

__all__ = [
    "BUS_SHIFT",
    "CAN_EFF_FLAG",
    "CAN_ERR_FLAG",
    "CAN_RTR_FLAG",
    "FRAME",
    "LENGTH_MASKS",
    "QUEUE_CAPACITY",
    "Frame",
    "Queue",
    "arbitration_key",
    "buses_of",
    "data_bytes",
    "data_word",
    "frames",
    "new_queue",
    "push",
    "stations_of",
]


class Frame(Record):
    """A frame, ready to be sent or received."""

    t_ns: int  # time at which it is ready (in a queue), or end of frame (in a log)
    can_id: int  # identifier with Linux's flags
    length: int  # data bytes, 0-8
    word: int  # little-endian word of the eight data bytes, zero-padded
    source: int  # number of the sending station; in a log of several buses also of the bus (`buses_of`)


FRAME = dtype_of(Frame)

LENGTH_MASKS = np.array([(1 << 8 * length) - 1 for length in range(8)] + [-1])
"""Bits of `word` that the data of a frame have, by its length."""

BUS_SHIFT = 8
"""In a log of several buses, the `source` of bus k is larger by ``k << BUS_SHIFT``."""

QUEUE_CAPACITY = 1024


class Queue(Record):
    """Frames that stations request the bus to send."""

    count: int  # number of pending frames
    dropped: int  # frames dropped because the queue was full
    waiting: int  # frames taken over by the bus and not sent yet, as far as it has reported
    frames: Annotated[RecordArray[Frame], QUEUE_CAPACITY]  # the first `count` of them are valid


def frames(capacity: int) -> RecordArray[Frame]:
    """Return `capacity` empty frames."""
    return new_records(Frame, capacity)


def buses_of(log: Records) -> npt.NDArray[np.int64]:
    """Return the number of the bus of each frame of a log; station numbers begin with the host's, -1."""
    numbers: npt.NDArray[np.int64] = (log["source"] + 1) >> BUS_SHIFT
    return numbers


def stations_of(log: Records) -> npt.NDArray[np.int64]:
    """Return the number of the sending station of each frame of a log."""
    numbers: npt.NDArray[np.int64] = (log["source"] + 1 & (1 << BUS_SHIFT) - 1) - 1
    return numbers


def new_queue() -> Queue:
    """Return an empty queue: one record of `Queue`, which kernels take by reference."""
    queue: Queue = new_records(Queue)[0]
    return queue


arbitration_key = inlined(can_flags.arbitration_key)


@kernel
def push(out: Queue, source: int, t_ns: int, can_id: int, length: int, word: int) -> None:
    """Append a frame that is ready at `t_ns`; if the queue is full, drop and count the frame."""
    count = out.count
    if count >= QUEUE_CAPACITY:
        out.dropped += 1
        return
    frame = out.frames[count]
    frame.t_ns = t_ns
    frame.can_id = can_id
    frame.length = length
    frame.word = word
    frame.source = source
    out.count = count + 1
