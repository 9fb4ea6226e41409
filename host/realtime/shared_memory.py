"""Shared memory of the data plane and its parent: one anonymous file in memory, mapped by both processes.

The parent fills in the AXIS records and gives commands. The data plane runs the cycle on the same records,
logs the frames into a ring, and counts. Fields of PLANE that one side polls and the other writes are
accessed atomically (`kernels.libc`). Every other field has only one writer.
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
"""Size of the ring: about nine seconds of frames and telemetry at 1 kHz; a power of two."""

PATH_BYTES = 4096
"""Size of the recording's path, filled up with zeros; a longer one is not told."""

BINS = 20_000
"""Number of bins of the histograms, each 1 us wide.

Longer times are in the last bin; their maximum is stored separately.
"""

TRACE_ROWS = 1 << 15
"""Size of the trace (`recording.trace`), with two or three rows for each cycle."""

PAGE = 4096


class PlaneCommand(IntEnum):
    """Command of the parent."""

    LISTEN = 0  # log the frames on the bus
    CYCLE = 1  # run the cycle from `start_ns` on
    QUIT = 2


class PlaneStatus(IntEnum):
    """State of the data plane."""

    STARTING = 0
    LISTENING = 1
    CYCLING = 2
    ENDED = 3  # as commanded
    LOST = 4  # the bus is lost; `error` is the errno, 0 if the other side has closed


class PlaneRecord(Record):
    """Commands of the parent, and state of the data plane."""

    # written by the parent
    command: int  # a `PlaneCommand`
    stop: int  # value for HOST.stop: 1 a safe stop, above it a Trip
    deadman_ns: int  # CLOCK_MONOTONIC until which the dead man's switch counts as held
    start_ns: int  # time at which the first cycle is due
    parent: int  # the parent's process id; 0: its end is not monitored
    parent_ns: int  # CLOCK_MONOTONIC until which the parent counts as running; 0: not monitored
    log_tail: int  # number of frames that the parent has read from the ring
    trace_tail: int  # number of rows that the parent has read from the trace
    packed: int  # bit k: a message on bus k may carry several frames
    order: int  # number of the newest order of parameters (`host.cycle.live_parameters`)
    order_axis: int  # axis of the newest order
    # written by the data plane
    status: int  # a `PlaneStatus`
    error: int  # errno of a lost bus
    lost_bus: int  # number of the lost bus, from 1; 0: none
    log_head: int  # number of frames written to the ring
    trace_head: int  # number of rows written to the trace
    rx_ns: int  # stamp of the last received frame
    ordered: int  # number of the last published order
    asked: int  # reason of the last stop request to all axes
    cycles: int  # number of finished cycles
    missed_deadlines: int  # periods whose RPDOs were not sent at their end
    full_in_a_row: int  # cycles in a row in which the bus did not accept a frame
    cpu_ns: int  # CPU time of this thread in cycles
    wakeup_max_ns: int  # largest wake-up delay
    latency_max_ns: int  # largest time from SYNC to the last RPDO
    skew_max_ns: int  # largest time between the SYNCs of a cycle on several buses
    interrupted: int  # number of waits interrupted by a signal
    tx_full: int  # frames that the bus did not accept: EAGAIN, ENOBUFS
    unsent: int  # frames for a lost bus
    rx_frames: int  # received frames
    rx_malformed: int  # received messages that are not valid frames
    rx_overflow: int  # frames dropped by the sockets' queues
    error_frames: int  # received error frames
    foreign_sync: int  # SYNC or the host's heartbeat from another station
    log_dropped: int  # frames and rows dropped for lack of room


PLANE = dtype_of(PlaneRecord)


def field_offset(name: str) -> int:
    """Return the offset of a field in the PLANE record, in bytes."""
    fields = PLANE.fields
    assert fields is not None
    return int(fields[name][1])


def _sections(axes: int) -> tuple[tuple[str, np.dtype[Any], tuple[int, ...]], ...]:
    """Return name, data type and shape of each section for `axes` axes."""
    return (
        ("plane", PLANE, (1,)),
        ("axes", AXIS, (axes,)),
        ("owner", np.dtype(np.int64), (2048,)),
        ("bus_of", np.dtype(np.int64), (2048,)),
        ("wakeup_bins", np.dtype(np.int64), (BINS,)),
        ("latency_bins", np.dtype(np.int64), (BINS,)),
        ("skew_bins", np.dtype(np.int64), (BINS,)),
        ("ring", FRAME, (RING_FRAMES,)),
        ("trace", TRACE, (TRACE_ROWS,)),
        ("recording", np.dtype(np.uint8), (PATH_BYTES,)),  # its path; written by the parent
        ("zero_ns", np.dtype(np.int64), (1,)),  # its time 0, of CLOCK_MONOTONIC
    )


def _places(axes: int) -> tuple[dict[str, int], int]:
    """Return the offset of each section, each on its own cache line, and the total size."""
    places, end = {}, 0
    for name, dtype, shape in _sections(axes):
        places[name] = end
        end += -(-dtype.itemsize * math.prod(shape) // 64) * 64
    return places, -(-end // PAGE) * PAGE


class SharedPlane:
    """The shared memory at the descriptor `fd` for `axes` axes; each section is an attribute.

    The arrays point into the mapping, which exists as long as any of them.
    """

    plane: RecordArray[PlaneRecord]
    axes: AxisRecords
    ring: RecordArray[Frame]
    trace: RecordArray[TraceRow]
    owner: np.ndarray[Any, np.dtype[np.int64]]
    bus_of: np.ndarray[Any, np.dtype[np.int64]]
    wakeup_bins: np.ndarray[Any, np.dtype[np.int64]]
    latency_bins: np.ndarray[Any, np.dtype[np.int64]]
    skew_bins: np.ndarray[Any, np.dtype[np.int64]]
    recording: np.ndarray[Any, np.dtype[np.uint8]]
    zero_ns: np.ndarray[Any, np.dtype[np.int64]]

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
        """Close the descriptor; the mapping exists as long as arrays use it."""
        os.close(self.fd)
