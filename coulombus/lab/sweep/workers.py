"""Workers of a sweep: local processes.

They yield the result of each run on completion, in any order; the numbers do not depend on the worker.

A worker is this module as a program: ``python -m coulombus.lab.sweep.workers FD PARENT``, with an open socket. It receives
the job, then one request after another, and returns the result of each. It has a separate session, without the
terminal's signals, and ends with its parent.
"""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import suppress
from itertools import islice
from multiprocessing.connection import Connection, wait
from pathlib import Path

from coulombus.lab.sweep.one_run import FinishedRun, Job, RunRequest, carry_out, failed_row, warm_up
from coulombus.system.realtime import die_with_parent
from coulombus.system.stop_signals import ignore

__all__ = ["on_processes"]


MODULE = "coulombus.lab.sweep.workers"
AHEAD = 2
"""Runs that a local process has at a time: it goes on while this process writes the table."""
MOST_STARTS = 3
"""Failures before the first run after which a worker counts as unable to start."""


class _Worker:
    """A process, and its runs: the present one, and the next."""

    def __init__(self, job: Job) -> None:
        ours, its = socket.socketpair()
        root = str(Path(__file__).parents[__name__.count(".")])
        path = os.pathsep.join(filter(None, (root, os.environ.get("PYTHONPATH"))))
        with its:
            self.process = subprocess.Popen(
                [sys.executable, "-P", "-m", MODULE, str(its.fileno()), str(os.getpid())],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                pass_fds=(its.fileno(),),
                start_new_session=True,  # the terminal's Ctrl-C is the parent's
                env={**os.environ, "PYTHONPATH": path, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
            )
        self.line = Connection(ours.detach())
        self.ready = False
        self.requests = deque[RunRequest]()
        with suppress(OSError):  # it has ended: the waiting reader notices
            self.line.send(job)

    def send(self, request: RunRequest) -> None:
        """Send it a run."""
        self.requests.append(request)
        with suppress(OSError):
            self.line.send(request)

    def end(self) -> str:
        """Kill it; return its exit status if it had ended by itself."""
        with suppress(OSError):
            self.line.close()
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(1.0)
        self.process.kill()
        status = self.process.wait()
        return f"by {signal.Signals(-status).name}" if status < 0 else f"with exit status {status}"


def on_processes(job: Job, requests: Iterable[RunRequest], count: int) -> Iterator[FinishedRun]:
    """Yield the results of the runs, by `count` local processes.

    If a process ends during a run (killed, out of memory), that run fails, and a new process continues.

    Raises
    ------
    RuntimeError
        the processes cannot be started
    OSError
        a recording cannot be written
    """
    coming, waiting = iter(requests), deque[RunRequest]()

    def left() -> int:
        """Return the number of waiting runs; `count` + 1: perhaps more."""
        waiting.extend(islice(coming, max(0, count + 1 - len(waiting))))
        return len(waiting)

    workers = [_Worker(job) for _ in range(min(count, left()))]
    stillborn = 0
    try:
        while workers:
            by_line = {worker.line: worker for worker in workers}
            for line in wait(list(by_line)):
                worker = by_line[line]  # type: ignore[index]
                try:
                    answer = worker.line.recv()
                except (EOFError, OSError):
                    how = worker.end()
                    workers.remove(worker)
                    stillborn += not worker.ready
                    if stillborn >= MOST_STARTS:
                        raise RuntimeError(f"the processes of the sweep end {how} before their first run") from None
                    request = worker.requests.popleft() if worker.requests else None
                    waiting.extendleft(reversed(worker.requests))
                    if left():
                        workers.append(_Worker(job))
                    if request is not None:
                        yield FinishedRun(failed_row(job, request, f"the process of the run ended {how}"))
                    continue
                worker.ready = True
                if isinstance(answer, OSError):
                    raise answer
                if answer is not None:
                    worker.requests.popleft()
                while left() and len(worker.requests) < (AHEAD if len(waiting) > len(workers) else 1):
                    worker.send(waiting.popleft())
                if not worker.requests:
                    worker.process.kill()  # its runs are over; the others' results do not wait for its end
                    worker.end()
                    workers.remove(worker)
                if answer is not None:
                    yield answer
    finally:
        for worker in workers:
            worker.process.kill()
            worker.end()


def main(fd: int, parent: int) -> None:
    """Execute requests until there are no more."""
    ignore()
    die_with_parent(parent)
    runs = threading.Thread(target=_carry_out, args=(fd,))  # outside the main thread, kernels do not delay signals
    runs.start()
    runs.join()


def _carry_out(fd: int) -> None:
    with Connection(fd) as line:
        job = line.recv()
        assert isinstance(job, Job)
        warm_up(job)
        line.send(None)
        while True:
            try:
                request = line.recv()
            except EOFError:
                return
            assert isinstance(request, RunRequest)
            try:
                line.send(carry_out(job, request))
            except OSError as error:  # of the recording: the parent ends the sweep
                line.send(error)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
