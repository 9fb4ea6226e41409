"""A session of a subject: displays, questions, breaks; it ends at any time and goes on later.

Each display is a whole run of the rig, brought up, armed and safely ended like any other: in
virtual time (`virtual_display`), or on a bus (`host.run.real_run`). A display that trips, is
stopped or loses its deadlines ends the session; its trial is shown again when the session goes on.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from coulombus.host.run.result import RunResult
from coulombus.lab.experiment.folder import SubjectFolder
from coulombus.lab.experiment.trials import Trial
from coulombus.lab.simulate import simulate
from coulombus.rigs.rig import Rig

__all__ = ["Display", "People", "Session", "run_session", "virtual_display"]


@dataclass(frozen=True)
class Display:
    """One display of a trial: the order to show it."""

    rig: Rig
    mode: str
    seconds: float
    record: Path
    seed: int
    trial: int
    number: int


def virtual_display(display: Display) -> RunResult:
    """Show a display in virtual time, on the simulated rig, to its simulated hand."""
    return simulate(display.rig, display.mode, display.seconds, record=display.record, seed=display.seed, force=True)


@dataclass(frozen=True)
class People:
    """Who is told and asked.

    Attributes
    ----------
    tell : says a text
    ask : returns the answer to a trial; None: the subject stops
    go_on : asks whether to go on after a text, a break or the consent; False: the subject stops
    """

    tell: Callable[[str], None]
    ask: Callable[[Trial], str | None]
    go_on: Callable[[str], bool]


@dataclass(frozen=True)
class Session:
    """What a session came to.

    Attributes
    ----------
    trials : answered by now, those of earlier sessions too
    complete : no trial is left
    ended_by : why it ended before that
    exit_status : of the display that ended it; else 0
    """

    subject: str
    trials: int
    complete: bool
    ended_by: str | None = None
    exit_status: int = 0

    def as_dict(self) -> dict[str, Any]:
        """Return it as plain values for JSON."""
        return asdict(self)


def run_session(folder: SubjectFolder, show: Callable[[Display], RunResult], people: People) -> Session:
    """Show and ask what is left of a subject's trials."""
    study, trials = folder.study, folder.resumed()
    file = study.file
    trial = trials.next()
    if trial is None:
        return Session(folder.subject, _answered(folder), True)
    begun = trial.number
    rigs: dict[tuple[str, float], Rig] = {}
    for text in (file.consent, file.instructions):
        if text and not people.go_on(text):
            return Session(folder.subject, trial.number - 1, False, "stopped by the subject")
    while trial is not None:
        done = trial.number - 1
        rest = file.break_after and done and done % file.break_after == 0 and trial.number != begun
        if rest and not people.go_on("Time for a break."):
            return Session(folder.subject, done, False, "stopped by the subject")
        people.tell(_headline(trial, file.blinded))
        for number, level in enumerate(trial.levels, 1):
            if len(trial.levels) > 1:
                people.tell(f"display {number}")
            key = trial.condition.name, level
            rig = rigs[key] = rigs.get(key) or study.variant(trial.condition, level)
            seed = int(np.random.SeedSequence([file.seed, folder.number, trial.number, number]).generate_state(1)[0])
            record = folder.recording(trial, number)
            result = show(Display(rig, trial.condition.mode, file.seconds, record, seed, trial.number, number))
            if result.exit_status or result.trip or result.stopped_by:
                why = result.trip or result.stopped_by or f"exit status {result.exit_status}"
                return Session(folder.subject, done, False, f"trial {trial.number}: {why}", result.exit_status)
        answer = people.ask(trial) if file.question else "n/a"
        if answer is None:
            return Session(folder.subject, done, False, "stopped by the subject")
        folder.keep(trial, answer)
        trials.answer(answer)
        trial = trials.next()
    return Session(folder.subject, _answered(folder), True)


def _answered(folder: SubjectFolder) -> int:
    return folder.events.read_bytes().count(b"\n") - 1


def _headline(trial: Trial, blinded: bool) -> str:
    text = f"trial {trial.number}" + (" (training)" if trial.training else "")
    return text if blinded else f"{text}: {trial.condition.name}, level {trial.level:g}"
