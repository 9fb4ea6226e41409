"""The state of an axis after a cycle, as a program outside reads it."""

from __future__ import annotations

from typing import Any, NamedTuple

from coulombus.host.world.records import STATE

__all__ = ["RUN", "State", "state_of"]

RUN = 5
"""`State.phase` while the display runs (`host.cycle.records.Phase.RUN`)."""


class State(NamedTuple):
    """The state of an axis after a cycle.

    Torques with the sign of `motor_Nm` act on the handle in its positive sense.
    """

    sequence: int
    """Number of the cycle."""
    t_ns: int
    """CLOCK_MONOTONIC at which the cycle's SYNC was due; in virtual time the host's clock."""
    axis: int
    """Axis of the rig, from 0."""
    phase: int
    """Phase of the cycle; `RUN` while the display runs."""
    trip: int
    """Reason of the safe state; 0: none."""
    x_rad: float
    """The handle's position."""
    v_rad_s: float
    """Its velocity, as the law sees it."""
    handle_Nm: float
    """The hand's torque on the handle; 0 without a transducer."""
    motor_Nm: float
    """Commanded torque of the motor on the handle."""
    brake_Nm: float
    """Commanded torque of the brake, 0 or more."""
    law_Nm: float
    """Output of the rig's law, before its share; positive: it resists motion in the positive sense."""
    world_Nm: float
    """What of `motor_Nm` the model gives."""
    world_brake_Nm: float
    """What of `brake_Nm` the model gives."""
    tip_x_m: float
    """Position of an arm's tip, x; 0 without an arm, as all of the tip."""
    tip_y_m: float
    """Position of the tip, y."""
    tip_vx_m_s: float
    """Velocity of the tip, x, as the law sees it."""
    tip_vy_m_s: float
    """Velocity of the tip, y."""
    hand_x_N: float
    """The hand's force on the tip, x."""
    hand_y_N: float
    """The hand's force on the tip, y."""
    world_x_N: float
    """The model's force on the tip, x; of brakes and motors together."""
    world_y_N: float
    """The model's force on the tip, y."""
    share: float
    """Share of the model: 1, less while it fades, 0 without a model."""
    model: int
    """Number of the model in use, as its sender counts; 0: none yet."""
    clipped: int
    """Cycles so far in which a limit changed what the model asked for."""
    softened: float
    """Share of the model's stiffness that is withheld: with all of it the handle would swing."""
    lost: int
    """States so far that this reader did not get, because it was slow."""
    sent_ns: int
    """CLOCK_MONOTONIC at the end of the cycle; 0 in virtual time."""

    @property
    def t_s(self) -> float:
        """`t_ns` in seconds."""
        return self.t_ns * 1e-9

    @property
    def runs(self) -> bool:
        """Whether the display runs."""
        return self.phase == RUN


assert tuple(STATE.names or ())[1:] == State._fields


def state_of(record: Any) -> State:
    """Return a `StateRecord` as a `State`."""
    return State(*record.tolist()[1:])
