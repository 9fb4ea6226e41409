"""Run `coulombus` as on a system that is no Linux: `python elsewhere.py LINE ...`, each line in a process
forked from this one. It prints a JSON object for each: its exit status, and what it wrote on stderr.

What only Linux has is hidden: modules, and attributes of `os`, `socket`, `select` and `signal`.
"""

from __future__ import annotations

import ctypes
import json
import os
import select
import shlex
import signal
import socket
import sys
import tempfile

MODULES = ("fcntl", "termios", "tty", "resource", "pwd", "grp")
ATTRIBUTES = {
    os: ("eventfd", "eventfd_read", "eventfd_write", "memfd_create", "timerfd_create", "sched_getaffinity", "pipe2"),
    socket: ("AF_CAN", "PF_CAN", "CAN_RAW", "SOCK_SEQPACKET", "SO_PEERCRED"),
    select: ("epoll", "poll"),
    signal: ("SIGTTIN", "SIGTTOU", "sigtimedwait", "SIGHUP", "SIGQUIT", "SIGALRM", "setitimer"),
}


class CLibrary(ctypes.CDLL):
    """Windows' has no name."""

    def __init__(self, name, *words, **options):
        if name is None:
            raise TypeError("bad argument type for built-in operation")
        super().__init__(name, *words, **options)


def hide():
    """Hide it from all that is imported from now on."""
    for name in MODULES:
        sys.modules[name] = None
    for module, names in ATTRIBUTES.items():
        for name in (*names, *(one for one in dir(module) if one.startswith("sched_"))):
            if hasattr(module, name):
                delattr(module, name)
    ctypes.CDLL = CLibrary


def ended(line):
    """Run a line in a child; return its exit status and its stderr."""
    import coulombus.lab.simulate  # noqa: F401  most verbs import it
    from coulombus.cli.main import main

    with tempfile.TemporaryFile("w+") as err:
        pid = os.fork()
        if pid == 0:
            os.dup2(err.fileno(), 2)
            os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
            main(shlex.split(line), prog_name="coulombus")
            sys.exit()
        status = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
        err.seek(0)
        return {"status": status, "stderr": err.read()}


if __name__ == "__main__":
    hide()
    for line in sys.argv[1:]:
        print(json.dumps(ended(line)), flush=True)
