"""CiA 301's NMT state machine as one table, shared by the device, the
host and the tools (section 7.3.2.2, figure 48).

`STATES` has what may be sent and received in each state, `TRANSITIONS` what an NMT command leads
to, `AUTOMATIC` what a device does by itself; every array and mapping, and the diagram and the table
of docs/devices.md, are made of these three. The arrays are plain int64, so kernels read them as
they stand: ``ALLOWED[state] & Service.PDO``.
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
    """A state, and the services that it allows, as a sum of their bits."""

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
"""(number, state, command, next state) of every transition that an NMT command leads to."""

AUTOMATIC: tuple[tuple[NmtState | None, str, int | None, NmtState], ...] = (
    (None, "power on (1)", None, _S.INITIALISING),
    (_S.INITIALISING, "boot-up (2)", None, _S.PRE_OPERATIONAL),
    (_S.OPERATIONAL, "error, 1029h is 0", 0, _S.PRE_OPERATIONAL),
    (_S.OPERATIONAL, "error, 1029h is 2", 2, _S.STOPPED),
    (_S.PRE_OPERATIONAL, "error, 1029h is 2", 2, _S.STOPPED),
)
"""(state, when, value of 1029h if it decides, next state) of what a
device does by itself; None is the switched-off device.

A device that starts by itself (1F80h bit 2 clear) makes transition 3 behind its boot-up.
"""

_VALUES = max(NmtState) + 1


def _allowed() -> npt.NDArray[np.int64]:
    table = np.zeros(_VALUES, np.int64)
    for row in STATES:
        table[row.state] = row.services
    return table


ALLOWED = _allowed()
"""``ALLOWED[state]``: sum of the bits of the services that a state allows."""

NEXT_STATE: Mapping[tuple[int, int], NmtState] = {(state, command): end for _, state, command, end in TRANSITIONS}
"""(state, command) -> the state that follows; no key where the command changes nothing."""


def _after_command() -> npt.NDArray[np.int64]:
    table = np.repeat(np.arange(_VALUES, dtype=np.int64)[:, None], 256, axis=1)
    for (state, command), end in NEXT_STATE.items():
        table[state, command] = end
    return table


AFTER_COMMAND = _after_command()
"""``AFTER_COMMAND[state, command]``: the same, for each byte; the same state where it changes nothing."""


def _after_error() -> npt.NDArray[np.int64]:
    table = np.tile(np.arange(_VALUES, dtype=np.int64), (3, 1))
    for state, _, behaviour, end in AUTOMATIC:
        if state is not None and behaviour is not None:
            table[behaviour, state] = end
    return table


AFTER_ERROR = _after_error()
"""``AFTER_ERROR[behaviour, state]``: the state that follows an error,
by 1029h (0 to 2); the same state where it changes nothing.
"""


def diagram() -> str:
    """Return the state machine as a state diagram in Mermaid's words."""
    lines = [
        f"    {'[*]' if state is None else state.name} --> {end.name}: {when}" for state, when, _, end in AUTOMATIC
    ]
    lines += [f"    {state.name} --> {end.name}: {command.name} ({n})" for n, state, command, end in TRANSITIONS]
    return "\n".join(("stateDiagram-v2", *lines))


def services() -> str:
    """Return which services each state allows, as a table in Markdown."""
    rows = ["| | " + " | ".join(row.state.name for row in STATES) + " |", "|---" * (len(STATES) + 1) + "|"]
    for service in Service:
        cells = ("yes" if row.services & service else "" for row in STATES)
        rows.append(f"| {service.name} | " + " | ".join(cells) + " |")
    return "\n".join(rows)
