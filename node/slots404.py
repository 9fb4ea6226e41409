"""Where the objects of the CiA 404 brake stand in a node's record, and what else it keeps there."""

from __future__ import annotations

import numpy as np

from coulombus.node.profile import CoreObject, Fields, Terminal
from coulombus.node.slots import COMMON

ACTS_SETPOINT = 2
"""What the brake acts on: 7300h:01."""

SETPOINT = 8
FAULT_MODE = 9
FAULT_VALUE = 10
INPUT = 11  # three of them
OUTPUT_FV = 14
INPUT_STATUS = 15  # three of them

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
"""The objects that the brake uses."""

FIELDS: Fields = [
    # simulated inputs
    ("in_handle_Nm", np.float64),
    ("in_coil_A", np.float64),
    ("in_coil_degC", np.float64),
    # simulated outputs
    ("out_brake_Nm", np.float64),  # >= 0 always
    ("out_reverse_A", np.float64),  # current of the demagnetisation pulse, only while out_brake_Nm is 0
    # output block and input blocks
    ("setpoint_high", np.int64),  # high limit of 7300h:01 in the EDS, raw
    ("ao_gain_Nm", np.float64),  # torque = 7300h:01 * gain + bias (6302h, 7320h to 7323h)
    ("ao_bias_Nm", np.float64),
    ("ao_full_Nm", np.float64),  # full scale, no output is above it
    ("ao_FV_Nm", np.float64),  # 7330h:01 for one Nm
    ("ai_gain", np.float64, (3,)),  # 6126h * 10 ** 6132h
    ("ai_bias", np.float64, (3,)),  # (6127h + 6124h) * 10 ** 6132h
    ("ai_low", np.float64, (3,)),  # 7148h and 7149h; the other way round for a channel that is off
    ("ai_high", np.float64, (3,)),
    # coil
    ("coil_A_Nm", np.float64),  # what the coil draws for one Nm, told by the rig; 0: no coil is known
    ("max_A", np.float64),  # 2010h
    ("short_A", np.float64),
    ("least_A", np.float64),
    ("open_ns", np.int64),
    ("open_since_ns", np.int64),  # command without current since then; -1: no
    ("warm_degC", np.float64),  # 2011h
    ("hot_degC", np.float64),
    ("cooled_degC", np.float64),  # below it the over-temperature is over
    ("share_left", np.float64),  # of max_A, at hot_degC
    ("derated", np.int64),
    ("limit_Nm", np.float64),  # what max_A and the board allow now
    ("board_Nm", np.float64),  # most that the hardware may put out (an I/O file); 0: it sets no limit
    ("demag_A", np.float64),  # 2012h
    ("demag_ns", np.int64),
    ("demag_delay_ns", np.int64),
    ("pulse_due", np.int64),  # 1: the output was above 0 since the last pulse
    ("pulse_ns", np.int64),  # when the pulse begins
    # ramp to the fault value
    ("ramp_to_Nm", np.float64),
    ("ramp_from_Nm", np.float64),
    ("ramp_start_ns", np.int64),
]
"""What the brake keeps in its record."""

TERMINALS: tuple[Terminal, ...] = (
    Terminal(0x7300, 1, "out_brake_Nm", high="board_Nm"),
    Terminal(0x7130, 1, "in_handle_Nm"),
    Terminal(0x7130, 2, "in_coil_A"),
    Terminal(0x7130, 3, "in_coil_degC"),
)
"""The torque that the coil is to give, and what the driver measures."""
