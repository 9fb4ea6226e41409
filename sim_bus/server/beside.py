"""Python beside the compiled loop: where another bus carries the frames, it does not stand still
while a node of ours answers an SDO.

On a bus of our own the world's time stands still while Python works, so what was recorded comes out
again (`lab.replay.virtual_replay`). On SocketCAN, or on the bus of another process, everybody else
goes on. So there Python has the node records for itself, and `Beside` works on them in a thread of
its own: the answers to SDO requests and to NMT commands other than resets, what Python's stations
hear, and the next block of the hand's force. Everything else (resets, LSS, scripts, power) is done
as on our own bus, when all that was asked before is done.

There is one job at a time, the first of `Jobs.ring`, and its way is::

    IDLE --hand_over: the loop copies the node's record--> ASKED
    ASKED --the thread works on Python's record, and tells which words it changed--> DONE
    DONE --take_back: the loop writes these words and sends the frames--> IDLE

So both copies are made between two events of the world, and no record is ever seen half-written. A
word that the loop has written meanwhile, too, keeps the loop's value: it is the newer one. A node
with a request under way leaves all its SDO requests to Python (`busy` of its record), so they are
answered in their order.
"""

from __future__ import annotations

import os
import select
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from coulombus.compiled.decorator import Entry, kernel
from coulombus.compiled.libc import load_acquire, read, store_release, write
from coulombus.eds.cia301 import CobId, NmtCommand
from coulombus.node.record import NODE
from coulombus.node.sizes import BLOCK_SEGMENTS
from coulombus.sim_bus.network.kernel import MOST_DEVICES, World, actuate, refresh
from coulombus.sim_bus.network.network import VirtualNetwork
from coulombus.wire.frame import Queue, Records, new_queue, new_records, push
from coulombus.wire.realtime import set_fifo

__all__ = ["Beside", "Jobs", "Kind", "ask_force", "ask_service", "exchange", "has_room", "is_beside"]

ROOM = 128
"""Requests that wait at most; with more of them the loop waits, too."""
SPARE = 16
"""Places for what is no request of a client."""
SETTLE_S = 1.0


class Kind(IntEnum):
    """Of a request."""

    SERVICE = 0  # a frame for the services of nodes, or for Python's stations
    ENABLED = 1  # the drive of an axis entered Operation Enabled: the operator's schedule begins
    RESTED = 2  # it left it again: the schedule is over
    FORCE = 3  # the block of the operator's force is half over


IDLE, ASKED, DONE = 0, 1, 2
"""State of the job."""

REQUEST = np.dtype(
    [
        ("kind", np.int64),
        ("t_ns", np.int64),
        ("can_id", np.int64),
        ("length", np.int64),
        ("word", np.int64),
        ("source", np.int64),
        ("heard", np.int64),  # 1: a station of Python's wants the frame
        ("rows", np.int64),  # nodes that want it
        ("row", np.int64, (MOST_DEVICES,)),
        ("axis", np.int64),
        ("start_ns", np.int64),  # when the schedule began; -1: it has not
    ],
    align=True,
)

JOB = np.dtype(
    [
        ("state", np.int64),  # first: both sides read it with `load_acquire`
        ("one", np.int64),  # what is written to an eventfd
        ("read", np.int64),  # what is read from one
        ("ask", np.int64),  # eventfd that wakes the thread
        ("wake", np.int64),  # eventfd that wakes the loop
        ("first", np.int64),  # of the ring
        ("count", np.int64),
        ("t_ns", np.int64),  # the world's time at which it was handed over
        ("step", np.int64),  # the plant's step at which the block of force begins
        ("changes", np.int64),  # words that the thread changed
    ],
    align=True,
)
_ONE, _READ = 8, 16

_SETTLED = ("rpdo", "tpdo", "fast_key", "fast_slot", "fast_size", "route", "rtr_route")
"""What only Python writes, two thirds of a record: the loop need not copy it."""


