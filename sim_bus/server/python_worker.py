"""Python's share of a bus in real time, in a thread of its own: the compiled loop continues meanwhile.

A device answers an SDO in milliseconds, and sends its PDOs meanwhile. So Python works on its own
records, in its own thread, one job at a time:

1. The loop queues Python's work (a frame for a node's services, the next block of a hand's force,
   frames to be recorded) as a `JOB`.
2. When Python is free, the loop copies the job's input into Python's records and wakes it.
3. Python does the job, records which words of the nodes' records it has changed, and wakes the loop.
4. Between two events the loop copies these words back, and queues the frames that Python requested.

Python's changes reach the loop completely, and the loop's own changes meanwhile stay: only for a
word that both changed, Python's value counts. A node's ring of segments (`node.sdo_kernels`) is frozen
meanwhile, because both change it.

If Python needs the whole world (a script's entry), `drain_jobs` completes the jobs first. A server
without this (`BesideRecord.on` is 0) returns to Python for everything.

In the kernels: `j` the `BesideRecord`, `w` the `sim_bus.network.event_loop.WorldRecord`.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from coulombus.kernels.decorator import constant, kernel
from coulombus.kernels.libc import POLLIN, ppoll_ns, read, write
from coulombus.kernels.records import Integers, Records, new_records
from coulombus.node.record import LOOP_WORDS, NODE
from coulombus.sim_bus.network.event_loop import Exit, World, actuate, refresh
from coulombus.sim_bus.network.network import VirtualNetwork
from coulombus.sim_bus.rig.plant_step import CourseFunction
from coulombus.sim_bus.server.records import JOBS, BesideRecord, PaceRecord
from coulombus.wire.clock import NEVER_NS
from coulombus.wire.frame import push

__all__ = ["FRAME", "RECORD", "Beside", "Worker", "drain_jobs", "drained", "enqueue", "take_results"]

NODE_WORDS = NODE.itemsize // 8
PATIENCE_NS = 100_000_000
FRAME, RECORD = constant(-1), constant(-2)
"""Axis of jobs that belong to no axis."""


class JobState(IntEnum):
    """State of Python's current job."""

    FREE = 0  # Python is idle
    PYTHON = 1  # Python works on `BesideRecord.now`
    DONE = 2  # the loop has to take the results over


class Beside(NamedTuple):
    """Data shared by the loop and Python, besides Python's own world."""

    state: BesideRecord
    """A record of `BesideRecord`."""
    python: World
    """World used by Python's objects."""
    nodes: Records
    """Nodes of the loop as words, one row each."""
    python_nodes: Records
    """Nodes of Python."""
    axes: Integers
    """Axes and their plants, likewise."""
    python_axes: Integers
    plant: Integers
    python_plant: Integers
    loop_words: Integers
    """First and last + 1 of each run of a node's words that the loop writes."""
    changed: Integers
    """Places in `nodes`, all rows concatenated."""
    asked: Integers
    """By axis, and last for the log: jobs that are pending or in progress."""
    words: Integers
    """Buffers: a word written to an eventfd, a word read from it, and a struct pollfd."""


@kernel
def _copy(to: Integers, source: Integers, first: int, end: int) -> None:
    """Copy words of a row; numba compiles a slice assignment slowly."""
    for k in range(first, end):
        to[k] = source[k]


@kernel
def enqueue(beside: Beside, world: World, course: CourseFunction, pace: PaceRecord, why: int, axis: int) -> bool:
    """Queue the reason of the kernel's return as a job for Python, concurrent with the loop; tell whether it was
    queued.

    `axis`: axis of the hand; `FRAME`: the last frame of the log is for services; `RECORD`: the
    delivered rows of the log are to be recorded.
    """
    j, w = beside.state, world.state
    if j.on == 0 or (axis == FRAME and w.control_plane + w.heard != 0):
        return False
    if axis == FRAME and j.waiting == JOBS:
        j.dropped += 1
        return True
    if axis != FRAME:
        place = axis if axis >= 0 else beside.asked.shape[0] - 1
        if beside.asked[place] != 0 and why != Exit.ENABLED:
            return True  # it is queued already, or will be after the current job
        beside.asked[place] += 1
    if j.waiting == JOBS:
        _await(beside, world, course, pace)
    job = j.jobs[(j.first + j.waiting) % JOBS]
    j.waiting += 1
    j.most_waiting = max(j.most_waiting, j.waiting)
    job.why = why
    job.axis = axis
    job.frames = pace.handed_out if axis == RECORD else 0
    job.rows = 0
    if axis == FRAME:
        frame = world.log[w.log_count - 1]
        job.t_ns = frame.t_ns
        job.can_id = frame.can_id
        job.length = frame.length
        job.word = frame.word
        job.rows = w.services
        for k in range(w.services):
            job.row[k] = w.service[k]
    _begin(beside, world)
    return True


