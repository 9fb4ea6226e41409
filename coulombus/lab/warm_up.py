"""``coulombus warm-up``: compile all that `run`, `emulate`, `simulate` and `sweep` need, before it is needed.

Two processes at a time compile groups of kernels (`coulombus.lab.warm_up_steps`), each group after
those whose kernels it calls. A rig's size, mode and law change no kernel; an arm in the plane has
kernels of its own.
"""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import IO, Any, NamedTuple

from coulombus.kernels.compile_notice import compiling
from coulombus.kernels.decorator import CACHE_DIR, JIT_DISABLED, is_warm, warming
from coulombus.kernels.kernel_cache import SCOPES
from coulombus.system.errors import CoulombusError

__all__ = ["GROUPS", "WarmUp", "WarmUpError", "warm_up"]

MODULE = "coulombus.lab.warm_up_steps"
WORKERS = 2


class KernelGroup(NamedTuple):
    """Kernels that one process compiles."""

    steps: int
    after: tuple[str, ...] = ()
    """Groups whose kernels it calls."""
    scope: str = "run"
    """The first of `kernels.kernel_cache.SCOPES` that needs it."""


GROUPS: Mapping[str, KernelGroup] = MappingProxyType(
    {
        "bus": KernelGroup(4),
        "nodes": KernelGroup(2),
        "server": KernelGroup(1, ("bus", "nodes")),
        "host": KernelGroup(1, ("nodes",)),
        "loop": KernelGroup(1, ("host", "server"), "simulate"),
        "arm": KernelGroup(3, ("bus", "host"), "arm"),
        "arm_loop": KernelGroup(1, ("arm", "loop"), "arm"),
    }
)
"""By name; of those that can begin, the first does."""


class WarmUpError(CoulombusError):
    """The kernels could not be compiled, or cannot be kept; the text has the reason."""

    exit_status = 2


@dataclass(frozen=True)
class WarmUp:
    """Result of a warm-up.

    Attributes
    ----------
    compiled : number of functions compiled now; 0 if all were in the cache
    seconds : wall time [s]
    directory : directory of the compiled code; None with NUMBA_DISABLE_JIT=1, which compiles nothing
    """

    compiled: int
    seconds: float
    directory: Path | None

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return {
            "compiled": self.compiled,
            "seconds": round(self.seconds, 3),
            "directory": None if self.directory is None else str(self.directory),
        }


def warm_up(progress: Callable[[int, int], None] | None = None, *, scope: str = SCOPES[-1]) -> WarmUp:
    """Compile every kernel of a scope that is not in the cache; another process that needs one waits for the end.

    Parameters
    ----------
    progress : called with the number of finished steps, and of all
    scope : of `kernels.kernel_cache.SCOPES`

    Raises
    ------
    WarmUpError
        no directory for compiled code can be written, or a compiling process ended
    """
    begin, compiled = time.monotonic(), 0
    if not is_warm(scope):
        if CACHE_DIR is None:
            raise WarmUpError("compiled code cannot be kept: no directory can be written; name one by NUMBA_CACHE_DIR")
        with warming(scope):
            if not is_warm(scope):  # another process may have compiled all while this one waited
                compiling()
                compiled = _compile(scope, progress or (lambda done, of: None))
    return WarmUp(compiled, time.monotonic() - begin, None if JIT_DISABLED else CACHE_DIR)


def _compile(scope: str, progress: Callable[[int, int], None]) -> int:
    """Run the groups of a scope; return the number of functions compiled."""
    scopes = SCOPES[: SCOPES.index(scope) + 1]
    waiting = {name: group for name, group in GROUPS.items() if group.scope in scopes}
    done, of, counts = 0, sum(group.steps for group in waiting.values()), dict.fromkeys(waiting, 0)
    running: dict[str, subprocess.Popen[bytes]] = {}
    try:
        while waiting or running:
            for name in [name for name, group in waiting.items() if not {*waiting, *running}.intersection(group.after)]:
                if len(running) < WORKERS:
                    del waiting[name]
                    running[name] = _start(name)
            lines = {_output(process): name for name, process in running.items()}
            for line in select.select(list(lines), [], [])[0]:
                name = lines[line]
                if text := line.readline():
                    counts[name], done = int(text), done + 1
                    progress(done, of)
                else:
                    _check(name, running[name].wait())
                    line.close()
                    del running[name]
    finally:
        for process in running.values():
            process.kill()
            process.wait()
            _output(process).close()
    return sum(counts.values())


def _start(group: str) -> subprocess.Popen[bytes]:
    root = str(Path(__file__).parents[__name__.count(".")])
    path = os.pathsep.join(filter(None, (root, os.environ.get("PYTHONPATH"))))
    return subprocess.Popen(
        [sys.executable, "-P", "-m", MODULE, group, str(os.getpid())],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        bufsize=0,  # select(2) sees no line that a buffer holds
        start_new_session=True,  # the terminal's Ctrl-C is the parent's
        env={**os.environ, "PYTHONPATH": path, "OPENBLAS_NUM_THREADS": "1"},
    )


def _output(process: subprocess.Popen[bytes]) -> IO[bytes]:
    assert process.stdout is not None
    return process.stdout


def _check(group: str, status: int) -> None:
    if status:
        how = f"by {signal.Signals(-status).name}" if status < 0 else f"with exit status {status}"
        raise WarmUpError(f"compiling was cut short: the process of the group {group!r} ended {how}")
