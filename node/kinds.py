"""The kinds of devices. A new one is a file with its `Profile`, and a line here."""

from __future__ import annotations

from collections.abc import Mapping

from coulombus.eds.own_devices import VENDOR_ID
from coulombus.node.brake404 import BRAKE404
from coulombus.node.drive402 import DRIVE402
from coulombus.node.io401 import IO401
from coulombus.node.profile import Behaviour, Profile
from coulombus.node.slots import REGISTER

__all__ = ["BEHAVIOURS", "GENERIC", "NO_KIND", "PROFILES", "named", "number", "of_identity"]

GENERIC = Profile("generic", objects=(REGISTER,))
"""Any file: objects, PDOs and services. Nothing acts behind the
objects, a value stays what was written to it last.
"""

PROFILES: tuple[Profile, ...] = (
    GENERIC,
    DRIVE402,
    BRAKE404,
    IO401,
)
"""Every kind, by the number that the record's `kind` has."""

NO_KIND = 0
"""The number of `GENERIC`."""

BEHAVIOURS: tuple[Behaviour, ...] = tuple(one.behaviour._replace(number=k) for k, one in enumerate(PROFILES))
"""The kernels of every kind: `node.reactions` goes through it with
`numba.literal_unroll`, which gives one branch for each.
"""

_OWN: Mapping[tuple[int, int], Profile] = {
    (VENDOR_ID, profile.product): profile for profile in PROFILES if profile.product is not None
}


def number(profile: Profile) -> int:
    """Return the number of a profile in `PROFILES`.

    Raises
    ------
    ValueError
        It is none of them, so no kernel knows it.
    """
    for k, one in enumerate(PROFILES):
        if one is profile:
            return k
    names = ", ".join(one.name for one in PROFILES)
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
