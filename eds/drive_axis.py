"""Axes of a CiA 402 drive: the first has the objects 6000h to 67FFh, each further axis those 800h higher.

64 PDOs of each direction belong to each axis (CiA 402-3).
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
    """Return the object of an axis (1 to 8) that corresponds to `index` of the first axis.

    An object that belongs to no axis, below 6000h or from 6800h on, is returned unchanged.
    """
    return index + (axis - 1) * AXIS_OBJECTS if axis_of(index) == 1 else index


def axis_of(index: int) -> int:
    """Return the axis (1 to 8) to which an object belongs; 0: none."""
    return (index - PROFILE_OBJECTS) // AXIS_OBJECTS + 1 if PROFILE_OBJECTS <= index < PROFILE_END else 0


def first_axis_object(index: int) -> int:
    """Return the object of the first axis that corresponds to `index`."""
    return index - max(0, axis_of(index) - 1) * AXIS_OBJECTS


def pdo_numbers(axis: int) -> range:
    """Return the numbers of an axis's PDOs: 1 to 64 for the first, 65 to 128 for the second."""
    return range((axis - 1) * AXIS_PDOS + 1, axis * AXIS_PDOS + 1)
