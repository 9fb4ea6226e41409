"""Records of the bus in real time: its clients, its timing, and Python's concurrent jobs."""

from __future__ import annotations

from typing import Annotated

from coulombus.kernels.records import IntegerField, Record, RecordArray, dtype_of
from coulombus.rigs.model import MOST_DEVICES

__all__ = ["JOBS", "SLOT", "BesideRecord", "JobRecord", "PaceRecord", "SlotRecord"]

JOBS = 64
"""Largest number of pending jobs. A further frame is lost, as in a device whose buffer is full; for the
simulation's other jobs the loop waits.
"""


class SlotRecord(Record):
    """State of a client."""

    fd: int
    state: int
    greeted: int  # wire.handshake.Flags
    filters: int  # number of filters; 0: everything passes
    staged: int  # frames of the message being sent
    next: int  # first of them that is not on the bus yet
    ready_ns: int  # world time at which the message was sent
    dry: int  # 1: nothing was left to read since the last ppoll
    gone: int  # 1: it has gone, and its last frames are still to be sent
    out: int  # frames in its batch
    watched: int  # its place among the polled descriptors; 0: none
    # counters
    sent: int  # frames sent on the bus for it
    delivered: int  # frames delivered to it
    lost: int  # frames that it did not get because it did not read
    malformed: int  # messages or frames dropped as malformed
    overflow: int  # SocketCAN: frames that this process did not read in time (SO_RXQ_OVFL)
    no_buffer: int  # SocketCAN: frames of the nodes that the interface refused (ENOBUFS)
    net_down: int  # SocketCAN: times that the interface was found down (ENETDOWN)
    error_frames: int  # SocketCAN: error frames received


class JobRecord(Record):
    """A job for Python."""

    why: int  # an `Exit`, or one of `sim_bus.server.realtime_loop.Serve`
    axis: int  # axis of the hand; -1: none
    t_ns: int  # time of a frame for services
    can_id: int
    length: int
    word: int
    rows: int  # rows of the devices with services
    row: Annotated[IntegerField, MOST_DEVICES]
    frames: int  # log rows to be recorded
    start_ns: int  # start of the hand's schedule, as known to Python


class BesideRecord(Record):
    """Data exchanged between the loop and Python."""

    on: int  # 0: no concurrent jobs
    turn: int
    python: int  # descriptor of the eventfd that wakes Python
    loop: int  # descriptor of the eventfd that wakes the loop
    first: int  # first pending job in the ring
    waiting: int
    jobs: Annotated[RecordArray[JobRecord], JOBS]
    now: JobRecord  # current job
    changed: int  # number of words of the nodes' records that Python has changed
    served: int  # completed jobs
    dropped: int  # frames for services that were dropped because `JOBS` were pending
    most_waiting: int


class PaceRecord(Record):
    """Timing of the loop."""

    stop: int  # first: Python and a signal handler write it, the loop reads it with `load_acquire`
    start_ns: int  # CLOCK_MONOTONIC at world time 0
    end_ns: int  # world time at which to end
    listener: int  # descriptors
    wake: int
    slot: int
    message_bytes: int
    error: int  # error of the failed system call; 0: none
    handed_out: int  # log rows delivered to the clients
    keep: int  # frames that stay in the log until Python takes them; 0: none
    planned_ns: int  # planned wake-up in world time, or the time of the last call for Python
    wakeups: int
    stalls: int
    stalled_ns: int
    latest_ns: int  # longest from an end of frame to its delivery


SLOT = dtype_of(SlotRecord)
