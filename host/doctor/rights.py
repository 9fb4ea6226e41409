"""Checks of this user's rights: real-time priority, locked memory, and CPU idle states."""

from __future__ import annotations

import os
from functools import partial

from coulombus.host.doctor.checks import CannotRead, Check, Machine, Outcome, nonsense

__all__ = ["DMA_FIX", "checks", "dma_writable"]

CAP_SYS_NICE = 23
PRIORITY = 80
DMA = "/dev/cpu_dma_latency"
GROUP = "realtime"
_JOIN = f"sudo groupadd -f {GROUP} && sudo usermod -aG {GROUP} $USER  # then log in again"
LIMITS_FIX = (
    f"printf '@{GROUP} - rtprio 95\\n@{GROUP} - memlock unlimited\\n'"
    f" | sudo tee /etc/security/limits.d/90-realtime.conf && {_JOIN}"
)
DMA_FIX = (
    f'echo \'KERNEL=="cpu_dma_latency", GROUP="{GROUP}", MODE="0660"\''
    f" | sudo tee /etc/udev/rules.d/90-realtime.rules && sudo udevadm control --reload && sudo udevadm trigger /dev/cpu_dma_latency"
    f" && {_JOIN}"
)


def checks(machine: Machine) -> list[Check]:
    """Return the checks of this user's rights."""
    return [(f"rights.{check.__name__}", partial(check, machine)) for check in (rtprio, memlock, dma_latency)]


def _limit(machine: Machine, name: str) -> float:
    """Return the soft limit `name` of /proc/self/limits; infinite if unlimited."""
    for line in machine.text("/proc/self/limits").splitlines():
        if line.startswith(name):
            soft = line[len(name) :].split()[:1]
            if soft == ["unlimited"]:
                return float("inf")
            if soft and soft[0].isdecimal():
                return float(soft[0])
            raise nonsense("/proc/self/limits", line, f"{name!r} and a number")
    raise CannotRead(f"/proc/self/limits has no {name!r}")


def rtprio(machine: Machine) -> Outcome:
    """Check the real-time limit: SCHED_FIFO for the cycle needs it at the cycle's priority, or CAP_SYS_NICE."""
    limit = _limit(machine, "Max realtime priority")
    if machine.capable(CAP_SYS_NICE):
        return Outcome(True, "any priority (CAP_SYS_NICE)")
    if limit >= PRIORITY:
        return Outcome(True, f"up to {limit:g}")
    return Outcome(False, f"up to {limit:g}; the cycle asks for SCHED_FIFO {PRIORITY}", LIMITS_FIX)


def memlock(machine: Machine) -> Outcome:
    """Check that locked memory is unlimited: it has no page faults, and under a limit a later allocation would
    fail.
    """
    limit = _limit(machine, "Max locked memory")
    if machine.root_user or limit == float("inf"):
        return Outcome(True, "unlimited")
    return Outcome(False, f"{limit / 1024:.0f} KiB; expected unlimited", LIMITS_FIX)


def dma_writable(machine: Machine) -> bool:
    """Return whether this user may keep the CPUs out of deep idle states."""
    return os.access(machine.path(DMA), os.W_OK)


def dma_latency(machine: Machine) -> Outcome:
    """Check that /dev/cpu_dma_latency is writable, which the host holds open at 0 us."""
    if dma_writable(machine):
        return Outcome(True, f"{DMA} can be written")
    exists = os.path.lexists(machine.path(DMA))
    text = f"{DMA} cannot be written" if exists else f"there is no {DMA}"
    return Outcome(
        False,
        text,
        DMA_FIX if exists else "# a kernel with CONFIG_PM_QOS; in a container: --device /dev/cpu_dma_latency",
    )
