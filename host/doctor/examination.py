"""All checks of a machine for a rig, in the order of the report, and the rig's requirements on it."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from coulombus.host.doctor import can, cpu, linux_kernel, rights, software
from coulombus.host.doctor.checks import CannotRead, Check, CheckResult, Machine, Outcome, examine
from coulombus.rigs.rig import Rig
from coulombus.wire.address import BusAddress

__all__ = ["RigDemands", "examination", "free"]

PACKET_BYTES, TRACE_BYTES = 48, 12
"""Size of a frame and of a cycle's trace in a recording, rounded up."""
ENOUGH_H = 8.0
"""Required recording time [h]: a working day."""


@dataclass(frozen=True)
class RigDemands:
    """Limits of a rig.

    Attributes
    ----------
    period_s : SYNC period
    window_s : part of the period for the TPDOs
    watchdog_s : shortest watchdog: time without a set-point or TPDO after which host or device makes the
        rig safe
    loss_limit : largest share of lost cycles
    bitrates_bit_s : bit rate of each bus by its channel
    frames : largest number of frames of all axes in a cycle
    """

    period_s: float
    window_s: float
    watchdog_s: float
    loss_limit: float
    bitrates_bit_s: dict[str, int]
    frames: int

    @classmethod
    def from_rig(cls, rig: Rig) -> RigDemands:
        """Return the requirements of a rig."""
        period_s = min(bus.period_s for bus in rig.buses)
        limits = [axis.limits.missed_tpdo_cycles * period_s for axis in rig.axes]
        for axis in rig.axes:
            limits += [
                time
                for section in (axis.motor, axis.brake)
                for time in (section.setpoint_fault_s, section.sync_timeout_s)
            ]
        return cls(
            period_s=period_s,
            window_s=max(bus.tpdo_window_s for bus in rig.buses),
            watchdog_s=min(limits),
            loss_limit=rig.host.loss_limit,
            bitrates_bit_s={bus.channel: bus.bitrate_bit_s for bus in rig.buses},
            frames=2 + len(rig.pdos()),
        )

    def __str__(self) -> str:
        rate = 1 / self.period_s
        frequency = f"{rate / 1000:g} kHz" if rate >= 1000 else f"{rate:g} Hz"
        return f"{frequency} with {self.watchdog_s * 1e3:g} ms watchdogs"


def examination(
    demands: RigDemands,
    addresses: Mapping[str, BusAddress],
    *,
    machine: Machine | None = None,
    given_cpu: int | None = None,
    folder: Path | None = None,
) -> list[CheckResult]:
    """Check a machine and return the findings; never raises, and changes nothing.

    Parameters
    ----------
    demands : the rig's requirements
    addresses : the buses by their channels; a card is checked for Linux interfaces only
    machine : the machine to check; default is this one
    given_cpu : CPU for the cycle; default is the host's default
    folder : folder for recordings; default is the current folder
    """
    computer = Machine() if machine is None else machine
    checks = linux_kernel.checks(computer) + cpu.checks(computer, given_cpu) + rights.checks(computer)
    for channel, address in addresses.items():
        checks += _of_bus(computer, demands, channel, address, several=len(addresses) > 1)
    checks += [("disk.free", partial(free, Path() if folder is None else folder, demands)), *software.checks()]
    return examine(checks)


def _of_bus(machine: Machine, demands: RigDemands, channel: str, address: BusAddress, *, several: bool) -> list[Check]:
    if not address.is_interface:
        text = f"{address} is a virtual bus: no card is looked at (--bus socketcan:can0 names one)"
        checks: list[Check] = [("can.interface", lambda: Outcome(True, text))]
    else:
        checks = can.checks(machine, address.name, demands.bitrates_bit_s.get(channel))
        checks += [("power.usb", partial(can.usb, machine, address.name))]
    return [(f"{name}.{channel}", check) for name, check in checks] if several else checks


def bytes_s(demands: RigDemands) -> float:
    """Return the data rate of a recording [bytes/s]."""
    return (PACKET_BYTES * demands.frames + TRACE_BYTES) / demands.period_s


def free(folder: Path, demands: RigDemands) -> Outcome:
    """Check that the disk has room for a day's recordings."""
    try:
        volume = os.statvfs(folder)
    except OSError as error:
        raise CannotRead(f"{folder} cannot be read: {error.strerror}") from None
    left = volume.f_bavail * volume.f_frsize
    hours = left / bytes_s(demands) / 3600
    text = f"{left / 1e9:.1f} GB in {folder.absolute()}: {hours:.0f} h of recording"
    if not os.access(folder, os.W_OK):
        return Outcome(False, f"{folder.absolute()} cannot be written", "# record to another folder")
    return Outcome(hours >= ENOUGH_H, text, "# free some space, or record with --rotate and --keep")
