"""Slots of the objects of a CiA 402 drive in a node's record, and its terminals."""

from __future__ import annotations

from collections.abc import Mapping

from coulombus.eds import cia402
from coulombus.node.profile import CoreObject, Terminal
from coulombus.node.slots import COMMON, ERROR_CODE

ACTS_CONTROLWORD, ACTS_TORQUE, ACTS_SPEED, ACTS_POSITION, ACTS_PROBE = 1, 2, 4, 8, 16
"""Objects on which the drive acts: 6040h, 6071h, 60FFh, 607Ah and 60C1h, 60B8h."""

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
SLOW_DOWN_MS = 32  # 2006h: longest slope
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
VENDOR_TARGET = 48  # set-point of a vendor-specific mode
POSITION_DEMAND = 49
INTERNAL_POSITION = 50
FOLLOWING_WINDOW = 51
FOLLOWING_MS = 52
POSITION_WINDOW = 53
POSITION_WINDOW_MS = 54
TARGET_POSITION = 55
RANGE_LOW = 56
RANGE_HIGH = 57
HOME_OFFSET = 58
PROFILE_VELOCITY = 59
HOMING_METHOD = 60
HOMING_SPEED = 61
HOMING_ZERO_SPEED = 62
HOMING_ACCELERATION = 63
POSITION_OFFSET = 64
INTERPOLATED_POSITION = 65
MAX_ACCELERATION = 66
MAX_DECELERATION = 67
POSITION_OPTION = 68
FOLLOWING_ERROR = 69
DIGITAL_INPUTS = 70
PROBE_FUNCTION = 71
PROBE_STATUS = 72
PROBE_RISING = 73  # of probe 1; of probe 2: + 2
PROBE_FALLING = 74
MAX_MOTOR_SPEED = 77  # rpm

NO_WINDOW = 0xFFFFFFFF
"""6065h or 6067h that is off."""
NO_SPEED_LIMIT = 0xFFFFFFFF
"""6080h that limits nothing."""

