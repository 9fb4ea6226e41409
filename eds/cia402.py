"""CiA 402's power drive state machine as one table for device and host (IEC 61800-7-201, figure 2).

The table serves both roles. The drive looks up the next state for a state and a controlword
(`NEXT_STATE`); the host looks up the state for a statusword (`STATE_OF_STATUSWORD`) and the next
controlword on the way to Operation Enabled (`CONTROLWORD_TO_ENABLE`). All tables are plain int64
arrays, so kernels read them directly.

`STATES` has each state's statusword, `TRANSITIONS` the transitions that a controlword commands,
`AUTOMATIC` those that a drive makes by itself. Every array, and the diagram of docs/devices.md, is
generated from these three.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from coulombus.eds.drive_axis import first_axis_object

__all__ = [
    "AUTOMATIC",
    "COMMAND_OF_CONTROLWORD",
    "CONTROLWORD",
    "CONTROLWORD_FIELDS",
    "CONTROLWORD_TO_ENABLE",
    "INTERNAL_LIMIT",
    "MODE_NAMES",
    "NEXT_STATE",
    "OPERATION_MODE_CSP",
    "OPERATION_MODE_CST",
    "OPERATION_MODE_CSV",
    "OPERATION_MODE_HOMING",
    "OPERATION_MODE_INTERPOLATED_POSITION",
    "OPERATION_MODE_PROFILE_POSITION",
    "OPERATION_MODE_PROFILE_TORQUE",
    "OPERATION_MODE_PROFILE_VELOCITY",
    "STATES",
    "STATE_OF_STATUSWORD",
    "STATUSWORD",
    "STATUSWORD_FIELDS",
    "TRANSITIONS",
    "VOLTAGE_ENABLED",
    "Command",
    "PowerState",
    "PowerStateRow",
    "WordField",
    "diagram",
    "word_fields",
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
    """Commands of a controlword; FAULT_RESET is the rising edge of bit 7."""

    NONE = 0
    SHUTDOWN = 1
    SWITCH_ON = 2
    ENABLE_OPERATION = 3
    DISABLE_VOLTAGE = 4
    QUICK_STOP = 5
    FAULT_RESET = 6


OPERATION_MODE_PROFILE_POSITION = 1
OPERATION_MODE_PROFILE_VELOCITY = 3
OPERATION_MODE_PROFILE_TORQUE = 4
OPERATION_MODE_HOMING = 6
OPERATION_MODE_INTERPOLATED_POSITION = 7
OPERATION_MODE_CSP = 8
OPERATION_MODE_CSV = 9
OPERATION_MODE_CST = 10

MODE_NAMES: Mapping[int, str] = MappingProxyType(
    {
        0: "no mode",
        1: "profile position",
        2: "velocity",
        3: "profile velocity",
        4: "profile torque",
        6: "homing",
        7: "interpolated position",
        8: "cyclic synchronous position",
        9: "cyclic synchronous velocity",
        10: "cyclic synchronous torque",
        11: "cyclic synchronous torque with commutation angle",
    }
)
"""Modes of operation (6060h, 6061h); bit n - 1 of 6502h is mode n."""

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
"""Controlword (6040h) of each command."""


class PowerStateRow(NamedTuple):
    """A state, its statusword (6041h), and the controlword for the next step towards Operation Enabled."""

    state: PowerState
    mask: int
    value: int
    onward: int


_S, _C = PowerState, Command
STATES = (
    PowerStateRow(_S.NOT_READY_TO_SWITCH_ON, 0x4F, 0x00, CONTROLWORD[_C.DISABLE_VOLTAGE]),
    PowerStateRow(_S.SWITCH_ON_DISABLED, 0x4F, 0x40, CONTROLWORD[_C.SHUTDOWN]),
    PowerStateRow(_S.READY_TO_SWITCH_ON, 0x6F, 0x21, CONTROLWORD[_C.SWITCH_ON]),
    PowerStateRow(_S.SWITCHED_ON, 0x6F, 0x23, CONTROLWORD[_C.ENABLE_OPERATION]),
    PowerStateRow(_S.OPERATION_ENABLED, 0x6F, 0x27, CONTROLWORD[_C.ENABLE_OPERATION]),
    PowerStateRow(_S.QUICK_STOP_ACTIVE, 0x6F, 0x07, CONTROLWORD[_C.DISABLE_VOLTAGE]),
    PowerStateRow(_S.FAULT_REACTION_ACTIVE, 0x4F, 0x0F, CONTROLWORD[_C.DISABLE_VOLTAGE]),
    PowerStateRow(_S.FAULT, 0x4F, 0x08, CONTROLWORD[_C.FAULT_RESET]),
)
"""CiA 402 table 30, in the order of `PowerState`. Bit 4 (voltage enabled) is in no mask; some drives
set bit 5 in the fault states.
"""

STATUSWORD: npt.NDArray[np.int64] = np.array([row.value for row in STATES], np.int64)
"""Bits 0-3, 5 and 6 of the statusword (6041h) by `PowerState`."""

CONTROLWORD_TO_ENABLE: npt.NDArray[np.int64] = np.array([row.onward for row in STATES], np.int64)
"""Controlword for the next step towards Operation Enabled, by `PowerState`."""


def _state_of_statusword() -> npt.NDArray[np.int64]:
    """State by the low 7 bits of the statusword, -1 if none fits."""
    table = np.full(128, -1, np.int64)
    for row in STATES:
        table[np.arange(128) & row.mask == row.value] = row.state
    return table


STATE_OF_STATUSWORD = _state_of_statusword()


def _command_of_controlword() -> npt.NDArray[np.int64]:
    """Command by the low 4 bits of the controlword (CiA 402 table 24); the caller handles the edge of
    bit 7.
    """
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


class WordField(NamedTuple):
    """Bits of a statusword or controlword; `values` names their meanings, and is empty for a single flag."""

    name: str
    start: int
    bits: int = 1
    values: Mapping[int, str] = MappingProxyType({})

    @property
    def mask(self) -> int:
        """Mask of the field's bits in the word."""
        return ((1 << self.bits) - 1) << self.start


