"""Where the objects that the core uses stand in a node's `values`: fixed slots by kind of device.

Slots from `FIRST_FREE` on are given to the other numeric objects of the EDS in their order. A kind's table names only
what its compiled core reads or writes; an EDS that lacks one of them leaves the slot at 0, or at `FALLBACK`.
"""

from __future__ import annotations

from collections.abc import Mapping

from node.records import KIND_BRAKE, KIND_DRIVE, KIND_GENERIC

__all__ = ["CORE_SLOTS", "FALLBACK", "FIRST_FREE"]

# every kind
ERROR_REGISTER = 0
SETPOINT_AGE_US = 1  # 2001h: drive: age at which a set-point gives torque 0; brake: how long a set-point is held
SYNC_TIMEOUT_US = 2  # 2002h
RAMP_US = 3  # 2005h

# CiA 402
CONTROLWORD = 8
STATUSWORD = 9
MODE = 10
MODE_DISPLAY = 11
TARGET_TORQUE = 12
MAX_TORQUE = 13
TORQUE_DEMAND = 14
TORQUE_ACTUAL = 15
POSITION = 16
VELOCITY = 17
TORQUE_SLOPE = 18
TORQUE_OFFSET = 19
ERROR_CODE = 20
ABORT_OPTION = 21
QUICK_STOP_OPTION = 22
SUPPORTED_MODES = 23
POSITIVE_LIMIT = 24
NEGATIVE_LIMIT = 25
CURRENT_ACTUAL = 26
DC_LINK_MV = 27

# CiA 404
SETPOINT = 8
FAULT_MODE = 9
FAULT_VALUE = 10
INPUT = 11  # three of them

FIRST_FREE = 32

_COMMON: Mapping[tuple[int, int], int] = {
    (0x1001, 0): ERROR_REGISTER,
    (0x2001, 0): SETPOINT_AGE_US,
    (0x2002, 0): SYNC_TIMEOUT_US,
    (0x2005, 0): RAMP_US,
}

CORE_SLOTS: Mapping[int, Mapping[tuple[int, int], int]] = {
    KIND_GENERIC: {(0x1001, 0): ERROR_REGISTER},
    KIND_DRIVE: {
        **_COMMON,
        (0x603F, 0): ERROR_CODE,
        (0x6007, 0): ABORT_OPTION,
        (0x6040, 0): CONTROLWORD,
        (0x6041, 0): STATUSWORD,
        (0x605A, 0): QUICK_STOP_OPTION,
        (0x6060, 0): MODE,
        (0x6061, 0): MODE_DISPLAY,
        (0x6064, 0): POSITION,
        (0x606C, 0): VELOCITY,
        (0x6071, 0): TARGET_TORQUE,
        (0x6072, 0): MAX_TORQUE,
        (0x6074, 0): TORQUE_DEMAND,
        (0x6077, 0): TORQUE_ACTUAL,
        (0x6078, 0): CURRENT_ACTUAL,
        (0x6079, 0): DC_LINK_MV,
        (0x6087, 0): TORQUE_SLOPE,
        (0x60B2, 0): TORQUE_OFFSET,
        (0x60E0, 0): POSITIVE_LIMIT,
        (0x60E1, 0): NEGATIVE_LIMIT,
        (0x6502, 0): SUPPORTED_MODES,
    },
    KIND_BRAKE: {
        **_COMMON,
        (0x7130, 1): INPUT,
        (0x7130, 2): INPUT + 1,
        (0x7130, 3): INPUT + 2,
        (0x7300, 1): SETPOINT,
        (0x6340, 1): FAULT_MODE,
        (0x7341, 1): FAULT_VALUE,
    },
}
"""(index, subindex) -> slot of what the core of a kind uses."""

FALLBACK: Mapping[int, Mapping[int, int]] = {
    KIND_GENERIC: {},
    KIND_DRIVE: {
        MODE: 10,
        MAX_TORQUE: 1000,
        POSITIVE_LIMIT: 32767,
        NEGATIVE_LIMIT: 32767,
        TORQUE_SLOPE: 1_000_000,
        ABORT_OPTION: 2,
        QUICK_STOP_OPTION: 2,
        SUPPORTED_MODES: 0x208,
    },
    KIND_BRAKE: {FAULT_MODE: 1},
}
"""Value of a core slot by kind where the EDS has no such object."""
