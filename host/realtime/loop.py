"""The data plane's loop: the cycle in real time on a non-blocking socket, compiled, without allocation.

    sleep until t_k - receive late frames - SYNC - receive until all TPDOs or the end of the window -
    `host.cycle.step` - RPDOs - count

t_k are absolute times of CLOCK_MONOTONIC. Missed periods are skipped and counted, and never caught up. The
loop logs every frame, its own and received ones, into a ring that the parent reads
(`host.realtime.log_rings`). In every case it sends set-points of zero torque last.

With a world outside, the law takes the newest local model of each axis, and the state of each axis goes out
after the cycle. A world never delays the cycle.

The loop also monitors its parent. A parent that has ended, or has not reported in time
(`PLANE.parent_ns`), is a reason for the safe state (HOST). After the parent's end the loop ends when all
axes are done.

Several buses (`host.realtime.bus_sockets`) share the cycle: SYNC goes to all of them at once, and the step waits
for the TPDOs of all. Only the safe set-points after the last cycle are repeated until they are accepted, for up to
`END_ATTEMPTS` ms, because nothing follows them.

    b : the Buffers        p : the `PlaneRecord`        c, h : the `ControlRecord` and the `HostRecord` of an axis
    f : a frame        k : the number of an axis, or of a bus        w : the `LocalModelRecord` of an axis
"""

from __future__ import annotations

