"""System calls from kernels, with what Python's own say as the expectation."""

from __future__ import annotations

import os
import select
import socket
import time

import numpy as np

from coulombus.kernels import libc
from coulombus.kernels.decorator import JIT_DISABLED, kernel
from coulombus.kernels.libc import (
    CLOCK_REALTIME,
    EAGAIN,
    EBADF,
    EPOLLIN,
    MSG_DONTWAIT,
    POLLIN,
    clock_ns,
    epoll_wait,
    errno,
    load_acquire,
    now_ns,
    ppoll_ns,
    read,
    recv,
    send,
    sleep_until,
    store_release,
    write,
)


@kernel
def clocks():
    return now_ns(), clock_ns(CLOCK_REALTIME)


@kernel
def sleep_to(t_ns):
    return sleep_until(t_ns), now_ns()


@kernel
def pass_on(fd_in, fd_out, buffer):
    n = recv(fd_in, buffer.ctypes.data, buffer.size * 8, MSG_DONTWAIT)
    if n < 0:
        return -errno()
    return send(fd_out, buffer.ctypes.data, n, MSG_DONTWAIT)


@kernel
def copy(fd_in, fd_out, buffer):
    n = read(fd_in, buffer.ctypes.data, buffer.size * 8)
    return -errno() if n < 0 else write(fd_out, buffer.ctypes.data, n)


@kernel
def wait_readable(pollfd, timeout_ns):
    return ppoll_ns(pollfd.ctypes.data, pollfd.size, timeout_ns)


@kernel
def wait_epoll(fd, events):
    return epoll_wait(fd, events.ctypes.data, 4, 0)


@kernel
def count_until_told(flags):
    address = flags.ctypes.data
    n = 0
    while load_acquire(address) == 0:
        n += 1
        store_release(address + 8, n)
        if n == 1000:
            store_release(address, 1)
    return n


def test_clocks_are_pythons():
    before = time.monotonic_ns(), time.time_ns()
    readings = clocks()
    after = time.monotonic_ns(), time.time_ns()
    assert before[0] <= readings[0] <= after[0]
    assert before[1] <= readings[1] <= after[1]


def test_sleep_ends_at_its_instant():
    until = time.monotonic_ns() + 2_000_000
    result, woken = sleep_to(until)
    assert result == 0
    assert woken >= until
    assert sleep_to(0)[0] == 0  # long past


def test_messages_go_through_and_errors_have_their_numbers():
    a, b = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    c, d = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    buffer = np.zeros(8, np.int64)
    with a, b, c, d:
        assert pass_on(b.fileno(), c.fileno(), buffer) == -EAGAIN
        a.send(b"sixteen bytes on")
        assert pass_on(b.fileno(), c.fileno(), buffer) == 16
        assert d.recv(100) == b"sixteen bytes on"
        a.send(b"a")
        assert copy(b.fileno(), c.fileno(), buffer) == 1
        assert d.recv(100) == b"a"
        a.send(b"a")
        of_a_record = np.array([b.fileno(), c.fileno()])  # as the loops have them: in plain Python no int
        assert pass_on(of_a_record[0], of_a_record[1], buffer) == 1
        assert d.recv(100) == b"a"
    assert copy(-1, -1, buffer) == -EBADF


def test_ppoll_tells_what_is_readable_and_gives_up_in_time():
    a, b = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with a, b:
        pollfd = np.array([b.fileno() | POLLIN << 32], np.int64)
        assert wait_readable(pollfd, 0) == 0
        assert wait_readable(pollfd, 1_000_000) == 0
        a.send(b"x")
        assert wait_readable(pollfd, -1) == 1
        assert pollfd[0] >> 48 == POLLIN


def test_epoll_gives_back_what_was_registered():
    a, b = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with a, b, select.epoll() as poller:
        poller.register(b.fileno(), select.EPOLLIN)
        events = np.zeros(12, np.uint32)
        assert wait_epoll(poller.fileno(), events) == 0
        a.send(b"x")
        assert wait_epoll(poller.fileno(), events) == 1
        assert events[0] == EPOLLIN


def test_a_flag_is_read_anew_each_time():
    flags = np.zeros(2, np.int64)
    assert count_until_told(flags) == 1000
    assert flags.tolist() == [1, 1000]


def test_constants_are_the_systems():
    for name in ("EAGAIN", "EBADF", "EINTR", "ENETDOWN", "ENOBUFS", "EPIPE", "ENXIO", "ENODEV", "ENOMEM", "ECONNRESET"):
        assert getattr(libc, name) == getattr(__import__("errno"), name)
    for name in ("MSG_DONTWAIT", "MSG_NOSIGNAL", "MSG_TRUNC", "MSG_CTRUNC"):
        assert getattr(libc, name) == getattr(socket, name)
    assert (os.environ.get("NUMBA_DISABLE_JIT") == "1") == JIT_DISABLED
