"""Slots of the objects of the CiA 404 brake in a node's record, and its terminals."""

from __future__ import annotations

from coulombus.node.profile import CoreObject, Terminal
from coulombus.node.slots import COMMON

ACTS_SETPOINT = 2
"""Object on which the brake acts: 7300h:01."""

SETPOINT = 8
FAULT_MODE = 9
FAULT_VALUE = 10
INPUT = 11  # three slots
OUTPUT_FV = 14
INPUT_STATUS = 15  # three slots

OBJECTS: tuple[CoreObject, ...] = (
    *COMMON,
    CoreObject(0x6150, 1, INPUT_STATUS),
    CoreObject(0x6150, 2, INPUT_STATUS + 1),
    CoreObject(0x6150, 3, INPUT_STATUS + 2),
    CoreObject(0x7130, 1, INPUT, changing=True),
    CoreObject(0x7130, 2, INPUT + 1, changing=True),
    CoreObject(0x7130, 3, INPUT + 2, changing=True),
    CoreObject(0x7300, 1, SETPOINT, acts=ACTS_SETPOINT, needed=True),
    CoreObject(0x6340, 1, FAULT_MODE, 1),
    CoreObject(0x7330, 1, OUTPUT_FV),
    CoreObject(0x7341, 1, FAULT_VALUE),
)
"""Objects that the brake uses."""

TERMINALS: tuple[Terminal, ...] = (
    Terminal(0x7300, 1, "out_brake_Nm", high="board_Nm"),
    Terminal(0x7130, 1, "in_handle_Nm"),
    Terminal(0x7130, 2, "in_coil_A"),
    Terminal(0x7130, 3, "in_coil_degC"),
)
"""Torque command of the coil, and measurements of the driver."""
