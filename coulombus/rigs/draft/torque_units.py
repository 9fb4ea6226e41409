"""Units of torque and current from object names, and known units of makers."""

from __future__ import annotations

import re
from collections.abc import Mapping

from coulombus.rigs.draft.device import DraftDevice, Place

__all__ = ["AMPERES", "NEWTON_METRES", "rated_unit", "unit_of"]

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
