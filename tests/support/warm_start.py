"""``coulombus VERB ...`` as a process of its own, forked from one that has imported everything and
loaded the loops of bus and host: most of a short run is Python's start otherwise.

`Warm` is a `subprocess.Popen` whose child is made by the server below, one for each test process.
The child has the given files, folder and environment. What it starts of this project, as a host
its data plane, is forked from it in turn (`Forked`). Three things it does not do, as it would take
a second: lock its memory, which has all modules of the project in it, listen for another host for
longer than `LISTEN_S`, and take its modules apart at its end. What a variable changes at import is
the server's: tests of the start itself use `subprocess`.
"""

from __future__ import annotations

import array
import atexit
import gc
import importlib.util
import inspect
import json
import os
import select
import signal
import socket
import subprocess
import sys
import threading
import traceback
from contextlib import suppress
from pathlib import Path

MODULES = (
    *(f"coulombus.cli.{name}" for name in ("main", "run", "stop", "emulate", "node", "bridge", "replay")),
    *("coulombus.host.run.real_run", "coulombus.host.realtime.data_plane", "coulombus.sim_bus.server.rig_server"),
    *("coulombus.sim_bus.server.server", "coulombus.sim_bus.server.bridge", "coulombus.lab.demo.real_demo"),
    *("scipy.signal", "scipy.stats", "matplotlib.figure"),  # each takes a second; some verbs import them when they run
)
MOST_BYTES = 1 << 16
LISTEN_S = 0.3


class Warm(subprocess.Popen):
    """A process of ``coulombus`` with the arguments ``args``."""

    closed = ()
    """Which of the descriptors 0 to 2 it has not."""
    ignored = ()
    """Which signals it ignores from its start on."""

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
            "ignored": self.ignored,
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


class InBackground(Warm):
    """One that is started as a shell's background job: ``coulombus VERB ... &``."""

    ignored = (signal.SIGINT,)


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
        reset_signals(order["ignored"])
        for at, one in enumerate(files[:3]):
            os.dup2(one, at)
        orders.close()
        for one in (*files, wake, waker, *waiting.values()):
            if one > 2:
                os.close(one)
        enter(order["env"], order["cwd"], order["closed"])
        sys.argv = ["coulombus", *order["args"]]
        subprocess.Popen = Forked
        return


def reset_signals(ignored=()):
    """Leave the signals as a Python finds them that is executed: what is ignored stays so."""
    signal.set_wakeup_fd(-1)
    for one in signal.valid_signals():
        if one in ignored:
            signal.signal(one, signal.SIG_IGN)
        elif signal.getsignal(one) is not signal.SIG_IGN and one == signal.SIGINT:
            signal.signal(one, signal.default_int_handler)
        elif callable(signal.getsignal(one)):
            signal.signal(one, signal.SIG_DFL)


def enter(environment, folder, closed=()):
    """Go to a folder, with an environment, and with streams on the descriptors 0 to 2 but for those
    that are closed.
    """
    os.environ.clear()
    os.environ.update(environment)
    os.chdir(folder)
    for fd in closed:
        os.close(fd)
    for fd, (name, mode) in enumerate((("stdin", "r"), ("stdout", "w"), ("stderr", "w"))):
        stream = None if fd in closed else open(fd, mode, closefd=False)  # noqa: SIM115
        setattr(sys, name, stream)
        setattr(sys, f"__{name}__", stream)


class Forked(subprocess.Popen):
    """What a warm process starts: a module of this project in a fork of itself, anything else as
    always.
    """

    def _execute_child(self, *given):
        bound = inspect.signature(super()._execute_child).bind(*given).arguments
        words = list(map(os.fspath, bound["args"])) if isinstance(bound["args"], (list, tuple)) else []
        at = words.index("-m") + 1 if words[:1] == [sys.executable] and "-m" in words else 0
        if not at or words[at].partition(".")[0] != "coulombus":
            super()._execute_child(*given)
            return
        self.pid = os.fork()
        if self.pid == 0:
            run_module(bound, words[at], words[at + 1 :])
        self._child_created = True
        self._close_pipe_fds(
            *(bound[name] for name in ("p2cread", "p2cwrite", "c2pread", "c2pwrite", "errread", "errwrite"))
        )


