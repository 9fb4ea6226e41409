"""The drive's own scale of its position, held against the rig file's before anything moves.

The host's bounds in radians (the sign check's travel, the speed limit, the release) are wrong by
the factor by which the rig file's counts are. So bring-up reads the objects that decide the drive's
scale (`eds.drive_scale`), after what it has written itself, and refuses a difference. Our own drive
has no user units.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import NamedTuple

from coulombus.eds.drive_axis import first_axis_object, of_axis
from coulombus.eds.drive_scale import SCALE_OBJECTS, PositionScale, defaults, position_scale, resolution
from coulombus.eds.own_devices import is_own, told_identity
from coulombus.host.errors import SdoAborted
from coulombus.rigs.axis import Axis
from coulombus.rigs.devices import drive_axis_of

__all__ = ["OWN_SCALE", "BelievedScale", "believed_scale", "early_wrap", "remark_of", "scale_differences"]

OWN_SCALE = "position scale is the rig file's"
"""What host.accept acknowledges, after the drive's name, where its objects tell another scale than
it has.
"""
MARKS = "coulombus commission --step encoder measures it between two marks"
RANGE_LIMIT = 0x607B
POSITION, INCREMENTS = (0x6064, 0), (0x6063, 0)


class BelievedScale(NamedTuple):
    """Counts of the position in one turn of the motor, as the rig file has them.

    Attributes
    ----------
    who, name : the drive, in words and by its name in host.accept
    place : the object that is the position
    counts_rev : in one turn of the motor
    key : of the rig file that decides it
    accepted : host.accept says that it is the rig file's, whatever the drive tells
    drive_axis : which axis of the drive it is
    """

    who: str
    name: str
    place: tuple[int, int]
    counts_rev: float
    key: str
    accepted: bool
    drive_axis: int

    def told(self, value: Callable[[int, int], int | None]) -> PositionScale:
        """Return the scale that these values of the drive's objects make; they are asked for as the
        first axis' objects.
        """
        if first_axis_object(self.place[0]) == POSITION[0]:
            return position_scale(value, self.drive_axis)
        increments = resolution(value)
        return PositionScale(
            None if increments is None else float(increments), f"{of_axis(0x608F, self.drive_axis):04X}h"
        )

    def difference(self, value: Callable[[int, int], int | None]) -> str:
        """Return how the drive's scale differs, "" where it does not, or the drive does not tell."""
        told = self.told(value)
        if told.counts_rev is None or told.agrees(self.counts_rev):
            return ""
        name = f"{self.place[0]:04X}h"
        return (
            f"{self.who}: {name} counts {told.counts_rev:.9g} in one turn of the motor ({told.by}), "
            f"the rig file says {self.counts_rev:.9g} ({self.key})"
        )

    def objects(self, has: Callable[[int, int], bool]) -> tuple[tuple[int, int], ...]:
        """Return the objects to read, of those that the drive has."""
        places = ((of_axis(index, self.drive_axis), subindex) for index, subindex in SCALE_OBJECTS)
        return tuple(place for place in places if has(*place))


def believed_scale(axis: Axis, who: str, name: str) -> BelievedScale | None:
    """Return the scale that the rig file gives the drive's position; None of our own drive, and
    where another object or device is the position.

    Parameters
    ----------
    who, name : the drive, in words and by its name in host.accept
    """
    binding = axis.allocation.bound.get("position")
    if binding is None or binding.node != "motor" or is_own("motor", told_identity(axis.description("motor"))):
        return None
    place = binding.entry.index, binding.entry.subindex
    number = drive_axis_of(axis.motor)
    if place not in [(of_axis(index, number), subindex) for index, subindex in (POSITION, INCREMENTS)]:
        return None
    counts_rev = 2 * math.pi / (abs(binding.scale) * axis.mechanics.ratio)
    key = binding.decided if binding.decided.startswith("role.") else "motor.encoder_counts_rev"
    return BelievedScale(who, name, place, counts_rev, key, f"{name}: {OWN_SCALE}" in axis.host.accept, number)


def remark_of(axis: Axis, scale: BelievedScale) -> tuple[str, str]:
    """Return what the EDS file alone says of the scale: a question that only the drive can answer,
    and what is lost where it cannot; "" where there is none.
    """
    description = axis.description("motor")
    if scale.accepted:
        guard = "" if axis.mechanics.counts_turn is not None else f", and nothing guards {scale.key} ({MARKS})"
        return "", f"{scale.who}: {OWN_SCALE}, and no object of the drive is held against it (host.accept){guard}"
    if not scale.objects(description.has):
        text = "the drive tells no scale of its position"
        if axis.mechanics.counts_turn is not None:
            return (
                "",
                f"{scale.who}: {text}; what was measured between marks guards {scale.key} (mechanics.counts_turn)",
            )
        return "", f"{scale.who}: {text}: nothing guards {scale.key} ({MARKS})"
    difference = scale.difference(defaults(description, scale.drive_axis))
    if difference:
        return f"{difference}; that is {description.path}, and bring-up asks the drive", ""
    if scale.told(defaults(description, scale.drive_axis)).counts_rev is None:
        text = "does not tell the scale of the position; bring-up asks the drive"
        return f"{scale.who}: {description.path} {text}, and holds {scale.key} against it", ""
    return "", ""


def early_wrap(axis: Axis, who: str) -> str:
    """Return that the drive's position wraps sooner than its type does (607Bh); "" where the EDS file
    does not say so.
    """
    binding, description = axis.allocation.bound["position"], axis.description("motor")
    index = of_axis(RANGE_LIMIT, drive_axis_of(axis.motor))
    low, high = (description.default(index, sub, 0) if description.has(index, sub) else None for sub in (1, 2))
    if binding.node != "motor" or not (isinstance(low, int) and isinstance(high, int)):
        return ""
    if not 0 < high - low < (1 << binding.entry.bits) - 1:
        return ""
    follows = f"the host follows a wrap of {binding.entry.bits} bits alone, and trips with ENCODER_JUMP there"
    return f"{who}: {index:04X}h lets the position wrap from {high} to {low}: {follows}"


def scale_differences(
    scale: BelievedScale | None, has: Callable[[int, int], bool], upload: Callable[[int, int], bytes]
) -> Iterator[str]:
    """Yield how the live drive's scale differs from the rig file's, after bring-up's own writes.

    Parameters
    ----------
    has : whether the drive's file describes an object
    upload : the object as the live drive has it; `SdoAborted` where it has none

    Raises
    ------
    NodeMissing, AnswerUntrusted
        the drive does not answer, or something else than it is asked
    """
    if scale is None or scale.accepted:
        return
    values: dict[tuple[int, int], int] = {}
    for index, subindex in scale.objects(has):
        with suppress(SdoAborted):  # the drive has fewer objects than its file
            values[index, subindex] = int.from_bytes(upload(index, subindex), "little")
    difference = scale.difference(lambda index, subindex: values.get((of_axis(index, scale.drive_axis), subindex)))
    if difference:
        accept = f'host.accept = ["{scale.name}: {OWN_SCALE}"] if its objects are wrong'
        yield f"{difference}; correct the key or the drive, or {accept}"
