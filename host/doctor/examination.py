"""All checks of a machine for a rig, in the order of the report."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from coulombus.host.doctor import can, cpu, disk, linux_kernel, power, rights, software
from coulombus.host.doctor.finding import Check, CheckResult, Outcome, examine
from coulombus.host.doctor.machine import Machine
from coulombus.host.doctor.wanted import RigDemands
from coulombus.wire.address import BusAddress

__all__ = ["examination"]


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
    checks += disk.checks(Path() if folder is None else folder, demands) + software.checks()
    return examine(checks)


def _of_bus(machine: Machine, demands: RigDemands, channel: str, address: BusAddress, *, several: bool) -> list[Check]:
    if not address.is_interface:
        text = f"{address} is a virtual bus: no card is looked at (--bus socketcan:can0 names one)"
        checks: list[Check] = [("can.interface", lambda: Outcome(True, text))]
    else:
        checks = can.checks(machine, address.name, demands.bitrates_bit_s.get(channel))
        checks += power.checks(machine, address.name)
    return [(f"{name}.{channel}", check) for name, check in checks] if several else checks
