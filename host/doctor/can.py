"""Checks of the CAN interface: driver, settings, error counters, and the power saving of its USB port."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from coulombus.host.doctor.checks import Absent, CannotRead, Check, Machine, Outcome, nonsense
from coulombus.host.doctor.linux_kernel import preempt_rt
from coulombus.host.doctor.rights import PRIORITY
from coulombus.system.quoting import comment, extended_regex, shell

__all__ = ["CanInterface", "checks", "usb"]

ARPHRD_CAN = 280
SHORTEST_QUEUE, LONGEST_QUEUE = 16, 256
"""Limits of the queue in frames: a shorter queue has no room for an SDO during the cycle; in a longer one
outdated set-points wait.
"""
RESTART_MS = 100
IRQ_PRIORITY = 90
"""SCHED_FIFO priority of the card's interrupt thread: above the host's."""
RT_PRIORITY = 40 - 3
"""Index of the field rt_priority in /proc/PID/stat, counted from the first field after the name (proc(5))."""
SAMPLE_POINTS = {1_000_000: (0.75, 0.90), 800_000: (0.75, 0.90)}
SAMPLE_POINT, BEST_SAMPLE_POINT = (0.85, 0.90), 0.875
"""Range of the sample point (CiA 301, bit timing), which is wider at 800 and 1000 kbit/s."""


@dataclass(frozen=True)
class CanInterface:
    """An interface, its required bit rate, and the output of ``ip -details -json link`` for it."""

    machine: Machine
    name: str
    bitrate_bit_s: int | None = None
    _kept: dict[str, Any] = field(default_factory=dict)

    @property
    def setup(self) -> str:
        """The commands that set the interface up."""
        rate = self.bitrate_bit_s or "BITRATE"
        link = f"sudo ip link set {shell(self.name)}"
        return (
            f"{link} down && {link} type can bitrate {rate} sample-point {BEST_SAMPLE_POINT} restart-ms {RESTART_MS}\n"
            f"{link} type can berr-reporting on || true  # not every card can\n"
            f"{link} txqueuelen 64 up"
        )

    @property
    def details(self) -> dict[str, Any]:
        """Output of `ip` for the interface, read once; CannotRead if it is not valid."""
        if "link" not in self._kept:
            text = self.machine.ask(["ip", "-details", "-statistics", "-json", "link", "show", "dev", self.name])
            try:
                (self._kept["link"],) = json.loads(text)
                dict.keys(self._kept["link"])
            except (ValueError, TypeError, RecursionError):
                self._kept.pop("link", None)
                raise CannotRead(f"what `ip` says of {self.name} cannot be read: {text[:40]!r}") from None
        details: dict[str, Any] = self._kept["link"]
        return details

    def data(self, *keys: str) -> Any:
        """Return the value under `keys` of the details; CannotRead if there is none."""
        value: Any = self.details
        for key in keys:
            if not isinstance(value, dict) or key not in value:
                raise CannotRead(f"`ip` says nothing of {'.'.join(keys)} of {self.name}")
            value = value[key]
        return value

    def number(self, *keys: str) -> float:
        """Return the number under `keys`; CannotRead if there is none."""
        value = self.data(*keys)
        try:
            return float(value)
        except (TypeError, ValueError):
            raise CannotRead(f"{'.'.join(keys)} of {self.name}: got {value!r}, expected a number") from None

    def info(self, *keys: str) -> Any:
        """Return the value under `keys` of the controller's data."""
        return self.data("linkinfo", "info_data", *keys)

    @property
    def modes(self) -> frozenset[str]:
        """The active modes of the controller; `ip` omits the list if there are none."""
        data = self.data("linkinfo", "info_data")
        modes = data.get("ctrlmode", []) if isinstance(data, dict) else None
        if not isinstance(modes, list):
            raise CannotRead(f"ctrlmode of {self.name}: got {modes!r}, expected a list")
        return frozenset(map(str, modes))

    @property
    def virtual(self) -> bool:
        """Whether the interface has no controller (vcan, vxcan)."""
        kind = self.details.get("linkinfo")
        return isinstance(kind, dict) and kind.get("info_kind") in ("vcan", "vxcan")


