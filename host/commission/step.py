r"""Interface of a commissioning step: its risk, its exercises, and the analysis of their recordings.

A step computes with figures of the rig file, each of which is a factor of its result. So the intervals of earlier steps
contribute to its own: by the delta method, the squares of relative 95 % reaches add,

.. math:: \Bigl(\frac{r}{x}\Bigr)^2 = \Bigl(\frac{r_0}{x}\Bigr)^2 + \sum_i s_i^2

(JCGM 100:2008, GUM, 5.1.6). If a measured figure was not written because its difference was not
significant, this difference is added to its reach: the file has the old value.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, ClassVar

from coulombus.host.laws.laws import EXERCISES
from coulombus.recording.signals import Recording
from coulombus.rigs.axis import Axis
from coulombus.rigs.rig import Rig
from coulombus.system.errors import CoulombusError

__all__ = [
    "ANGLE",
    "HANDLE_TORQUE",
    "INERTIA",
    "SCALE",
    "TABLE",
    "TRAVEL_SHARE",
    "CommissionError",
    "Curve",
    "Exercise",
    "ExerciseResult",
    "Finding",
    "Given",
    "Outcome",
    "Risk",
    "Step",
    "TrippedExercise",
    "exercise",
    "lacks_roles",
    "move_s",
    "rounded",
    "shares",
    "strokes",
]


class CommissionError(CoulombusError):
    """A step has no result to write; the text has the reason and a remedy."""

    exit_status = 1


@dataclass(frozen=True)
class Given:
    """The operator's inputs; None if not given."""

    weight_Nm: float | None = None
    """Torque of a known weight on an arm of known length at the handle, in its positive direction."""
    marks_rad: float | None = None
    """Angle between two marks at the handle."""
    marks_reach_rad: float = 0.002
    """Half of the 95 % interval of that angle, as set by hand."""
    weight_reach_Nm: float = 0.0
    """Half of the 95 % interval of the weight's torque."""
    shares: Mapping[str, float] = field(default_factory=dict)
    """Relative 95 % reaches of the figures that earlier steps have measured (`shares`)."""

    def share(self, *names: str) -> float:
        """Return the relative reach of the first measured figure of `names`; 0 if none was measured."""
        return next((self.shares[name] for name in names if name in self.shares), 0.0)

    def exact(self, figures: Mapping[str, Sequence[str]]) -> tuple[str, ...]:
        """Return a remark on the figures that no step has measured, and that count as exact.

        `figures`: text of each figure -> its keys or names in the steps
        """
        missing = [words for words, names in figures.items() if not any(name in self.shares for name in names)]
        return (f"not measured, so the interval takes it as exact: {', '.join(missing)}",) if missing else ()


@dataclass(frozen=True)
class Risk:
    """Motion of a step, with its limits.

    The exercise's law keeps these limits; the limits of the rig file hold in addition.
    """

    moves: str
    motor_Nm: float = 0.0
    speed_rad_s: float = 0.0
    travel_rad: float = 0.0
    brake_Nm: float = 0.0
    seconds: float = 0.0
    operator: str = "Let go of the handle, and stay clear of it."
    """Instruction for the operator."""

    def lines(self) -> list[str]:
        """Return the lines of the announcement."""
        limits = [
            f"motor {self.motor_Nm:.3g} Nm" if self.motor_Nm else "no motor torque",
            f"brake {self.brake_Nm:.3g} Nm" if self.brake_Nm else "brake off",
            *([f"{self.speed_rad_s:.3g} rad/s"] if self.speed_rad_s else []),
            *([f"+-{self.travel_rad:.3g} rad"] if self.travel_rad else []),
            f"{self.seconds:.0f} s",
        ]
        return [self.moves, f"at most: {', '.join(limits)}", self.operator, "Ctrl-C stops it at any time."]


@dataclass(frozen=True)
class Exercise:
    """A run: its rig, its mode, and the settings of the simulated hand in a rehearsal."""

    name: str
    rig: Rig
    mode: str
    seconds: float
    hand: tuple[str, ...] = ()
    """Overrides of [operator] and [[phase]] for the simulated hand, which follows `Risk.operator`."""
    may_trip: tuple[str, ...] = ()
    """Trips after which the recording is still valid."""


@dataclass(frozen=True)
class Finding:
    """A measured figure.

    Attributes
    ----------
    key : key of the rig file; "": none, the figure is for information
    name : text of the figure
    old, new : the rig file's value, and the measured value
    uncertainty : half of the 95 % interval, in `unit`; None without one
    basis : data of the measurement
    changed : whether the difference is significant
    """

    key: str
    name: str
    old: Any
    new: Any
    unit: str
    uncertainty: float | None
    basis: str
    changed: bool = True


@dataclass(frozen=True)
class Curve:
    """A figure for the report: lines of points, each with a matplotlib style such as "-" or "o"."""

    title: str
    x: str
    y: str
    lines: Mapping[str, tuple[Sequence[float], Sequence[float], str]]


@dataclass(frozen=True)
class Outcome:
    """Result of a step."""

    findings: tuple[Finding, ...]
    remarks: tuple[str, ...] = ()
    curves: tuple[Curve, ...] = ()
    again: bool = False
    """Whether the step must be repeated: with the old values the rig could not be armed for the exercise, with
    the findings it can.
    """

    def as_dict(self) -> dict[str, Any]:
        """Return plain values."""
        return asdict(self)


