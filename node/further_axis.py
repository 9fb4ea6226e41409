"""Device kind of a drive with several axes: one axis is simulated.

The objects of that axis replace those of the first axis. The objects of its other axes are values
only.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

from coulombus.eds.drive_axis import axis_of, first_axis_object, of_axis
from coulombus.node.profile import Key, Objects, Profile
from coulombus.node.record import NodeRecord

__all__ = ["on_axis"]


class _AxisObjects(NamedTuple):
    """Objects of an axis, by the indices of the first axis."""

    objects: Objects
    axis: int

    def number(self, index: int, subindex: int = 0, fallback: int = 0) -> int:
        return self.objects.number(of_axis(index, self.axis), subindex, fallback)

    def own(self, index: int, subindex: int, fallback: int) -> int:
        return self.objects.own(index, subindex, fallback)

    def real(self, index: int, subindex: int, fallback: float) -> float:
        return self.objects.real(of_axis(index, self.axis), subindex, fallback)

    def high(self, index: int, subindex: int, fallback: int) -> int:
        return self.objects.high(of_axis(index, self.axis), subindex, fallback)

    def __contains__(self, key: object) -> bool:
        assert isinstance(key, tuple)
        return (of_axis(key[0], self.axis), key[1]) in self.objects

    def __setitem__(self, key: Key, value: float) -> None:
        self.objects[of_axis(key[0], self.axis), key[1]] = value


def on_axis(profile: Profile, axis: int) -> Profile:
    """Return a kind of drive with the objects of an axis (1 to 8)."""
    if axis == 1:
        return profile

    def started(record: NodeRecord, objects: Objects, t_ns: int) -> None:
        profile.started(record, _AxisObjects(objects, axis), t_ns)

    def changed(record: NodeRecord, objects: Objects, index: int, subindex: int) -> None:
        if axis_of(index) in (0, axis):
            profile.changed(record, _AxisObjects(objects, axis), first_axis_object(index), subindex)

    def check(objects: Objects, index: int, subindex: int, value: int) -> None:
        if axis_of(index) in (0, axis):
            profile.check(_AxisObjects(objects, axis), first_axis_object(index), subindex, value)

    return replace(
        profile,
        objects=tuple(replace(row, index=of_axis(row.index, axis)) for row in profile.objects),
        terminals=tuple(replace(row, index=of_axis(row.index, axis)) for row in profile.terminals),
        started=started,
        changed=changed,
        check=check,
    )
