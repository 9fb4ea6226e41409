"""Comparison of the drive's own position scale with the rig file's, before anything moves.

A wrong number of counts in the rig file makes all of the host's limits in radians wrong by the same
factor: the sign check's travel, the speed limit, the release. So bring-up reads the objects that set the
drive's scale (`eds.drive_scale`), after its own writes, and refuses a difference. This project's drive has
no user units.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import suppress
from typing import NamedTuple

from coulombus.eds.drive_axis import first_axis_object, of_axis
from coulombus.eds.drive_scale import SCALE_OBJECTS, PositionScale, defaults, position_scale, resolution
from coulombus.eds.own_devices import identity_from_1018h, is_own
from coulombus.host.errors import SdoAborted
from coulombus.rigs.axis import Axis
from coulombus.rigs.devices import drive_axis_of

__all__ = ["OWN_SCALE", "BelievedScale", "believed_scale", "early_wrap", "remark_of", "scale_differences"]

OWN_SCALE = "position scale is the rig file's"
"""Text in host.accept, after the drive's name, that acknowledges a wrong scale in the drive's objects."""
MARKS = "coulombus commission --step encoder measures it between two marks"
RANGE_LIMIT = 0x607B
POSITION, INCREMENTS = (0x6064, 0), (0x6063, 0)


class BelievedScale(NamedTuple):
    """Counts of the position in one turn of the motor, according to the rig file.

    Attributes
    ----------
    who, name : the drive, as text and by its name in host.accept
    place : the position's object
    counts_rev : counts in one turn of the motor
    key : the rig file's key that sets the scale
    accepted : whether host.accept gives the rig file's scale precedence over the drive's
    drive_axis : number of the axis in the drive
    """

    who: str
    name: str
    place: tuple[int, int]
    counts_rev: float
    key: str
    accepted: bool
    drive_axis: int

    def drive_scale(self, value: Callable[[int, int], int | None]) -> PositionScale:
        """Return the scale from the values of the drive's objects; `value` takes the first axis' objects."""
        if first_axis_object(self.place[0]) == POSITION[0]:
            return position_scale(value, self.drive_axis)
        increments = resolution(value)
        return PositionScale(
            None if increments is None else float(increments), f"{of_axis(0x608F, self.drive_axis):04X}h"
        )

    def difference(self, value: Callable[[int, int], int | None]) -> str:
        """Return the text of the drive's different scale; "" if it agrees, or the drive has no scale."""
        drive_scale = self.drive_scale(value)
        if drive_scale.counts_rev is None or drive_scale.agrees(self.counts_rev):
            return ""
        name = f"{self.place[0]:04X}h"
        return (
            f"{self.who}: {name} counts {drive_scale.counts_rev:.9g} in one turn of the motor ({drive_scale.by}), "
            f"the rig file says {self.counts_rev:.9g} ({self.key})"
        )

    def objects(self, has: Callable[[int, int], bool]) -> tuple[tuple[int, int], ...]:
        """Return the objects of the scale that the drive has."""
        places = ((of_axis(index, self.drive_axis), subindex) for index, subindex in SCALE_OBJECTS)
        return tuple(place for place in places if has(*place))


def believed_scale(axis: Axis, who: str, name: str) -> BelievedScale | None:
    """Return the drive's position scale according to the rig file.

    None: the drive is this project's, or the position is another object or comes from another device.

    Parameters
    ----------
    who, name : the drive, as text and by its name in host.accept
    """
    binding = axis.allocation.bound.get("position")
    if binding is None or binding.node != "motor" or is_own("motor", identity_from_1018h(axis.description("motor"))):
        return None
    place = binding.entry.index, binding.entry.subindex
    number = drive_axis_of(axis.motor)
    if place not in [(of_axis(index, number), subindex) for index, subindex in (POSITION, INCREMENTS)]:
        return None
    counts_rev = 2 * math.pi / (abs(binding.scale) * axis.mechanics.ratio)
    key = binding.decided if binding.decided.startswith("role.") else "motor.encoder_counts_rev"
    return BelievedScale(who, name, place, counts_rev, key, f"{name}: {OWN_SCALE}" in axis.host.accept, number)


def remark_of(axis: Axis, scale: BelievedScale) -> tuple[str, str]:
    """Return the question and the loss that follow from the EDS file alone; "" for none.

    A question is answered by the drive in bring-up. A loss is a scale that no object can confirm.
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
    if scale.drive_scale(defaults(description, scale.drive_axis)).counts_rev is None:
        text = "does not tell the scale of the position; bring-up asks the drive"
        return f"{scale.who}: {description.path} {text}, and holds {scale.key} against it", ""
    return "", ""


def early_wrap(axis: Axis, who: str) -> str:
    """Return the loss of a position that wraps earlier than its data type (607Bh); "" if the EDS file has no
    such range.
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
    """Yield the differences of the live drive's scale from the rig file's, after bring-up's own writes.

    Parameters
    ----------
    has : returns whether the drive's EDS file describes an object
    upload : returns an object of the live drive; `SdoAborted` if the drive lacks it

    Raises
    ------
    NodeMissing, AnswerUntrusted
        the drive does not answer, or its answer cannot be used
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
