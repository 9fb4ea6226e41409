"""The data plane's loop: the cycle in real time on a non-blocking socket, compiled, without allocation.

    sleep until t_k - receive late frames - SYNC - receive until all TPDOs or the end of the window -
    `host.cycle.step` - RPDOs - count

t_k are absolute times of CLOCK_MONOTONIC. Missed periods are skipped and counted, and never caught up. The
loop logs every frame, its own and received ones, into a ring that the parent reads
(`host.realtime.log_rings`). In every case it sends set-points of zero torque last.

The loop also monitors its parent. A parent that has ended, or has not reported in time
(`PLANE.parent_ns`), is a reason for the safe state (HOST). After the parent's end the loop ends when all
axes are done.

Results of system calls:

- EINTR: the call is repeated.
- EAGAIN or ENOBUFS on sending: the frame is lost and counted. It is not repeated, because a delayed frame
  would be a wrong set-point. Too many such cycles trip.
- Every other error, or the other side's close: the bus is lost.

Only the safe set-points after the last cycle are repeated until they are accepted, for up to
`END_ATTEMPTS` ms, because nothing follows them.

    b : the Buffers        p : the `PlaneRecord`        c, h : the `ControlRecord` and the `HostRecord` of an axis
    f : a frame
"""

from __future__ import annotations

from typing import NamedTuple

from coulombus.eds.cia301 import CobId
from coulombus.host.cycle.axes import ask_to_stop, begin, finish, on_frame, ramps_a_brake, safe_setpoints
from coulombus.host.cycle.records import AxisRecords, LawFunction, Phase, PlaneFunctions, Trip
from coulombus.host.cycle.step import SOURCE_HOST
from coulombus.host.cycle.telemetry import tell
from coulombus.host.realtime.log_rings import log_frame, log_moment
from coulombus.host.realtime.shared_memory import BINS, PlaneCommand, PlaneRecord, PlaneStatus, field_offset
from coulombus.host.realtime.world_link import take_models, tell_world
from coulombus.host.world.records import StateRecord
from coulombus.kernels.decorator import kernel
from coulombus.kernels.libc import (
    CLOCK_REALTIME,
    CLOCK_THREAD_CPUTIME_ID,
    EAGAIN,
    EINTR,
    ENOBUFS,
    MSG_DONTWAIT,
    MSG_NOSIGNAL,
    POLLIN,
    clock_ns,
    errno,
    getppid,
    load_acquire,
    now_ns,
    ppoll_ns,
    send,
    sleep_until,
    store_release,
)
from coulombus.kernels.records import Integers, RecordArray
from coulombus.recording.trace import Moment, TraceRow
from coulombus.wire.frame import CAN_ERR_FLAG, Frame, Queue
from coulombus.wire.recvmsg import Mailbox, receive

__all__ = ["MESSAGE_FRAMES", "Buffers", "run_plane"]

MESSAGE_FRAMES = 64
"""Largest number of frames in a message."""

SOURCE_BUS = 0
"""Station number of received frames in the log."""


class Buffers(NamedTuple):
    """Buffers of the loop: its socket, the memory shared with the parent (`SharedPlane`), and the receive
    and send buffers.
    """

    fd: int
    plane: RecordArray[PlaneRecord]
    ring: RecordArray[Frame]
    trace: RecordArray[TraceRow]
    wakeup_bins: Integers
    latency_bins: Integers
    axes: AxisRecords
    owner: Integers
    box: RecordArray[Mailbox]
    words: Integers
    tx: Integers
    poll: Integers
    out: Queue
    told: RecordArray[Frame]  # telemetry frames of one axis (`host.cycle.telemetry`)
    world_fd: int  # socket for the states of each cycle (`host.world.server`); -1: none
    world_state: RecordArray[StateRecord]  # the state that is sent, one record


AT_COMMAND, AT_STATUS, AT_STOP = field_offset("command"), field_offset("status"), field_offset("stop")
AT_CYCLES, AT_PARENT, AT_ORDER = field_offset("cycles"), field_offset("parent_ns"), field_offset("order")
AT_DEADMAN = field_offset("deadman_ns")

