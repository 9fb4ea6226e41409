"""Units and modes of makers: what an EDS file says of torque and current only by its objects' names.

A manufacturer-specific mode and its set-point serve a drive without CST and profile torque.
Modes that are not in the table are searched by the objects' names.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

from coulombus.rigs.draft.device import DraftDevice, Place

__all__ = ["AMPERES", "MAKERS", "NEWTON_METRES", "MakerMode", "maker_mode", "rated_unit", "unit_of"]


NEWTON_METRES: Mapping[str, float] = {"Nm": 1.0, "cNm": 1e-2, "mNm": 1e-3, "uNm": 1e-6}
"""Nm per unit."""
AMPERES: Mapping[str, float] = {"A": 1000.0, "mA": 1.0}
"""mA per unit."""
UNIT = re.compile(r"(?<!\w)([cmu\u00b5\u03bc]?N ?m|mA|(?<=[\[(])A(?=[\])]))(?!\w)")
"""A unit that stands alone in a name, "A" in brackets only: "Target torque [mNm]"."""
MICRO_MAKERS: Mapping[int, str] = {0xFB: "maxon"}
"""1018h:1 of makers whose manuals have 6076h in uNm."""


def unit_of(device: DraftDevice, place: Place) -> str:
    """Return the unit of torque or current in an object's name, as `NEWTON_METRES` and `AMPERES` spell it; "" if none."""
    index, subindex = place
    if not device.has(index, subindex):
        return ""
    entry = device.description.objects[device.at(index)]
    match = UNIT.search(f"{entry.name} {entry.variables[subindex].name}")
    return match[1].replace(" ", "").replace("\u00b5", "u").replace("\u03bc", "u") if match else ""


def rated_unit(device: DraftDevice) -> tuple[float, str]:
    """Return the Nm of one count of 6076h, and the reason; CiA 402's mNm and "" if nothing states it."""
    unit = unit_of(device, (0x6076, 0))
    if unit in NEWTON_METRES:
        return NEWTON_METRES[unit], f"in {unit} by its name"
    vendor, _ = device.identity(1)
    if maker := MICRO_MAKERS.get(vendor or 0):
        return NEWTON_METRES["uNm"], f"in uNm as {maker} has it"
    return NEWTON_METRES["mNm"], ""


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
