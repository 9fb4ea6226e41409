"""Commissioning in virtual time: a rig file is commissioned on a rig whose truth is known (`commission`).

The host uses its rig file, the simulated rig its true values, and a simulated hand follows the steps' instructions
(`rehearsed`).
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from coulombus.host.commission.report import write_report
from coulombus.host.commission.session import STEPS, Runner, Session, StepEnd, results
from coulombus.host.commission.step import CommissionError, Exercise, Finding, Given
from coulombus.host.run.result import RunResult
from coulombus.lab.simulate import simulate
from coulombus.rigs.arguments import path_text
from coulombus.rigs.rig import Rig

__all__ = ["Commissioned", "commission", "rehearsed"]


@dataclass(frozen=True)
class Commissioned:
    """The results of a commissioning.

    Attributes
    ----------
    steps : the end of each step, in their order
    rig_path : the rig file, with the findings
    report : the report of all completed steps, HTML; absent if there is none
    """

    steps: tuple[StepEnd, ...]
    rig_path: Path
    report: Path

    @property
    def findings(self) -> Mapping[str, Finding]:
        """Each finding by its key in the rig file, or by its name where it has no key."""
        outcomes = (step.outcome for step in self.steps if step.outcome is not None)
        return {finding.key or finding.name: finding for outcome in outcomes for finding in outcome.findings}

    def as_dict(self) -> dict[str, Any]:
        """Return the plain values of ``coulombus commission --json``."""
        return dict(results(self.steps))


def commission(
    path: str | os.PathLike[str],
    truth: Rig | None = None,
    *,
    steps: Sequence[str] = (),
    given: Given | None = None,
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Commissioned:
    """Commission a rig file in virtual time, and write the findings into it.

    Every step is repeated. A folder beside the rig file keeps recordings, old rig files and the
    report.

    Parameters
    ----------
    path : of the rig file
    truth : the simulated rig as it truly is; None: as the rig file says
    steps : names of steps, all by default; they run in their own order
    given : the operator's measurements, torques in Nm and angles in rad
    seed : of all random numbers
    progress : called with the time of each display [s]

    Raises
    ------
    CommissionError
        a step has another name, or a recording does not carry what the step looks for
    coulombus.host.errors.SafetyTrip
        a run tripped; the steps before it are written
    coulombus.rigs.rig.RigError
        the rig file is wrong, or has several axes
    """
    names = [step.name for step in STEPS]
    if unknown := [name for name in steps if name not in names]:
        raise CommissionError(f"steps={unknown[0]!r}: expected one of {', '.join(names)}")
    file = Path(path_text(path, "path", 'commission("my-rig.toml")'))
    session = Session(file, rehearsed(truth, seed=seed, progress=progress), given or Given())
    ends = []
    for step in STEPS:
        if not steps or step.name in steps:
            ends.append(session.do(step, lambda step, risk: True))
            if ends[-1].what == "done":
                write_report(session)  # of the steps so far, should the next step fail
    return Commissioned(tuple(ends), file, session.state.folder / "report.html")


def rehearsed(truth: Rig | None, *, seed: int = 0, progress: Callable[[float], None] | None = None) -> Runner:
    """Return a function that runs the exercises of commissioning in virtual time.

    Parameters
    ----------
    truth : the true rig; None: the rig file of each exercise
    seed : random seed
    """

    def run(exercise: Exercise, path: Path) -> RunResult:
        mode = exercise.rig.one_axis().mode[exercise.mode]
        same = (f"mode.{exercise.mode}.{key}={value!r}" for key, value in mode.model_dump().items())
        true = (truth or exercise.rig).variant(*exercise.hand, *same)  # the true rig may lack the mode
        return simulate(
            exercise.rig,
            exercise.mode,
            exercise.seconds,
            record=path,
            seed=seed,
            force=True,
            simulated=true,
            progress=progress,
        )

    return run
