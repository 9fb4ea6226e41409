"""The C library, for the few calls that Python lacks."""

from __future__ import annotations

import ctypes
from typing import Any

from coulombus.system.errors import CoulombusError

__all__ = ["NeedsLinux", "c_library"]


class NeedsLinux(CoulombusError, ImportError):
    """A feature that only Linux has was requested on another system."""

    exit_status = 4

    def __init__(self, absent: str) -> None:
        super().__init__(
            f"this needs Linux (there is no {absent} here); what needs no live bus works everywhere, "
            "and so does an adapter of python-can, --bus can:INTERFACE:CHANNEL"
        )


def c_library() -> Any:
    """Return the C library, whose calls leave `ctypes.get_errno`; None where it has no name, as on Windows.

    A function that a system lacks is no attribute of it: ``hasattr(c_library(), "prctl")`` is true on Linux alone.
    """
    try:
        return ctypes.CDLL(None, use_errno=True)
    except TypeError:
        return None
