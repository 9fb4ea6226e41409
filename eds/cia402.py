"""CiA 402's power drive state machine as one table, shared by the device and the host (IEC 61800-7-201, figure 2).

The table does not know which role it plays. The drive asks "this state, this controlword: which state next?"
(`NEXT_STATE`), the host asks "this statusword: which state?" (`STATE_OF_STATUSWORD`) and "which controlword leads on to
Operation Enabled from here?" (`CONTROLWORD_TO_ENABLE`). All tables are plain int64 arrays, so kernels read them as they
stand.

Transitions that a drive takes by itself: 0 and 1 after power-on, 13 on a fault (to FAULT_REACTION_ACTIVE), 14 when the
fault reaction is complete, 12 when a quick stop is complete.
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np
import numpy.typing as npt

__all__ = [
    "COMMAND_OF_CONTROLWORD",
    "CONTROLWORD",
    "CONTROLWORD_TO_ENABLE",
    "INTERNAL_LIMIT",
    "NEXT_STATE",
    "OPERATION_MODE_CST",
    "OPERATION_MODE_CSV",
    "OPERATION_MODE_PROFILE_TORQUE",
    "OPERATION_MODE_PROFILE_VELOCITY",
    "STATE_OF_STATUSWORD",
    "STATUSWORD",
    "VOLTAGE_ENABLED",
    "Command",
    "PowerState",
]


class PowerState(IntEnum):
    """States of the power drive system."""

    NOT_READY_TO_SWITCH_ON = 0
    SWITCH_ON_DISABLED = 1
    READY_TO_SWITCH_ON = 2
    SWITCHED_ON = 3
    OPERATION_ENABLED = 4
    QUICK_STOP_ACTIVE = 5
    FAULT_REACTION_ACTIVE = 6
    FAULT = 7


class Command(IntEnum):
    """Commands that a controlword spells; FAULT_RESET is the rising edge of bit 7."""

    NONE = 0
    SHUTDOWN = 1
    SWITCH_ON = 2
    ENABLE_OPERATION = 3
    DISABLE_VOLTAGE = 4
    QUICK_STOP = 5
    FAULT_RESET = 6


OPERATION_MODE_PROFILE_VELOCITY = 3
OPERATION_MODE_PROFILE_TORQUE = 4
OPERATION_MODE_CSV = 9
OPERATION_MODE_CST = 10

VOLTAGE_ENABLED = 0x0010
INTERNAL_LIMIT = 0x0800

CONTROLWORD = {
    Command.SHUTDOWN: 0x0006,
    Command.SWITCH_ON: 0x0007,
    Command.ENABLE_OPERATION: 0x000F,
    Command.DISABLE_VOLTAGE: 0x0000,
    Command.QUICK_STOP: 0x0002,
    Command.FAULT_RESET: 0x0080,
}
"""The controlword (6040h) that spells each command."""

STATUSWORD: npt.NDArray[np.int64] = np.array([0x0000, 0x0040, 0x0021, 0x0023, 0x0027, 0x0007, 0x000F, 0x0008], np.int64)
"""Bits 0-3, 5 and 6 of the statusword (6041h) by `PowerState`; bit 5 of the fault states is set too by some drives."""


def _state_of_statusword() -> npt.NDArray[np.int64]:
    """State by the low 7 bits of the statusword; bit 4 (voltage enabled) is no part of it, -1 where none fits."""
    table = np.full(128, -1, np.int64)
    for word in range(128):
        low = word & 0x4F
        if low in (0x00, 0x40, 0x0F, 0x08):
            table[word] = {0x00: 0, 0x40: 1, 0x0F: 6, 0x08: 7}[low]
        elif word & 0x6F in (0x21, 0x23, 0x27, 0x07):
            table[word] = {0x21: 2, 0x23: 3, 0x27: 4, 0x07: 5}[word & 0x6F]
    return table


STATE_OF_STATUSWORD = _state_of_statusword()


def _command_of_controlword() -> npt.NDArray[np.int64]:
    """Command by the low 4 bits of the controlword (CiA 402 table 24); the edge of bit 7 is the caller's."""
    table = np.full(16, Command.NONE, np.int64)
    for word in range(16):
        if not word & 0b0010:
            table[word] = Command.DISABLE_VOLTAGE
        elif not word & 0b0100:
            table[word] = Command.QUICK_STOP
        elif not word & 0b0001:
            table[word] = Command.SHUTDOWN
        elif not word & 0b1000:
            table[word] = Command.SWITCH_ON
        else:
            table[word] = Command.ENABLE_OPERATION
    return table


COMMAND_OF_CONTROLWORD = _command_of_controlword()

_S, _C = PowerState, Command
TRANSITIONS: tuple[tuple[int, PowerState, Command, PowerState], ...] = (
    (2, _S.SWITCH_ON_DISABLED, _C.SHUTDOWN, _S.READY_TO_SWITCH_ON),
    (3, _S.READY_TO_SWITCH_ON, _C.SWITCH_ON, _S.SWITCHED_ON),
    (4, _S.READY_TO_SWITCH_ON, _C.ENABLE_OPERATION, _S.OPERATION_ENABLED),  # 3 and 4 at once (table 24, note)
    (4, _S.SWITCHED_ON, _C.ENABLE_OPERATION, _S.OPERATION_ENABLED),
    (5, _S.OPERATION_ENABLED, _C.SWITCH_ON, _S.SWITCHED_ON),
    (6, _S.SWITCHED_ON, _C.SHUTDOWN, _S.READY_TO_SWITCH_ON),
    (7, _S.READY_TO_SWITCH_ON, _C.QUICK_STOP, _S.SWITCH_ON_DISABLED),
    (7, _S.READY_TO_SWITCH_ON, _C.DISABLE_VOLTAGE, _S.SWITCH_ON_DISABLED),
    (8, _S.OPERATION_ENABLED, _C.SHUTDOWN, _S.READY_TO_SWITCH_ON),
    (9, _S.OPERATION_ENABLED, _C.DISABLE_VOLTAGE, _S.SWITCH_ON_DISABLED),
    (10, _S.SWITCHED_ON, _C.DISABLE_VOLTAGE, _S.SWITCH_ON_DISABLED),
    (10, _S.SWITCHED_ON, _C.QUICK_STOP, _S.SWITCH_ON_DISABLED),
    (11, _S.OPERATION_ENABLED, _C.QUICK_STOP, _S.QUICK_STOP_ACTIVE),
    (12, _S.QUICK_STOP_ACTIVE, _C.DISABLE_VOLTAGE, _S.SWITCH_ON_DISABLED),
    (15, _S.FAULT, _C.FAULT_RESET, _S.SWITCH_ON_DISABLED),
    (16, _S.QUICK_STOP_ACTIVE, _C.ENABLE_OPERATION, _S.OPERATION_ENABLED),
)
"""(number, state, command, next state) of every transition that a controlword commands."""


def _next_state() -> npt.NDArray[np.int64]:
    table = np.tile(np.arange(len(PowerState), dtype=np.int64)[:, None], (1, len(Command)))
    for _, state, command, following in TRANSITIONS:
        table[state, command] = following
    return table


NEXT_STATE = _next_state()
"""``NEXT_STATE[state, command]``: the state that follows; the same state where the table has no transition."""

CONTROLWORD_TO_ENABLE: npt.NDArray[np.int64] = np.array([0x00, 0x06, 0x07, 0x0F, 0x0F, 0x00, 0x00, 0x80], np.int64)
"""The controlword that leads one step on towards Operation Enabled, by `PowerState`."""
