"""Session of a commissioning: each step is announced, run, analysed, and written into the rig file.

Nothing is written before a step is finished. If a trip, a signal, a lost device or a full disk ends it, the
rig file is unchanged, and the earlier steps remain done.

The progress is stored in a folder next to the rig file, so that the session can be resumed:

    my.toml                         the rig file, with the findings
    my.commission/state.json        the outcome of each finished step
    my.commission/friction.pcapng   the recordings of the steps
    my.commission/my.TIME.toml      the rig file before each change
    my.commission/report.html       the report on one page

For a rig file with named axes, each axis has such a folder: ``my.commission/left``.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, TypeAlias

from coulombus.host.commission.brake import BrakeStep
from coulombus.host.commission.delay import DelayStep
from coulombus.host.commission.display import DisplayStep
from coulombus.host.commission.encoder import EncoderStep
from coulombus.host.commission.friction import FrictionStep
from coulombus.host.commission.limits import LimitsStep
from coulombus.host.commission.motor import MotorStep
from coulombus.host.commission.response import ResponseStep
from coulombus.host.commission.step import (
    CommissionError,
    Exercise,
    ExerciseResult,
    Finding,
    Given,
    Outcome,
    Risk,
    Step,
    TrippedExercise,
    shares,
)
from coulombus.host.commission.transducer import WeightStep, ZeroStep
from coulombus.host.errors import SafetyTrip
from coulombus.host.run.result import RunResult
from coulombus.recording.reading import read
from coulombus.rigs.errors import dotted, toml_value
from coulombus.rigs.rewrite import NewValue, replace_file, rewritten
from coulombus.rigs.rig import Rig, RigError, load_rig, load_rig_text
from coulombus.system.errors import CoulombusError
from coulombus.system.unfinished_file import write_whole

__all__ = ["MARK", "STEPS", "Progress", "RunEnded", "Runner", "Session", "StepEnd", "folder_of", "results"]

MARK = "commission"
"""Prefix of the comments that commissioning writes above a key."""

Runner: TypeAlias = Callable[[Exercise, Path], RunResult]
"""Runs an exercise with a recording at a path: on a bus (`host.run.real_run`), or in virtual time."""
VERSION = 1
LARGEST = 1 << 24
KEPT = ("at", "title", "findings", "remarks", "curves", "recordings")
"""Stored entries of a step."""
STEPS: tuple[Step, ...] = (
    ZeroStep(),
    WeightStep(),
    EncoderStep(),
    MotorStep(),
    FrictionStep(),
    BrakeStep(),
    ResponseStep(),
    DelayStep(),
    LimitsStep(),
    DisplayStep(),
)


class RunEnded(CoulombusError):
    """A run was ended by Ctrl-C or ``coulombus stop``."""

    def __init__(self, by: str, exit_status: int) -> None:
        super().__init__(f"ended by {by}; nothing of this step was written")
        self.exit_status = exit_status


@dataclass(frozen=True)
class StepEnd:
    """A step's end: "done", "skipped" (by the operator) or "lacking" (not possible on the rig), with the
    reason.
    """

    step: str
    title: str
    what: str
    why: str = ""
    outcome: Outcome | None = None
    written: tuple[str, ...] = ()
    """The keys of the rig file that were changed."""

    def as_dict(self) -> dict[str, Any]:
        """Return plain values, without the curves, which are in the report."""
        outcome = self.outcome
        findings = [asdict(finding) for finding in outcome.findings] if outcome else []
        remarks = list(outcome.remarks) if outcome else []
        return {
            "step": self.step,
            "title": self.title,
            "what": self.what,
            "why": self.why,
            "written": list(self.written),
            "findings": findings,
            "remarks": remarks,
        }


def _utc_now() -> str:
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


class Session:
    """The commissioning of one rig file.

    Parameters
    ----------
    path : path of the rig file, which is written
    run : runs an exercise
    given : the operator's inputs
    overrides : ``SECTION.KEY=VALUE``, for this session alone
    axis : name of an axis, for a rig file with named axes; findings are written below ``[axis.NAME]``
    now : returns date and time as text, "2026-11-22T14:03:05Z"; the computer's by default

    Raises
    ------
    coulombus.rigs.rig.RigError
        the rig file is not valid, or it has named axes and `axis` is None
    CommissionError
        the folder of the commissioning has other content
    """

    def __init__(
        self,
        path: Path,
        run: Runner,
        inputs: Given,
        overrides: Sequence[str] = (),
        axis: str | None = None,
        *,
        now: Callable[[], str] = _utc_now,
    ) -> None:
        self.path, self.run, self.given, self.now = path, run, inputs, now
        self.overrides, self.axis = tuple(overrides), axis
        names = self._whole().axis_names
        if names and axis is None:
            has = f"the rig {path} has the axes {', '.join(names)}"
            raise RigError([f"{has}; commissioning is of one axis at a time: give --axis {names[0]}"])
        self.rig()
        self.state = Progress.load(folder_of(path, axis))

    def _whole(self) -> Rig:
        """Return the rig with all its axes."""
        return load_rig(str(self.path.resolve()), self.overrides)

    def rig(self) -> Rig:
        """Return the rig, or its axis as a separate rig, from the present file."""
        return self._whole().alone(self.axis)

    def do(self, step: Step, agree: Callable[[Step, Risk], bool]) -> StepEnd:
        """Do one step; `agree` is called before anything moves, and may refuse.

        Raises
        ------
        RunEnded
            the run was stopped by Ctrl-C or ``coulombus stop``
        coulombus.host.errors.SafetyTrip
            a run tripped
        CommissionError
            the recording does not give the result
        OSError, coulombus.rigs.rig.RigError
            the findings cannot be written; the rig file is unchanged
        """
        for last in (False, True):
            rig = self.rig()
            axis = rig.one_axis()
            lack = step.lacks(axis, self.given)
            if lack is not None:
                return StepEnd(step.name, step.title, "lacking", lack)
            if not agree(step, step.risk(axis, self.given)):
                return StepEnd(step.name, step.title, "skipped")
            self.state.folder.mkdir(parents=True, exist_ok=True)
            exercises = step.exercises(rig, self.given)
            runs = [self._run_exercise(step, exercise) for exercise in exercises]
            inputs = replace(self.given, shares=shares(self.state.steps))
            outcome = step.analyse(runs, axis, inputs)
            written = self._write(step, outcome)
            if not outcome.again or last:
                break
        record = outcome.as_dict() | {
            "at": self.now(),
            "title": step.title,
            "recordings": [f"{exercise.name}.pcapng" for exercise in exercises],
        }
        self.state.keep(step.name, record)
        return StepEnd(step.name, step.title, "done", outcome=outcome, written=written)

    def _run_exercise(self, step: Step, exercise: Exercise) -> ExerciseResult:
        """Run an exercise, and return its recording."""
        path = self.state.folder / f"{exercise.name}.pcapng"
        result = self.run(exercise, path)
        if result.stopped_by is not None:
            raise RunEnded(result.stopped_by, result.exit_status)
        trip = None
        if result.trip is not None:
            trip = TrippedExercise(result.trip.partition(":")[0], result.trip)
            if trip.name not in exercise.may_trip:
                raise SafetyTrip(f"step {step.name}: {result.trip}; nothing of it was written; the recording is {path}")
        return ExerciseResult(read(path), trip)

    def _write(self, step: Step, outcome: Outcome) -> tuple[str, ...]:
        """Write the findings into the rig file; return the changed keys."""
        changed = [finding for finding in outcome.findings if finding.key and finding.changed]
        if not changed:
            return ()
        at, rig = self.now(), self._whole()
        above = () if self.axis is None else ("axis", self.axis)  # shared keys hold for the other axes, too
        values = {
            (*above, *finding.key.split(".")): NewValue(finding.new, f"{at}: {_comment(finding)}")
            for finding in changed
        }
        text = rewritten(rig.text, values, MARK, str(self.path))
        load_rig_text(text, str(self.path.resolve()), overrides=self.overrides)  # an invalid file is not written
        stamp = at.replace(":", "").replace("-", "")
        backup = self.state.folder / f"{self.path.stem}.{stamp}.{step.name}.toml"
        replace_file(self.path, rig.text, text, backup)
        return tuple(dotted(key) for key in values)


def _comment(finding: Finding) -> str:
    """Return the comment for a finding above its key."""
    short = toml_value(finding.old) if finding.old is not None else "nothing"
    was = short if len(short) <= 40 else f"{short[:37]}..."
    reach = ""
    if finding.uncertainty is not None:
        reach = f"; 95 % on a rig as modelled: +- {finding.uncertainty:.2g} {finding.unit}"
    return f"was {was}{reach}; {finding.basis}".replace("\n", " ")


def results(done: Sequence[StepEnd]) -> Mapping[str, Any]:
    """Return the output of `coulombus commission --json`."""
    return {"steps": [end.as_dict() for end in done]}


def folder_of(rig_path: Path, axis: str | None = None) -> Path:
    """Return the folder of a rig file's commissioning, or the folder of an axis in it."""
    folder = rig_path.with_name(f"{rig_path.stem}.commission")
    return folder if axis is None else folder / axis