def _written() -> tuple[tuple[int, int], ...]:
    """Return the runs of words of a record that the loop may write, but for `segments_word`."""
    runs: list[list[int]] = []
    for name in NODE.names or ():
        kind, at = NODE.fields[name][:2]  # type: ignore[index]
        if name in (*_SETTLED, "segments_word"):
            continue
        if runs and runs[-1][1] == at // 8:
            runs[-1][1] += kind.itemsize // 8
        else:
            runs.append([at // 8, (at + kind.itemsize) // 8])
    return tuple((first, end) for first, end in runs)


_RUNS = np.array(_written(), np.int64)
_SEGMENTS = int(NODE.fields["segments_word"][1]) // 8  # type: ignore[index]
_NEXT = int(NODE.fields["next_ns"][1]) // 8  # type: ignore[index]


class Jobs(NamedTuple):
    """What the loop and the thread share."""

    job: Any
    """One record of `JOB`."""
    ring: Any
    """Records of `REQUEST`."""
    live: Any
    """The loop's node records, a row of words each."""
    base: Any
    """What was handed over of them."""
    changes: Any
    """Rows of (node, word, before, after)."""
    out: Any
    """The frames that Python sends."""
    force: Any
    """By axis: the next block of the operator's force."""
    asked: Any
    """By axis: requests for a block that are under way."""


# the loop's side


@kernel
def has_room(jobs: Jobs) -> bool:
    """Tell whether one more frame may ask for Python."""
    return jobs.job[0].count < ROOM - SPARE  # type: ignore[no-any-return]


@kernel
def is_beside(w: Any, log: Any) -> bool:
    """Tell whether what the last frame asks of Python can be done beside the loop: no reset, no
    LSS.
    """
    f = log[w.log_count - 1]
    if w.control_plane != 0 or f.can_id == CobId.LSS_RX:
        return False
    command = f.word & 0xFF
    return not (f.can_id == CobId.NMT and command in (NmtCommand.RESET_NODE, NmtCommand.RESET_COMMUNICATION))


@kernel
def _new_request(jobs: Jobs, kind: int, t_ns: int) -> Any:
    job = jobs.job[0]
    request = jobs.ring[(job.first + job.count) % ROOM]
    job.count += 1
    request.kind = kind
    request.t_ns = t_ns
    request.rows = 0
    request.heard = 0
    return request


@kernel
def ask_service(world: World, jobs: Jobs) -> None:
    """Let the thread serve the last frame."""
    w = world.state
    f = world.log[w.log_count - 1]
    request = _new_request(jobs, Kind.SERVICE, f.t_ns)
    request.can_id, request.length, request.word, request.source = f.can_id, f.length, f.word, f.source
    request.heard, request.rows = w.heard, w.services
    for k in range(w.services):
        request.row[k] = w.service[k]
        world.nodes[w.service[k]].busy += 1


@kernel
def ask_force(world: World, jobs: Jobs, kind: int, a: int) -> None:
    """Let the thread compute a block of the operator's force on axis `a`."""
    axis = world.axes[a]
    request = _new_request(jobs, kind, world.state.t_ns)
    request.axis, request.start_ns = a, axis.operator_start_ns
    jobs.asked[a] += 1
    if kind == Kind.RESTED:
        axis.operator_start_ns = -1
        world.state.to_begin += 1


@kernel
def _copy(jobs: Jobs, n: Any, i: int) -> None:
    """Copy what the loop may have written of node `i`, whose record is `n`."""
    live, base = jobs.live[i], jobs.base[i]
    for r in range(_RUNS.shape[0]):
        for k in range(_RUNS[r, 0], _RUNS[r, 1]):
            base[k] = live[k]
    for channel in range(n.sdo_used):
        first = _SEGMENTS + channel * BLOCK_SEGMENTS
        for k in range(first, first + n.segments_count[channel]):
            base[k] = live[k]


@kernel
def _hand_over(world: World, jobs: Jobs, anyway: bool) -> None:
    """Give the thread the next request, unless its nodes have segments to send first.

    Python may take some of these back, and the loop sends them meanwhile. `anyway`: it does not.
    """
    job, nodes = jobs.job[0], world.nodes
    request = jobs.ring[job.first]
    for k in range(request.rows):
        if nodes[request.row[k]].outbox_count > 0 and not anyway:
            return
    for k in range(request.rows):
        _copy(jobs, nodes[request.row[k]], request.row[k])
    job.t_ns = world.state.t_ns
    if request.kind != Kind.SERVICE:
        job.step = world.plant[request.axis].t_ns // world.plant[request.axis].step_ns
    store_release(jobs.job.ctypes.data, ASKED)
    write(job.ask, jobs.job.ctypes.data + _ONE, 8)


@kernel
def _take_back(world: World, jobs: Jobs) -> None:
    """Take over what the thread has done, as of now."""
    w, job, out = world.state, jobs.job[0], jobs.out
    request = jobs.ring[job.first]
    read(job.wake, jobs.job.ctypes.data + _READ, 8)
    for k in range(job.changes):
        i, place = jobs.changes[k, 0], jobs.changes[k, 1]
        now = jobs.live[i, place]
        if place == _NEXT:
            jobs.live[i, place] = min(now, jobs.changes[k, 3])
        elif now == jobs.changes[k, 2]:
            jobs.live[i, place] = jobs.changes[k, 3]
    for k in range(out.count):
        f = out.frames[k]
        push(world.out, f.source, max(f.t_ns, w.t_ns), f.can_id, f.length, f.word)
    out.count = 0
    if request.kind != Kind.SERVICE:
        a = request.axis
        axis, block, f_h = world.axes[a], jobs.force[a], world.f_h[a]
        for k in range(block.shape[0]):
            f_h[k] = block[k]
        axis.force_step = job.step
        axis.force_end_ns = (job.step + (block.shape[0] - 1) * axis.steps_per_knot) * world.plant[a].step_ns
        jobs.asked[a] -= 1
    for k in range(request.rows):
        i = request.row[k]
        node = world.nodes[i]
        node.busy -= 1
        node.next_ns = min(node.next_ns, w.t_ns + 1)  # it looks for itself what follows from it
    refresh(w, world.nodes, world.axes, world.deadlines, world.wants)
    for k in range(request.rows):
        if world.axis_of[request.row[k]] >= 0:
            actuate(world, world.axis_of[request.row[k]], w.t_ns)
    job.first = (job.first + 1) % ROOM
    job.count -= 1
    store_release(jobs.job.ctypes.data, IDLE)


@kernel
def exchange(world: World, jobs: Jobs, anyway: bool) -> int:
    """Take back what the thread has done, and give it the next request.

    Return 1 when something was taken back: frames may be due at once. `anyway`: the loop stands
    still until all is done.
    """
    job, taken = jobs.job[0], 0
    if job.count == 0:
        return 0
    state = load_acquire(jobs.job.ctypes.data)
    if state == DONE:
        _take_back(world, jobs)
        state, taken = IDLE, 1
    if state == IDLE and job.count > 0:
        _hand_over(world, jobs, anyway)
    return taken


@kernel
def _done(jobs: Jobs, changes: int) -> None:
    """Give the loop the job back, with so many changed words, and wake it."""
    jobs.job[0].changes = changes
    store_release(jobs.job.ctypes.data, DONE)
    write(jobs.job[0].wake, jobs.job.ctypes.data + _ONE, 8)


# Python's side


class Beside:
    """The thread, and what it shares with the loop.

    Parameters
    ----------
    world : whose services it does; its records become Python's own, the loop works on copies
    wake : eventfd that wakes the loop
    stop : ends the loop, when the thread fails
    apart : without this nothing is copied and no thread started: `jobs` is there for its types
    """

    def __init__(self, world: VirtualNetwork, wake: int, stop: Callable[[], None], *, apart: bool) -> None:
        self.world, self.apart, self._stop = world, apart, stop
        self.failure: BaseException | None = None
        """What the thread ended with."""
        self._wake, self._ask = wake, os.eventfd(0, os.EFD_CLOEXEC)
        self._nodes, self._out = world.nodes, world.out
        self._live_nodes, self._live_out = world.set_apart() if apart else (world.nodes, new_queue())
        shared = world.arguments[0]
        n = len(world.nodes) if apart else 0
        words = NODE.itemsize // 8
        self._mine = _words(self._nodes)[:n]
        job = new_records(JOB)
        job["one"], job["ask"], job["wake"] = 1, self._ask, wake
        self.jobs = Jobs(
            job=job,
            ring=new_records(REQUEST, ROOM),
            live=_words(self._live_nodes)[:n],
            base=self._mine.copy(),
            changes=np.zeros((max(words, 512 * n) if apart else 0, 4), np.int64),
            out=self._out if apart else self._live_out,
            force=np.zeros_like(shared.f_h),
            asked=np.zeros(len(shared.axes), np.int64),
        )
        self._exchange, self._done = Entry(exchange), Entry(_done)
        self._exchange.load(shared, self.jobs, True)
        self._done.load(self.jobs, 0)
        self._over = False
        self._thread: threading.Thread | None = None

    def start(self, priority: int | None) -> None:
        """Begin to work, just below the loop's `priority` of SCHED_FIFO where that is granted."""
        if self.apart:
            self._thread = threading.Thread(target=self._work, args=(priority,), name="services")
            self._thread.start()

    def stop(self) -> None:
        """End the thread; a service that is under way is done first."""
        if self._thread is not None:
            self._over = True
            os.eventfd_write(self._ask, 1)
            self._thread.join()
            self._thread, self._over = None, False

    def close(self) -> None:
        """End the thread, and give back what it had."""
        self.stop()
        if self._ask >= 0:
            os.close(self._ask)
            self._ask = -1

    @contextmanager
    def in_the_loop(self) -> Iterator[None]:
        """Work on the loop's own records while it stands still, after all that was asked before."""
        if not self.apart:
            yield
            return
        self._settle()
        self._nodes[:] = self._live_nodes
        _copy_queue(self._live_out, self._out)
        try:
            yield
        finally:
            self._live_nodes[:] = self._nodes
            self.jobs.base[:] = self._mine
            _copy_queue(self._out, self._live_out)
            self._out["count"] = 0

    def _settle(self) -> None:
        """Let all be done that was asked for; the loop stands still meanwhile."""
        while True:
            self._exchange(self.world.arguments[0], self.jobs, True)
            if not self.jobs.job["count"][0] or self.failure is not None:
                return
            if self.jobs.job["state"][0] == ASKED:
                select.select([self._wake], [], [], SETTLE_S)

    def _work(self, priority: int | None) -> None:
        if priority is not None and priority > 1:
            set_fifo(priority - 1)
        while not self._over:
            os.eventfd_read(self._ask)
            if self.jobs.job["state"][0] != ASKED:
                continue
            changes = 0
            try:
                changes = self._serve()
            except BaseException as error:
                self.failure = error
                self._stop()
            self._done(self.jobs, changes)

    def _serve(self) -> int:
        """Do the job; return how many words of the nodes' records changed with it."""
        jobs = self.jobs
        job = jobs.job[0]
        request = jobs.ring[int(job["first"])]
        if request["kind"] != Kind.SERVICE:
            axis = int(request["axis"])
            jobs.force[axis] = self.world.force_beside(Kind(int(request["kind"])), axis, request, int(job["step"]))
            return 0
        rows = [int(row) for row in request["row"][: int(request["rows"])]]
        for row in rows:
            self._mine[row] = jobs.base[row]
        can_id, length, word = int(request["can_id"]), int(request["length"]), int(request["word"])
        t_ns, source = int(job["t_ns"]), int(request["source"])
        self.world.serve(rows, t_ns, can_id, length, word)
        if request["heard"]:
            self.world.hear(int(request["t_ns"]), can_id, length, word, source)
        count = 0
        for row in rows:
            mine, base = self._mine[row], jobs.base[row]
            where = np.flatnonzero(mine != base)
            told = jobs.changes[count : count + len(where)]
            told[:, 0], told[:, 1], told[:, 2], told[:, 3] = row, where, base[where], mine[where]
            base[where] = mine[where]
            count += len(where)
        return count


def _words(nodes: Records) -> npt.NDArray[np.int64]:
    """Return node records as rows of words."""
    return nodes.view(np.ndarray).view(np.int64).reshape(len(nodes), -1)


def _copy_queue(source: Queue, to: Queue) -> None:
    count = int(source["count"])
    to["frames"][:count] = source["frames"][:count]
    to["count"], to["dropped"], to["waiting"] = count, source["dropped"], source["waiting"]
