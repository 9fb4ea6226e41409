"""Messages with the kernel's stamps, against Python's own recvmsg."""

from __future__ import annotations

import errno as numbers
import socket
import struct
import time

from coulombus.kernels.decorator import kernel
from coulombus.kernels.libc import MSG_DONTWAIT, errno
from coulombus.wire.recvmsg import ask_for_stamps, new_mailbox, receive


@kernel
def take(fd, box):
    n = receive(fd, box, MSG_DONTWAIT)
    return -errno() if n < 0 else n


def test_message_and_stamp():
    a, b = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    box, data = new_mailbox(4)
    with a, b:
        ask_for_stamps(b)
        assert take(b.fileno(), box) == -numbers.EAGAIN
        for k in range(3):
            before = time.time_ns()
            a.send(struct.pack("=IB3x8s", 0x181 + k, 8, b"abcdefgh") * (k + 1))
            after = time.time_ns()
            assert take(b.fileno(), box) == 16 * (k + 1)
            assert before <= int(box["stamp_ns"][0]) <= after
            assert data.tobytes()[: 16 * (k + 1)] == struct.pack("=IB3x8s", 0x181 + k, 8, b"abcdefgh") * (k + 1)
            assert int(box["truncated"][0]) == 0


def test_too_long_a_message_is_told_and_the_end_is_zero():
    a, b = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    box, _ = new_mailbox(4)
    with b:
        with a:
            a.send(bytes(80))
            a.send(bytes(64))
            assert take(b.fileno(), box) == 64
            assert int(box["truncated"][0]) == 1
            assert int(box["stamp_ns"][0]) == 0  # nobody asked for stamps
            assert take(b.fileno(), box) == 64
            assert int(box["truncated"][0]) == 0
        assert take(b.fileno(), box) == 0
