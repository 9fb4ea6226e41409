"""The loop's buses: a non-blocking socket each, on which it receives and sends without allocation.

The host's frames go to the bus of their identifier, and SYNC and the host's heartbeat to every bus
(`Buffers.bus_of`). A bus that is lost makes all axes safe; the loop goes on with the others until
they are, so that a hand which both hold is let go gently (`lose`).

Results of system calls:

- EINTR: the call is repeated.
- EAGAIN or ENOBUFS on sending: the frame is lost and counted. It is not repeated, because a delayed frame
  would be a wrong set-point. Too many such cycles trip.
- Every other error, or the other side's close: the bus is lost.

    b : the Buffers        p : the `PlaneRecord`        c : the `ControlRecord` of the first axis
    f : a frame            k : the number of a bus
"""

from __future__ import annotations

from typing import NamedTuple

from coulombus.eds.cia301 import CobId
from coulombus.host.cycle.axes import ask_to_stop, on_frame
from coulombus.host.cycle.controllers import EVERY_BUS
from coulombus.host.cycle.records import AxisRecords, Trip
from coulombus.host.cycle.step import SOURCE_HOST
from coulombus.host.realtime.log_rings import log_frame
from coulombus.host.realtime.shared_memory import PlaneRecord
from coulombus.host.world.records import StateRecord
from coulombus.kernels.decorator import kernel
from coulombus.kernels.libc import (
    CLOCK_REALTIME,
    EAGAIN,
    EINTR,
    ENOBUFS,
    MSG_DONTWAIT,
    MSG_NOSIGNAL,
    POLLIN,
    clock_ns,
    errno,
    now_ns,
    send,
    sleep_until,
)
from coulombus.kernels.records import Integers, RecordArray
from coulombus.recording.trace import TraceRow
from coulombus.wire.frame import BUS_SHIFT, CAN_ERR_FLAG, Frame, Queue
from coulombus.wire.recvmsg import Mailbox, receive

__all__ = [
    "COMPLETE",
    "DRAIN_MESSAGES",
    "EMPTY",
    "GONE",
    "MESSAGE_FRAMES",
    "Buffers",
    "drain",
    "failed",
    "receive_message",
    "stop",
    "transmit",
    "watch",
]

MESSAGE_FRAMES = 64
"""Largest number of frames in a message."""

SOURCE_BUS = 0
"""Station number of received frames in the log."""


class Buffers(NamedTuple):
    """Buffers of the loop: its sockets, the memory shared with the parent (`SharedPlane`), and the receive
    and send buffers.
    """

    fds: Integers  # socket of each bus; -1: a bus that is lost
    bus_of: Integers  # by identifier: bus of a frame of the host; EVERY_BUS: all
    plane: RecordArray[PlaneRecord]
    ring: RecordArray[Frame]
    trace: RecordArray[TraceRow]
    wakeup_bins: Integers
    latency_bins: Integers
    skew_bins: Integers
    axes: AxisRecords
    owner: Integers
    box: RecordArray[Mailbox]
    words: Integers
    tx: Integers
    sent_ns: Integers  # time at which each bus had taken the first message of the last `transmit`
    overflows: Integers  # frames that each bus' socket has dropped
    poll: Integers
    out: Queue
    telemetry: RecordArray[Frame]  # frames of one axis (`host.cycle.telemetry`)
    world_fd: int  # socket for the states of each cycle (`host.world.server`); -1: none
    world_state: RecordArray[StateRecord]  # the state that is sent, one record


DRAIN_MESSAGES = 512  # largest number of messages that a cycle reads from a flooded bus
END_PAUSE_NS = 1_000_000  # between two attempts of a frame that is repeated
STAMP_AGE_NS = 1_000_000_000  # an older stamp means that the clock was set
CAN_ERR_BUSOFF = 0x40

# results of `receive_message`
EMPTY, TOOK, COMPLETE, GONE = 0, 1, 2, 3


@kernel
def stop(p: PlaneRecord, axes: AxisRecords, trip: int) -> None:
    """Request the safe state of all axes with the reason `trip`, or without a reason (1).

    The first reason counts.
    """
    if p.asked < trip and p.asked <= 1:
        p.asked = trip
    ask_to_stop(axes, trip)


@kernel
def failed(p: PlaneRecord) -> bool:
    """Return whether a call that returned -1 has a permanent error: a failing wait would return at once,
    without end.
    """
    error = errno()
    if error in (EINTR, EAGAIN):
        return False
    p.error = error
    return True


@kernel
def watch(b: Buffers) -> None:
    """Let `ppoll_ns` wait for frames on every bus that is not lost."""
    for k in range(len(b.fds)):
        b.poll[k] = (b.fds[k] & 0xFFFFFFFF) | POLLIN << 32


@kernel
def lose(b: Buffers, k: int, error: int) -> int:
    """Note that a bus is lost. If it was the last, return GONE.

    Else give it up, and make all axes safe on the others.
    """
    p, left = b.plane[0], 0
    p.error = error
    p.lost_bus = k + 1
    for other in range(len(b.fds)):
        left += 1 if other != k and b.fds[other] >= 0 else 0
    if left == 0:
        return GONE
    b.fds[k] = -1
    watch(b)
    stop(p, b.axes, Trip.BUS_LOST)
    return TOOK


