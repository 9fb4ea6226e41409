"""Checks of the kernel: PREEMPT_RT, clock source, real-time throttling, swap, hypervisor, container."""

from __future__ import annotations

from functools import partial

from coulombus.host.doctor.checks import Absent, CannotRead, Check, Machine, Outcome, nonsense

__all__ = ["checks"]

GOOD_CLOCKS = ("tsc", "kvm-clock", "arch_sys_counter", "riscv_clocksource", "hyperv_clocksource_tsc_page", "timebase")
CLOCKS = "/sys/devices/system/clocksource/clocksource0"
RT_KERNELS = {
    "debian": "sudo apt install linux-image-rt-$(dpkg --print-architecture)  # then restart",
    "ubuntu": "sudo pro enable realtime-kernel  # then restart",
    "fedora": "# Fedora has no such kernel: build one with CONFIG_PREEMPT_RT, or take Debian",
    "arch": "# install linux-rt and boot it: sudo pacman -S linux-rt",
}
THROTTLED_SHARE = 0.9
"""Smallest acceptable share of CPU time for real-time threads; a loop that sleeps in each period uses less."""


def checks(machine: Machine) -> list[Check]:
    """Return the checks of the kernel."""
    each = (preempt_rt, clocksource, rt_throttling, swap, hypervisor, container)
    return [(f"kernel.{check.__name__}", partial(check, machine)) for check in each]


def preempt_rt(machine: Machine) -> Outcome:
    """Check for PREEMPT_RT: without it, a driver may delay the cycle by milliseconds."""
    version = machine.text("/proc/version")
    words = version.split()
    if words[:2] != ["Linux", "version"]:
        raise nonsense("/proc/version", version, "'Linux version ...'")
    try:
        real_time = machine.text("/sys/kernel/realtime") == "1"
    except Absent:
        real_time = False
    if real_time or "PREEMPT_RT" in words or "PREEMPT RT" in version:
        return Outcome(True, f"{words[2]} is PREEMPT_RT")
    return Outcome(False, f"{words[2]} is not a PREEMPT_RT kernel", RT_KERNELS.get(_distribution(machine), _build()))


def _build() -> str:
    return "# boot a kernel with CONFIG_PREEMPT_RT=y (in Linux itself since 6.12)"


def _distribution(machine: Machine) -> str:
    try:
        lines = machine.text("/etc/os-release").splitlines()
    except CannotRead:
        return ""
    return next((line[3:].strip("\"'") for line in lines if line.startswith("ID=")), "")


def clocksource(machine: Machine) -> Outcome:
    """Check the clock source: a clock that needs a system call or a port access costs microseconds for each
    read.
    """
    name = machine.text(f"{CLOCKS}/current_clocksource")
    if name in GOOD_CLOCKS:
        return Outcome(True, name)
    others = machine.text(f"{CLOCKS}/available_clocksource").split()
    better = next((other for other in GOOD_CLOCKS if other in others), None)
    if better is None:
        return Outcome(
            False, f"{name}: slow to read, and none better is offered", "# see `dmesg | grep -i clocksource`"
        )
    fix = f"echo {better} | sudo tee {CLOCKS}/current_clocksource"
    return Outcome(False, f"{name}: slow to read; {better} is there", fix)


def rt_throttling(machine: Machine) -> Outcome:
    """Check the throttling, which stops real-time threads that use more than a share of the CPU."""
    path = "/proc/sys/kernel/sched_rt_runtime_us"
    runtime, period = machine.number(path), machine.number("/proc/sys/kernel/sched_rt_period_us")
    if runtime == -1:
        return Outcome(True, "no limit (sched_rt_runtime_us = -1)")
    if period <= 0:
        raise nonsense("/proc/sys/kernel/sched_rt_period_us", str(period), "a number above 0")
    share = runtime / period
    text = f"real-time threads may use {share:.0%} of each {period * 1e-6:g} s"
    if share >= THROTTLED_SHARE:
        return Outcome(True, f"{text}; the cycle sleeps, and needs less")
    return Outcome(False, text, f"echo {round(0.95 * period)} | sudo tee {path}")


def swap(machine: Machine) -> Outcome:
    """Check that swap is off: only the cycle's memory is locked, not that of recording and bring-up."""
    lines = machine.text("/proc/swaps").splitlines()
    if not lines or not lines[0].startswith("Filename"):
        raise nonsense("/proc/swaps", lines[0] if lines else "", "the line 'Filename ...'")
    used = [line.split()[0] for line in lines[1:] if line.strip()]
    if not used:
        return Outcome(True, "none")
    return Outcome(False, f"swap is on: {', '.join(used)}", "sudo swapoff -a  # for good: take it out of /etc/fstab")


def hypervisor(machine: Machine) -> Outcome:
    """Check for a hypervisor, which may stop the whole CPU at any time."""
    flags = [line for line in machine.text("/proc/cpuinfo").splitlines() if line.startswith(("flags", "Features"))]
    try:
        kind = machine.text("/sys/hypervisor/type")
    except CannotRead:
        kind = ""
    if not flags and not kind and "processor" not in machine.text("/proc/cpuinfo"):
        raise nonsense("/proc/cpuinfo", machine.text("/proc/cpuinfo"), "a list of processors")
    if not kind and not any("hypervisor" in line.split() for line in flags):
        return Outcome(True, "none")
    try:
        product = machine.text("/sys/class/dmi/id/product_name")
    except CannotRead:
        product = ""
    name = ", ".join(filter(None, (kind, product)))
    text = f"this is a virtual machine{f' ({name})' if name else ''}: it may stand still at any time"
    return Outcome(False, text, "# run the host on a machine of its own; here only with simulated nodes")


def container(machine: Machine) -> Outcome:
    """Report a container; it is no problem in itself, and the checks of rights report its limits."""
    for name, kind in (("/.dockerenv", "docker"), ("/run/.containerenv", "podman")):
        if machine.path(name).exists():
            return Outcome(True, f"this is a container ({kind}): limits and devices are those that it was given")
    return Outcome(True, "none")
