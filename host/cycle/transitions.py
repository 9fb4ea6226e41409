"""Tables of the cycle's phases: transitions with their conditions and trips, and controlwords.

`host.cycle.phases` implements the table. The tests compare every transition of the compiled step with
it, and the diagram of docs/safety.md is drawn from it. Two changes of the phase happen outside the step:
`Controller.start` sets STILL, and the end of the data plane sets DONE from any phase.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from coulombus.eds.cia402 import CONTROLWORD, CONTROLWORD_TO_ENABLE, Command, PowerState
from coulombus.host.cycle.records import Phase, Trip

__all__ = ["BRAKE_CONTROLWORDS", "CONTROLWORDS", "TRANSITIONS", "Transition", "allowed", "diagram"]


class Transition(NamedTuple):
    """A row of the table: from one of `phases`, under `condition`, to `following`.

    A row to SAFE has the possible reasons in `trips`.
    """

    phases: tuple[Phase, ...]
    condition: str
    following: Phase
    trips: tuple[Trip, ...] = ()


ANY_TIME = (
    *(Trip.SPEED, Trip.ENCODER_JUMP, Trip.NET_WORK, Trip.HANDLE_TORQUE, Trip.TRAVEL, Trip.VOLTAGE, Trip.COIL_I2T),
    *(Trip.TPDO_LOST, Trip.EMCY_MOTOR, Trip.EMCY_BRAKE, Trip.HEARTBEAT_MOTOR, Trip.HEARTBEAT_BRAKE, Trip.NMT_STATE),
    *(Trip.EMCY_SENSOR, Trip.HEARTBEAT_SENSOR, Trip.MOTOR_TORQUE, Trip.WORKSPACE, Trip.SINGULAR),
)
"""Trips of the monitors that run in every phase."""

FROM_OUTSIDE = (
    *(Trip.TRANSMIT, Trip.RECORDING, Trip.BUS_LOST, Trip.SECOND_HOST, Trip.DATA_PLANE, Trip.OTHER_AXIS, Trip.HOST),
    Trip.NONE,
)
"""Trips that come from outside the step; NONE is the normal end."""

BEFORE_SAFE = tuple(phase for phase in Phase if phase < Phase.SAFE)

TRANSITIONS = (
    Transition((Phase.STILL,), "still, not loaded, switched on, switch held", Phase.ENABLE),
    Transition((Phase.ENABLE,), "drive enabled", Phase.SIGN),
    Transition((Phase.ENABLE,), "drive enabled, mode without a motor", Phase.RUN),
    Transition((Phase.SIGN,), "signs agree", Phase.SETTLE),
    Transition((Phase.SETTLE,), "torque 0, still", Phase.RUN),
    Transition(
        (Phase.STILL,),
        "not so in time",
        Phase.SAFE,
        (Trip.NOT_STILL, Trip.HANDLE_LOADED, Trip.ENABLE_TIMEOUT, Trip.DEADMAN),
    ),
    Transition((Phase.ENABLE,), "not enabled in time", Phase.SAFE, (Trip.ENABLE_TIMEOUT,)),
    Transition(
        (Phase.SIGN,),
        "a sign is wrong, or nothing moves",
        Phase.SAFE,
        (Trip.SIGN_NO_MOTION, Trip.SIGN_ENCODER, Trip.SIGN_TRANSDUCER, Trip.SIGN_TRAVEL),
    ),
    Transition((Phase.SETTLE,), "not so in time", Phase.SAFE, (Trip.NOT_STILL,)),
    Transition(
        (Phase.RUN,),
        "the law returns no finite number, is clipped, or oscillates",
        Phase.SAFE,
        (Trip.LAW, Trip.LAW_CLIPPED, Trip.LAW_OSCILLATES),
    ),
    Transition(BEFORE_SAFE, "a watch doubts", Phase.SAFE, ANY_TIME),
    Transition((Phase.SIGN, Phase.SETTLE, Phase.RUN), "the drive is not enabled", Phase.SAFE, (Trip.DRIVE_STATE,)),
    Transition(BEFORE_SAFE[2:], "the switch is let go", Phase.SAFE, (Trip.DEADMAN,)),
    Transition(BEFORE_SAFE, "asked to stop", Phase.SAFE, FROM_OUTSIDE),
    Transition((Phase.SAFE,), "brake ramped off", Phase.DISABLE),
    Transition((Phase.DISABLE,), "drive disabled, or time over", Phase.DONE),
)
"""Every transition of the compiled step. Without a matching row the phase continues."""


def _controlwords(disabled_from: Phase) -> npt.NDArray[np.int64]:
    """Return the controlwords by phase and by the drive's state; 0 from phase `disabled_from` on.

    The last column is for a statusword that matches no state (-1).
    """
    table = np.zeros((len(Phase), len(PowerState) + 1), np.int64)
    table[[Phase.STILL, Phase.ENABLE], :-1] = CONTROLWORD_TO_ENABLE
    table[Phase.STILL, PowerState.SWITCHED_ON] = CONTROLWORD[Command.SWITCH_ON]  # stays in Switched On
    table[Phase.SIGN : disabled_from, PowerState.OPERATION_ENABLED] = CONTROLWORD[Command.ENABLE_OPERATION]
    return table


CONTROLWORDS = _controlwords(Phase.SAFE)
"""``CONTROLWORDS[phase, state of the drive]``: the controlword for the motor's drive; 0 (disable voltage)
in every phase in which the drive must not be enabled.
"""
BRAKE_CONTROLWORDS = _controlwords(Phase.DISABLE)
"""The same for a brake with power states, which stays enabled until it is ramped off."""


def allowed(phase: Phase, following: Phase, trip: Trip = Trip.NONE) -> bool:
    """Return whether the table has a row from `phase` to `following` (for SAFE: with this trip), or the
    phase continues.
    """
    if phase is following:
        return True
    return any(
        phase in row.phases and row.following is following and (following is not Phase.SAFE or trip in row.trips)
        for row in TRANSITIONS
    )


def diagram() -> str:
    """Return the table as a Mermaid state diagram, with one arrow for each pair of phases."""
    lines = ["stateDiagram-v2", "    direction LR", "    [*] --> STILL: bring-up is done"]
    arrows: dict[tuple[Phase, Phase], list[str]] = {}
    for row in TRANSITIONS:
        for phase in row.phases:
            if phase is not Phase.OFF:  # before the start: not drawn
                arrows.setdefault((phase, row.following), []).append(row.condition)
    for (phase, following), conditions in arrows.items():
        text = "a failed check, or the end" if following is Phase.SAFE else "; ".join(conditions)
        lines.append(f"    {phase.name} --> {following.name}: {text}")
    return "\n".join((*lines, "    DONE --> [*]"))
