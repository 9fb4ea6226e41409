"""The axes of a CiA 402 drive: the objects of the first stand from 6000h to 67FFh, those of each
further one 800h higher; 64 PDOs of each direction belong to each (CiA 402-3).
"""

from __future__ import annotations

__all__ = [
    "AXIS_OBJECTS",
    "MOST_DRIVE_AXES",
    "PROFILE_OBJECTS",
    "axis_of",
    "first_axis_object",
    "of_axis",
    "pdo_numbers",
]

PROFILE_OBJECTS, PROFILE_END = 0x6000, 0xA000
AXIS_OBJECTS, AXIS_PDOS = 0x800, 64
MOST_DRIVE_AXES = (PROFILE_END - PROFILE_OBJECTS) // AXIS_OBJECTS


def of_axis(index: int, axis: int) -> int:
    """Return the object of an axis (1 to 8) that the first axis has at `index`.

    An object that is of no axis, below 6000h or from 6800h on, is returned as it is.
    """
    return index + (axis - 1) * AXIS_OBJECTS if axis_of(index) == 1 else index


def axis_of(index: int) -> int:
    """Return the axis (1 to 8) that an object belongs to; 0: none."""
    return (index - PROFILE_OBJECTS) // AXIS_OBJECTS + 1 if PROFILE_OBJECTS <= index < PROFILE_END else 0


def first_axis_object(index: int) -> int:
    """Return the object of the first axis that means what `index` does of its own."""
    return index - max(0, axis_of(index) - 1) * AXIS_OBJECTS


def pdo_numbers(axis: int) -> range:
    """Return the numbers of the PDOs that are an axis': 1 to 64 the first's, 65 to 128 the
    second's.
    """
    return range((axis - 1) * AXIS_PDOS + 1, axis * AXIS_PDOS + 1)
