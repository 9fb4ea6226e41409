"""Kinds of devices: a new kind is a file with its `Profile`, and a line here."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

from coulombus.eds.description import Description
from coulombus.eds.drive_axis import axis_of, first_axis_object, of_axis
from coulombus.eds.own_devices import SERVO, VENDOR_ID, identity_from_1018h
from coulombus.node.brake404 import BRAKE404
from coulombus.node.drive402 import DRIVE402
from coulombus.node.io401 import IO401, IO404
from coulombus.node.profile import Behaviour, Key, Objects, Profile
from coulombus.node.record import NodeRecord
from coulombus.node.slots import REGISTER

__all__ = [
    "BEHAVIOURS",
    "GENERIC",
    "NO_KIND",
    "PROFILES",
    "named",
    "number",
    "of_description",
    "of_identity",
    "on_axis",
]

GENERIC = Profile("generic", objects=(REGISTER,))
"""Any file: objects, PDOs and services. Nothing acts behind the objects; each keeps the value last
written.
"""

PROFILES: tuple[Profile, ...] = (
    GENERIC,
    DRIVE402,
    BRAKE404,
    IO401,
    IO404,
)
"""Every kind, by the number in the record's `kind`."""

NO_KIND = 0
"""Number of `GENERIC`."""

BEHAVIOURS: tuple[Behaviour, ...] = tuple(profile.behaviour._replace(number=k) for k, profile in enumerate(PROFILES))
"""Kernels of every kind: `node.reactions` iterates over them with `numba.literal_unroll`, which creates a
branch for each.
"""

_OWN: Mapping[tuple[int, int], Profile] = {
    **{(VENDOR_ID, profile.product): profile for profile in PROFILES if profile.product is not None},
    (VENDOR_ID, SERVO): DRIVE402,
}


def number(profile: Profile) -> int:
    """Return the number of a profile in `PROFILES`.

    A profile fitted to a file has the number of its kind.

    Raises
    ------
    ValueError
        The profile is in no kernel.
    """
    for k, candidate in enumerate(PROFILES):
        if candidate.name == profile.name and candidate.behaviour is profile.behaviour:
            return k
    names = ", ".join(candidate.name for candidate in PROFILES)
    raise ValueError(f"got kind {profile.name}, expected one of node.kinds.PROFILES: {names}")


def named(name: str) -> Profile:
    """Return the profile with this name; ValueError if there is none."""
    for profile in PROFILES:
        if profile.name == name:
            return profile
    raise ValueError(f"got kind {name!r}, expected {', '.join(profile.name for profile in PROFILES)}")


def of_identity(identity: tuple[int, int]) -> Profile:
    """Return the profile of our own device with (1018h:01, 1018h:02); `GENERIC` for other devices."""
    return _OWN.get(identity, GENERIC)


_BY_PROFILE: Mapping[int, Profile] = {401: IO401, 402: DRIVE402, 404: IO404}
"""Profiles of other vendors' devices, by the lower half of 1000h (CiA 301, 7.5.2.1)."""

_SIGNS: tuple[tuple[Profile, tuple[int, ...]], ...] = (
    (DRIVE402, (0x6040, 0x6041)),
    (IO404, (0x7300,)),
    (IO404, (0x7130,)),
    (IO404, (0x9130,)),
    (IO404, (0x9300,)),
    (IO401, (0x6411,)),
    (IO401, (0x6401,)),
    (IO401, (0x6200,)),
    (IO401, (0x6000,)),
)
"""Objects that identify a kind if 1000h does not."""


def of_description(description: Description) -> Profile:
    """Return the profile for a file's objects.

    Our own devices have theirs. Otherwise it is the profile of 1000h if the file has its objects, else
    the kind whose objects the file has, else `GENERIC`.
    """
    ours = of_identity(identity_from_1018h(description))
    if ours is not GENERIC:
        return ours
    device_type = description.variable(0x1000, 0).default if description.has(0x1000, 0) else None
    by_profile = _BY_PROFILE.get(device_type & 0xFFFF) if isinstance(device_type, int) else None
    fitting = [kind for kind, indices in _SIGNS if all(_has(description, index, kind) for index in indices)]
    if by_profile in fitting:
        return by_profile or GENERIC
    return fitting[0] if fitting else GENERIC


def _has(description: Description, index: int, kind: Profile) -> bool:
    """Tell whether an object exists and is that of the kind: CiA 406 has other objects at 6000h and 6401h."""
    if kind is not IO401:
        return description.has(index)
    widths = (
        {variable.bits for subindex, variable in description.objects[index].variables.items() if subindex}
        if description.has(index)
        else set()
    )
    return widths == {8 if index < 0x6400 else 16}


class _AxisObjects(NamedTuple):
    """Objects of an axis, by the indices of the first axis."""

    objects: Objects
    axis: int

    def number(self, index: int, subindex: int = 0, fallback: int = 0) -> int:
        return self.objects.number(of_axis(index, self.axis), subindex, fallback)

    def own_number(self, index: int, subindex: int, fallback: int) -> int:
        return self.objects.own_number(index, subindex, fallback)

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