@kernel
def _of_hand(world: World, a: int) -> tuple[int, int]:
    """Return first and last + 1 of the axes that the hand of axis `a` holds: of an arm all."""
    if world.plant[0].plane.on != 0:
        return 0, world.axes.shape[0]
    return a, a + 1


@kernel
def _begin(beside: Beside, world: World) -> None:
    """Let Python begin with the first pending job, unless it is working."""
    j, w, python = beside.state, world.state, beside.python
    if j.turn != JobState.FREE or j.waiting == 0:
        return
    job, now = j.jobs[j.first], j.now
    j.first = (j.first + 1) % JOBS
    j.waiting -= 1
    now.why = job.why
    now.axis = job.axis
    now.frames = job.frames
    now.t_ns = job.t_ns
    now.can_id = job.can_id
    now.length = job.length
    now.word = job.word
    now.rows = job.rows
    python.state.t_ns = w.t_ns
    if job.axis >= 0:
        python.state.axis = job.axis
        now.start_ns = world.axes[job.axis].operator_start_ns
        first, end = _of_hand(world, job.axis)
        for a in range(first, end):
            _copy(beside.python_axes[a], beside.axes[a], 0, beside.axes.shape[1])
            _copy(beside.python_plant[a], beside.plant[a], 0, beside.plant.shape[1])
    for k in range(job.rows):
        i = job.row[k]
        now.row[k] = i
        for r in range(beside.loop_words.shape[0]):
            _copy(beside.python_nodes[i], beside.nodes[i], beside.loop_words[r, 0], beside.loop_words[r, 1])
        world.nodes[i].outbox_next_ns = NEVER_NS
    j.turn = JobState.PYTHON
    beside.words[0] = 1
    write(j.python, beside.words.ctypes.data, 8)


@kernel
def take_results(beside: Beside, world: World, course: CourseFunction, pace: PaceRecord) -> None:
    """Take over the results of Python's job, and let it begin with the next job."""
    j, w, python = beside.state, world.state, beside.python
    if j.turn != JobState.DONE:
        return
    now, a = j.now, j.now.axis
    for k in range(j.changed):
        i, n = beside.changed[k] // NODE_WORDS, beside.changed[k] % NODE_WORDS
        beside.nodes[i, n] = beside.python_nodes[i, n]
    for k in range(now.rows):
        i = now.row[k]
        world.nodes[i].outbox_next_ns = python.nodes[i].outbox_next_ns
    if a >= 0:
        first, end = _of_hand(world, a)
        for i in range(first, end):
            for k in range(python.f_h.shape[1]):
                world.f_h[i, k] = python.f_h[i, k]
            world.axes[i].force_step = python.axes[i].force_step
            world.axes[i].force_end_ns = python.axes[i].force_end_ns
        if python.axes[a].operator_start_ns != now.start_ns:
            world.axes[a].operator_start_ns = python.axes[a].operator_start_ns
        beside.asked[a] -= 1
        w.script_ns = min(w.script_ns, python.state.script_ns)
    if now.frames > 0:  # frames that came meanwhile move up
        for k in range(now.frames, w.log_count):
            world.log[k - now.frames] = world.log[k]
        w.log_count -= now.frames
        pace.handed_out -= now.frames
        beside.asked[beside.asked.shape[0] - 1] -= 1
    for k in range(python.out.count):
        frame = python.out.frames[k]
        push(world.out, frame.source, frame.t_ns, frame.can_id, frame.length, frame.word)
    python.out.count = 0
    for k in range(world.axes.shape[0]):
        actuate(world, course, k, w.t_ns)
    j.served += 1
    j.turn = JobState.FREE
    refresh(w, world.nodes, world.axes, world.deadlines, world.wants)
    _begin(beside, world)


@kernel
def drained(beside: Beside) -> None:
    """Read the loop's wake-up from its eventfd."""
    read(beside.state.loop, beside.words.ctypes.data + 8, 8)


@kernel
def _await(beside: Beside, world: World, course: CourseFunction, pace: PaceRecord) -> None:
    """Sleep until Python's job is done, and take over its results."""
    j = beside.state
    while j.turn == JobState.PYTHON:
        beside.words[2] = (j.loop & 0xFFFFFFFF) | POLLIN << 32
        if ppoll_ns(beside.words.ctypes.data + 16, 1, PATIENCE_NS) > 0:
            drained(beside)
    take_results(beside, world, course, pace)


@kernel
def drain_jobs(beside: Beside, world: World, course: CourseFunction, pace: PaceRecord) -> None:
    """Complete all jobs: Python needs the whole world."""
    j = beside.state
    while j.turn != JobState.FREE or j.waiting > 0:
        _await(beside, world, course, pace)


