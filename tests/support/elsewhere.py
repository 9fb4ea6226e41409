"""Run `coulombus` as on a system that is no Linux: `python elsewhere.py WORDS`.

What only Linux has is hidden: modules, and attributes of `os`, `socket`, `select` and `signal`.
"""

from __future__ import annotations

import ctypes
import os
import select
import signal
import socket
import sys

MODULES = ("fcntl", "termios", "tty", "resource", "pwd", "grp")
ATTRIBUTES = {
    os: ("eventfd", "eventfd_read", "eventfd_write", "memfd_create", "timerfd_create", "sched_getaffinity"),
    socket: ("AF_CAN", "PF_CAN", "CAN_RAW", "SOCK_SEQPACKET", "SO_PEERCRED"),
    select: ("epoll",),
    signal: ("SIGTTIN", "SIGTTOU", "sigtimedwait"),
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


if __name__ == "__main__":
    hide()
    from coulombus.cli.main import main

    main(sys.argv[1:], prog_name="coulombus")
