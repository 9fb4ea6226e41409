"""A worker of a sweep: ``python -m coulombus.lab.sweep.worker FD PARENT``.

`coulombus.lab.sweep.workers` starts it with an open socket.

It receives the job, then one order after another, and returns the result of each. It has a separate
session, without the terminal's signals, and ends with its parent.
"""

from __future__ import annotations

import sys
import threading
from multiprocessing.connection import Connection

from coulombus.lab.sweep.one_run import Job, RunRequest, carry_out, warm_up
from coulombus.system.realtime import die_with_parent
from coulombus.system.stop_signals import ignore

__all__ = ["main"]


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