OBJECTS: tuple[CoreObject, ...] = (
    *COMMON,
    CoreObject(0x2006, 0, SLOW_DOWN_MS, 1000),
    CoreObject(0x6007, 0, ABORT_OPTION, 2),
    CoreObject(0x603F, 0, ERROR_CODE),
    CoreObject(0x6040, 0, CONTROLWORD, acts=ACTS_CONTROLWORD, needed=True),
    CoreObject(0x6041, 0, STATUSWORD, needed=True),
    CoreObject(0x605A, 0, QUICK_STOP_OPTION, 2),
    CoreObject(0x605B, 0, SHUTDOWN_OPTION),
    CoreObject(0x605C, 0, DISABLE_OPTION),
    CoreObject(0x605D, 0, HALT_OPTION, 1),
    CoreObject(0x605E, 0, FAULT_OPTION),
    CoreObject(0x6060, 0, MODE, 10),
    CoreObject(0x6061, 0, MODE_DISPLAY),
    CoreObject(0x6062, 0, POSITION_DEMAND, changing=True),
    CoreObject(0x6063, 0, INTERNAL_POSITION, changing=True),
    CoreObject(0x6064, 0, POSITION, changing=True),
    CoreObject(0x6065, 0, FOLLOWING_WINDOW, NO_WINDOW),
    CoreObject(0x6066, 0, FOLLOWING_MS),
    CoreObject(0x6067, 0, POSITION_WINDOW, NO_WINDOW),
    CoreObject(0x6068, 0, POSITION_WINDOW_MS),
    CoreObject(0x606B, 0, VELOCITY_DEMAND, changing=True),
    CoreObject(0x606C, 0, VELOCITY, changing=True),
    CoreObject(0x606D, 0, VELOCITY_WINDOW),
    CoreObject(0x606E, 0, VELOCITY_WINDOW_MS),
    CoreObject(0x606F, 0, VELOCITY_THRESHOLD),
    CoreObject(0x6070, 0, VELOCITY_THRESHOLD_MS),
    CoreObject(0x6071, 0, TARGET_TORQUE, acts=ACTS_TORQUE),
    CoreObject(0x6072, 0, MAX_TORQUE, 1000),
    CoreObject(0x6073, 0, MAX_CURRENT, 32767),
    CoreObject(0x6074, 0, TORQUE_DEMAND, changing=True),
    CoreObject(0x6077, 0, TORQUE_ACTUAL, changing=True),
    CoreObject(0x6078, 0, CURRENT_ACTUAL, changing=True),
    CoreObject(0x6079, 0, DC_LINK_MV, changing=True),
    CoreObject(0x607A, 0, TARGET_POSITION, acts=ACTS_POSITION),
    CoreObject(0x607B, 1, RANGE_LOW),
    CoreObject(0x607B, 2, RANGE_HIGH),
    CoreObject(0x607C, 0, HOME_OFFSET),
    CoreObject(0x607D, 1, LOWEST_POSITION, -0x80000000),
    CoreObject(0x607D, 2, HIGHEST_POSITION, 0x7FFFFFFF),
    CoreObject(0x607F, 0, MAX_VELOCITY, 0x7FFFFFFF),
    CoreObject(0x6080, 0, MAX_MOTOR_SPEED, NO_SPEED_LIMIT),
    CoreObject(0x6081, 0, PROFILE_VELOCITY, 0x7FFFFFFF),
    CoreObject(0x6083, 0, ACCELERATION, 1_000_000),
    CoreObject(0x6084, 0, DECELERATION, 1_000_000),
    CoreObject(0x6085, 0, QUICK_STOP_DECELERATION, 4_000_000),
    CoreObject(0x6087, 0, TORQUE_SLOPE, 1_000_000),
    CoreObject(0x6098, 0, HOMING_METHOD),
    CoreObject(0x6099, 1, HOMING_SPEED, 10_000),
    CoreObject(0x6099, 2, HOMING_ZERO_SPEED, 1000),
    CoreObject(0x609A, 0, HOMING_ACCELERATION, 1_000_000),
    CoreObject(0x60B0, 0, POSITION_OFFSET),
    CoreObject(0x60B1, 0, VELOCITY_OFFSET),
    CoreObject(0x60B2, 0, TORQUE_OFFSET),
    CoreObject(0x60B8, 0, PROBE_FUNCTION, acts=ACTS_PROBE),
    CoreObject(0x60B9, 0, PROBE_STATUS),
    CoreObject(0x60BA, 0, PROBE_RISING, changing=True),
    CoreObject(0x60BB, 0, PROBE_FALLING, changing=True),
    CoreObject(0x60BC, 0, PROBE_RISING + 2, changing=True),
    CoreObject(0x60BD, 0, PROBE_FALLING + 2, changing=True),
    CoreObject(0x60C1, 1, INTERPOLATED_POSITION, acts=ACTS_POSITION),
    CoreObject(0x60C5, 0, MAX_ACCELERATION),
    CoreObject(0x60C6, 0, MAX_DECELERATION),
    CoreObject(0x60E0, 0, POSITIVE_LIMIT, 32767),
    CoreObject(0x60E1, 0, NEGATIVE_LIMIT, 32767),
    CoreObject(0x60F2, 0, POSITION_OPTION),
    CoreObject(0x60F4, 0, FOLLOWING_ERROR, changing=True),
    CoreObject(0x60F8, 0, MAX_SLIPPAGE, 0x7FFFFFFF),
    CoreObject(0x60FD, 0, DIGITAL_INPUTS),
    CoreObject(0x60FF, 0, TARGET_VELOCITY, acts=ACTS_SPEED),
    CoreObject(0x6502, 0, SUPPORTED_MODES, 0x30C),
)
"""Objects that the drive uses."""

SETPOINTS: Mapping[int, CoreObject] = {
    mode: next(row for row in OBJECTS if row.key == key)
    for mode, key in (
        (cia402.OPERATION_MODE_PROFILE_POSITION, (0x607A, 0)),
        (cia402.OPERATION_MODE_PROFILE_VELOCITY, (0x60FF, 0)),
        (cia402.OPERATION_MODE_PROFILE_TORQUE, (0x6071, 0)),
        (cia402.OPERATION_MODE_HOMING, (0x6098, 0)),
        (cia402.OPERATION_MODE_INTERPOLATED_POSITION, (0x60C1, 1)),
        (cia402.OPERATION_MODE_CSP, (0x607A, 0)),
        (cia402.OPERATION_MODE_CSV, (0x60FF, 0)),
        (cia402.OPERATION_MODE_CST, (0x6071, 0)),
    )
}
"""Set-point of each mode; the homing method of mode 6."""

TERMINALS: tuple[Terminal, ...] = (
    Terminal(0x6064, 0, "in_position_counts"),
    Terminal(0x606C, 0, "in_velocity_counts_s"),
    Terminal(0x6077, 0, "in_torque_pm"),
    Terminal(0x6071, 0, "out_torque_pm"),
)
"""Measurements of the drive, and the torque command of its power stage."""
