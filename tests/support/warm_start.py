"""``coulombus VERB ...`` as a process of its own, forked from one that has imported everything:
most of a short run is Python's start otherwise.

`Warm` is a `subprocess.Popen` whose child is made by the server below, one for each test process.
The child has the given files, folder and environment, and ends as any Python does. What a variable
changes at import is the server's: tests of the start itself use `subprocess`.
"""

from __future__ import annotations

import array
import atexit
import gc
import importlib
import inspect
import json
import os
import select
import signal
import socket
import subprocess
import sys

MODULES = (
    *("coulombus.verbs.run", "coulombus.verbs.sim", "coulombus.verbs.replay", "coulombus.verbs.main"),
    *("coulombus.host.run.real_run", "coulombus.host.realtime.data_plane", "coulombus.sim_bus.server.rig_server"),
    *("coulombus.sim_bus.server.server", "coulombus.sim_bus.server.bridge", "coulombus.lab.demo.real_demo"),
    *("scipy.signal", "scipy.stats", "matplotlib.figure"),  # each takes a second; some verbs import them when they run
)
MOST_BYTES = 1 << 16


class Warm(subprocess.Popen):
    """A process of ``coulombus`` with the arguments ``args``."""

    closed = ()
    """Which of the descriptors 0 to 2 it has not."""

    def _execute_child(self, *given):
        bound = inspect.signature(subprocess.Popen._execute_child).bind(self, *given).arguments
        ours, its = os.pipe()
        files = [bound[name] for name in ("p2cread", "c2pwrite", "errwrite")]
        wanted = [one if one != -1 else at for at, one in enumerate(files)]
        order = {
            "args": list(map(str, bound["args"])),
            "cwd": str(bound["cwd"] or "."),
            "env": bound["env"] or dict(os.environ),
            "closed": self.closed,
        }
        self._status = ours
        self.pid = _server().start(order, [*wanted, its])
        self._child_created = True
        os.close(its)
        for ours, its in (("p2cwrite", "p2cread"), ("c2pread", "c2pwrite"), ("errread", "errwrite")):
            if bound[ours] != -1:  # a pipe of Popen's own
                os.close(bound[its])

    def _internal_poll(self, *_, **__):
        if self.returncode is None:
            self._wait(0)
        return self.returncode

    def _wait(self, timeout):
        if self.returncode is None:
            ready, _, _ = select.select([self._status], [], [], timeout)
            if ready:
                told = os.read(self._status, 8)
                os.close(self._status)
                self.returncode = int(told) if told else -signal.SIGKILL
            elif timeout:
                raise subprocess.TimeoutExpired(self.args, timeout)
        return self.returncode


class WithoutStdout(Warm):
    """One that is started as by ``coulombus VERB ... >&-``."""

    closed = (1,)


class _Server:
    def __init__(self):
        self.socket, its = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with its:
            self.process = subprocess.Popen(
                [sys.executable, __file__, str(its.fileno())], pass_fds=[its.fileno()], stdin=subprocess.DEVNULL
            )
        atexit.register(self.end)

    def start(self, order, files):
        self.socket.sendmsg(
            [json.dumps(order).encode()], [(socket.SOL_SOCKET, socket.SCM_RIGHTS, array.array("i", files))]
        )
        return int(self.socket.recv(32))

    def end(self):
        self.socket.close()
        self.process.wait()


_servers = {}


def _server():
    """Return the server of this process."""
    if os.getpid() not in _servers:
        _servers[os.getpid()] = _Server()
    return _servers[os.getpid()]


def serve(fd):
    """Fork a child for each order, and tell its end to who has ordered it.

    Return in the child, with its arguments.
    """
    orders = socket.socket(fileno=fd)
    waiting = {}
    wake, waker = os.pipe2(os.O_NONBLOCK)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    signal.set_wakeup_fd(waker, warn_on_full_buffer=False)
    while True:
        ready, _, _ = select.select([orders, wake], [], [])
        if wake in ready:
            os.read(wake, MOST_BYTES)
            while waiting:
                pid, status = os.waitpid(-1, os.WNOHANG)
                if pid == 0:
                    break
                told = waiting.pop(pid)
                os.write(told, str(os.waitstatus_to_exitcode(status)).encode())
                os.close(told)
        if orders not in ready:
            continue
        message, ancillary, _, _ = orders.recvmsg(MOST_BYTES, socket.CMSG_SPACE(4 * 4))
        if not message:
            os._exit(0)
        files = array.array("i")
        files.frombytes(ancillary[0][2])
        order = json.loads(message)
        pid = os.fork()
        if pid:
            waiting[pid] = files[3]
            for one in files[:3]:
                os.close(one)
            orders.send(str(pid).encode())
            continue
        signal.set_wakeup_fd(-1)
        for one in (signal.SIGCHLD, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT):
            signal.signal(one, signal.SIG_DFL)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        for at, one in enumerate(files[:3]):
            os.dup2(one, at)
        orders.close()
        for one in (*files, wake, waker, *waiting.values()):
            if one > 2:
                os.close(one)
        os.environ.clear()
        os.environ.update(order["env"])
        os.chdir(order["cwd"])
        for fd in order["closed"]:
            os.close(fd)
        for fd, (name, mode) in enumerate((("stdin", "r"), ("stdout", "w"), ("stderr", "w"))):
            stream = None if fd in order["closed"] else open(fd, mode, closefd=False)  # noqa: SIM115
            setattr(sys, name, stream)
            setattr(sys, f"__{name}__", stream)
        sys.argv = ["coulombus", *order["args"]]
        return


if __name__ == "__main__":
    from coulombus.wire.frame import arbitration_key

    for module in MODULES:
        importlib.import_module(module)
    arbitration_key(0)  # numba prepares itself when the first kernel is loaded
    gc.collect()
    gc.freeze()  # else each child copies the memory of all modules, when it looks for rubbish at its end: 0.6 s
    serve(int(sys.argv[1]))
    from coulombus.verbs.main import main

    main(prog_name="coulombus")
