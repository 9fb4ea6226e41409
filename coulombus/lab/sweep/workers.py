"""Workers of a sweep: local processes, or a cluster of dask.distributed.

Both yield the result of each run on completion, in any order; the numbers do not depend on the worker.
"""

from __future__ import annotations

import importlib
import os
import signal
import socket
import subprocess
import sys
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

from coulombus.lab.sweep.one_run import FinishedRun, Job, RunRequest, carry_out, failed_row
from coulombus.system.errors import CoulombusError

__all__ = ["ClusterError", "on_cluster", "on_processes"]

MODULE = "coulombus.lab.sweep.worker"
WAITING = 256
"""Runs submitted to a cluster at a time."""
CONNECT_S = 10
AHEAD = 2
"""Runs that a local process has at a time: it goes on while this process writes the table."""
MOST_STARTS = 3
"""Failures before the first run after which a worker counts as unable to start."""


class ClusterError(CoulombusError):
    """A cluster cannot be used; the text has the reason and the remedy."""

    exit_status = 2


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
        self.orders = deque[RunRequest]()
        with suppress(OSError):  # it has ended: the waiting reader notices
            self.line.send(job)

    def take(self, order: RunRequest) -> None:
        """Send it a run."""
        self.orders.append(order)
        with suppress(OSError):
            self.line.send(order)

    def end(self) -> str:
        """Kill it; return its exit status if it had ended by itself."""
        with suppress(OSError):
            self.line.close()
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(1.0)
        self.process.kill()
        status = self.process.wait()
        return f"by {signal.Signals(-status).name}" if status < 0 else f"with exit status {status}"


def on_processes(job: Job, orders: Sequence[RunRequest], count: int) -> Iterator[FinishedRun]:
    """Yield the results of the runs, by `count` local processes.

    If a process ends during a run (killed, out of memory), that run fails, and a new process continues.

    Raises
    ------
    RuntimeError
        the processes cannot be started
    OSError
        a recording cannot be written
    """
    waiting = list(reversed(orders))
    workers = [_Worker(job) for _ in range(min(count, len(orders)))]
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
                    order = worker.orders.popleft() if worker.orders else None
                    waiting.extend(reversed(worker.orders))
                    if waiting:
                        workers.append(_Worker(job))
                    if order is not None:
                        yield FinishedRun(failed_row(job, order, f"the process of the run ended {how}"))
                    continue
                worker.ready = True
                if isinstance(answer, OSError):
                    raise answer
                if answer is not None:
                    worker.orders.popleft()
                while waiting and len(worker.orders) < (AHEAD if len(waiting) > len(workers) else 1):
                    worker.take(waiting.pop())
                if not worker.orders:
                    worker.end()
                    workers.remove(worker)
                if answer is not None:
                    yield answer
    finally:
        for worker in workers:
            worker.process.kill()
            worker.end()


def on_cluster(job: Job, orders: Sequence[RunRequest], address: str) -> Iterator[FinishedRun]:
    """Yield the results of the runs, by the workers of the dask.distributed scheduler at `address`.

    Its workers need this package, and the file of a user-defined law.

    Raises
    ------
    ClusterError
        dask.distributed is not installed, or no scheduler responds there
    """
    try:
        cluster: Any = importlib.import_module("distributed")
    except ImportError:
        raise ClusterError("a dask cluster needs dask and distributed: pip install '.[cluster]' in the clone") from None
    try:
        client = cluster.Client(address, timeout=CONNECT_S)
    except (OSError, TimeoutError, ValueError) as error:
        raise ClusterError(
            f"--dask {address}: no scheduler answers ({error}); expected one such as tcp://HOST:8786"
        ) from None
    with client:
        if not client.scheduler_info()["workers"]:
            raise ClusterError(f"--dask {address}: the cluster has no worker; start one with dask worker {address}")
        everywhere = client.scatter(job, broadcast=True)
        waiting = list(reversed(orders))
        at_work: dict[Any, RunRequest] = {}

        def give() -> Any:
            order = waiting.pop()
            task = client.submit(carry_out, everywhere, order, pure=False)
            at_work[task] = order
            return task

        coming = cluster.as_completed([give() for _ in range(min(WAITING, len(waiting)))], raise_errors=False)
        for task in coming:
            order = at_work.pop(task)
            if waiting:
                coming.add(give())
            if task.status == "finished":
                yield task.result()
            else:
                yield FinishedRun(failed_row(job, order, f"the cluster lost the run: {task.exception()}"))