def run_module(bound, module, words):
    """Run a module as ``python -m`` does, in a child that has nothing open but what it is given."""
    status = 1
    try:
        gc.freeze()  # what is the parent's is not closed here: its descriptors have other owners by then
        for at, name in enumerate(("p2cread", "c2pwrite", "errwrite")):
            if bound[name] not in (-1, at):
                os.dup2(bound[name], at)
        for one in map(int, os.listdir("/proc/self/fd")):
            if one > 2 and one not in bound["pass_fds"]:
                with suppress(OSError):  # that of the listing is closed already
                    os.close(one)
        if bound["start_new_session"]:
            os.setsid()
        reset_signals()
        if bound["preexec_fn"] is not None:
            bound["preexec_fn"]()
        enter(os.environ.copy() if bound["env"] is None else bound["env"], bound["cwd"] or ".")
        spec = importlib.util.find_spec(module)
        if spec.submodule_search_locations is not None:
            spec = importlib.util.find_spec(f"{module}.__main__")
        sys.argv = [spec.origin, *words]
        sys.modules["__main__"] = main = importlib.util.module_from_spec(spec)
        main.__name__ = "__main__"
        exec(spec.loader.get_code(spec.name), vars(main))
        status = 0
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else int(end.code is not None)
    except BaseException:
        traceback.print_exc()
    finally:
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError):
                stream.flush()
        os._exit(status)


def leave_out():
    """Leave out what takes a second of each start."""
    from coulombus.host.run import realtime_sequence
    from coulombus.system import realtime

    realtime_sequence.LISTEN_S = LISTEN_S
    realtime.lock_memory = lambda: realtime.Right("locked memory", True, "mlockall", "")


def leave(code):
    """End as Python does, but leave its memory to the system: to take all modules apart takes half a second."""
    for thread in threading.enumerate():
        if thread is not threading.current_thread() and not thread.daemon:
            thread.join()
    status = code if isinstance(code, int) else int(code is not None)
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            try:
                stream.flush()
            except OSError as error:
                print(f"Exception ignored in: {stream!r}: {error}", file=sys.__stderr__)
                status = 120
    os._exit(status)


def load_loops():
    """Load, or compile, the loop of a bus with its rig, and that of a data plane."""
    from coulombus.host.cycle.controllers import Controllers
    from coulombus.host.laws.laws import load_law
    from coulombus.host.realtime.process import new_buffers, warm_up
    from coulombus.host.realtime.shared_memory import SharedPlane
    from coulombus.rigs.rig import load_rig
    from coulombus.sim_bus.server.rig_server import SimServer
    from coulombus.wire.address import parse_address

    rig = load_rig("bench")
    SimServer(rig, parse_address(f"coulombus:warm-{os.getpid()}")).close()
    controllers = Controllers(rig, "hybrid")
    shared = SharedPlane.create(len(controllers.each))
    controllers.adopt(shared.axes)
    shared.owner[:] = controllers.owner
    ours, its = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours, its:
        warm_up(shared, new_buffers([its.fileno()], shared), load_law(rig.law_function, Path(rig.law_directory)))
    shared.close()


if __name__ == "__main__":
    for module in MODULES:
        importlib.import_module(module)
    leave_out()
    load_loops()
    gc.collect()
    gc.freeze()  # else each child copies the memory of all modules, when it looks for rubbish at its end: 0.6 s
    serve(int(sys.argv[1]))
    from coulombus.cli.main import main

    try:
        main(prog_name="coulombus")
    except SystemExit as end:
        leave(end.code)
