"""Checks of the CPUs: isolation of the cycle's CPU, and causes of its delays."""

from __future__ import annotations

import re
from functools import partial

from coulombus.host.doctor.checks import Absent, CannotRead, Check, Machine, Outcome
from coulombus.host.doctor.rights import DMA_FIX, dma_writable

__all__ = ["checks", "cycle_cpu", "others_mask"]

CPUS = "/sys/devices/system/cpu"
GRUB = "/etc/default/grub"
DEEP_US = 50
"""Longest acceptable wake-up latency of an idle state [us]."""
SHOWN = 6


def cycle_cpu(machine: Machine, cpu_option: int | None = None) -> int:
    """Return the CPU for the cycle: the given one, else the machine's last.

    CannotRead if the machine does not list its CPUs.
    """
    return max(machine.online(), default=0) if cpu_option is None else cpu_option


def checks(machine: Machine, cpu_option: int | None = None) -> list[Check]:
    """Return the checks of the CPUs; `cpu_option` is the CPU for the cycle."""
    of_cpu = (isolated, nohz_full, irq_affinity, governor)
    entries: list[Check] = [(f"cpu.{check.__name__}", partial(check, machine, cpu_option)) for check in of_cpu]
    return [*entries, ("cpu.c_states", partial(c_states, machine))]


def _listed(machine: Machine, name: str, cpu_option: int | None, why: str) -> Outcome:
    online, cpu = machine.online(), cycle_cpu(machine, cpu_option)
    if len(online) < 2:
        return Outcome(False, "there is one CPU only: the cycle shares it", "# take a machine with two CPUs or more")
    try:
        text = machine.text(f"{CPUS}/{name}")
        listed = frozenset() if text in ("", "(null)") else machine.cpus(f"{CPUS}/{name}")
    except Absent:
        listed = frozenset()
    if cpu in listed:
        return Outcome(True, f"CPU {cpu}, the cycle's, is among {_cpus(listed)}")
    words = f"isolcpus={cpu} nohz_full={cpu} rcu_nocbs={cpu}"
    add = f"sudo sed -i 's/^GRUB_CMDLINE_LINUX=\"/&{words} /' {GRUB} && sudo update-grub"
    fix = f"grep -q isolcpus= {GRUB} || {{ {add}; }}  # then restart"
    return Outcome(False, f"CPU {cpu}, the cycle's, {why}", fix)


def isolated(machine: Machine, cpu_option: int | None = None) -> Outcome:
    """Check that the cycle's CPU is isolated (isolcpus), so that ordinary threads do not run there."""
    return _listed(machine, "isolated", cpu_option, "is not isolated: ordinary threads run there, too")


def nohz_full(machine: Machine, cpu_option: int | None = None) -> Outcome:
    """Check that the cycle's CPU is in nohz_full: it has no timer tick while a single thread runs there."""
    return _listed(machine, "nohz_full", cpu_option, "is not in nohz_full: the timer ticks there")


def _cpus(cpus: frozenset[int]) -> str:
    return ",".join(map(str, sorted(cpus)))


def others_mask(online: frozenset[int], cpu: int) -> str:
    """Return the mask of all CPUs except `cpu` in the format of /proc/irq: words of 32 bits."""
    bits = sum(1 << other for other in online - {cpu}) or 1
    words = []
    while bits:
        words.append(f"{bits & 0xFFFFFFFF:08x}")
        bits >>= 32
    return ",".join(reversed(words)).lstrip("0") or "0"


def irq_affinity(machine: Machine, cpu_option: int | None = None) -> Outcome:
    """Check that no interrupts of other devices come to the cycle's CPU, where they would delay the cycle."""
    online, cpu = machine.online(), cycle_cpu(machine, cpu_option)
    if len(online) < 2:
        return Outcome(
            False, "there is one CPU only: all interrupts come there", "# take a machine with two CPUs or more"
        )
    numbers = [name for name in machine.names("/proc/irq") if name.isdecimal()]
    if not numbers:
        raise CannotRead("/proc/irq cannot be read: it lists no interrupt")
    here, unknown = [], 0
    for number in numbers:
        try:
            handlers = [
                n for n in machine.names(f"/proc/irq/{number}") if machine.path(f"/proc/irq/{number}/{n}").is_dir()
            ]
            if handlers and cpu in _affinity(machine, number) and not any(re.search(r"can\d", n) for n in handlers):
                here.append(f"{number} ({handlers[0]})")
        except CannotRead:
            unknown += 1
    doubt = f"; {unknown} cannot be read" if unknown else ""
    if not here:
        return Outcome(
            not unknown, f"none but the CAN card's comes to CPU {cpu}{doubt}", "# look as root: sudo coulombus doctor"
        )
    shown = ", ".join(here[:SHOWN]) + (f" and {len(here) - SHOWN} more" if len(here) > SHOWN else "")
    mask = others_mask(online, cpu)
    fix = (
        "sudo systemctl disable --now irqbalance 2>/dev/null || true\n"
        f"echo {mask} | sudo tee /proc/irq/default_smp_affinity\n"
        f"for i in /proc/irq/[0-9]*/smp_affinity; do echo {mask} | sudo tee $i || true; done >/dev/null 2>&1"
    )
    return Outcome(False, f"interrupts come to CPU {cpu}: {shown}{doubt}", fix)


def _affinity(machine: Machine, number: str) -> frozenset[int]:
    try:
        return machine.cpus(f"/proc/irq/{number}/effective_affinity_list")
    except Absent:
        return machine.cpus(f"/proc/irq/{number}/smp_affinity_list")


def governor(machine: Machine, cpu_option: int | None = None) -> Outcome:
    """Check the CPU governor: one that saves power changes the clock during the cycle."""
    cpu = cycle_cpu(machine, cpu_option)
    try:
        name = machine.text(f"{CPUS}/cpu{cpu}/cpufreq/scaling_governor")
    except Absent:
        return Outcome(True, f"CPU {cpu} has no frequency scaling that Linux would govern")
    if name == "performance":
        return Outcome(True, f"CPU {cpu}: performance")
    if not re.fullmatch(r"[a-z_]{1,16}", name):
        raise CannotRead(f"{CPUS}/cpu{cpu}/cpufreq/scaling_governor cannot be read: got {name[:40]!r}, expected a name")
    fix = f"echo performance | sudo tee {CPUS}/cpu*/cpufreq/scaling_governor"
    return Outcome(False, f"CPU {cpu}: {name}", fix)


def c_states(machine: Machine) -> Outcome:
    """Check that the host can prevent deep idle states, by /dev/cpu_dma_latency."""
    deepest, which = 0, ""
    for state in machine.names(f"{CPUS}/cpu0/cpuidle"):
        folder = f"{CPUS}/cpu0/cpuidle/{state}"
        if not re.fullmatch(r"state\d+", state):
            continue
        try:
            disabled = machine.number(f"{folder}/disable")
        except Absent:
            disabled = 0
        if not disabled and (latency := machine.number(f"{folder}/latency")) >= deepest:
            deepest, which = latency, machine.text(f"{folder}/name")
    if deepest <= DEEP_US:
        return Outcome(True, f"at most {deepest} us to wake ({which})" if which else "no idle state that Linux chooses")
    text = f"{which} takes {deepest} us to wake from"
    if dma_writable(machine):
        return Outcome(True, f"{text}; the host forbids it while it runs")
    return Outcome(False, f"{text}, and the host may not forbid it", DMA_FIX)