class Worker:
    """Python's side: a thread that does the jobs, and the loop's copies of the records.

    Parameters
    ----------
    world : Python keeps its records
    wake : eventfd that wakes the loop
    stop : ends the loop; called when a job fails
    on : False: `loop` is Python's own world, and there is no thread

    Attributes
    ----------
    loop : the world that the loop runs
    shared : data shared by both
    failure : exception of a job, after which the loop is to be stopped
    """

    def __init__(self, world: VirtualNetwork, wake: int, stop: Callable[[], None], *, on: bool) -> None:
        self._world, self._stop = world, stop
        python: World = world.arguments[0]
        self.failure: BaseException | None = None
        self._wake = wake
        self._python = os.eventfd(0, os.EFD_CLOEXEC)
        names = ("state", "out", "nodes", "axes", "plant", "f_h") if on else ()
        loop_arrays = {name: _twin(getattr(python, name)) for name in names}
        self.loop: World = python._replace(**loop_arrays)
        self._twins = [(getattr(python, name), loop_arrays[name]) for name in names]
        state = new_records(BesideRecord)[0]
        state["on"], state["python"], state["loop"] = on, self._python, wake
        nodes, axes = len(self.loop.nodes), len(self.loop.axes)
        self.shared = Beside(
            state=state,
            python=python,
            nodes=_words(self.loop.nodes),
            python_nodes=_words(python.nodes),
            axes=_words(self.loop.axes),
            python_axes=_words(python.axes),
            plant=_words(self.loop.plant),
            python_plant=_words(python.plant),
            loop_words=LOOP_WORDS,
            changed=np.zeros(nodes * NODE_WORDS, np.int64),
            asked=np.zeros(axes + 1, np.int64),
            words=np.zeros(3, np.int64),
        )
        self._thread: threading.Thread | None = None
        if on:
            self.to_loop()
            self._thread = threading.Thread(target=self._work, name="beside", daemon=True)

    def start(self) -> None:
        """Start waiting for jobs, with the present rights of the calling thread."""
        if self._thread is not None:
            self._thread.start()

    def close(self) -> None:
        """End the thread."""
        state = self.shared.state
        if self._python < 0:
            return
        if self._thread is not None and self._thread.ident is not None:
            state["on"] = 0
            os.eventfd_write(self._python, 1)
            self._thread.join()
        os.close(self._python)
        self._python = -1

    @contextmanager
    def whole(self) -> Iterator[None]:
        """Give Python the whole world while the loop does not run and no job is in progress."""
        for python, loop in self._twins:
            _copy_record(python, loop)
        try:
            yield
        finally:
            self.to_loop()

    def to_loop(self) -> None:
        """Let the loop continue from Python's state of the whole world."""
        for python, loop in self._twins:
            _copy_record(loop, python)
        if self._twins:  # pending frames now belong to the loop; Python's next job begins with none
            self.shared.python.out["count"] = 0
        self.loop.state["stale"] = 1

    # in the thread

    def _work(self) -> None:
        state = self.shared.state
        while True:
            os.eventfd_read(self._python)
            if not state["on"]:
                return
            try:
                self._do(state["now"])
            except BaseException as error:
                self.failure = error
                self._stop()
            state["turn"] = JobState.DONE
            os.eventfd_write(self._wake, 1)

    def _do(self, job: Any) -> None:
        rows = job["row"][: int(job["rows"])].tolist()
        nodes = self.shared.python_nodes
        before = nodes[rows]
        if job["frames"]:
            self._world.hand_over(int(job["frames"]))
        elif job["axis"] >= 0:
            self._world.answer(int(job["why"]))
        else:
            self._world.serve(rows, *(int(job[name]) for name in ("t_ns", "can_id", "length", "word")))
        k, word = np.nonzero(nodes[rows] != before)
        place = np.array(rows, np.int64)[k] * NODE_WORDS + word
        self.shared.changed[: len(place)] = place
        self.shared.state["changed"] = len(place)


def _twin(original: Any) -> Any:
    """Return an array, or a record, of the same type."""
    if isinstance(original, np.record):
        return np.zeros(1, original.dtype).view(np.recarray)[0]
    return np.zeros_like(original)


def _copy_record(to: Any, source: Any) -> None:
    if isinstance(to, np.record):
        for name in to.dtype.names or ():
            to[name] = source[name]
    else:
        to[:] = source


def _words(records: Records) -> npt.NDArray[np.int64]:
    """Return records as rows of words, in the same memory."""
    plain: npt.NDArray[np.int64] = records.view(np.ndarray).view(np.int64)
    return plain.reshape(len(records), records.dtype.itemsize // 8)
