"""Manufacturer-specific torque and current modes, and their set-points, for drives without CST and profile torque.

Modes that are not in the table are searched by the objects' names.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from coulombus.rigs.draft.device import DraftDevice, Place

__all__ = ["MAKERS", "MakerMode", "maker_mode"]

MANUFACTURER = range(0x2000, 0x6000)


@dataclass(frozen=True)
class MakerMode:
    """A manufacturer-specific mode (6060h) in which a PDO can carry torque or current.

    Attributes
    ----------
    unit : of the set-point's and the actual value's raw counts; "unit": manufacturer-specific
    actual : object of the actual torque or current; None: the profile's, in per mille
    continuous_mA : object of the motor's continuous current [mA]
    sdo : objects that the mode needs: (object, CiA 301's type, value)
    sure : from the table of makers; else only from the objects' names
    """

    vendor_id: int
    name: str
    mode: int
    setpoint: Place
    unit: Literal["mA", "unit"]
    actual: Place | None = None
    continuous_mA: Place | None = None
    sdo: tuple[tuple[Place, str, int], ...] = ()
    sure: bool = True


MAKERS = (
    MakerMode(0xFB, "maxon's current mode", -3, (0x2030, 0), "mA", (0x6078, 0), (0x6410, 1)),
    MakerMode(
        *(0x1A3, "Technosoft's external reference torque mode", -5, (0x201C, 0), "unit"),
        sdo=(((0x201D, 0), "UNSIGNED16", 1),),
    ),
)
"""By 1018h:1, of EPOS2 and iPOS."""

QUANTITY = re.compile(r"current|torque", re.I)
COMMANDED = re.compile(r"target|set ?-?point|setting value|set value|command|reference", re.I)
SOMETHING_ELSE = re.compile(
    r"actual|limit|max|min|homing|gain|offset|window|slope|time|protection|thresh|param|stand-?by|feed|profile|rated|"
    r"position|velocity|speed|mode select",
    re.I,
)


def maker_mode(device: DraftDevice) -> MakerMode | None:
    """Return a manufacturer-specific mode that can command a drive, or None."""
    vendor, _ = device.identity(1)
    for row in MAKERS:
        if row.vendor_id == vendor and device.entry(row.setpoint, "rpdo"):
            return row
    named = next(_named(device), None)
    if named is None:
        return None
    modes = device.value(0x6502) or 0
    mode = next((15 - bit for bit in range(16, 32) if modes >> bit & 1), -1)  # bit 16 is mode -1
    return MakerMode(vendor or 0, "the maker's own mode", mode, named, "unit", sure=False)


def _named(device: DraftDevice) -> Iterator[Place]:
    """Yield the manufacturer-specific objects whose names say commanded torque or current."""
    for index, entry in device.description.objects.items():
        for subindex, variable in entry.variables.items() if index in MANUFACTURER else ():
            name = f"{entry.name} {variable.name}"
            called = QUANTITY.search(name) and COMMANDED.search(name) and not SOMETHING_ELSE.search(name)
            mapped = device.entry((index, subindex), "rpdo") if called else None
            if mapped is not None and 16 <= mapped.bits <= 32 and mapped.signed:
                yield index, subindex