@kernel
def receive_message(b: Buffers, k: int, live: int) -> int:
    """Receive one message of a bus if there is one; `live`: pass its frames to the cycle."""
    p, c, words = b.plane[0], b.axes[0].control, b.words
    if b.fds[k] < 0:
        return EMPTY
    n = receive(b.fds[k], b.box, MSG_DONTWAIT)
    if n <= 0:
        error = 0 if n == 0 else errno()
        if error == EAGAIN:
            return EMPTY
        if error == EINTR:
            p.interrupted += 1
            return TOOK
        return lose(b, k, error)
    m = b.box[0]
    p.rx_overflow += m.overflow - b.overflows[k]
    b.overflows[k] = m.overflow
    if n % 16 != 0 or m.truncated:
        p.rx_malformed += 1
        return TOOK
    t_ns = now_ns()
    if m.stamp_ns > 0:  # the stamp is of CLOCK_REALTIME: convert it by its age
        age = clock_ns(CLOCK_REALTIME) - m.stamp_ns
        if 0 < age < STAMP_AGE_NS:
            t_ns -= age
    t_ns = max(t_ns, p.rx_ns)  # keeps the queue's order, which the difference of two clocks may break
    p.rx_ns = t_ns
    result = TOOK
    for i in range(n // 16):
        can_id = words[2 * i] & 0xFFFFFFFF
        length = (words[2 * i] >> 32) & 0xFF
        word = words[2 * i + 1]
        if length > 8:
            p.rx_malformed += 1
            continue
        if length < 8:
            word &= (1 << 8 * length) - 1
        p.rx_frames += 1
        log_frame(b.plane, b.ring, t_ns, can_id, length, word, SOURCE_BUS + (k << BUS_SHIFT))
        if can_id & CAN_ERR_FLAG:
            p.error_frames += 1
            if live and can_id & CAN_ERR_BUSOFF:
                stop(p, b.axes, Trip.BUS_LOST)
            continue
        if not live:
            continue
        if can_id == c.sync_cob_id or can_id == CobId.HEARTBEAT + c.host_id:
            p.foreign_sync += 1
            stop(p, b.axes, Trip.SECOND_HOST)
        if on_frame(b.axes, b.owner, t_ns, can_id, length, word) == 1:
            result = COMPLETE
    return result


@kernel
def _send(b: Buffers, k: int, patience: int) -> int:
    """Send the queue's frames of a bus; return GONE if the last bus is lost by it."""
    p, tx, out = b.plane[0], b.tx, b.out
    count = 0
    for i in range(out.count):
        f = out.frames[i]
        if b.bus_of[f.can_id & 0x7FF] in (k, EVERY_BUS):
            tx[2 * count] = f.can_id | f.length << 32
            tx[2 * count + 1] = f.word
            count += 1
    if b.fds[k] < 0:
        p.unsent += count
        return TOOK
    done = 0
    while done < count:
        frames = count - done if p.packed >> k & 1 else 1
        n = send(b.fds[k], tx.ctypes.data + 16 * done, 16 * frames, MSG_DONTWAIT | MSG_NOSIGNAL)
        if n < 0:
            error = errno()
            if error == EINTR:
                p.interrupted += 1
                continue
            if patience > 0:
                patience -= 1
                sleep_until(now_ns() + END_PAUSE_NS)
                continue
            if error != EAGAIN and error != ENOBUFS:
                p.unsent += count - done
                return lose(b, k, error)
            p.tx_full += frames
        else:
            t_ns = now_ns()
            if done == 0:
                b.sent_ns[k] = t_ns
            for i in range(done, done + frames):
                can_id, length = tx[2 * i] & 0xFFFFFFFF, tx[2 * i] >> 32
                log_frame(b.plane, b.ring, t_ns, can_id, length, tx[2 * i + 1], SOURCE_HOST + (k << BUS_SHIFT))
        done += frames
    return TOOK


@kernel
def transmit(b: Buffers, patience: int) -> int:
    """Send the queue's frames, each on its bus; return 1 if the last bus is lost, else 0.

    A frame that a bus does not accept is lost. With `patience`, frames are offered again, up to
    `patience` times in total, with pauses of `END_PAUSE_NS`. A bus that was lost comes last.
    """
    first, result = b.plane[0].lost_bus, 0
    for turn in range(len(b.fds)):
        k = (first + turn) % len(b.fds)
        if _send(b, k, patience) == GONE:
            result = 1
    b.out.count = 0
    return result


@kernel
def drain(b: Buffers) -> int:
    """Receive the frames since the last cycle; return 1 if the last bus is lost."""
    for k in range(len(b.fds)):
        result = TOOK
        messages = 0
        while result != EMPTY and messages < DRAIN_MESSAGES:
            result = receive_message(b, k, 1)
            messages += 1
            if result == GONE:
                return 1
    return 0
