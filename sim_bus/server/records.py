"""The records of the bus in real time: its clients, its pace, and what Python does beside it."""

from __future__ import annotations

from typing import Annotated

from coulombus.kernels.records import IntegerField, Record, RecordArray, dtype_of
from coulombus.rigs.model import MOST_DEVICES

__all__ = ["JOBS", "SLOT", "BesideRecord", "JobRecord", "PaceRecord", "SlotRecord"]

JOBS = 64
"""Jobs that wait at most. A further frame is lost, as in a device whose buffer is full; for the
rest, which is the simulation's own, the loop waits.
"""


class SlotRecord(Record):
    """A client."""

    fd: int
    state: int
    greeted: int  # wire.hello.Flags
    filters: int  # how many; 0: everything
    staged: int  # frames of its message that is being sent
    next: int  # the first of them that is not on the bus yet
    ready_ns: int  # world time at which the message was sent
    dry: int  # nothing was left to read since the last ppoll
    gone: int  # it has gone, and its last frames are still to be carried
    out: int  # frames that wait in its batch
    watched: int  # its place among those that the loop waits for; 0: none
    # counters
    sent: int  # frames on the bus from it
    delivered: int  # frames that it was given
    lost: int  # frames that it did not get because it did not read
    malformed: int  # messages or frames that were dropped
    overflow: int  # SocketCAN: frames that this process did not read in time (SO_RXQ_OVFL)
    no_buffer: int  # SocketCAN: frames of the nodes that the interface did not take (ENOBUFS)
    net_down: int  # SocketCAN: times that the interface was found down (ENETDOWN)
    error_frames: int  # SocketCAN: error frames that came


class JobRecord(Record):
    """What Python is to do."""

    why: int  # an `Exit`, or one of `sim_bus.server.realtime_loop.Serve`
    axis: int  # whose hand it is; -1: nobody's
    t_ns: int  # a frame for services
    can_id: int
    length: int
    word: int
    rows: int  # whose services
    row: Annotated[IntegerField, MOST_DEVICES]
    frames: int  # rows of the log to be recorded
    start_ns: int  # of the hand's schedule, as Python finds it


class BesideRecord(Record):
    """What the loop and Python tell each other."""

    on: int  # 0: nothing is done beside the loop
    turn: int
    python: int  # descriptors: an eventfd that wakes Python
    loop: int  # and the one that wakes the loop
    first: int  # of the jobs that wait, a ring
    waiting: int
    jobs: Annotated[RecordArray[JobRecord], JOBS]
    now: JobRecord  # the one that is under way
    changed: int  # how many words of the nodes' records Python has changed
    served: int  # jobs that are done
    dropped: int  # frames for services that came while `JOBS` waited
    most_waiting: int


class PaceRecord(Record):
    """What keeps the loop to the clock."""

    stop: int  # first: Python and a signal handler write it, the loop reads it with `load_acquire`
    start_ns: int  # CLOCK_MONOTONIC at world time 0
    end_ns: int  # world time at which to end
    listener: int  # descriptors
    wake: int
    slot: int
    message_bytes: int
    error: int  # of the call that failed; 0: none
    handed_out: int  # rows of the log that the clients have
    keep: int  # frames that stay in the log until Python takes them; 0: none
    planned_ns: int  # world time at which the loop meant to be awake, or was when it last called for Python
    wakeups: int
    stalls: int
    stalled_ns: int
    latest_ns: int  # longest from an end of frame to its delivery


SLOT = dtype_of(SlotRecord)
