"""The virtual bus in real time: a compiled loop between clients' sockets and `sim_bus.network.event_loop`.

The world's time is CLOCK_MONOTONIC minus its start. The loop sleeps in ppoll(2) until the world's
next event or a client's message, runs the world up to the present and delivers each frame at its
end of frame. It returns to Python only for rare events: a client that connects, greets or leaves
(`sim_bus.network.event_loop.Exit`, `sim_bus.server.clients.Need`, `Serve`). The services of a
simulated rig's nodes run concurrently with this loop (`sim_bus.server.python_worker`).

A frame is ready when the kernel received it from its sender (SO_TIMESTAMPNS), not when this loop
read it. So frames that waited in a socket while this process could not run are sent, and handled by
the nodes, before a deadline is checked. If the whole machine was stalled, so that nobody sent
anything, the world was stopped, too (`stalled_ns`): no deadline passes in a time in which nobody
could have met it.

    p : the `PaceRecord`
"""

from __future__ import annotations

from enum import IntEnum

from coulombus.eds.cia402 import PowerState
from coulombus.kernels.decorator import constant, kernel
from coulombus.kernels.libc import (
    CLOCK_REALTIME,
    EAGAIN,
    EBADF,
    EINTR,
    POLLIN,
    POLLNVAL,
    clock_ns,
    errno,
    load_acquire,
    now_ns,
    ppoll_ns,
)
from coulombus.kernels.records import Integers, RecordArray
from coulombus.sim_bus.can_bus.cable_cut import choose
from coulombus.sim_bus.network.event_loop import Exit, HostCycle, World, next_event, refresh, run
from coulombus.sim_bus.rig.plant_step import CourseFunction
from coulombus.sim_bus.server.clients import Clients, SlotState, flush, hand_out, offer_frames
from coulombus.sim_bus.server.python_worker import FRAME, RECORD, Beside, drained, enqueue, take_results
from coulombus.sim_bus.server.records import PaceRecord, SlotRecord

__all__ = ["Serve", "serve"]

STALL_NS = 5_000_000
LONGEST_SLEEP_NS = 100_000_000
KEPT_NS = 100_000_000
"""Longest waiting time of frames for the recorder; the loop sleeps no longer than LONGEST_SLEEP_NS. A
killed process loses less than 0.25 s.
"""


AHEAD_NS = 1_000_000_000
"""Lead time of the request for the next block of a hand's force."""


class Serve(IntEnum):
    """Reason why the loop returned, besides `sim_bus.network.event_loop.Exit` and `sim_bus.server.clients.Need`."""

    STOP = 30  # stop requested
    TIME = 31  # the time is over
    ACCEPT = 32  # a client waits at the listener
    RESTED = 33  # the drive of an axis left Operation Enabled: the operator's schedule ends
    RECORD = 34  # `PaceRecord.keep` frames wait in the log for the recorder, or the oldest for KEPT_NS
    FAILED = 35  # an essential system call failed; `PaceRecord.error`


_RECORD, _RESTED, _FORCE = constant(Serve.RECORD), constant(Serve.RESTED), constant(Exit.FORCE)


@kernel
def _wait(p: PaceRecord, slots: RecordArray[SlotRecord], pollfds: Integers, timeout_ns: int, beside: Beside) -> int:
    """Sleep until a client is readable or the time is over.

    Return Serve.ACCEPT if a client waits at the listener, FAILED, or 0.

    `pollfds` has only the descriptors that are polled: never more than this process may open
    (RLIMIT_NOFILE), because ppoll refuses more.
    """
    pollfds[0] = (p.listener & 0xFFFFFFFF) | POLLIN << 32
    pollfds[1] = (p.wake & 0xFFFFFFFF) | POLLIN << 32
    n, count = slots.shape[0], 2
    for i in range(n):
        s = slots[i]  # a client with an unfinished message is not polled, not even for its end
        s.watched = 0
        if s.state != SlotState.FREE and s.next >= s.staged and s.gone == 0:
            pollfds[count] = s.fd | POLLIN << 32
            s.watched = count
            count += 1
    ready = ppoll_ns(pollfds.ctypes.data, count, timeout_ns)
    p.wakeups += 1
    if ready < 0:
        number = errno()
        if number in (EINTR, EAGAIN):
            return 0
        p.error = number
        return Serve.FAILED
    if ready > 0:
        if pollfds[1] >> 48 & POLLNVAL:
            p.error = EBADF
            return Serve.FAILED
        if pollfds[1] >> 48 & POLLIN:
            drained(beside)
        for i in range(n):
            if slots[i].watched != 0 and pollfds[slots[i].watched] >> 48 != 0:
                slots[i].dry = 0
        if pollfds[0] >> 48 != 0:
            return Serve.ACCEPT
    return 0


