"""Slots of the objects of a CiA 402 drive in a node's record, and its terminals."""

from __future__ import annotations

from coulombus.node.profile import CoreObject, Terminal
from coulombus.node.slots import COMMON, ERROR_CODE

ACTS_CONTROLWORD, ACTS_TORQUE, ACTS_SPEED = 1, 2, 4
"""Objects on which the drive acts: 6040h, 6071h, 60FFh."""

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

OBJECTS: tuple[CoreObject, ...] = (
    *COMMON,
    CoreObject(0x2006, 0, SLOW_DOWN_MS, 1000),
    CoreObject(0x603F, 0, ERROR_CODE),
    CoreObject(0x6007, 0, ABORT_OPTION, 2),
    CoreObject(0x6040, 0, CONTROLWORD, acts=ACTS_CONTROLWORD, needed=True),
    CoreObject(0x6041, 0, STATUSWORD, needed=True),
    CoreObject(0x605A, 0, QUICK_STOP_OPTION, 2),
    CoreObject(0x605B, 0, SHUTDOWN_OPTION),
    CoreObject(0x605C, 0, DISABLE_OPTION),
    CoreObject(0x605D, 0, HALT_OPTION, 1),
    CoreObject(0x605E, 0, FAULT_OPTION),
    CoreObject(0x6060, 0, MODE, 10),
    CoreObject(0x6061, 0, MODE_DISPLAY),
    CoreObject(0x6064, 0, POSITION, changing=True),
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
    CoreObject(0x607D, 1, LOWEST_POSITION, -0x80000000),
    CoreObject(0x607D, 2, HIGHEST_POSITION, 0x7FFFFFFF),
    CoreObject(0x607F, 0, MAX_VELOCITY, 0x7FFFFFFF),
    CoreObject(0x6083, 0, ACCELERATION, 1_000_000),
    CoreObject(0x6084, 0, DECELERATION, 1_000_000),
    CoreObject(0x6085, 0, QUICK_STOP_DECELERATION, 4_000_000),
    CoreObject(0x6087, 0, TORQUE_SLOPE, 1_000_000),
    CoreObject(0x60B1, 0, VELOCITY_OFFSET),
    CoreObject(0x60B2, 0, TORQUE_OFFSET),
    CoreObject(0x60E0, 0, POSITIVE_LIMIT, 32767),
    CoreObject(0x60E1, 0, NEGATIVE_LIMIT, 32767),
    CoreObject(0x60F8, 0, MAX_SLIPPAGE, 0x7FFFFFFF),
    CoreObject(0x60FF, 0, TARGET_VELOCITY, acts=ACTS_SPEED),
    CoreObject(0x6502, 0, SUPPORTED_MODES, 0x30C),
)
"""Objects that the drive uses."""


TERMINALS: tuple[Terminal, ...] = (
    Terminal(0x6064, 0, "in_position_counts"),
    Terminal(0x606C, 0, "in_velocity_counts_s"),
    Terminal(0x6077, 0, "in_torque_pm"),
    Terminal(0x6071, 0, "out_torque_pm"),
)
"""Measurements of the drive, and the torque command of its power stage."""