@dataclass
class Progress:
    """The finished steps, in their order.

    Attributes
    ----------
    folder : folder of the commissioning
    steps : name of a step -> {"at": time, "findings": [...], "remarks": [...], "curves": [...],
        "recordings": [...]}
    """

    folder: Path
    steps: dict[str, dict[str, Any]] = field(default_factory=dict)

    @property
    def path(self) -> Path:
        """Path of the state file."""
        return self.folder / "state.json"

    @classmethod
    def load(cls, folder: Path) -> Progress:
        """Return the progress in a folder; empty if there is none.

        Raises
        ------
        CommissionError
            the file is not a state of this version
        OSError
            the file cannot be read
        """
        state = cls(folder)
        try:
            with state.path.open("rb") as file:
                raw = file.read(LARGEST)
        except FileNotFoundError:
            return state
        try:
            values = json.loads(raw)
            if values["version"] != VERSION or not all(set(KEPT) <= step.keys() for step in values["steps"].values()):
                raise ValueError
        except (ValueError, KeyError, TypeError, AttributeError):
            refusal = f"this is no state of a commissioning (version {VERSION}); take the folder away to begin anew"
            raise CommissionError(f"{state.path}: {refusal}") from None
        state.steps = values["steps"]
        return state

    def keep(self, name: str, outcome: dict[str, Any]) -> None:
        """Store the outcome of a step; the file is replaced as a whole.

        Raises
        ------
        OSError
            the file cannot be written; it is unchanged
        """
        steps = {other: result for other, result in self.steps.items() if other != name} | {name: outcome}
        write_whole(self.path, json.dumps({"version": VERSION, "steps": steps}, indent=1).encode())
        self.steps = steps
