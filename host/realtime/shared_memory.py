"""What the data plane and its parent share: one anonymous file in memory, mapped by both processes.

The parent fills in the AXIS records, and commands; the data plane runs the cycle on the very same
records, logs the frames into a ring and counts. Fields of PLANE that one side polls and the other
writes are read and written atomically (`kernels.libc`); everything else is written by one side
only while the other looks on.
"""

from __future__ import annotations

import math
import mmap
import os
from enum import IntEnum
from typing import Any

import numpy as np

from coulombus.host.cycle.records import AXIS, AxisRecords
from coulombus.kernels.records import Record, RecordArray, dtype_of
from coulombus.recording.trace import TRACE, TraceRow
from coulombus.wire.frame import FRAME, Frame

__all__ = ["BINS", "PLANE", "RING_FRAMES", "TRACE_ROWS", "PlaneCommand", "PlaneStatus", "SharedPlane", "field_offset"]

RING_FRAMES = 1 << 17
"""About nine seconds of frames, and of what the host tells of itself, at 1 kHz; a power of two."""

BINS = 20_000
"""Microseconds that the histograms resolve.

What is later is in the last bin, and its maximum is kept.
"""

TRACE_ROWS = 1 << 15
"""Rows of the trace (`recording.trace`), two or three for each cycle."""

PAGE = 4096


class PlaneCommand(IntEnum):
    """What the parent wants."""

    LISTEN = 0  # log what the bus carries
    CYCLE = 1  # run the cycle from `start_ns` on
    QUIT = 2


class PlaneStatus(IntEnum):
    """What the data plane is doing."""

    STARTING = 0
    LISTENING = 1
    CYCLING = 2
    ENDED = 3  # as commanded
    LOST = 4  # the bus is gone; `error` is the system's number, 0 when the other side has closed


class PlaneRecord(Record):
    """What the data plane and its parent tell each other."""

    # written by the parent
    command: int  # a `PlaneCommand`
    stop: int  # for HOST.stop: 1 a safe stop, above it a Trip
    deadman_ns: int  # CLOCK_MONOTONIC until which the dead man's key counts as held
    start_ns: int  # when the first cycle is due
    parent: int  # its process id; 0: its end is not looked for
    parent_ns: int  # CLOCK_MONOTONIC until which it counts as running; 0: not looked at
    log_tail: int  # frames that the parent has taken from the ring
    trace_tail: int  # and rows from the trace
    packed: int  # 1: one message may carry several frames
    order: int  # number of the newest order of parameters (`host.cycle.live_parameters`)
    order_axis: int  # ... and whose it is
    # written by the data plane
    status: int  # a `PlaneStatus`
    error: int  # the system's number, where the bus is lost
    log_head: int  # frames that the ring was given
    trace_head: int  # and rows that the trace was given
    rx_ns: int  # stamp of the frame that was received last
    ordered: int  # number of the order that was wanted last
    asked: int  # the reason for which all axes were asked to stop
    cycles: int  # done
    missed_deadlines: int  # periods at whose end their RPDOs were not out
    full_in_a_row: int  # cycles one after another in which the bus did not take a frame
    cpu_ns: int  # of this thread while it cycled
    wakeup_max_ns: int  # the latest that a cycle began
    latency_max_ns: int  # SYNC to the last RPDO
    interrupted: int  # waits that a signal ended
    tx_full: int  # frames that the bus did not take: EAGAIN, ENOBUFS
    rx_frames: int  # frames that were received
    rx_malformed: int  # messages that are no frame
    rx_overflow: int  # frames that this socket's queue has dropped
    error_frames: int  # error frames that were received
    foreign_sync: int  # SYNC or the host's heartbeat from another station
    log_dropped: int  # frames that found no place in the ring


PLANE = dtype_of(PlaneRecord)


def field_offset(name: str) -> int:
    """Return where a field of the PLANE record is, in bytes from its begin."""
    fields = PLANE.fields
    assert fields is not None
    return int(fields[name][1])


def _sections(axes: int) -> tuple[tuple[str, np.dtype[Any], tuple[int, ...]], ...]:
    """Return name, records and shape of each section for so many axes."""
    return (
        ("plane", PLANE, (1,)),
        ("axes", AXIS, (axes,)),
        ("owner", np.dtype(np.int64), (2048,)),
        ("wakeup_bins", np.dtype(np.int64), (BINS,)),
        ("latency_bins", np.dtype(np.int64), (BINS,)),
        ("ring", FRAME, (RING_FRAMES,)),
        ("trace", TRACE, (TRACE_ROWS,)),
    )


def _places(axes: int) -> tuple[dict[str, int], int]:
    """Return where each section begins, each on a cache line of its own, and the size of the
    whole.
    """
    places, end = {}, 0
    for name, dtype, shape in _sections(axes):
        places[name] = end
        end += -(-dtype.itemsize * math.prod(shape) // 64) * 64
    return places, -(-end // PAGE) * PAGE


class SharedPlane:
    """The shared memory of so many axes behind the descriptor `fd`; each section is an attribute.

    The arrays point into the mapping, which lasts as long as any of them.
    """

    plane: RecordArray[PlaneRecord]
    axes: AxisRecords
    ring: RecordArray[Frame]
    trace: RecordArray[TraceRow]
    owner: np.ndarray[Any, np.dtype[np.int64]]
    wakeup_bins: np.ndarray[Any, np.dtype[np.int64]]
    latency_bins: np.ndarray[Any, np.dtype[np.int64]]

    def __init__(self, fd: int, axes: int = 1) -> None:
        self.fd, self.axis_count = fd, axes
        places, size = _places(axes)
        memory = mmap.mmap(fd, size)
        for name, dtype, shape in _sections(axes):
            section = np.frombuffer(memory, dtype, math.prod(shape), places[name]).reshape(shape)
            setattr(self, name, section if dtype.names is None else section.view(np.recarray))

    @classmethod
    def create(cls, axes: int = 1) -> SharedPlane:
        """Return new shared memory, all zero."""
        fd = os.memfd_create("coulombus-plane", os.MFD_CLOEXEC)
        try:
            os.ftruncate(fd, _places(axes)[1])
            return cls(fd, axes)
        except BaseException:
            os.close(fd)
            raise

    def close(self) -> None:
        """Close the descriptor; the mapping stays while arrays use it."""
        os.close(self.fd)