def checks(machine: Machine, name: str, bitrate_bit_s: int | None = None) -> list[Check]:
    """Return the checks of the interface `name`, with its required bit rate (None: any)."""
    can = CanInterface(machine, name, bitrate_bit_s)
    if not machine.path(f"/sys/class/net/{name}").exists():
        return [("can.interface", partial(_missing, can))]
    if not _is_can(machine, name):  # the other checks apply to CAN interfaces only
        return [("can.interface", partial(interface, can))]
    general = (interface, driver, up, txqueuelen)
    of_controller = (
        irq_thread,
        state,
        mode,
        bitrate,
        sample_point,
        restart_ms,
        berr_reporting,
        error_counters,
        timestamps,
    )
    entries: list[Check] = [(f"can.{check.__name__}", partial(check, can)) for check in general]
    return entries + [(f"can.{check.__name__}", partial(_of_controller, can, check)) for check in of_controller]


def _of_controller(can: CanInterface, check: Callable[[CanInterface], Outcome]) -> Outcome:
    if can.virtual:
        return Outcome(True, f"{can.name} has no controller: it is {can.data('linkinfo', 'info_kind')}")
    return check(can)


def _is_can(machine: Machine, name: str) -> bool:
    try:
        return machine.number(f"/sys/class/net/{name}/type") == ARPHRD_CAN
    except CannotRead:
        return False


def _missing(can: CanInterface) -> Outcome:
    interfaces = [name for name in can.machine.names("/sys/class/net") if _is_can(can.machine, name)]
    others = f"CAN interfaces here: {', '.join(interfaces)}" if interfaces else "no CAN interface is here"
    fix = (
        f"# name one of them: --bus socketcan:{comment(interfaces[0])}"
        if interfaces
        else "# plug the card in; see `lsusb`, `lspci`, `dmesg`"
    )
    return Outcome(False, f"there is no interface {can.name}; {others}", fix)


def interface(can: CanInterface) -> Outcome:
    """Check that the interface is a CAN interface."""
    kind = can.machine.number(f"/sys/class/net/{can.name}/type")
    if kind == ARPHRD_CAN:
        return Outcome(True, f"{can.name} is a CAN interface")
    return Outcome(
        False, f"{can.name} is not a CAN interface (type {kind})", "# name a CAN interface: --bus socketcan:can0"
    )


def driver(can: CanInterface) -> Outcome:
    """Check the driver: slcan is a serial line, too slow for a cycle of a millisecond."""
    target = can.machine.path(f"/sys/class/net/{can.name}/device/driver")
    name = os.path.basename(os.path.realpath(target)) if target.exists() else ""
    if not name and can.virtual:
        return Outcome(True, f"{can.data('linkinfo', 'info_kind')}: no wire, for trials only")
    if not name and re.match(r"slcan|can-ser", can.name):
        return Outcome(
            False, "slcan: a serial line, with milliseconds of delay", "# take a card with a driver of its own"
        )
    if not name:
        raise CannotRead(f"/sys/class/net/{can.name}/device/driver names no driver")
    return Outcome(True, name)


def up(can: CanInterface) -> Outcome:
    """Check that the interface is up."""
    flags = can.machine.text(f"/sys/class/net/{can.name}/flags")
    try:
        is_up = bool(int(flags, 16) & 1)
    except ValueError:
        raise CannotRead(f"/sys/class/net/{can.name}/flags cannot be read: got {flags[:40]!r}") from None
    if is_up:
        return Outcome(True, "up")
    fix = f"sudo ip link set {shell(can.name)} up" if can.virtual else can.setup
    return Outcome(False, "down", fix)


def txqueuelen(can: CanInterface) -> Outcome:
    """Check the length of the transmit queue: a short queue loses frames, a long queue keeps old set-points."""
    length = can.machine.number(f"/sys/class/net/{can.name}/tx_queue_len")
    fix = f"sudo ip link set {shell(can.name)} txqueuelen 64"
    if can.virtual:
        return Outcome(True, f"{length} frames; nothing waits there: it is virtual")
    if length < SHORTEST_QUEUE:
        return Outcome(False, f"{length} frames: an SDO transfer during the cycle may overflow it", fix)
    if length > LONGEST_QUEUE:
        return Outcome(False, f"{length} frames: a bus without traffic fills it with old set-points", fix)
    return Outcome(True, f"{length} frames")