LISTEN_NS = 5_000_000  # period of the check for commands while listening
DRAIN_MESSAGES = 512  # largest number of messages that a cycle reads from a flooded bus
END_ATTEMPTS, END_PAUSE_NS = 20, 1_000_000  # for the last set-points, which no cycle repeats
STAMP_AGE_NS = 1_000_000_000  # an older stamp means that the clock was set
CAN_ERR_BUSOFF = 0x40
CLOSED = -1

# results of `_take`
EMPTY, TOOK, COMPLETE, GONE = 0, 1, 2, 3


@kernel
def _tell(b: Buffers, t_ns: int) -> None:
    """Log the telemetry of all axes, after the frames of their cycle."""
    for k in range(b.axes.shape[0]):
        for i in range(tell(b.axes[k], k, t_ns, b.told, 0)):
            f = b.told[i]
            log_frame(b.plane, b.ring, t_ns, f.can_id, f.length, f.word, f.source)


@kernel
def _stop(p: PlaneRecord, axes: AxisRecords, trip: int) -> None:
    """Request the safe state of all axes with the reason `trip`, or without a reason (1).

    The first reason counts.
    """
    if p.asked < trip and p.asked <= 1:
        p.asked = trip
    ask_to_stop(axes, trip)


@kernel
def _skip(p: PlaneRecord, axes: AxisRecords, periods: int) -> int:
    """Skip and count missed periods, and add them to the position's age of every axis; return their number."""
    if periods <= 0:
        return 0
    p.missed_deadlines += periods
    for k in range(axes.shape[0]):
        axes[k].host.position_age += periods
    return periods


@kernel
def _take(b: Buffers, live: int) -> int:
    """Receive one message if there is one; `live`: pass its frames to the cycle."""
    p, c, words = b.plane[0], b.axes[0].control, b.words
    n = receive(b.fd, b.box, MSG_DONTWAIT)
    if n <= 0:
        error = 0 if n == 0 else errno()
        if error == EAGAIN:
            return EMPTY
        if error == EINTR:
            p.interrupted += 1
            return TOOK
        p.error = error
        return GONE
    m = b.box[0]
    p.rx_overflow = m.overflow
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
        log_frame(b.plane, b.ring, t_ns, can_id, length, word, SOURCE_BUS)
        if can_id & CAN_ERR_FLAG:
            p.error_frames += 1
            if live and can_id & CAN_ERR_BUSOFF:
                _stop(p, b.axes, Trip.BUS_LOST)
            continue
        if not live:
            continue
        if can_id == c.sync_cob_id or can_id == CobId.HEARTBEAT + c.host_id:
            p.foreign_sync += 1
            _stop(p, b.axes, Trip.SECOND_HOST)
        if on_frame(b.axes, b.owner, t_ns, can_id, length, word) == 1:
            result = COMPLETE
    return result


@kernel
def _transmit(b: Buffers, patience: int) -> int:
    """Send the queue's frames; return 0, or the error number of a lost bus.

    A frame that the bus does not accept is lost. With `patience`, frames are offered again, up to
    `patience` times in total, with pauses of `END_PAUSE_NS`.
    """
    p, tx, out = b.plane[0], b.tx, b.out
    count = out.count
    out.count = 0
    for i in range(count):
        f = out.frames[i]
        tx[2 * i] = f.can_id | f.length << 32
        tx[2 * i + 1] = f.word
    done = 0
    while done < count:
        frames = count - done if p.packed else 1
        n = send(b.fd, tx.ctypes.data + 16 * done, 16 * frames, MSG_DONTWAIT | MSG_NOSIGNAL)
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
                p.error = error
                return error
            p.tx_full += frames
        else:
            t_ns = now_ns()
            for i in range(done, done + frames):
                f = out.frames[i]
                log_frame(b.plane, b.ring, t_ns, f.can_id, f.length, f.word, SOURCE_HOST)
        done += frames
    return 0


