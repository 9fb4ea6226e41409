"""Where the objects that the core uses stand in a node's `values`: fixed slots by kind of device.

Slots from `FIRST_FREE` on are given to the other numeric objects of the EDS in their order. A kind's table names only
what its compiled core reads or writes; an EDS that lacks one of them leaves the slot at 0, or at `FALLBACK`.
"""

from __future__ import annotations

from collections.abc import Mapping

from coulombus.eds.own_devices import MANUFACTURER, VENDOR_ID
from coulombus.node.record import KIND_BRAKE, KIND_DRIVE, KIND_GENERIC

__all__ = ["CORE_SLOTS", "FALLBACK", "FIRST_FREE", "MANUFACTURER", "VENDOR_ID"]

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
SHUTDOWN_OPTION = 28
DISABLE_OPTION = 29
HALT_OPTION = 30
FAULT_OPTION = 31
SLOW_DOWN_MS = 32  # 2006h: no slope is longer
MAX_CURRENT = 33
LOWEST_POSITION = 34
HIGHEST_POSITION = 35
TARGET_VELOCITY = 36
VELOCITY_OFFSET = 37
VELOCITY_DEMAND = 38
MAX_VELOCITY = 39
ACCELERATION = 40
DECELERATION = 41
QUICK_STOP_DECELERATION = 42
VELOCITY_WINDOW = 43
VELOCITY_WINDOW_MS = 44
VELOCITY_THRESHOLD = 45
VELOCITY_THRESHOLD_MS = 46
MAX_SLIPPAGE = 47

# CiA 404
SETPOINT = 8
FAULT_MODE = 9
FAULT_VALUE = 10
INPUT = 11  # three of them
OUTPUT_FV = 14
INPUT_STATUS = 15  # three of them

FIRST_FREE = 64

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
        (0x2006, 0): SLOW_DOWN_MS,
        (0x605A, 0): QUICK_STOP_OPTION,
        (0x605B, 0): SHUTDOWN_OPTION,
        (0x605C, 0): DISABLE_OPTION,
        (0x605D, 0): HALT_OPTION,
        (0x605E, 0): FAULT_OPTION,
        (0x6060, 0): MODE,
        (0x6061, 0): MODE_DISPLAY,
        (0x6064, 0): POSITION,
        (0x606B, 0): VELOCITY_DEMAND,
        (0x606C, 0): VELOCITY,
        (0x606D, 0): VELOCITY_WINDOW,
        (0x606E, 0): VELOCITY_WINDOW_MS,
        (0x606F, 0): VELOCITY_THRESHOLD,
        (0x6070, 0): VELOCITY_THRESHOLD_MS,
        (0x6071, 0): TARGET_TORQUE,
        (0x6072, 0): MAX_TORQUE,
        (0x6073, 0): MAX_CURRENT,
        (0x6074, 0): TORQUE_DEMAND,
        (0x6077, 0): TORQUE_ACTUAL,
        (0x6078, 0): CURRENT_ACTUAL,
        (0x6079, 0): DC_LINK_MV,
        (0x607D, 1): LOWEST_POSITION,
        (0x607D, 2): HIGHEST_POSITION,
        (0x607F, 0): MAX_VELOCITY,
        (0x6083, 0): ACCELERATION,
        (0x6084, 0): DECELERATION,
        (0x6085, 0): QUICK_STOP_DECELERATION,
        (0x6087, 0): TORQUE_SLOPE,
        (0x60B1, 0): VELOCITY_OFFSET,
        (0x60B2, 0): TORQUE_OFFSET,
        (0x60E0, 0): POSITIVE_LIMIT,
        (0x60E1, 0): NEGATIVE_LIMIT,
        (0x60F8, 0): MAX_SLIPPAGE,
        (0x60FF, 0): TARGET_VELOCITY,
        (0x6502, 0): SUPPORTED_MODES,
    },
    KIND_BRAKE: {
        **_COMMON,
        (0x6150, 1): INPUT_STATUS,
        (0x6150, 2): INPUT_STATUS + 1,
        (0x6150, 3): INPUT_STATUS + 2,
        (0x7130, 1): INPUT,
        (0x7130, 2): INPUT + 1,
        (0x7130, 3): INPUT + 2,
        (0x7300, 1): SETPOINT,
        (0x6340, 1): FAULT_MODE,
        (0x7330, 1): OUTPUT_FV,
        (0x7341, 1): FAULT_VALUE,
    },
}
"""(index, subindex) -> slot of what the core of a kind uses."""

FALLBACK: Mapping[int, Mapping[int, int]] = {
    KIND_GENERIC: {},
    KIND_DRIVE: {
        MODE: 10,
        MAX_TORQUE: 1000,
        MAX_CURRENT: 32767,
        POSITIVE_LIMIT: 32767,
        NEGATIVE_LIMIT: 32767,
        TORQUE_SLOPE: 1_000_000,
        ABORT_OPTION: 2,
        QUICK_STOP_OPTION: 2,
        HALT_OPTION: 1,
        SLOW_DOWN_MS: 1000,
        LOWEST_POSITION: -0x80000000,
        HIGHEST_POSITION: 0x7FFFFFFF,
        MAX_VELOCITY: 0x7FFFFFFF,
        ACCELERATION: 1_000_000,
        DECELERATION: 1_000_000,
        QUICK_STOP_DECELERATION: 4_000_000,
        MAX_SLIPPAGE: 0x7FFFFFFF,
        SUPPORTED_MODES: 0x30C,
    },
    KIND_BRAKE: {FAULT_MODE: 1},
}
"""Value of a core slot by kind where the EDS has no such object."""