from coulombus.host.cycle.axes import WINDOW_OPEN, WINDOW_OVER, begin, finish, ramps_a_brake, safe_setpoints
from coulombus.host.cycle.display_state import describe
from coulombus.host.cycle.records import AXIS, AxisRecords, LawFunction, Phase, PlaneFunctions, Trip
from coulombus.host.cycle.telemetry import write_axis
from coulombus.host.realtime.bus_sockets import (
    COMPLETE,
    DRAIN_MESSAGES,
    EMPTY,
    GONE,
    Buffers,
    drain,
    failed,
    receive_message,
    stop,
    transmit,
    watch,
)
from coulombus.host.realtime.log_rings import log_frame, log_moment
from coulombus.host.realtime.shared_memory import BINS, PlaneCommand, PlaneRecord, PlaneStatus, field_offset
from coulombus.host.world.recorded import AXIS_BITS, KEY_MASK
from coulombus.host.world.records import StateRecord, offset_of
from coulombus.kernels.decorator import kernel
from coulombus.kernels.libc import (
    CLOCK_THREAD_CPUTIME_ID,
    EINTR,
    MSG_DONTWAIT,
    MSG_NOSIGNAL,
    clock_ns,
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

__all__ = ["run_plane"]

AT_COMMAND, AT_STATUS, AT_STOP = field_offset("command"), field_offset("status"), field_offset("stop")
AT_CYCLES, AT_PARENT, AT_ORDER = field_offset("cycles"), field_offset("parent_ns"), field_offset("order")
AT_DEADMAN = field_offset("deadman_ns")
AXIS_SIZE = AXIS.itemsize
AT_PUBLISHED = offset_of(AXIS, "world", "published")

LISTEN_NS = 5_000_000  # period of the check for commands while listening
END_ATTEMPTS = 20  # for the last set-points, which no cycle repeats


@kernel
def _log_telemetry(b: Buffers, t_ns: int) -> None:
    """Log the telemetry of all axes, after the frames of their cycle."""
    for k in range(b.axes.shape[0]):
        for i in range(write_axis(b.axes[k], k, t_ns, b.telemetry, 0)):
            f = b.telemetry[i]
            log_frame(b.plane, b.ring, t_ns, f.can_id, f.length, f.word, f.source)


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
def _look_after_parent(p: PlaneRecord, base: int, axes: AxisRecords) -> None:
    """Request the safe state if the parent has ended or hangs.

    If it has ended and all axes are done, end the loop.
    """
    until = load_acquire(base + AT_PARENT)
    orphan = p.parent != 0 and getppid() != p.parent
    if orphan or 0 < until < now_ns():
        stop(p, axes, Trip.HOST)
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
def _count(bins: Integers, t_ns: int) -> None:
    bins[min(max(t_ns, 0) // 1000, BINS - 1)] += 1


@kernel
def _obey(b: Buffers) -> None:
    """Execute the parent's requests (safe state, dead man's switch, parameters), and check that it runs."""
    p, axes, base = b.plane[0], b.axes, b.plane.ctypes.data
    stop(p, axes, load_acquire(base + AT_STOP))
    _look_after_parent(p, base, axes)
    if axes[0].control.deadman_key:
        held = 1 if now_ns() < load_acquire(base + AT_DEADMAN) else 0
        for k in range(axes.shape[0]):
            axes[k].host.deadman_ok = held
    number = load_acquire(base + AT_ORDER)
    if number != p.ordered:
        p.ordered = number
        axes[p.order_axis].live.wanted = number
        log_moment(b.plane, b.trace, Moment.SET, now_ns(), number)


@kernel
def _tell_world(fd: int, state: RecordArray[StateRecord], axes: AxisRecords, done_ns: int) -> None:
    """Send the state of each axis after a cycle to the socket `fd` (-1: none); without room it is lost there.

    `state` is one record for the states, one after the other.
    """
    for k in range(axes.shape[0] if fd >= 0 else 0):
        describe(axes, k, done_ns, state[0])
        send(fd, state.ctypes.data, state.itemsize, MSG_DONTWAIT | MSG_NOSIGNAL)


@kernel
def _take_models(plane: RecordArray[PlaneRecord], trace: RecordArray[TraceRow], axes: AxisRecords) -> None:
    """Let the law take the newest model of each axis: also one that came after the cycle had begun."""
    for k in range(axes.shape[0]):
        w = axes[k].world
        if w.on == 0:
            continue
        number = load_acquire(axes.ctypes.data + k * AXIS_SIZE + AT_PUBLISHED)
        if number != w.wanted:
            w.wanted = number
            log_moment(plane, trace, Moment.MODEL, now_ns(), (number << AXIS_BITS | k) & KEY_MASK)


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
        ready = ppoll_ns(b.poll.ctypes.data, len(b.fds), left)
        if ready < 0 and failed(p):
            return 1
        if ready <= 0:  # the window is over, or a signal interrupted the wait
            continue
        waiting = 1
        for k in range(len(b.fds)):
            if b.poll[k] >> 48 == 0:
                continue
            result = receive_message(b, k, 1)
            messages += 1
            if result == GONE:
                return 1
            if result == COMPLETE:
                _take_models(b.plane, b.trace, axes)
                now = now_ns()
                log_moment(b.plane, b.trace, Moment.ARRIVED, now, p.asked)
                waiting = finish(axes, law_function, now, WINDOW_OPEN, b.out, arm)
                if waiting != 0 and transmit(b, 0) != 0:
                    return 1
        if waiting == 0:
            break
    _take_models(b.plane, b.trace, axes)
    now = now_ns()
    log_moment(b.plane, b.trace, Moment.WINDOW, now, p.asked)
    finish(axes, law_function, now, WINDOW_OVER, b.out, arm)
    return 1 if transmit(b, 0) != 0 else 0


@kernel
def _goes_on(p: PlaneRecord, axes: AxisRecords, command: int) -> bool:
    """Return whether another cycle begins: by command, or to ramp a brake off before the end.

    For the latter, the safe state is requested, which ends within its time.
    """
    if command == PlaneCommand.CYCLE:
        return True
    if not ramps_a_brake(axes):
        return False
    stop(p, axes, 1)
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
        if drain(b) != 0:
            return 1
        _obey(b)
        log_moment(b.plane, b.trace, Moment.BEGIN, t, axes[0].host.deadman_ok)
        displays = not _all_done(axes)
        begin(axes, t, b.out)
        if transmit(b, 0) != 0:
            return 1
        if len(b.fds) > 1 and p.lost_bus == 0:
            skew = b.sent_ns.max() - b.sent_ns.min()
            _count(b.skew_bins, skew)
            p.skew_max_ns = max(p.skew_max_ns, skew)
        sync = now_ns()
        if _collect(b, law_function, arm, sync + c.window_ns) != 0:
            return 1
        done = now_ns()
        _tell_world(b.world_fd, b.world_state, b.axes, done)
        _log_telemetry(b, done)
        if displays:
            _count(b.latency_bins, done - sync)
            p.latency_max_ns = max(p.latency_max_ns, done - sync)
        p.full_in_a_row = p.full_in_a_row + 1 if p.tx_full > full else 0
        if p.full_in_a_row >= missed_cycles:
            stop(p, axes, Trip.TRANSMIT)
        t += c.period_ns
        t += c.period_ns * _skip(p, axes, (done - t + c.period_ns - 1) // c.period_ns)
        store_release(base + AT_CYCLES, p.cycles + 1)
    return 0


@kernel
def run_plane(b: Buffers, law_function: LawFunction, arm: PlaneFunctions | None = None) -> int:
    """Execute the parent's commands until QUIT or the loss of the bus; return the `PlaneStatus`."""
    p, axes = b.plane[0], b.axes
    base = b.plane.ctypes.data
    watch(b)
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
            transmit(b, END_ATTEMPTS)
            p.error = error
            for k in range(axes.shape[0]):
                axes[k].host.phase = Phase.DONE
            if gone:
                store_release(base + AT_STATUS, PlaneStatus.LOST)
                return PlaneStatus.LOST
        elif command == PlaneCommand.LISTEN:
            store_release(base + AT_STATUS, PlaneStatus.LISTENING)
            empty = 1
            for k in range(len(b.fds)):
                empty = empty if receive_message(b, k, 0) == EMPTY else 0
            lost = p.lost_bus != 0  # before anything is armed, one bus is enough
            if empty and ppoll_ns(b.poll.ctypes.data, len(b.fds), LISTEN_NS) < 0:
                lost = failed(p)
            if lost:
                store_release(base + AT_STATUS, PlaneStatus.LOST)
                return PlaneStatus.LOST
            if p.parent != 0 and getppid() != p.parent:
                store_release(base + AT_COMMAND, PlaneCommand.QUIT)
        else:
            store_release(base + AT_STATUS, PlaneStatus.ENDED)
            return PlaneStatus.ENDED
