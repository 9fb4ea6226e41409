"""What a real-time thread asks the system for, and what it was granted.
Nothing is required; each refusal names the command that would grant it.
"""

from __future__ import annotations

import ctypes
import gc
import os
import signal
import struct
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from coulombus.system.c_library import c_library

__all__ = [
    "RealTime",
    "Right",
    "ask_for_real_time",
    "bus_cpu",
    "cpu_list",
    "default_cpu",
    "die_with_parent",
    "freeze_garbage",
    "hold_dma_latency",
    "lock_memory",
    "outlive_parent",
    "pin",
    "set_fifo",
    "set_timer_slack",
    "usable_cpus",
]

PR_SET_PDEATHSIG, PR_SET_TIMERSLACK = 1, 29
MCL_CURRENT, MCL_FUTURE = 1, 2
MOST_CPUS = 8192
_ALLOW = "sudo prlimit --pid $$ --rtprio=95 --memlock=unlimited  (for this shell; for good: rtprio and memlock in /etc/security/limits.d)"
_library = c_library()


@dataclass(frozen=True)
class Right:
    """One thing that was asked for."""

    name: str
    granted: bool
    detail: str = ""
    remedy: str = ""
    """The command that would grant it; empty when it was granted."""

    def __str__(self) -> str:
        if self.granted:
            return f"{self.name}: granted" + (f" ({self.detail})" if self.detail else "")
        return f"{self.name}: refused ({self.detail}); to have it: {self.remedy}"


@dataclass(frozen=True)
class RealTime:
    """Everything that was asked for."""

    rights: tuple[Right, ...] = ()

    @property
    def refused(self) -> tuple[Right, ...]:
        """What was not granted."""
        return tuple(right for right in self.rights if not right.granted)

    def as_dict(self) -> list[dict[str, Any]]:
        """Return the rights as plain values for JSON."""
        return [asdict(right) for right in self.rights]


def _checked(result: int) -> None:
    if result != 0:
        number = ctypes.get_errno()
        raise OSError(number, os.strerror(number))


def _ask(name: str, detail: str, remedy: str, request: Callable[[], None]) -> Right:
    try:
        request()
    except (OSError, ValueError) as error:
        return Right(name, False, getattr(error, "strerror", None) or str(error), remedy)
    return Right(name, True, detail)


def set_fifo(priority: int) -> Right:
    """Schedule the calling thread by SCHED_FIFO; threads and
    processes that it starts are not (SCHED_RESET_ON_FORK).
    """

    def request() -> None:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))

    return _ask("SCHED_FIFO", f"priority {priority}", _ALLOW, request)


def lock_memory() -> Right:
    """Keep all of this process's memory, present and future, out of page faults (mlockall)."""

    def request() -> None:
        import resource

        # under a limit the call may succeed now, and a later allocation fail: rather not at all
        if os.geteuid() != 0 and resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] != resource.RLIM_INFINITY:
            raise PermissionError(1, "the limit of locked memory (ulimit -l) is not unlimited")
        _checked(_library.mlockall(MCL_CURRENT | MCL_FUTURE))

    return _ask("locked memory", "mlockall", _ALLOW, request)


def cpu_list(text: str) -> frozenset[int]:
    """Return the CPUs of a list as the kernel writes it, ``0-2,4``; none for an empty text.

    Raises
    ------
    ValueError
        it is no such list
    """
    cpus: set[int] = set()
    for part in filter(None, (part.strip() for part in text.split(","))):
        first, dash, last = part.partition("-")
        low, high = int(first), int(last) if dash else int(first)
        if not 0 <= low <= high < MOST_CPUS:
            raise ValueError(f"{part!r} is no CPU")
        cpus.update(range(low, high + 1))
    return frozenset(cpus)


def isolated_cpus(root: Path = Path("/")) -> frozenset[int]:
    """Return the running CPUs that the kernel's command line keeps ordinary threads away from
    (isolcpus); none where that is not told.
    """
    folder = root / "sys/devices/system/cpu"
    try:
        online, isolated = (cpu_list((folder / name).read_text()) for name in ("online", "isolated"))
    except (OSError, ValueError):
        return frozenset()
    return online & isolated