def irq_thread(can: CanInterface) -> Outcome:
    """Check the priority of the card's interrupt thread.

    A PREEMPT_RT kernel empties the card's receive buffer in a thread, by default with priority 50. Below the
    host's priority it waits while the host polls, and frames are lost.
    """
    machine = can.machine
    if not preempt_rt(machine).ok:
        return Outcome(True, "no PREEMPT_RT kernel: the card's interrupt goes before any thread")
    numbers = _interrupts(can)
    priorities: dict[str, int] = {}
    for pid in filter(str.isdecimal, machine.names("/proc")):
        try:
            name = machine.text(f"/proc/{pid}/comm")
            if (thread := re.match(r"irq/(\d+)-", name)) and thread[1] in numbers:
                priorities[name] = _priority(machine, pid)
        except Absent:  # the process has ended in the meantime
            continue
    if not priorities:
        return Outcome(True, f"no interrupt of {can.name} has a thread")
    text = ", ".join(f"{name}: SCHED_FIFO {priority}" for name, priority in sorted(priorities.items()))
    fix = "\n".join(
        f"sudo chrt -f -p {IRQ_PRIORITY} $(pgrep -x {shell(extended_regex(name))})" for name in sorted(priorities)
    )
    if min(priorities.values()) > PRIORITY:
        return Outcome(True, text)
    return Outcome(False, f"{text}; the host polls at {PRIORITY}, and the receive buffer overflows meanwhile", fix)


def _interrupts(can: CanInterface) -> set[str]:
    """Return the numbers of the interrupts with the interface's name, or of its device; for a USB card, of
    the USB controller.
    """
    machine = can.machine
    numbers = [name for name in machine.names("/proc/irq") if name.isdecimal()]
    named = {number for number in numbers if machine.path(f"/proc/irq/{number}/{can.name}").is_dir()}
    if named:
        return named
    device, root = (
        Path(os.path.realpath(path)) for path in (machine.path(f"/sys/class/net/{can.name}/device"), machine.root)
    )
    for place in (device, *device.parents):
        if place == root:
            break
        interrupts = {entry.name for entry in place.glob("msi_irqs/*")}
        with suppress(OSError):
            interrupts |= {(place / "irq").read_text().strip()}
        if interrupts := interrupts & set(numbers):
            return interrupts
    return set()


def _priority(machine: Machine, pid: str) -> int:
    """Return the real-time priority of a thread; 0: none."""
    text = machine.text(f"/proc/{pid}/stat")
    try:
        return int(text.rpartition(")")[2].split()[RT_PRIORITY])
    except (ValueError, IndexError):
        raise nonsense(f"/proc/{pid}/stat", text, "the numbers of a thread") from None


def state(can: CanInterface) -> Outcome:
    """Check that the controller is error-active."""
    name = str(can.info("state"))
    if name == "ERROR-ACTIVE":
        return Outcome(True, name)
    if name == "STOPPED":
        return Outcome(False, name, can.setup)
    return Outcome(
        False,
        f"{name}: bit rate, cable or termination",
        "# 60 ohms between CAN_H and CAN_L with power off; then:\n" + can.setup,
    )


def mode(can: CanInterface) -> Outcome:
    """Check that no mode suppresses frames or their retransmission."""
    bad = sorted(can.modes & {"LOOPBACK", "LISTEN-ONLY", "ONE-SHOT", "PRESUME-ACK"})
    if not bad:
        return Outcome(True, "sends, and sends again what was destroyed")
    off = " ".join(f"{name.lower()} off" for name in bad)
    name = shell(can.name)
    fix = f"sudo ip link set {name} down && sudo ip link set {name} type can {off} && sudo ip link set {name} up"
    return Outcome(False, f"{', '.join(bad)} is on", fix)