def _named(table: npt.NDArray[np.int64], names: type[IntEnum]) -> Mapping[int, str]:
    return MappingProxyType(
        {word: names(code).name.lower().replace("_", " ") for word, code in enumerate(table.tolist()) if code >= 0}
    )


STATUSWORD_FIELDS = (
    WordField("state", 0, 7, _named(STATE_OF_STATUSWORD, PowerState)),
    WordField("warning", 7),
    WordField("manufacturer_8", 8),
    WordField("remote", 9),
    WordField("target_reached", 10),
    WordField("internal_limit", 11),
    WordField("mode_12", 12),
    WordField("mode_13", 13),
    WordField("manufacturer_14", 14),
    WordField("manufacturer_15", 15),
)
"""Statusword without overlap (CiA 402 table 29). The state is bits 0 to 6, including voltage enabled;
bits 12 and 13 depend on the mode of operation.
"""

CONTROLWORD_FIELDS = (
    WordField("command", 0, 4, _named(COMMAND_OF_CONTROLWORD, Command)),
    WordField("mode_4", 4, 3),
    WordField("fault_reset", 7),
    WordField("halt", 8),
    WordField("mode_9", 9),
    WordField("manufacturer_11", 11, 5),
)
"""Controlword (CiA 402 table 23); bits 4 to 6 and 9 depend on the mode of operation."""


def word_fields(index: int) -> tuple[WordField, ...]:
    """Return the fields of a statusword 6041h or controlword 6040h, also of a drive's further axes
    (6841h ...); empty for another object.
    """
    return {0x6041: STATUSWORD_FIELDS, 0x6040: CONTROLWORD_FIELDS}.get(first_axis_object(index), ())


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

AUTOMATIC: tuple[tuple[int, PowerState | None, str, PowerState], ...] = (
    (0, None, "power on", _S.NOT_READY_TO_SWITCH_ON),
    (1, _S.NOT_READY_TO_SWITCH_ON, "by itself", _S.SWITCH_ON_DISABLED),
    (12, _S.QUICK_STOP_ACTIVE, "quick stop complete", _S.SWITCH_ON_DISABLED),
    (13, _S.OPERATION_ENABLED, "fault, in every state", _S.FAULT_REACTION_ACTIVE),
    (14, _S.FAULT_REACTION_ACTIVE, "fault reaction complete", _S.FAULT),
)
"""(number, state, condition, next state) of every transition that a drive makes by itself; None is the
switched-off drive.
"""


def _next_state() -> npt.NDArray[np.int64]:
    table = np.tile(np.arange(len(PowerState), dtype=np.int64)[:, None], (1, len(Command)))
    for _, state, command, following in TRANSITIONS:
        table[state, command] = following
    return table


NEXT_STATE = _next_state()
"""``NEXT_STATE[state, command]``: the next state; the same state if the table has no transition."""


def diagram() -> str:
    """Return the state machine as a Mermaid state diagram."""
    lines = [
        f"    {'[*]' if state is None else state.name} --> {end.name}: {n} {when}" for n, state, when, end in AUTOMATIC
    ]
    lines += [f"    {state.name} --> {end.name}: {n} {command.name}" for n, state, command, end in TRANSITIONS]
    return "\n".join(("stateDiagram-v2", *lines))
