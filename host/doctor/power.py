"""Check of the power saving of the CAN card's USB port."""

from __future__ import annotations

import os
import re
from functools import partial
from pathlib import Path

from coulombus.host.doctor.finding import Check, Outcome
from coulombus.host.doctor.machine import CannotRead, Machine, nonsense

__all__ = ["checks"]


def checks(machine: Machine, interface: str) -> list[Check]:
    """Return the checks of the port of a CAN interface."""
    return [("power.usb", partial(usb, machine, interface))]


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
