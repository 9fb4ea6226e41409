"""Slots of the objects that every kind's core may use, in a node's `values`.

A kind's own objects have the slots from `FIRST_OF_KIND` on, as in its table
(`node.profile.CoreObject`). Slots from `FIRST_FREE` on, and after the kind's last, are assigned to
the other numeric objects of the EDS in order.
"""

from __future__ import annotations

from coulombus.node.profile import CoreObject

__all__ = [
    "COMMON",
    "ERROR_CODE",
    "ERROR_REGISTER",
    "FIRST_FREE",
    "FIRST_OF_KIND",
    "RAMP_US",
    "REGISTER",
    "SETPOINT_AGE_US",
    "SYNC_TIMEOUT_US",
]

ERROR_REGISTER = 0
SETPOINT_AGE_US = 1  # 2001h: drive: age at which a set-point gives torque 0; brake: hold time of a set-point
SYNC_TIMEOUT_US = 2  # 2002h
RAMP_US = 3  # 2005h
ERROR_CODE = 4  # code of the last EMCY, 0 if all are reset: 603Fh of a drive
FIRST_OF_KIND = 8
FIRST_FREE = 64

REGISTER = CoreObject(0x1001, 0, ERROR_REGISTER)
"""The error register, which every device has."""

COMMON: tuple[CoreObject, ...] = (
    REGISTER,
    CoreObject(0x2001, 0, SETPOINT_AGE_US),
    CoreObject(0x2002, 0, SYNC_TIMEOUT_US),
    CoreObject(0x2005, 0, RAMP_US),
)
"""Objects of every kind that has an output."""
