"""A worker of a sweep: ``python -m coulombus.lab.sweep.worker FD PARENT``, started by
`coulombus.lab.sweep.workers` with an open socket.

It takes the job, then one order after another, and answers each with what came of it. It has a
session of its own, out of the terminal's reach, and ends with its parent.
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
    """Carry out orders until there are no more."""
    ignore()
    die_with_parent(parent)
    runs = threading.Thread(target=_carry_out, args=(fd,))  # beside the main thread no kernel holds signals back
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
                order = line.recv()
            except EOFError:
                return
            assert isinstance(order, RunRequest)
            try:
                line.send(carry_out(job, order))
            except OSError as error:  # the recording's: the parent ends the sweep by it
                line.send(error)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
