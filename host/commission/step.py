"""What a step of commissioning is: what will move, the exercise that moves it, and what its
recording says.
"""

from __future__ import annotations

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
    "strokes",
]


class CommissionError(CoulombusError):
    """A step found nothing that could be written: the text says why, and what to do."""

    exit_status = 1


@dataclass(frozen=True)
class Given:
    """What only the operator knows: None where it was not given."""

    weight_Nm: float | None = None
    """Torque of a known weight on an arm of known length at the handle, in its positive sense."""
    marks_rad: float | None = None
    """Angle between two marks at the handle."""
    marks_reach_rad: float = 0.002
    """Half of the 95 % interval of that angle, as the hand sets it."""
    weight_reach_Nm: float = 0.0
    """Half of the 95 % interval of the weight's torque."""
    shares: Mapping[str, float] = field(default_factory=dict)
    """Relative 95 % reaches of what earlier steps have measured (`host.commission.earlier`)."""

    def share(self, *names: str) -> float:
        """Return the relative reach of the first of the figures that was measured; 0 if none was."""
        return next((self.shares[name] for name in names if name in self.shares), 0.0)

    def exact(self, figures: Mapping[str, Sequence[str]]) -> tuple[str, ...]:
        """Return a remark on the figures that no step has measured, and that count as exact.

        `figures`: words for each, and the keys or names under which a step has it.
        """
        missing = [words for words, names in figures.items() if not any(name in self.shares for name in names)]
        return (f"not measured, so the interval takes it as exact: {', '.join(missing)}",) if missing else ()


@dataclass(frozen=True)
class Risk:
    """What a step moves, and at most how much.

    The exercise keeps to these by its law; the limits of the rig file hold besides.
    """

    moves: str
    motor_Nm: float = 0.0
    speed_rad_s: float = 0.0
    travel_rad: float = 0.0
    brake_Nm: float = 0.0
    seconds: float = 0.0
    operator: str = "Let go of the handle, and stay clear of it."
    """What the operator has to do."""

    def lines(self) -> list[str]:
        """Return it in words."""
        most = [
            f"motor {self.motor_Nm:.3g} Nm" if self.motor_Nm else "no motor torque",
            f"brake {self.brake_Nm:.3g} Nm" if self.brake_Nm else "brake off",
            *([f"{self.speed_rad_s:.3g} rad/s"] if self.speed_rad_s else []),
            *([f"+-{self.travel_rad:.3g} rad"] if self.travel_rad else []),
            f"{self.seconds:.0f} s",
        ]
        return [self.moves, f"at most: {', '.join(most)}", self.operator, "Ctrl-C stops it at any time."]


@dataclass(frozen=True)
class Exercise:
    """One run: the rig file as it is for it, the mode, and how the rehearsal's hand behaves."""

    name: str
    rig: Rig
    mode: str
    seconds: float
    hand: tuple[str, ...] = ()
    """Overrides of [operator] and [[phase]] for the simulated hand, which does what `Risk.operator`
    asks for.
    """
    may_trip: tuple[str, ...] = ()
    """Trips that do not spoil what the recording says."""


@dataclass(frozen=True)
class Finding:
    """One thing that was measured.

    Attributes
    ----------
    key : of the rig file; "" where there is none, and the figure is for people
    name : in words
    old, new : what the rig file says, and what was found
    uncertainty : half of the 95 % interval, in `unit`; None where there is none
    basis : what it rests on
    changed : whether the difference is more than can be told apart
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
    """A picture for the report: lines of points, drawn as `style` says ("-", "o")."""

    title: str
    x: str
    y: str
    lines: Mapping[str, tuple[Sequence[float], Sequence[float], str]]


@dataclass(frozen=True)
class Outcome:
    """What a step came to."""

    findings: tuple[Finding, ...]
    remarks: tuple[str, ...] = ()
    curves: tuple[Curve, ...] = ()
    again: bool = False
    """The rig could not be armed for the exercise as it was believed: with the findings it can, and
    the step is to be done once more.
    """

    def as_dict(self) -> dict[str, Any]:
        """Return plain values."""
        return asdict(self)


@dataclass(frozen=True)
class TrippedExercise:
    """How an exercise ended otherwise than planned: the trip's name, and its words."""

    name: str
    text: str


@dataclass(frozen=True)
class ExerciseResult:
    """What an exercise gave: its recording, and the trip where it tripped as it may."""

    recording: Recording
    trip: TrippedExercise | None = field(default=None)


class Step(ABC):
    """One step."""

    name: ClassVar[str]
    title: ClassVar[str]

    def lacks(self, axis: Axis, given: Given) -> str | None:
        """Return why the step cannot be done on this rig, None where it can."""
        return None

    @abstractmethod
    def risk(self, axis: Axis, given: Given) -> Risk:
        """Return what will move, and at most how much."""

    @abstractmethod
    def exercises(self, rig: Rig, given: Given) -> tuple[Exercise, ...]:
        """Return the runs of the step; none where nothing has to move."""

    @abstractmethod
    def analyse(self, runs: Sequence[ExerciseResult], axis: Axis, given: Given) -> Outcome:
        """Return what the recordings say.

        Raises
        ------
        CommissionError
            they do not carry it
        """


TRAVEL_SHARE = 0.6
"""A step keeps to this share of ``limits.travel_rad``."""


def lacks_roles(axis: Axis, *roles: str) -> str | None:
    """Return the first of the roles that the rig has not, in words."""
    missing = next((role for role in roles if axis.allocation.bound.get(role) is None), None)
    return None if missing is None else f"the rig has no role {missing}"


def strokes(seconds: float, speed_rad_s: float, move_s: float, dwell_s: float) -> str:
    """Return a phase of a schedule in which the handle is stroked to and fro."""
    times = f"duration_s={seconds!r}, speed_rad_s={speed_rad_s!r}, move_s={move_s!r}, dwell_s={dwell_s!r}"
    return f'{{kind="stroke", {times}}}'


def move_s(axis: Axis, speed_rad_s: float, wanted_s: float) -> float:
    """Return how long a move of the hand at a speed is [s]: as wanted, or what the travel
    allows.
    """
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

    With motor torque it is in mode active: the sign check comes first. Else it is in mode passive,
    where the motor has none. The rig file's limits are taken as they are.
    """
    mode = "active" if motor_Nm > 0 else "passive"
    law_keys = {"K_p_Nm_rad": 1.0, "F_s_Nm": 0.0, "F_d_Nm": 0.0, "compensation": 0.0, "motor_limit_Nm": motor_Nm}
    schedule = f"phase=[{', '.join(phases)}]"
    chosen = rig.variant(
        f'law.function="{EXERCISES}:{law}"',
        f"law.user={[float(number) for number in user]}",
        *(f"mode.{mode}.{key}={value!r}" for key, value in law_keys.items()),
        schedule,
    )
    return Exercise(name, chosen, mode, chosen.schedule_s, (*hand, schedule), may_trip)