@kernel
def _look_after_parent(p: PlaneRecord, base: int, axes: AxisRecords) -> None:
    """Request the safe state if the parent has ended or hangs.

    If it has ended and all axes are done, end the loop.
    """
    until = load_acquire(base + AT_PARENT)
    orphan = p.parent != 0 and getppid() != p.parent
    if orphan or 0 < until < now_ns():
        _stop(p, axes, Trip.HOST)
    if orphan and _all_done(axes):
        store_release(base + AT_COMMAND, PlaneCommand.QUIT)


@kernel
def _all_done(axes: AxisRecords) -> bool:
    """Return whether all axes are done; from then on the nodes may be stopped from sending TPDOs."""
    done = 0
    for k in range(axes.shape[0]):
        done += 1 if axes[k].host.phase == Phase.DONE else 0
    return done == len(axes)


@kernel
def _failed(p: PlaneRecord) -> bool:
    """Return whether a call that returned -1 has a permanent error: a failing wait would return at once,
    without end.
    """
    error = errno()
    if error in (EINTR, EAGAIN):
        return False
    p.error = error
    return True


@kernel
def _count(bins: Integers, t_ns: int) -> None:
    bins[min(max(t_ns, 0) // 1000, BINS - 1)] += 1


@kernel
def _drain(b: Buffers) -> int:
    """Receive the frames since the last cycle; return 1 if the bus is lost."""
    result = TOOK
    messages = 0
    while result != EMPTY and messages < DRAIN_MESSAGES:
        result = _take(b, 1)
        messages += 1
        if result == GONE:
            return 1
    return 0


@kernel
def _obey(b: Buffers) -> None:
    """Execute the parent's requests (safe state, dead man's switch, parameters, models), and check that it runs."""
    p, axes, base = b.plane[0], b.axes, b.plane.ctypes.data
    _stop(p, axes, load_acquire(base + AT_STOP))
    _look_after_parent(p, base, axes)
    if axes[0].control.deadman_key:
        held = 1 if now_ns() < load_acquire(base + AT_DEADMAN) else 0
        for k in range(axes.shape[0]):
            axes[k].host.deadman_ok = held
    order = load_acquire(base + AT_ORDER)
    if order != p.ordered:
        p.ordered = order
        axes[p.order_axis].live.wanted = order
        log_moment(b.plane, b.trace, Moment.SET, now_ns(), order)
    take_models(b.plane, b.trace, b.axes)


@kernel
def _collect(b: Buffers, law_function: LawFunction, arm: PlaneFunctions | None, end_ns: int) -> int:
    """Receive until all axes have finished their cycle, or until the window for TPDOs is over.

    Return 1 if the bus is lost.
    """
    p, axes = b.plane[0], b.axes
    messages = 0
    while messages < DRAIN_MESSAGES:
        left = end_ns - now_ns()
        if left <= 0:
            break
        ready = ppoll_ns(b.poll.ctypes.data, 1, left)
        if ready < 0 and _failed(p):
            return 1
        if ready <= 0:  # the window is over, or a signal interrupted the wait
            continue
        result = _take(b, 1)
        messages += 1
        if result == GONE:
            return 1
        if result == COMPLETE:
            now = now_ns()
            log_moment(b.plane, b.trace, Moment.ARRIVED, now, p.asked)
            if finish(axes, law_function, now, 0, b.out, arm) == 0:
                break
            if _transmit(b, 0) != 0:
                return 1
    now = now_ns()
    log_moment(b.plane, b.trace, Moment.WINDOW, now, p.asked)
    finish(axes, law_function, now, 1, b.out, arm)
    return 1 if _transmit(b, 0) != 0 else 0


@kernel
def _goes_on(p: PlaneRecord, axes: AxisRecords, command: int) -> bool:
    """Return whether another cycle begins: by command, or to ramp a brake off before the end.

    For the latter, the safe state is requested, which ends within its time.
    """
    if command == PlaneCommand.CYCLE:
        return True
    if not ramps_a_brake(axes):
        return False
    _stop(p, axes, 1)
    return True


@kernel
def _cycle(b: Buffers, law_function: LawFunction, arm: PlaneFunctions | None) -> int:
    """Run cycles; return 0 after the parent's command, when brakes that only the host ramps are off, and 1
    if the bus is lost.
    """
    p, axes, base = b.plane[0], b.axes, b.plane.ctypes.data
    c = axes[0].control  # all axes share the cycle, the host's own identifiers and the dead man's switch
    missed_cycles = c.missed_cycles
    for k in range(1, axes.shape[0]):
        missed_cycles = min(missed_cycles, axes[k].control.missed_cycles)
    t = p.start_ns
    log_moment(b.plane, b.trace, Moment.START, t, 0)
    while _goes_on(p, axes, load_acquire(base + AT_COMMAND)):
        slept = sleep_until(t)
        if slept == EINTR:
            p.interrupted += 1
            continue
        if slept != 0:
            p.error = slept
            return 1
        wake = now_ns()
        _count(b.wakeup_bins, wake - t)
        p.wakeup_max_ns = max(p.wakeup_max_ns, wake - t)
        t += c.period_ns * _skip(p, axes, (wake - t) // c.period_ns)
        full = p.tx_full
        if _drain(b) != 0:
            return 1
        _obey(b)
        log_moment(b.plane, b.trace, Moment.BEGIN, t, axes[0].host.deadman_ok)
        displays = not _all_done(axes)
        begin(axes, t, b.out)
        if _transmit(b, 0) != 0:
            return 1
        sync = now_ns()
        if _collect(b, law_function, arm, sync + c.window_ns) != 0:
            return 1
        done = now_ns()
        tell_world(b.world_fd, b.world_state, b.axes, done)
        _tell(b, done)
        if displays:
            _count(b.latency_bins, done - sync)
            p.latency_max_ns = max(p.latency_max_ns, done - sync)
        p.full_in_a_row = p.full_in_a_row + 1 if p.tx_full > full else 0
        if p.full_in_a_row >= missed_cycles:
            _stop(p, axes, Trip.TRANSMIT)
        t += c.period_ns
        t += c.period_ns * _skip(p, axes, (done - t + c.period_ns - 1) // c.period_ns)
        store_release(base + AT_CYCLES, p.cycles + 1)
    return 0


@kernel
def run_plane(b: Buffers, law_function: LawFunction, arm: PlaneFunctions | None = None) -> int:
    """Execute the parent's commands until QUIT or the loss of the bus; return the `PlaneStatus`."""
    p, axes = b.plane[0], b.axes
    base = b.plane.ctypes.data
    b.poll[0] = b.fd | POLLIN << 32
    while True:
        command = load_acquire(base + AT_COMMAND)
        if command == PlaneCommand.CYCLE:
            store_release(base + AT_STATUS, PlaneStatus.CYCLING)
            cpu = clock_ns(CLOCK_THREAD_CPUTIME_ID)
            gone = _cycle(b, law_function, arm)
            p.cpu_ns += clock_ns(CLOCK_THREAD_CPUTIME_ID) - cpu
            for k in range(axes.shape[0]):
                h = axes[k].host
                if gone and h.phase < Phase.SAFE:
                    h.trip = Trip.BUS_LOST
                    h.trip_ns = now_ns()
            error = p.error
            now = now_ns()
            log_moment(b.plane, b.trace, Moment.END, now, 0)
            b.out.count = 0
            safe_setpoints(axes, now, b.out)
            _transmit(b, END_ATTEMPTS)
            p.error = error
            for k in range(axes.shape[0]):
                axes[k].host.phase = Phase.DONE
            if gone:
                store_release(base + AT_STATUS, PlaneStatus.LOST)
                return PlaneStatus.LOST
        elif command == PlaneCommand.LISTEN:
            store_release(base + AT_STATUS, PlaneStatus.LISTENING)
            result = _take(b, 0)
            lost = result == GONE
            if result == EMPTY and ppoll_ns(b.poll.ctypes.data, 1, LISTEN_NS) < 0:
                lost = _failed(p)
            if lost:
                store_release(base + AT_STATUS, PlaneStatus.LOST)
                return PlaneStatus.LOST
            if p.parent != 0 and getppid() != p.parent:
                store_release(base + AT_COMMAND, PlaneCommand.QUIT)
        else:
            store_release(base + AT_STATUS, PlaneStatus.ENDED)
            return PlaneStatus.ENDED
