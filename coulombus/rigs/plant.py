"""The simulation part of the rig file: the true rig, the simulated hand, and its schedule."""

from __future__ import annotations

from typing import Annotated, Any, Literal, TypeAlias

import numpy as np
import numpy.typing as npt
from pydantic import BeforeValidator, ConfigDict, Field

from coulombus.rigs.devices import Iron
from coulombus.rigs.model import NS, SAYS_POLARITY, Nanoseconds, Polarity, Section, to_ns
from coulombus.rigs.plant_detail import Cable, Fluid, Friction, Handle, Heat, Ripple

__all__ = [
    "PLANE_KINDS",
    "FilePhase",
    "HoldPhase",
    "MotionPhase",
    "Operator",
    "PaperPhase",
    "Phase",
    "Plant",
    "RestPhase",
    "StrokePhase",
]


class Plant(Section):
    """[plant]: the true rig, for the simulation only.

    Nothing is copied from [mechanics].
    """

    step_s: Nanoseconds = Field(
        ge=1e-7, le=1e-2, description="step of the physics; divides bus.period_s", json_schema_extra=NS
    )
    inertia_kg_m2: float = Field(gt=0, le=1e3, description="inertia of the device at the handle")
    viscous_Nms_rad: float = Field(ge=0, le=1e3, description="viscous friction at the handle")
    coulomb_Nm: float = Field(ge=0, le=1e3, description="Coulomb friction at the handle, without the brake's off-state")
    stribeck_Nm: float = Field(
        0.0, ge=0, le=1e3, description="what the device's own static friction is more than coulomb_Nm"
    )
    stribeck_rad_s: float = Field(0.05, gt=0, le=1e3, description="speed at which 1/e of that is left")
    ratio: float = Field(gt=0, le=1e4, description="motor revolutions for one of the handle")
    encoder_counts_rev: int = Field(ge=1, le=2**31 - 1, description="encoder counts in one turn of the motor")
    encoder_polarity: Polarity = Field(
        description="-1: the encoder counts down in the positive sense", json_schema_extra=SAYS_POLARITY
    )
    encoder_eccentricity_rad: float = Field(
        0.0, ge=0, le=0.5, description="error of the encoder's angle, a sine of one period in a turn of the motor"
    )
    motor_polarity: Polarity = Field(
        description="-1: positive 6071 drives in the negative sense", json_schema_extra=SAYS_POLARITY
    )
    motor_rated_torque_Nm: float = Field(gt=0, le=1e4, description="rated torque at the motor's shaft")
    motor_peak_ratio: float = Field(
        gt=0, le=1000, description="saturation of the motor's torque, times the rated torque"
    )
    motor_lag_s: float = Field(ge=0, le=1, description="time constant of the motor's torque; 0: none")
    cogging_Nm: float = Field(0.0, ge=0, le=1e3, description="amplitude of the motor's cogging at the handle")
    cogging_periods: int = Field(12, ge=1, le=1000, description="periods of the cogging in one revolution of the motor")
    brake_max_Nm: float = Field(gt=0, le=1e4, description="largest torque of the brake")
    brake_off_state_Nm: float = Field(ge=0, le=1e3, description="the brake's torque without current")
    brake_gain: float = Field(
        1.0,
        gt=0,
        le=100,
        description="true torque of the brake for each Nm that the role's scale or table says; 1: they are right",
    )
    brake_coil_lag_s: float = Field(ge=0, le=1, description="time constant of the brake's coil; 0: none")
    brake_fluid_lag_s: float = Field(ge=0, le=1, description="time constant of the brake's fluid; 0: none")
    transducer_noise_Nm: float = Field(0.0, ge=0, le=1e3, description="standard deviation of the transducer's noise")
    transducer_bias_Nm: float = Field(0.0, ge=-1e3, le=1e3, description="what the transducer reads without a load")
    transducer_drift_Nm_s: float = Field(0.0, ge=-1e3, le=1e3, description="by how much that changes each second")
    transducer_lag_s: float = Field(0.0, ge=0, le=1, description="time constant of the transducer's filter; 0: none")
    transducer_polarity: Polarity = Field(
        description="-1: the hand's torque in the positive sense reads negative", json_schema_extra=SAYS_POLARITY
    )
    coil_step_A: float = Field(0.0, ge=0, le=100, description="resolution of the driver's coil current; 0: continuous")
    temperature_degC: float = Field(22.0, ge=-40, le=200, description="the coil's temperature at the start")
    ambient_degC: float = Field(22.0, ge=-40, le=200, description="temperature of what cools the coil")
    coil_resistance_ohm: float = Field(4.0, ge=0, le=1e4, description="resistance of the brake's coil")
    coil_thermal_K_W: float = Field(
        0.0, ge=0, le=1e4, description="thermal resistance from the coil to the ambient; 0: the temperature is constant"
    )
    coil_thermal_s: float = Field(300.0, gt=0, le=1e6, description="thermal time constant of the coil")
    brake_remanence: float = Field(
        0.0,
        ge=0,
        le=0.9,
        description="torque that the iron remembers, as a share of the largest since it was demagnetised",
    )
    transducer_inertia_kg_m2: float | None = Field(
        None, ge=-1, le=1, description="crosstalk: what the transducer reads for each rad/s^2 of the handle; none"
    )
    cable: Cable | None = Field(None, description="elastic transmission")
    handle: Handle | None = Field(None, description="elastic handle")
    friction: Friction | None = Field(None, description="more of the device's own friction")
    fluid: Fluid | None = Field(None, description="more of the brake's fluid")
    iron: Iron | None = Field(None, description="the brake's magnetic hysteresis")
    ripple: Ripple | None = Field(None, description="the motor's torque ripple")
    heat: Heat | None = Field(None, description="the device's temperature")

    @property
    def in_detail(self) -> bool:
        """Whether it has more than one rigid body."""
        parts = self.cable, self.handle, self.friction, self.fluid, self.iron, self.ripple, self.heat
        return any(part is not None for part in (*parts, self.transducer_inertia_kg_m2))

    @property
    def step_ns(self) -> int:
        """Step in nanoseconds."""
        return to_ns(self.step_s)


