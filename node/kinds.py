"""The kinds of devices. A new one is a file with its `Profile`, and a line here."""

from __future__ import annotations

from collections.abc import Mapping

from coulombus.eds.description import Description
from coulombus.eds.own_devices import VENDOR_ID, told_identity
from coulombus.node.brake404 import BRAKE404
from coulombus.node.drive402 import DRIVE402
from coulombus.node.io401 import IO401, IO404
from coulombus.node.profile import Behaviour, Profile
from coulombus.node.slots import REGISTER

__all__ = ["BEHAVIOURS", "GENERIC", "NO_KIND", "PROFILES", "named", "number", "of_description", "of_identity"]

GENERIC = Profile("generic", objects=(REGISTER,))
"""Any file: objects, PDOs and services. Nothing acts behind the
objects, a value stays what was written to it last.
"""

PROFILES: tuple[Profile, ...] = (
    GENERIC,
    DRIVE402,
    BRAKE404,
    IO401,
    IO404,
)
"""Every kind, by the number that the record's `kind` has."""

NO_KIND = 0
"""The number of `GENERIC`."""

BEHAVIOURS: tuple[Behaviour, ...] = tuple(profile.behaviour._replace(number=k) for k, profile in enumerate(PROFILES))
"""The kernels of every kind: `node.reactions` goes through it with
`numba.literal_unroll`, which gives one branch for each.
"""

_OWN: Mapping[tuple[int, int], Profile] = {
    (VENDOR_ID, profile.product): profile for profile in PROFILES if profile.product is not None
}


def number(profile: Profile) -> int:
    """Return the number of a profile in `PROFILES`.

    One that was fitted to a file has that of its kind.

    Raises
    ------
    ValueError
        It is none of them, so no kernel knows it.
    """
    for k, candidate in enumerate(PROFILES):
        if candidate.name == profile.name and candidate.behaviour is profile.behaviour:
            return k
    names = ", ".join(candidate.name for candidate in PROFILES)
    raise ValueError(f"got kind {profile.name}, expected one of node.kinds.PROFILES: {names}")


def named(name: str) -> Profile:
    """Return the profile of that name; ValueError where there is none."""
    for profile in PROFILES:
        if profile.name == name:
            return profile
    raise ValueError(f"got kind {name!r}, expected {', '.join(profile.name for profile in PROFILES)}")


def of_identity(identity: tuple[int, int]) -> Profile:
    """Return what lives behind our own devices' objects by (1018h:01,
    1018h:02); behind others' `GENERIC`.
    """
    return _OWN.get(identity, GENERIC)


_BY_PROFILE: Mapping[int, Profile] = {401: IO401, 402: DRIVE402, 404: IO404}
"""What lives behind another maker's device, by the lower half of 1000h (CiA 301, 7.5.2.1)."""

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
"""Objects by which a kind is known where 1000h does not tell it."""


def of_description(description: Description) -> Profile:
    """Return what lives behind a file's objects, as far as they allow.

    Our own devices' is what they are. Else it is the profile of 1000h when the file has its
    objects, else the kind whose objects the file has, and `GENERIC` where there are none of them.
    """
    own = of_identity(told_identity(description))
    if own is not GENERIC:
        return own
    device_type = description.variable(0x1000, 0).default if description.has(0x1000, 0) else None
    by_profile = _BY_PROFILE.get(device_type & 0xFFFF) if isinstance(device_type, int) else None
    fitting = [kind for kind, indices in _SIGNS if all(_has(description, index, kind) for index in indices)]
    if by_profile in fitting:
        return by_profile or GENERIC
    return fitting[0] if fitting else GENERIC


def _has(description: Description, index: int, kind: Profile) -> bool:
    """Tell whether an object is there, and is that of the kind: CiA 406 has others at 6000h and
    6401h.
    """
    if kind is not IO401:
        return description.has(index)
    widths = (
        {variable.bits for subindex, variable in description.objects[index].variables.items() if subindex}
        if description.has(index)
        else set()
    )
    return widths == {8 if index < 0x6400 else 16}
