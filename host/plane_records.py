"""What the data plane and its parent share: one anonymous file in memory, mapped by both processes.

The parent fills in CONTROL, HOST, PDOs and law, and commands; the data plane runs the cycle on the very same records, logs the frames into a ring
and counts. Fields of PLANE that one side polls and the other writes are read and written atomically (`wire.libc`); everything else is
written by one side only while the other looks on.
"""

from __future__ import annotations

import mmap
import os
from enum import IntEnum
from typing import Any

import numpy as np

from eds.codec import PDO
from host.laws import LAW, LAW_STATE, MOTION
from host.records import CONTROL, DRIVE_PDOS, HOST
from wire.frame import FRAME, Records

__all__ = ["BINS", "PLANE", "RING_FRAMES", "Command", "SharedPlane", "Status"]

RING_FRAMES = 1 << 16
"""About seven seconds of frames at 1 kHz; a power of two."""

BINS = 20_000
"""Microseconds that the histograms resolve; what is later is in the last bin, and its maximum is kept."""

PAGE = 4096


class Command(IntEnum):
    """What the parent wants."""

    LISTEN = 0  # log what the bus carries
    CYCLE = 1  # run the cycle from `start_ns` on
    QUIT = 2


class Status(IntEnum):
    """What the data plane is doing."""

    STARTING = 0
    LISTENING = 1
    CYCLING = 2
    ENDED = 3  # as commanded
    LOST = 4  # the bus is gone; `error` is the system's number, 0 when the other side has closed


PLANE = np.dtype(
    [
        # written by the parent
        ("command", np.int64),
        ("stop", np.int64),  # for HOST.stop: 1 a safe stop, above it a Trip
        ("deadman_ns", np.int64),  # CLOCK_MONOTONIC until which the dead man's key counts as held
        ("start_ns", np.int64),  # when the first cycle is due
        ("log_tail", np.int64),  # frames that the parent has taken from the ring
        ("packed", np.int64),  # 1: one message may carry several frames
        # written by the data plane
        ("status", np.int64),
        ("error", np.int64),
        ("log_head", np.int64),
        ("cycles", np.int64),
        ("missed_deadlines", np.int64),  # periods at whose end their RPDOs were not out
        ("full_in_a_row", np.int64),  # cycles one after another in which the bus did not take a frame
        ("cpu_ns", np.int64),  # of this thread while it cycled
        ("wakeup_max_ns", np.int64),
        ("latency_max_ns", np.int64),  # SYNC to the last RPDO
        ("interrupted", np.int64),
        ("tx_full", np.int64),  # frames that the bus did not take: EAGAIN, ENOBUFS
        ("rx_frames", np.int64),
        ("rx_malformed", np.int64),
        ("rx_overflow", np.int64),  # frames that this socket's queue has dropped
        ("error_frames", np.int64),
        ("foreign_sync", np.int64),  # SYNC or the host's heartbeat from another station
        ("log_dropped", np.int64),
    ],
    align=True,
)

SECTIONS: tuple[tuple[str, np.dtype[Any], int], ...] = (
    ("plane", PLANE, 1),
    ("control", CONTROL, 1),
    ("host", HOST, 1),
    ("rpdos", PDO, DRIVE_PDOS),
    ("tpdos", PDO, DRIVE_PDOS),
    ("motion", MOTION, 1),
    ("law", LAW, 1),
    ("state", LAW_STATE, 1),
    ("wakeup_bins", np.dtype(np.int64), BINS),
    ("latency_bins", np.dtype(np.int64), BINS),
    ("ring", FRAME, RING_FRAMES),
)


def _places() -> tuple[dict[str, int], int]:
    """Return where each section begins, each on a cache line of its own, and the size of the whole."""
    places, end = {}, 0
    for name, dtype, count in SECTIONS:
        places[name] = end
        end += -(-dtype.itemsize * count // 64) * 64
    return places, -(-end // PAGE) * PAGE


PLACES, SIZE = _places()


class SharedPlane:
    """The shared memory behind the descriptor `fd`; each section is an attribute.

    The arrays point into the mapping, which lasts as long as any of them.
    """

    plane: Records
    control: Records
    host: Records
    rpdos: Records
    tpdos: Records
    motion: Records
    law: Records
    state: Records
    ring: Records
    wakeup_bins: np.ndarray[Any, np.dtype[np.int64]]
    latency_bins: np.ndarray[Any, np.dtype[np.int64]]

    def __init__(self, fd: int) -> None:
        self.fd = fd
        memory = mmap.mmap(fd, SIZE)
        for name, dtype, count in SECTIONS:
            section = np.frombuffer(memory, dtype, count, PLACES[name])
            setattr(self, name, section if dtype.names is None else section.view(np.recarray))

    @classmethod
    def create(cls) -> SharedPlane:
        """Return new shared memory, all zero."""
        fd = os.memfd_create("coulombus-plane", os.MFD_CLOEXEC)
        try:
            os.ftruncate(fd, SIZE)
            return cls(fd)
        except BaseException:
            os.close(fd)
            raise

    def close(self) -> None:
        """Close the descriptor; the mapping stays while arrays use it."""
        os.close(self.fd)