@dataclass(frozen=True)
class TrippedExercise:
    """Trip of an exercise: its name, and its text."""

    name: str
    text: str


@dataclass(frozen=True)
class ExerciseResult:
    """Result of an exercise: its recording, and its trip if it was one of `Exercise.may_trip`."""

    recording: Recording
    trip: TrippedExercise | None = field(default=None)


class Step(ABC):
    """A step of commissioning."""

    name: ClassVar[str]
    title: ClassVar[str]

    def lacks(self, axis: Axis, inputs: Given) -> str | None:
        """Return the reason why the step is not possible on this rig, or None."""
        return None

    @abstractmethod
    def risk(self, axis: Axis, inputs: Given) -> Risk:
        """Return the motion of the step, with its limits."""

    @abstractmethod
    def exercises(self, rig: Rig, inputs: Given) -> tuple[Exercise, ...]:
        """Return the runs of the step; empty if nothing has to move."""

    @abstractmethod
    def analyse(self, runs: Sequence[ExerciseResult], axis: Axis, inputs: Given) -> Outcome:
        """Return the result from the recordings.

        Raises
        ------
        CommissionError
            the recordings do not give a result
        """


TRAVEL_SHARE = 0.6
"""Largest travel of a step, as a share of ``limits.travel_rad``."""


def lacks_roles(axis: Axis, *roles: str) -> str | None:
    """Return a text with the first of `roles` that the rig lacks, or None."""
    missing = next((role for role in roles if axis.allocation.bound.get(role) is None), None)
    return None if missing is None else f"the rig has no role {missing}"


def strokes(seconds: float, speed_rad_s: float, move_s: float, dwell_s: float) -> str:
    """Return a schedule's phase in which the hand strokes the handle to and fro."""
    times = f"duration_s={seconds!r}, speed_rad_s={speed_rad_s!r}, move_s={move_s!r}, dwell_s={dwell_s!r}"
    return f'{{kind="stroke", {times}}}'


def move_s(axis: Axis, speed_rad_s: float, wanted_s: float) -> float:
    """Return the duration of the hand's move at a speed [s]: `wanted_s`, or less if the travel limits it."""
    return round(min(wanted_s, TRAVEL_SHARE * axis.limits.travel_limit_rad / speed_rad_s), 3)


def exercise(
    name: str,
    rig: Rig,
    law: str,
    user: Sequence[float],
    phases: Sequence[str],
    *,
    motor_Nm: float = 0.0,
    hand: Sequence[str] = (),
    may_trip: tuple[str, ...] = (),
) -> Exercise:
    """Return a run of one of `host.laws.exercises`, for the length of its `phases`.

    With motor torque it is in mode active, which begins with the sign check. Else it is in mode passive,
    in which the motor has no torque. The rig file's limits are unchanged, but for the share of
    `HANDLE_TORQUE`.
    """
    mode = "active" if motor_Nm > 0 else "passive"
    law_keys = {"K_p_Nm_rad": 1.0, "F_s_Nm": 0.0, "F_d_Nm": 0.0, "compensation": 0.0, "motor_limit_Nm": motor_Nm}
    schedule = f"phase=[{', '.join(phases)}]"
    variant = rig.variant(
        f'law.function="{EXERCISES}:{law}"',
        "limits.handle_mismatch_share=1e6",  # scales and signs are what it measures
        f"law.user={[float(number) for number in user]}",
        *(f"mode.{mode}.{key}={value!r}" for key, value in law_keys.items()),
        schedule,
    )
    return Exercise(name, variant, mode, variant.schedule_s, (*hand, schedule), may_trip)


SCALE = "role.handle_torque.scale_Nm"
HANDLE_TORQUE = "torque at the handle at 1000 per mille"
"""The motor's torque times the ratio; it is measured as a product, so the ratio's interval has no part in it."""
ANGLE = ("mechanics.ratio", "role.position.scale_rad")
TABLE = "role.brake_setpoint.table"
"""The brake's; its reach is relative to the largest torque, and holds both branches of a hysteresis."""
INERTIA = "mechanics.inertia_kg_m2"


def shares(steps: Mapping[str, Mapping[str, Any]]) -> dict[str, float]:
    """Return the relative 95 % reach of each figure of the rig file that the steps have measured.

    `steps`: `Progress.steps`
    """
    reaches: dict[str, float] = {}
    for step in steps.values():
        for finding in step["findings"]:
            old, new, reach = finding["old"], finding["new"], finding["uncertainty"]
            name = finding["key"] or finding["name"]
            if reach is None:
                continue
            if name == TABLE and new:
                reaches[name] = reach / max(abs(torque) for _, torque in new)
            if not isinstance(new, int | float):
                continue
            value = new if finding["changed"] else old
            if isinstance(value, int | float) and value:
                reaches[name] = (reach + abs(new - value)) / abs(value)
    return reaches


def rounded(value: float, reach: float) -> float:
    """Return a value rounded to the digits that its 95 % reach justifies."""
    if not reach > 0.0:
        return float(f"{value:.6g}")
    return round(value, math.ceil(-math.log10(reach)) + 1)