@kernel
def _discount_stall(p: PaceRecord, slots: RecordArray[SlotRecord], planned_ns: int, t_ns: int) -> int:
    """Shift the world's time by the time for which the whole machine was stalled since `planned_ns`.

    Return that time.
    """
    first = t_ns
    for i in range(slots.shape[0]):
        if slots[i].state != SlotState.FREE and slots[i].next < slots[i].staged:
            first = min(first, slots[i].ready_ns)
    lost = first - planned_ns
    if lost < STALL_NS:
        return 0
    for i in range(slots.shape[0]):
        slots[i].ready_ns -= lost
    p.start_ns += lost
    p.stalls += 1
    p.stalled_ns += lost
    return lost


@kernel
def serve(
    pace: RecordArray[PaceRecord],
    clients: Clients,
    beside: Beside,
    world: World,
    host: HostCycle,
    course: CourseFunction,
) -> int:
    """Serve until Python is needed; return an `Exit` or a `Serve` as the reason.

    Call `sim_bus.server.python_worker.drain_jobs` next: it completes Python's concurrent jobs.

    A host is a separate process, so the world's loop has none.
    """
    p, w, bus, out = pace[0], world.state, world.bus, world.out
    slots, batches, cable = clients.slots, clients.batches, bus[0]
    flag = pace.ctypes.data
    if w.stale:
        refresh(w, world.nodes, world.axes, world.deadlines, world.wants)
    while True:
        take_results(beside, world, course, p)
        t_ns = now_ns() - p.start_ns
        offset_ns = t_ns - clock_ns(CLOCK_REALTIME)
        need = offer_frames(w, p, bus, clients, out, offset_ns, t_ns)
        if t_ns > p.planned_ns + STALL_NS:
            t_ns -= _discount_stall(p, slots, p.planned_ns, t_ns)
        p.planned_ns = t_ns
        if need != 0:
            return need
        # the world up to the present, event by event: each start of a frame makes room for its sender's next
        while True:
            b = cable if cable.cut == 0 else bus[choose(bus, out)]
            t_event, _ = next_event(w, b, out, world.deadlines, host.axes)
            if t_event > t_ns:
                break
            w.until_ns = max(t_event, w.t_ns)
            reason = run(world, host, None, course, None)
            if w.log_count > p.handed_out:
                p.latest_ns = max(p.latest_ns, t_ns - world.log[w.log_count - 1].t_ns)
                lost = hand_out(w, p, bus, world.log, clients)
                if lost != 0:
                    return lost
            why = 0
            if reason == Exit.SERVICE:
                if not enqueue(beside, world, course, p, reason, FRAME):
                    why += reason
            elif reason == Exit.ENABLED:
                if not enqueue(beside, world, course, p, reason, w.axis):
                    why += reason
            elif reason not in (Exit.UNTIL, Exit.LOG):
                why += reason
            if why == 0:
                if p.keep == 0:
                    p.handed_out = w.log_count = 0
                elif reason == Exit.LOG or (
                    w.log_count >= p.keep and not enqueue(beside, world, course, p, _RECORD, RECORD)
                ):
                    why = Serve.RECORD
                for a in range(world.axes.shape[0]):
                    axis = world.axes[a]
                    state = world.nodes[axis.motor].power_state
                    if axis.operator_start_ns >= 0 and state != PowerState.OPERATION_ENABLED:
                        w.axis = a
                        if not enqueue(beside, world, course, p, _RESTED, a):
                            why = Serve.RESTED
                    elif axis.force_end_ns - t_ns < AHEAD_NS:
                        enqueue(beside, world, course, p, _FORCE, a)
            if why != 0:
                for i in range(slots.shape[0]):
                    flush(slots[i], batches[i])
                return why
            need = offer_frames(w, p, bus, clients, out, offset_ns, t_ns)
            if need != 0:
                break
        for i in range(slots.shape[0]):
            flush(slots[i], batches[i])
        if need != 0:
            return need
        waits = p.keep != 0 and 0 < w.log_count <= p.handed_out
        if waits and t_ns - world.log[0].t_ns >= KEPT_NS and not enqueue(beside, world, course, p, _RECORD, RECORD):
            return Serve.RECORD
        if load_acquire(flag) != 0:
            return Serve.STOP
        t_ns = now_ns() - p.start_ns
        if t_ns >= p.end_ns:
            return Serve.TIME
        p.planned_ns = min(min(t_event, p.end_ns), t_ns + LONGEST_SLEEP_NS)
        why = _wait(p, slots, clients.pollfds, max(p.planned_ns - t_ns, 0), beside)
        p.planned_ns = max(p.planned_ns, t_ns)
        if why != 0:
            return why
