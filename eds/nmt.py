"""CiA 301's NMT state machine as one table for device, host and tools (section 7.3.2.2, figure 48).

`STATES` has the services allowed in each state, `TRANSITIONS` the transitions by NMT commands,
`AUTOMATIC` those that a device makes by itself. Every array and mapping, and the diagram and the
table of docs/devices.md, are generated from these three. The arrays are plain int64, so kernels
read them directly: ``ALLOWED[state] & Service.PDO``.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from coulombus.eds.cia301 import NmtCommand, NmtState

__all__ = [
    "AFTER_COMMAND",
    "AFTER_ERROR",
    "ALLOWED",
    "AUTOMATIC",
    "NEXT_STATE",
    "STATES",
    "TRANSITIONS",
    "NmtStateRow",
    "Service",
    "diagram",
    "services",
]


class Service(IntEnum):
    """Communication objects, one bit each."""

    BOOT_UP = 1
    NMT = 2
    ERROR_CONTROL = 4  # heartbeat and node guarding
    SDO = 8
    SYNC = 16
    TIME = 32
    EMCY = 64
    PDO = 128


class NmtStateRow(NamedTuple):
    """A state, and its allowed services as a sum of their bits."""

    state: NmtState
    services: int


_S, _C = NmtState, NmtCommand
_ALWAYS = Service.NMT | Service.ERROR_CONTROL
_CONFIGURING = _ALWAYS | Service.SDO | Service.SYNC | Service.TIME | Service.EMCY

STATES = (
    NmtStateRow(_S.INITIALISING, int(Service.BOOT_UP)),
    NmtStateRow(_S.PRE_OPERATIONAL, _CONFIGURING),
    NmtStateRow(_S.OPERATIONAL, _CONFIGURING | Service.PDO),
    NmtStateRow(_S.STOPPED, _ALWAYS),
)
"""Section 7.3.2.2.5, table 37."""

TRANSITIONS: tuple[tuple[int, NmtState, NmtCommand, NmtState], ...] = (
    (3, _S.PRE_OPERATIONAL, _C.START, _S.OPERATIONAL),
    (4, _S.OPERATIONAL, _C.ENTER_PRE_OPERATIONAL, _S.PRE_OPERATIONAL),
    (5, _S.PRE_OPERATIONAL, _C.STOP, _S.STOPPED),
    (6, _S.STOPPED, _C.START, _S.OPERATIONAL),
    (7, _S.STOPPED, _C.ENTER_PRE_OPERATIONAL, _S.PRE_OPERATIONAL),
    (8, _S.OPERATIONAL, _C.STOP, _S.STOPPED),
    (9, _S.OPERATIONAL, _C.RESET_NODE, _S.INITIALISING),
    (10, _S.STOPPED, _C.RESET_NODE, _S.INITIALISING),
    (11, _S.PRE_OPERATIONAL, _C.RESET_NODE, _S.INITIALISING),
    (12, _S.OPERATIONAL, _C.RESET_COMMUNICATION, _S.INITIALISING),
    (13, _S.STOPPED, _C.RESET_COMMUNICATION, _S.INITIALISING),
    (14, _S.PRE_OPERATIONAL, _C.RESET_COMMUNICATION, _S.INITIALISING),
)
"""(number, state, command, next state) of every transition by an NMT command."""

AUTOMATIC: tuple[tuple[NmtState | None, str, int | None, NmtState], ...] = (
    (None, "power on (1)", None, _S.INITIALISING),
    (_S.INITIALISING, "boot-up (2)", None, _S.PRE_OPERATIONAL),
    (_S.OPERATIONAL, "error, 1029h is 0", 0, _S.PRE_OPERATIONAL),
    (_S.OPERATIONAL, "error, 1029h is 2", 2, _S.STOPPED),
    (_S.PRE_OPERATIONAL, "error, 1029h is 2", 2, _S.STOPPED),
)
"""(state, condition, deciding value of 1029h, next state) of every transition that a device makes by
itself; None is the switched-off device.

A device that starts by itself (1F80h bit 2 clear) makes transition 3 after its boot-up.
"""

_VALUES = max(NmtState) + 1


def _allowed() -> npt.NDArray[np.int64]:
    table = np.zeros(_VALUES, np.int64)
    for row in STATES:
        table[row.state] = row.services
    return table


ALLOWED = _allowed()
"""``ALLOWED[state]``: sum of the bits of the allowed services."""

NEXT_STATE: Mapping[tuple[int, int], NmtState] = {(state, command): end for _, state, command, end in TRANSITIONS}
"""(state, command) -> next state; no key if the command changes nothing."""


def _after_command() -> npt.NDArray[np.int64]:
    table = np.repeat(np.arange(_VALUES, dtype=np.int64)[:, None], 256, axis=1)
    for (state, command), end in NEXT_STATE.items():
        table[state, command] = end
    return table


AFTER_COMMAND = _after_command()
"""``AFTER_COMMAND[state, command]``: the same, for each byte; the same state if the command changes nothing."""


def _after_error() -> npt.NDArray[np.int64]:
    table = np.tile(np.arange(_VALUES, dtype=np.int64), (3, 1))
    for state, _, behaviour, end in AUTOMATIC:
        if state is not None and behaviour is not None:
            table[behaviour, state] = end
    return table


AFTER_ERROR = _after_error()
"""``AFTER_ERROR[behaviour, state]``: next state after an error, by 1029h (0 to 2); the same state if the
error changes nothing.
"""


def diagram() -> str:
    """Return the state machine as a Mermaid state diagram."""
    lines = [
        f"    {'[*]' if state is None else state.name} --> {end.name}: {when}" for state, when, _, end in AUTOMATIC
    ]
    lines += [f"    {state.name} --> {end.name}: {command.name} ({n})" for n, state, command, end in TRANSITIONS]
    return "\n".join(("stateDiagram-v2", *lines))


def services() -> str:
    """Return the services of each state as a Markdown table."""
    rows = ["| | " + " | ".join(row.state.name for row in STATES) + " |", "|---" * (len(STATES) + 1) + "|"]
    for service in Service:
        cells = ("yes" if row.services & service else "" for row in STATES)
        rows.append(f"| {service.name} | " + " | ".join(cells) + " |")
    return "\n".join(rows)
