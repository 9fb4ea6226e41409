"""One message from a socket, with the kernel's time stamp: recvmsg(2) for compiled loops.

A mailbox is one record that holds the struct msghdr, the struct iovec and the buffer for control
messages, and an array of int64 words for the data: two words are one ``struct can_frame``.
`receive` works on both kinds of bus, AF_UNIX and AF_CAN, when SO_TIMESTAMPNS is set on the socket
(and SO_RXQ_OVFL, on AF_CAN).
"""

from __future__ import annotations

import ctypes
import socket
from typing import Annotated

import numpy as np
import numpy.typing as npt

from coulombus.kernels.decorator import kernel
from coulombus.kernels.libc import MSG_TRUNC, recvmsg
from coulombus.kernels.records import IntegerField, Record, RecordArray, dtype_of, new_records
from coulombus.wire.ancillary import (
    CONTROL_WORDS,
    OVERFLOW,
    SECOND_NS,
    SO_RXQ_OVFL,
    SO_TIMESTAMPNS,
    STAMP,
    STAMP_NEW,
)

__all__ = ["MAILBOX", "ask_for_stamps", "new_mailbox", "receive", "set_up"]


class Mailbox(Record):
    """Buffers for one message, as recvmsg(2) takes them."""

    # struct msghdr
    name: int
    name_length: int
    iov: int
    iov_length: int
    control: int
    control_length: int
    message_flags: int  # an int and its padding
    # struct iovec
    buffer: int
    buffer_bytes: int
    # results of `receive`
    stamp_ns: int  # CLOCK_REALTIME at which the kernel received the message; 0: no stamp
    overflow: int  # frames that this socket's queue has dropped so far (SO_RXQ_OVFL)
    truncated: int  # the message was longer than its buffer
    room: Annotated[IntegerField, CONTROL_WORDS]  # struct cmsghdr ...


MAILBOX = dtype_of(Mailbox)


def new_mailbox(frames: int) -> tuple[RecordArray[Mailbox], npt.NDArray[np.int64]]:
    """Return a mailbox and its data words: buffers for a message of `frames` frames. Both must be kept
    alive and in place.
    """
    box, data = new_records(Mailbox), np.zeros(2 * frames, np.int64)
    set_up(box, data)
    return box, data


def set_up(box: RecordArray[Mailbox], data: npt.NDArray[np.int64]) -> None:
    """Set the mailbox `box` (an array of one record) up to put its messages into `data`."""
    if ctypes.sizeof(ctypes.c_void_p) != 8:
        raise ImportError("compiled sockets need a 64-bit system")
    start, at = box.ctypes.data, MAILBOX.fields
    assert at is not None
    box["iov"], box["iov_length"] = start + at["buffer"][1], 1
    box["control"] = start + at["room"][1]
    box["buffer"], box["buffer_bytes"] = data.ctypes.data, data.nbytes


def ask_for_stamps(target: socket.socket) -> None:
    """Set SO_TIMESTAMPNS; on a CAN socket also SO_RXQ_OVFL."""
    target.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
    if target.family == getattr(socket, "AF_CAN", None):
        target.setsockopt(socket.SOL_SOCKET, SO_RXQ_OVFL, 1)


@kernel
def receive(fd: int, box: RecordArray[Mailbox], flags: int) -> int:
    """Receive one message; return its bytes, 0 if the other side has closed, -1: see `errno`."""
    message = box[0]
    message.control_length = 8 * CONTROL_WORDS
    message.stamp_ns = 0
    count: int = recvmsg(fd, box.ctypes.data, flags)
    if count < 0:
        return count
    message.truncated = 1 if message.message_flags & MSG_TRUNC else 0
    words = min(message.control_length // 8, CONTROL_WORDS)
    at = 0
    while at + 2 < words:  # struct cmsghdr: length, level and type; then the data, padded to whole words
        length, kind = message.room[at], message.room[at + 1]
        if kind in (STAMP, STAMP_NEW):
            message.stamp_ns = message.room[at + 2] * SECOND_NS + message.room[at + 3]
        elif kind == OVERFLOW:
            message.overflow = message.room[at + 2] & 0xFFFFFFFF
        if length < 16:
            break
        at += (length + 7) // 8
    return count