class Operator(Section):
    """[operator]: the simulated hand, f_h - f = Z_o v."""

    inertia_kg_m2: float = Field(ge=0, le=1e3, description="the hand's inertia")
    damping_Nms_rad: float = Field(ge=0, le=1e4, description="the hand's damping, B_o")
    stiffness_Nm_rad: float = Field(ge=0, le=1e6, description="the hand's stiffness, K_o")
    tremor_Nm: float = Field(0.0, ge=0, le=1e3, description="amplitude of the tremor")
    tremor_Hz: float = Field(0.0, ge=0, le=1e3, description="frequency of the tremor")
    population: float = Field(
        0.0, ge=0, le=1, description="spread of hands: 0: every seed has this hand; else each seed is a subject"
    )


class _Phase(Section):
    duration_s: float = Field(gt=0, le=86400, description="length of the phase")


class RestPhase(_Phase):
    """[[phase]] of kind "rest": the hand does nothing."""

    kind: Literal["rest"]


TapTimes = Annotated[
    tuple[Annotated[float, Field(ge=0)], ...],
    Field(
        strict=False,
        max_length=1000,
        description="when taps begin, from the phase's start",
        json_schema_extra={"expected": "a list of at most 1000 numbers from 0 on, in s"},
    ),
]


class HoldPhase(_Phase):
    """[[phase]] of kind "hold": a slow push below the static friction, with taps."""

    kind: Literal["hold"]
    push_F_s: float = Field(ge=-10, le=10, description="amplitude of the push, as a share of the mode's F_s_Nm")
    frequency_Hz: float = Field(ge=0, le=1e3, description="frequency of the push (a sine)")
    taps_s: TapTimes = ()
    tap_Nm: float = Field(0.0, ge=-1e4, le=1e4, description="torque of a tap")
    tap_s: float = Field(0.01, gt=0, le=60, description="length of a tap")


class StrokePhase(_Phase):
    """[[phase]] of kind "stroke": back and forth at a constant desired speed, with dwells."""

    kind: Literal["stroke"]
    speed_rad_s: float = Field(ge=-1e3, le=1e3, description="desired speed of the first move; the next goes back")
    move_s: float = Field(gt=0, le=3600, description="length of a move ...")
    dwell_s: float = Field(ge=0, le=3600, description="... and of the dwell behind it")


class PaperPhase(_Phase):
    """[[phase]] of kind "paper": the force of the paper's section 4.

    f_h(t) = 40 sin(pi^2/4 t) + sin(pi/8 t) + 2 [1 - cos(pi/2 t)], in N (Nm at a handle of 1 m
    radius).
    """

    kind: Literal["paper"]


class TipHoldPhase(_Phase):
    """[[phase]] of kind "tip_hold": a slow push on the tip below the static friction, with taps."""

    kind: Literal["tip_hold"]
    push_F_s: float = Field(ge=-10, le=10, description="amplitude of the push, as a share of the law's F_s_N")
    frequency_Hz: float = Field(ge=0, le=1e3, description="frequency of the push (a sine)")
    direction_rad: float = Field(0.0, ge=-100, le=100, description="direction of push and taps; 0: along x")
    taps_s: TapTimes = ()
    tap_N: float = Field(0.0, ge=-1e5, le=1e5, description="force of a tap")
    tap_s: float = Field(0.01, gt=0, le=60, description="length of a tap")


