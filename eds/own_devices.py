"""Identity of this project's own devices: 1018h of `motor.eds`, `servo.eds` and `mr_brake.eds`.

The definitions of 2000h to 5FFFh in these files hold for these devices only; each vendor defines
its own objects there.
"""

from __future__ import annotations

from collections.abc import Mapping
from importlib import resources

from coulombus.eds.description import Description
from coulombus.eds.reader import read_eds

__all__ = ["MANUFACTURER", "PRODUCTS", "SERVO", "VENDOR_ID", "identity_from_1018h", "is_another", "is_own", "packaged"]

FILES = ("motor.eds", "mr_brake.eds")

VENDOR_ID = 0x4C0
"""1018h:01."""
PRODUCTS: Mapping[str, int] = {"motor": 0x402, "brake": 0x404}
"""1018h:02 by the device's role in a rig."""
SERVO = 0x403
"""1018h:02 of `servo.eds`, a drive with every mode, for an axis without a rig."""
MANUFACTURER = range(0x2000, 0x6000)
"""Manufacturer-specific objects (CiA 301, table 2)."""


def identity_from_1018h(description: Description) -> tuple[int, int]:
    """Return (1018h:01, 1018h:02) of the EDS file; 0 for a missing value."""
    numbers = (description.default(0x1018, part, 0) if description.has(0x1018, part) else None for part in (1, 2))
    vendor, product = (value if isinstance(value, int) else 0 for value in numbers)
    return vendor, product


def is_another(description: Description, identity: tuple[int, int]) -> bool:
    """Tell whether a device with (1018h:01, 1018h:02) is another one than that of the EDS file; 0 says nothing."""
    return any(
        seen not in (0, told) for seen, told in zip(identity, identity_from_1018h(description), strict=True) if told
    )


def is_own(role: str, identity: tuple[int, int]) -> bool:
    """Tell whether (1018h:01, 1018h:02) is the identity of our own device for `role`, "motor" or "brake"."""
    return identity == (VENDOR_ID, PRODUCTS.get(role))


def packaged() -> tuple[Description, ...]:
    """Return the installed EDS files of our own devices."""
    folder = resources.files("coulombus.eds")
    return tuple(read_eds(str(folder / name)) for name in FILES)
