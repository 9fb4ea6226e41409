"""Torque and current modes of makers' own: which object is the set-point, where a drive has neither
CST nor profile torque.

What is not in the table is looked for by the objects' names.
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
    """A mode of operation (6060h) of a maker's own, in which a PDO can carry torque or current.

    Attributes
    ----------
    unit : of the set-point's and the actual value's raw counts; "unit" is the maker's own
    actual : where the torque or current that flows is told; None: by the profile, in per mille
    continuous_mA : where the current that the motor bears stands [mA]
    sdo : objects that the mode needs: (object, CiA 301's type, value)
    sure : by the table of makers; else by the names of the objects alone
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
    """Return a maker's own mode by which a drive can be commanded, None where nothing looks like
    one.
    """
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
    """Yield the objects of the maker's own that are called a commanded torque or current."""
    for index, entry in device.description.objects.items():
        for subindex, variable in entry.variables.items() if index in MANUFACTURER else ():
            name = f"{entry.name} {variable.name}"
            called = QUANTITY.search(name) and COMMANDED.search(name) and not SOMETHING_ELSE.search(name)
            mapped = device.entry((index, subindex), "rpdo") if called else None
            if mapped is not None and 16 <= mapped.bits <= 32 and mapped.signed:
                yield index, subindex
