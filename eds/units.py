"""Units of objects: fixed by CiA 301 and 402, or read from a device (6131h and 6132h of CiA 404).

A device's units are in CiA 303-2's notation.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

from coulombus.eds.drive_axis import first_axis_object

__all__ = ["BLOCK_UNITS", "NOTATION", "Unit", "fixed_unit", "unit_from_code"]

NOTATION: Mapping[int, str] = {
    0x01: "m",
    0x02: "kg",
    0x03: "s",
    0x04: "A",
    0x05: "K",
    0x10: "rad",
    0x20: "Hz",
    0x21: "N",
    0x22: "Pa",
    0x23: "J",
    0x24: "W",
    0x26: "V",
    0x28: "ohm",
    0x2D: "degC",
    0x56: "Nm",
}
"""Numerators of a unit by notation index of CiA 303-2."""
BLOCK_UNITS = {0x7130: (0x6131, 0x6132), 0x9130: (0x6131, 0x6132), 0x7300: (0x6301, 0x6302), 0x9300: (0x6301, 0x6302)}
"""CiA 404: objects with the unit and the decimal digits of analogue inputs and outputs."""
MOST_DIGITS = 9


class Unit(NamedTuple):
    """Value = raw x `scale` + `offset`, in `unit`."""

    scale: float
    unit: str
    offset: float = 0.0


TORQUE, CURRENT = "per mille of 6076h", "per mille of 6075h"
FIXED: Mapping[int, Unit] = {
    0x1006: Unit(1, "us"),
    0x1007: Unit(1, "us"),
    0x100C: Unit(1, "ms"),
    0x1015: Unit(0.1, "ms"),
    0x1017: Unit(1, "ms"),
    **dict.fromkeys((0x6071, 0x6072, 0x6074, 0x6077), Unit(1, TORQUE)),
    **dict.fromkeys((0x6073, 0x6078), Unit(1, CURRENT)),
    0x6075: Unit(1, "mA"),
    0x6076: Unit(1, "mNm"),
    0x6079: Unit(1, "mV"),
    0x6087: Unit(1, f"{TORQUE} per s"),
}
PDO: Mapping[int, Unit] = {3: Unit(0.1, "ms"), 5: Unit(1, "ms")}
"""Inhibit time and event timer of a PDO."""


def fixed_unit(index: int, subindex: int) -> Unit | None:
    """Return the unit that CiA 301 or CiA 402 defines for an object, None if they define none."""
    if 0x1400 <= index < 0x1600 or 0x1800 <= index < 0x1A00:
        return PDO.get(subindex)
    return FIXED.get(first_axis_object(index)) if subindex == 0 else None


def unit_from_code(code: int, digits: int) -> Unit | None:
    """Return the unit of a CiA 404 block: 10^-digits, with the prefix of the unit's code; None if the unit
    is unknown.

    The code's four bytes are, from the highest: prefix (power of ten, INTEGER8), numerator,
    denominator, reserved.
    """
    prefix = (code >> 24 & 0xFF) - (0x100 if code >> 31 & 1 else 0)
    name = NOTATION.get(code >> 16 & 0xFF)
    if name is None or code >> 8 & 0xFF or not 0 <= digits <= MOST_DIGITS:
        return None
    return Unit(float(10.0 ** (prefix - digits)), name)
