"""Real-time settings of a thread: requested from the system, with the result of each request.

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
    """One setting that was requested."""

    name: str
    granted: bool
    detail: str = ""
    remedy: str = ""
    """Command that would grant it; empty if it was granted."""

    def __str__(self) -> str:
        if self.granted:
            return f"{self.name}: granted" + (f" ({self.detail})" if self.detail else "")
        return f"{self.name}: refused ({self.detail}); to have it: {self.remedy}"


@dataclass(frozen=True)
class RealTime:
    """All settings that were requested."""

    rights: tuple[Right, ...] = ()

    @property
    def refused(self) -> tuple[Right, ...]:
        """Settings that were not granted."""
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
    """Schedule the calling thread by SCHED_FIFO, but not the threads and processes that it starts
    (SCHED_RESET_ON_FORK).
    """

    def request() -> None:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))

    return _ask("SCHED_FIFO", f"priority {priority}", _ALLOW, request)


def lock_memory() -> Right:
    """Lock all present and future memory of this process into RAM (mlockall): no page faults."""

    def request() -> None:
        import resource

        # under a limit the call may succeed now and a later allocation fail: do not lock at all
        if os.geteuid() != 0 and resource.getrlimit(resource.RLIMIT_MEMLOCK)[0] != resource.RLIM_INFINITY:
            raise PermissionError(1, "the limit of locked memory (ulimit -l) is not unlimited")
        _checked(_library.mlockall(MCL_CURRENT | MCL_FUTURE))

    return _ask("locked memory", "mlockall", _ALLOW, request)


def cpu_list(text: str) -> frozenset[int]:
    """Return the CPUs of a list as the kernel writes it, ``0-2,4``; none for an empty text.

    Raises
    ------
    ValueError
        the text is not such a list
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
    """Return the running CPUs that the kernel's command line keeps free of ordinary threads (isolcpus); none if
    unknown.
    """
    folder = root / "sys/devices/system/cpu"
    try:
        online, isolated = (cpu_list((folder / name).read_text()) for name in ("online", "isolated"))
    except (OSError, ValueError):
        return frozenset()
    return online & isolated


def usable_cpus(root: Path = Path("/")) -> frozenset[int]:
    """Return the CPUs that a thread may be pinned to: those on which this process may run, and the
    isolated CPUs, which a thread uses only if pinned there.
    """
    if not hasattr(os, "sched_getaffinity"):  # not Linux
        return frozenset(range(os.cpu_count() or 1))
    allowed = frozenset(os.sched_getaffinity(0))
    return allowed | {cpu for cpu in isolated_cpus(root) - allowed if _may_have(cpu)}


def _may_have(cpu: int) -> bool:
    """Tell whether the calling thread may run on a CPU: only a trial shows a container's limits."""
    before = os.sched_getaffinity(0)
    try:
        os.sched_setaffinity(0, {cpu})
    except OSError:
        return False
    os.sched_setaffinity(0, before)
    return True


def default_cpu(root: Path = Path("/")) -> int | None:
    """Return the CPU for the cycle: the last isolated CPU, else the last CPU on which this process may
    run; None if it has only one.
    """
    usable = usable_cpus(root)
    isolated = usable & isolated_cpus(root)
    return max(isolated) if isolated else max(usable) if len(usable) > 1 else None


def bus_cpu(root: Path = Path("/")) -> int | None:
    """Return the CPU for nodes on a virtual interface of Linux: the first that is not isolated, so
    never the cycle's; None if there is only one.

    A virtual interface hands a frame on through a queue of the sending CPU: frames that one thread
    sends from two CPUs can overtake each other, which breaks the order of an SDO block.
    """
    usable = usable_cpus(root)
    return min(usable - isolated_cpus(root) or usable) if len(usable) > 1 else None


def pin(cpu: int) -> Right:
    """Restrict the calling thread to one CPU."""
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
    """Set the timer slack of the calling thread to a minimum: sleeps end on time, not up to 50 us late
    (matters for ordinary scheduling only).
    """
    remedy = "a kernel with PR_SET_TIMERSLACK"
    return _ask("timer slack", "1 ns", remedy, lambda: _checked(_library.prctl(PR_SET_TIMERSLACK, 1, 0, 0, 0)))


def ask_for_real_time(priority: int | None, cpu: int | None = None) -> RealTime:
    """Request all real-time settings for the calling thread.

    Call it when everything is loaded and allocated: memory is locked, and
    objects that live now are taken out of the garbage collector.

    Parameters
    ----------
    priority : of SCHED_FIFO, 1 to 99; None: ordinary scheduling, and
        only the timer slack is set
    cpu : CPU to which the thread is pinned
    """
    rights = [set_timer_slack()]
    if cpu is not None:
        rights.append(pin(cpu))
    if priority is not None:
        freeze_garbage()
        rights += [lock_memory(), hold_dma_latency(), set_fifo(priority)]
    return RealTime(tuple(rights))


def freeze_garbage() -> None:
    """Collect garbage once; later collections leave out the objects that live now."""
    gc.collect()
    gc.freeze()


def die_with_parent(parent: int, number: int = signal.SIGKILL) -> None:
    """Let the kernel send this process a signal when `parent`, its parent's id, ends (Linux only).

    If the parent has ended already, exit at once.
    """
    if hasattr(_library, "prctl"):
        _checked(_library.prctl(PR_SET_PDEATHSIG, int(number), 0, 0, 0))
    if os.getppid() != parent:
        os._exit(1)


def outlive_parent() -> None:
    """Undo `die_with_parent`: this process detects the end of its parent itself."""
    if hasattr(_library, "prctl"):
        _checked(_library.prctl(PR_SET_PDEATHSIG, 0, 0, 0, 0))