class TipLinePhase(_Phase):
    """[[phase]] of kind "tip_line": to and fro on a straight line, a sine of time."""

    kind: Literal["tip_line"]
    length_m: float = Field(gt=0, le=100, description="length of the line; it begins where the hand is")
    direction_rad: float = Field(0.0, ge=-100, le=100, description="direction of the line; 0: along x")
    frequency_Hz: float = Field(gt=0, le=1e3, description="ways to and fro in a second")


class TipCirclePhase(_Phase):
    """[[phase]] of kind "tip_circle": out to a circle about the hand's place, then round and round."""

    kind: Literal["tip_circle"]
    radius_m: float = Field(gt=0, le=100, description="radius of the circle")
    frequency_Hz: float = Field(ge=-1e3, le=1e3, description="laps in a second; negative: clockwise")
    direction_rad: float = Field(0.0, ge=-100, le=100, description="direction of the circle's first point; 0: along x")
    approach_s: float = Field(0.5, gt=0, le=3600, description="time from the centre to the first point")


class TipEightPhase(_Phase):
    """[[phase]] of kind "tip_eight": a figure of eight through the hand's place."""

    kind: Literal["tip_eight"]
    width_m: float = Field(gt=0, le=100, description="width along x")
    height_m: float = Field(gt=0, le=100, description="height along y")
    frequency_Hz: float = Field(gt=0, le=1e3, description="figures in a second")


PlanePhase: TypeAlias = TipHoldPhase | TipLinePhase | TipCirclePhase | TipEightPhase
PLANE_KINDS = ("tip_hold", "tip_line", "tip_circle", "tip_eight")
"""Kinds of phases of a rig with [kinematics]; "rest" is a kind of every rig."""


Floats: TypeAlias = npt.NDArray[np.float64]


def _column(value: Any) -> Any:
    """Return a read-only array of a list of finite numbers (bools and strings are refused)."""
    if isinstance(value, np.ndarray):
        value = value.tolist()
    if not isinstance(value, list | tuple) or not all(type(x) in (int, float) for x in value):
        raise ValueError("no list of numbers")
    array = np.array(value, dtype=np.float64)
    if not np.isfinite(array).all():
        raise ValueError("not finite")
    array.setflags(write=False)
    return array


class FilePhase(Section):
    """[[phase]] of kind "file": torque over time from a CSV file, linearly interpolated.

    The loader reads `path` into `t_s` and `torque_Nm`; a file that has both (a recording's rig)
    needs no CSV file.
    """

    model_config = ConfigDict(arbitrary_types_allowed=True)

    kind: Literal["file"]
    path: str = Field("", description="CSV file, next to the rig file; columns t_s,torque_Nm")
    duration_s: float = Field(
        gt=0, le=86400, description="length of the phase; the file's last t_s where it is not given"
    )
    t_s: Annotated[Floats, BeforeValidator(_column)] = Field(
        description="times instead of a file", json_schema_extra={"expected": "a list of numbers that grow, from 0 on"}
    )
    torque_Nm: Annotated[Floats, BeforeValidator(_column)] = Field(
        description="torques at these times", json_schema_extra={"expected": "a list of as many numbers as t_s has"}
    )

    def _key(self) -> tuple[str, float, bytes, bytes]:
        return self.path, self.duration_s, self.t_s.tobytes(), self.torque_Nm.tobytes()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, FilePhase) and self._key() == other._key()

    def __hash__(self) -> int:
        return hash(self._key())


class MotionPhase(Section):
    """[[phase]] of kind "motion": position of a recorded hand from a CSV file, linearly interpolated.

    The hand's impedance follows it: f_h = K_o theta_d + B_o theta_d'. The loader reads `path` into
    `t_s` and `x_rad`.
    """

    model_config = ConfigDict(arbitrary_types_allowed=True)

    kind: Literal["motion"]
    path: str = Field("", description="CSV file, next to the rig file; columns t_s,x_rad")
    duration_s: float = Field(
        gt=0, le=86400, description="length of the phase; the file's last t_s where it is not given"
    )
    t_s: Annotated[Floats, BeforeValidator(_column)] = Field(
        description="times instead of a file", json_schema_extra={"expected": "a list of numbers that grow, from 0 on"}
    )
    x_rad: Annotated[Floats, BeforeValidator(_column)] = Field(
        description="angles at these times", json_schema_extra={"expected": "a list of as many numbers as t_s has"}
    )

    def _key(self) -> tuple[str, float, bytes, bytes]:
        return self.path, self.duration_s, self.t_s.tobytes(), self.x_rad.tobytes()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, MotionPhase) and self._key() == other._key()

    def __hash__(self) -> int:
        return hash(self._key())


Phase: TypeAlias = Annotated[
    RestPhase | HoldPhase | StrokePhase | PaperPhase | FilePhase | MotionPhase | PlanePhase,
    Field(discriminator="kind"),
]