def bitrate(can: CanInterface) -> Outcome:
    """Check that the bit rate is that of the rig file."""
    rate = can.number("linkinfo", "info_data", "bittiming", "bitrate")
    if can.bitrate_bit_s is None:
        return Outcome(True, f"{rate / 1000:g} kbit/s")
    if abs(rate - can.bitrate_bit_s) <= 0.005 * can.bitrate_bit_s:
        return Outcome(True, f"{rate / 1000:g} kbit/s, as the rig file says")
    return Outcome(False, f"{rate / 1000:g} kbit/s; the rig file says {can.bitrate_bit_s / 1000:g}", can.setup)


def sample_point(can: CanInterface) -> Outcome:
    """Check the sample point: 87.5 % (CiA 301, bit timing)."""
    rate = round(can.number("linkinfo", "info_data", "bittiming", "bitrate"))
    point = can.number("linkinfo", "info_data", "bittiming", "sample_point")
    low, high = SAMPLE_POINTS.get(rate, SAMPLE_POINT)
    text = f"{point:.1%}; CiA 301 has {low:.0%} to {high:.0%} at {rate / 1000:g} kbit/s"
    return Outcome(low - 5e-4 <= point <= high + 5e-4, text, can.setup)


def restart_ms(can: CanInterface) -> Outcome:
    """Check that the interface restarts after a bus-off; the host has tripped, and stays tripped."""
    after = can.number("linkinfo", "info_data", "restart_ms")
    if after > 0:
        return Outcome(True, f"{after:g} ms")
    return Outcome(False, "0: after a bus-off the interface stays off", can.setup)


def berr_reporting(can: CanInterface) -> Outcome:
    """Check that each bus error is reported as an error frame, so that it is counted and recorded."""
    if "BERR-REPORTING" in can.modes:
        return Outcome(True, "on")
    supported = can.info().get("ctrlmode_supported")
    if isinstance(supported, list) and "BERR-REPORTING" not in supported:
        return Outcome(True, "off, and this card cannot: errors are seen by the counters only")
    return Outcome(False, "off: errors on the bus are not seen one by one", can.setup)


def error_counters(can: CanInterface) -> Outcome:
    """Check that the controller has counted no errors since its set-up."""
    tx, rx = (can.number("linkinfo", "info_data", "berr_counter", counter) for counter in ("tx", "rx"))
    try:
        counted = can.data("linkinfo", "info_xstats")
        since = {name: int(counted.get(name, 0)) for name in ("bus_error", "error_passive", "bus_off")}
    except (CannotRead, AttributeError, TypeError, ValueError):
        since = {}
    text = f"tx {tx:g}, rx {rx:g}" + "".join(f", {name.replace('_', ' ')} {n}" for name, n in since.items())
    ok = tx == rx == 0 and not any(since.values())
    return Outcome(ok, text, "# cable, termination, bit rate of each device; then, to zero the counters:\n" + can.setup)


def timestamps(can: CanInterface) -> Outcome:
    """Report the source of the time stamps: a card with its own stamps gives the time on the wire; else the
    kernel's stamps are used.
    """
    if can.machine.stamps(can.name):
        return Outcome(True, "in hardware")
    return Outcome(True, "by the kernel, when the frame is handed over: some tens of microseconds late")


def usb(machine: Machine, interface: str) -> Outcome:
    """Check that the USB port stays awake: with power saving it sleeps on a quiet bus, and wakes milliseconds
    late.
    """
    device = machine.path(f"/sys/class/net/{interface}/device")
    if not device.exists():
        return Outcome(True, f"{interface} is on no port")
    real, root = Path(os.path.realpath(device)), Path(os.path.realpath(machine.root))
    port = next((place for place in (real, *real.parents) if re.fullmatch(r"\d+-\d+(\.\d+)*", place.name)), None)
    if port is None:
        return Outcome(True, f"{interface} is not on USB")
    try:
        name = f"/{port.relative_to(root)}/power/control"
    except ValueError:
        raise CannotRead(f"{interface} is at {port}, outside of {root}") from None
    control = machine.text(name)
    if control == "on":
        return Outcome(True, f"USB port {port.name} stays awake")
    if control != "auto":
        raise nonsense(name, control, "on or auto")
    return Outcome(False, f"USB port {port.name} may sleep", f"echo on | sudo tee {name}")