def usable_cpus(root: Path = Path("/")) -> frozenset[int]:
    """Return the CPUs that a thread may be pinned to: those where this process may run, and the
    isolated ones, which nobody has who does not ask.
    """
    if not hasattr(os, "sched_getaffinity"):  # no Linux
        return frozenset(range(os.cpu_count() or 1))
    allowed = frozenset(os.sched_getaffinity(0))
    return allowed | {cpu for cpu in isolated_cpus(root) - allowed if _may_have(cpu)}


def _may_have(cpu: int) -> bool:
    """Tell whether the calling thread may run on a CPU: a container's limits show only so."""
    before = os.sched_getaffinity(0)
    try:
        os.sched_setaffinity(0, {cpu})
    except OSError:
        return False
    os.sched_setaffinity(0, before)
    return True


def default_cpu(root: Path = Path("/")) -> int | None:
    """Return the CPU for the cycle: the last isolated one, else the last one where this process may
    run; None when it has only one.
    """
    usable = usable_cpus(root)
    isolated = usable & isolated_cpus(root)
    return max(isolated) if isolated else max(usable) if len(usable) > 1 else None


def bus_cpu(root: Path = Path("/")) -> int | None:
    """Return the CPU for nodes on a virtual interface of Linux: the first that is not isolated, so
    another one than the cycle's; None when there is only one.

    A virtual interface hands a frame on through a queue of the CPU that sends: frames that one
    thread sends from two CPUs can overtake each other, and an SDO block is in order no more.
    """
    usable = usable_cpus(root)
    return min(usable - isolated_cpus(root) or usable) if len(usable) > 1 else None


def pin(cpu: int) -> Right:
    """Let the calling thread run on one CPU only."""
    return _ask(f"CPU {cpu}", "", f"a CPU of those allowed here: {_cpus()}", lambda: os.sched_setaffinity(0, {cpu}))


def _cpus() -> str:
    return ", ".join(str(cpu) for cpu in sorted(usable_cpus()))


_latency: list[int] = []


def hold_dma_latency() -> Right:
    """Keep the CPUs out of deep sleep for as long as this process
    lives (/dev/cpu_dma_latency held open at 0 us).
    """

    def request() -> None:
        if not _latency:
            fd = os.open("/dev/cpu_dma_latency", os.O_WRONLY | os.O_CLOEXEC)
            os.write(fd, struct.pack("i", 0))
            _latency.append(fd)

    return _ask("CPU wake-up latency", "/dev/cpu_dma_latency", "sudo chmod o+w /dev/cpu_dma_latency", request)


def set_timer_slack() -> Right:
    """Let the calling thread's sleeps end on time, not up to 50 us
    later (matters for ordinary scheduling only).
    """
    remedy = "a kernel with PR_SET_TIMERSLACK"
    return _ask("timer slack", "1 ns", remedy, lambda: _checked(_library.prctl(PR_SET_TIMERSLACK, 1, 0, 0, 0)))


def ask_for_real_time(priority: int | None, cpu: int | None = None) -> RealTime:
    """Ask for everything on behalf of the calling thread.

    Call it when all is loaded and allocated: memory is locked, and
    objects that live now are taken out of the garbage collector.

    Parameters
    ----------
    priority : of SCHED_FIFO, 1 to 99; None: ordinary scheduling, and
        nothing but the timer slack is asked for
    cpu : pin the thread there
    """
    rights = [set_timer_slack()]
    if cpu is not None:
        rights.append(pin(cpu))
    if priority is not None:
        freeze_garbage()
        rights += [lock_memory(), hold_dma_latency(), set_fifo(priority)]
    return RealTime(tuple(rights))


def freeze_garbage() -> None:
    """Collect garbage once; later collections leave out what lives now."""
    gc.collect()
    gc.freeze()


def die_with_parent(parent: int, number: int = signal.SIGKILL) -> None:
    """Let the kernel send this process a signal when `parent`, its
    parent's id, ends; if that has happened already, exit at once. Only Linux's does so.
    """
    if hasattr(_library, "prctl"):
        _checked(_library.prctl(PR_SET_PDEATHSIG, int(number), 0, 0, 0))
    if os.getppid() != parent:
        os._exit(1)


def outlive_parent() -> None:
    """Take `die_with_parent` back: this process sees for itself when its parent ends."""
    if hasattr(_library, "prctl"):
        _checked(_library.prctl(PR_SET_PDEATHSIG, 0, 0, 0, 0))
