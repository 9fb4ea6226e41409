"""A CAN frame as the kernels see it, and the queue in which frames wait.

All integers are int64. `word` holds the eight data bytes in little-endian order: byte 0 of the frame is bits 0-7, as in
the second half of Linux's 16-byte ``struct can_frame`` read on a little-endian machine. `can_id` carries Linux's flags
``CAN_EFF_FLAG``, ``CAN_RTR_FLAG`` and ``CAN_ERR_FLAG``.
"""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from coulombus.compiled.decorator import inlined, kernel
from coulombus.wire.can_id import CAN_EFF_FLAG, CAN_ERR_FLAG, CAN_RTR_FLAG

__all__ = [
    "CAN_EFF_FLAG",
    "CAN_ERR_FLAG",
    "CAN_RTR_FLAG",
    "FRAME",
    "QUEUE",
    "QUEUE_CAPACITY",
    "Queue",
    "Record",
    "Records",
    "arbitration_key",
    "data_bytes",
    "data_word",
    "frames",
    "new_queue",
    "new_records",
    "push",
]

Records: TypeAlias = npt.NDArray[Any]
"""An array of records (a structured dtype)."""
Record: TypeAlias = np.record
"""One record: an element of such an array, a view of it."""
Queue: TypeAlias = Record
"""A record of `QUEUE`: the frames that stations ask the bus to send."""

FRAME = np.dtype(
    [
        ("t_ns", np.int64),  # ready to be sent (in a queue), or end of frame (in a log)
        ("can_id", np.int64),
        ("length", np.int64),  # data bytes, 0-8
        ("word", np.int64),  # little-endian word of the eight data bytes, 0 beyond `length`
        ("source", np.int64),  # number of the sending station
    ],
    align=True,
)

QUEUE_CAPACITY = 1024
QUEUE = np.dtype(
    [
        ("count", np.int64),
        ("dropped", np.int64),
        ("waiting", np.int64),  # frames that the bus has taken over and not sent yet, as far as it has told
        ("frames", FRAME, (QUEUE_CAPACITY,)),  # the first `count` of them
    ],
    align=True,
)


def new_records(dtype: np.dtype[Any], count: int = 1) -> Records:
    """Return `count` records of `dtype`, all zero, whose fields are attributes in compiled and in plain Python."""
    return np.zeros(count, dtype).view(np.recarray)


def frames(capacity: int) -> Records:
    """Return `capacity` empty frames."""
    return new_records(FRAME, capacity)


def new_queue() -> Queue:
    """Return an empty queue: one record of `QUEUE`, which kernels take by reference."""
    queue: Queue = new_records(QUEUE)[0]
    return queue


@inlined
def arbitration_key(can_id: int) -> int:
    """Return the arbitration field as a number: the lower one wins the bus.

    The bits of the field in their order on the wire, 32 of them: base identifier (11), RTR or SRR, IDE, identifier extension (18), RTR (ISO 11898-1).
    """
    if can_id & CAN_EFF_FLAG:
        base = (can_id >> 18) & 0x7FF
        remote = 1 if can_id & CAN_RTR_FLAG else 0
        return (base << 21) | (0b11 << 19) | ((can_id & 0x3FFFF) << 1) | remote
    remote = 1 if can_id & CAN_RTR_FLAG else 0
    return ((can_id & 0x7FF) << 21) | (remote << 20)


@kernel
def push(out: Any, source: int, t_ns: int, can_id: int, length: int, data: int) -> None:
    """Append a frame that is ready at `t_ns`; when the queue is full the frame is dropped and counted."""
    n = out.count
    if n >= QUEUE_CAPACITY:
        out.dropped += 1
        return
    f = out.frames[n]
    f.t_ns = t_ns
    f.can_id = can_id
    f.length = length
    f.word = data
    f.source = source
    out.count = n + 1


def data_word(data: bytes) -> int:
    """Return up to eight data bytes as the signed 64-bit little-endian word of `FRAME`."""
    return int.from_bytes(data.ljust(8, b"\0"), "little", signed=True)


def data_bytes(word: int, length: int) -> bytes:
    """Return the first `length` data bytes of the word `word`."""
    return int(word).to_bytes(8, "little", signed=True)[:length]
