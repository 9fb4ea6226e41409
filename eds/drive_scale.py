"""Scale and sign of a CiA 402 drive's position and velocity.

They come from the factor group 608Fh, 6091h, 6092h and 6093h, the SI units 60A8h and 60A9h, and the
polarity 607Eh.

CiA 402-2 defines the position actual value 6064h in user units::

    position = increments x feed / (resolution x gear)

    resolution = 608Fh:1 / 608Fh:2   increments in one turn of the motor
    gear       = 6091h:1 / 6091h:2   turns of the motor in one of the driving shaft
    feed       = 6092h:1 / 6092h:2   user units in one turn of the driving shaft

so that one turn of the motor is feed / gear. The first edition of CiA 402 has the position factor
6093h instead, increments per unit: one turn is resolution / factor. If 6092h is 1 / 1, its value
before it is set, the unit 60A8h gives the user units per turn; if 60A8h gives nothing, or
increments, 608Fh gives them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from fractions import Fraction
from typing import NamedTuple

from coulombus.eds.description import Description
from coulombus.eds.drive_axis import of_axis

__all__ = [
    "POLARITY",
    "SCALE_OBJECTS",
    "VELOCITY_UNIT",
    "Polarity",
    "PositionScale",
    "defaults",
    "polarity",
    "position_scale",
    "resolution",
    "velocity_unit",
]

Place = tuple[int, int]
Values = Callable[[int, int], int | None]
"""Value of an object by index and sub-index; None if unknown."""

POSITION_FACTOR, POSITION_UNIT, VELOCITY_UNIT = 0x6093, 0x60A8, 0x60A9
POLARITY: Place = (0x607E, 0)
SCALE_OBJECTS: tuple[Place, ...] = (
    *((0x608F, 1), (0x608F, 2), (0x6091, 1), (0x6091, 2), (0x6092, 1), (0x6092, 2)),
    *((POSITION_FACTOR, 1), (POSITION_FACTOR, 2)),
    (POSITION_UNIT, 0),
)
"""Objects that determine the scale of 6064h."""
LEAST_INCREMENTS = 16
"""Least increments of an encoder per turn: an unset 608Fh says 1."""
LEAST_UNITS = 2
"""Least user units per turn by 60A8h: a unit of a whole turn means that 60A8h is not set."""

INCREMENTS = 0xB5
TURNS: Mapping[int, float] = {0x10: 2 * math.pi, 0x41: 360.0, 0x42: 21_600.0, 0x43: 1_296_000.0, 0xB4: 1.0}
"""Units per turn, by the notation index of CiA 303-2 for an angle: radian, degree, minute, second,
revolution.
"""
PER: Mapping[int, float] = {0x03: 1.0, 0x47: 60.0}
"""Seconds, by the notation index of a time: second, minute."""


class PositionScale(NamedTuple):
    """Counts of 6064h in one turn of the motor, and the objects that give them.

    Attributes
    ----------
    counts_rev : user units in one turn of the motor; None if unknown
    by : the objects and their values, in words
    """

    counts_rev: float | None
    by: str

    @property
    def whole(self) -> int:
        """Counts as in the rig file, an integer of at least 1."""
        return max(1, round(self.counts_rev or 0))

    def agrees(self, counts_rev: float) -> bool:
        """Tell whether another number equals this one within the rounding to an integer."""
        return self.counts_rev is None or abs(self.counts_rev - counts_rev) <= 0.5 + 1e-6 * self.counts_rev


class Polarity(NamedTuple):
    """Signs of 607Eh: -1 for an inverted quantity (CiA 402-2; bit 7 position, 6 velocity, 5 torque)."""

    position: int
    velocity: int
    torque: int


def defaults(description: Description, axis: int = 1) -> Values:
    """Return a function that gives the defaults of an EDS file's objects.

    Parameters
    ----------
    axis : of the drive; the function takes the indices of the first axis
    """

    def value(index: int, subindex: int) -> int | None:
        index = of_axis(index, axis)
        default = description.variable(index, subindex).default if description.has(index, subindex) else None
        return default if isinstance(default, int) else None

    return value


def polarity(code: int | None) -> Polarity:
    """Return the signs that 607Eh defines; all positive if it is unknown."""
    return Polarity(*(-1 if (code or 0) >> bit & 1 else 1 for bit in (7, 6, 5)))


def _ratio(value: Values, index: int) -> Fraction | None:
    """Return :1 / :2; None if :1 is unknown, or 0."""
    numerator, denominator = value(index, 1), value(index, 2)
    return Fraction(numerator, denominator or 1) if numerator else None


def resolution(value: Values) -> Fraction | None:
    """Return the increments in one turn of the motor (608Fh); None if they are not set."""
    increments = _ratio(value, 0x608F)
    return increments if increments is not None and increments >= LEAST_INCREMENTS else None


def position_scale(value: Values, axis: int = 1) -> PositionScale:
    """Return the scale of 6064h.

    Parameters
    ----------
    value : by the indices of the first axis
    axis : of the drive, for the names of its objects
    """
    resolution_name, gear_name, feed_name, unit_name = (
        f"{of_axis(index, axis):04X}h" for index in (0x608F, 0x6091, 0x6092, POSITION_UNIT)
    )
    increments, feed = resolution(value), _ratio(value, 0x6092)
    gear, code = _ratio(value, 0x6091) or Fraction(1), value(POSITION_UNIT, 0)
    geared = "" if gear == 1 else f", {gear_name} = {value(0x6091, 1)}:{value(0x6091, 2) or 1}"
    turn = _units_in_turn(code)
    if feed is not None and feed != 1:
        other = f"; {unit_name} = 0x{code or 0:08X} means {turn:g} in a turn" if turn and turn != feed else ""
        return PositionScale(
            float(feed / gear), f"{feed_name} = {value(0x6092, 1)}/{value(0x6092, 2) or 1}{geared}{other}"
        )
    factor = _ratio(value, POSITION_FACTOR)
    if factor is not None and factor != 1:
        factor_name = of_axis(POSITION_FACTOR, axis)
        by = f"{factor_name:04X}h = {value(POSITION_FACTOR, 1)}/{value(POSITION_FACTOR, 2) or 1}, {resolution_name}"
        if increments is None:
            return PositionScale(None, f"{by} tells nothing")
        return PositionScale(float(increments / factor), f"{by} = {value(0x608F, 1)}/{value(0x608F, 2) or 1}")
    if turn is not None and turn >= LEAST_UNITS:
        return PositionScale(turn / float(gear), f"{unit_name} = 0x{code or 0:08X}{geared}")
    if increments is not None:
        return PositionScale(float(increments), f"{resolution_name} = {value(0x608F, 1)}/{value(0x608F, 2) or 1}")
    return PositionScale(None, f"{resolution_name}, {gear_name}, {feed_name} and {unit_name} tell nothing")


def _prefixed(code: int) -> tuple[float, int, int]:
    """Return the power of ten of a unit, its numerator and its denominator (CiA 303-2)."""
    return 10.0 ** ((code >> 24 & 0xFF) - (0x100 if code >> 31 & 1 else 0)), code >> 16 & 0xFF, code >> 8 & 0xFF


def _units_in_turn(code: int | None) -> float | None:
    """Return the number of an angle unit's units per turn; None for any other unit."""
    if not code:
        return None
    prefix, numerator, _ = _prefixed(code & 0xFFFFFFFF)
    return TURNS[numerator] / prefix if numerator in TURNS else None


def velocity_unit(value: Values) -> tuple[float, str]:
    """Return rad/s of the motor per count of 606Ch, and the object that gives it.

    Raises
    ------
    ValueError
        60A9h is unknown, or is no angle or increments per second or minute
    """
    code = value(VELOCITY_UNIT, 0)
    if not isinstance(code, int):
        raise ValueError("60A9h (unit of velocity) is missing")
    prefix, numerator, time = _prefixed(code & 0xFFFFFFFF)
    increments = resolution(value)
    turn = TURNS.get(numerator)
    if numerator == INCREMENTS and increments is not None:
        turn = float(increments)
    if turn is None or time not in PER:
        raise ValueError(
            f"60A9h is 0x{code & 0xFFFFFFFF:08X}, no revolutions, angle or increments per second or minute"
        )
    gear = 1.0 if numerator == INCREMENTS else float(_ratio(value, 0x6091) or 1)
    return 2 * math.pi / turn / PER[time] * prefix * gear, "60A9h"
