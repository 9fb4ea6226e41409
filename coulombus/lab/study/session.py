"""A session of a subject: displays, questions, breaks; it ends at any time and goes on later.

`SubjectSession` goes through the trials one call at a time, for a program that has its own screen
(PsychoPy); `run_session` asks `People` all the way. A display that trips, is stopped or loses its
deadlines ends the session; its trial is shown again when the session goes on.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from coulombus.host.run.result import RunResult
from coulombus.host.run.run import Outputs, Run
from coulombus.lab.study.displays import Displays
from coulombus.lab.study.study_folder import SubjectFolder
from coulombus.lab.study.trials import Trial, is_answer
from coulombus.rigs.rig import Rig
from coulombus.system.errors import CoulombusError

__all__ = ["Ended", "People", "Session", "SubjectSession", "WrongStep", "run_session"]

BY_SUBJECT = "stopped by the subject"


class Ended(CoulombusError):
    """The session has ended before its last trial; the same study and folder go on with it.

    Attributes
    ----------
    exit_status : of the display that ended it; else 0
    """

    def __init__(self, why: str, exit_status: int = 0) -> None:
        super().__init__(why)
        self.exit_status = exit_status


class WrongStep(CoulombusError):
    """What was called is not what comes next; the text says what does."""

    exit_status = 2


@dataclass(frozen=True)
class People:
    """Who is told and asked.

    Attributes
    ----------
    tell : says a text
    ask : returns the answer to a trial; None: the subject stops
    go_on : asks whether to go on after a text, a break or the consent; False: the subject stops
    clock : seconds, by which answers are timed; None: they are not
    """

    tell: Callable[[str], None]
    ask: Callable[[Trial], str | None]
    go_on: Callable[[str], bool]
    clock: Callable[[], float] | None = None

    @classmethod
    def simulated(cls, answer: Callable[[Trial], str]) -> People:
        """Return a subject that reads no text, answers each trial and always goes on."""
        return cls(tell=lambda text: None, ask=answer, go_on=lambda text: True)


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


class SubjectSession:
    """The trials that are left of a subject: show each display of a trial, then answer it.

    Parameters
    ----------
    folder : entered
    mark : called with what happens, as it happens: "trial 3", "display 1 begins", "display 1 ends",
        "answer 2"; blinded, so it tells neither condition nor level
    recorded : called with the recording of each display, when it has ended
    """

    def __init__(
        self,
        folder: SubjectFolder,
        displays: Displays,
        mark: Callable[[str], None] = lambda text: None,
        recorded: Callable[[Path], None] = lambda path: None,
    ) -> None:
        self.folder, self.study = folder, folder.study
        self.displays, self._mark, self._recorded = displays, mark, recorded
        self._trials = folder.resumed()
        self._rigs: dict[tuple[str, float], Rig] = {}
        self._shown = 0
        self._stopped = False
        self.answered = folder.answered

    @property
    def trial(self) -> Trial | None:
        """The trial that waits for its displays and its answer; None: no trial is left."""
        return self._trials.next()

    def __iter__(self) -> Iterator[Trial]:
        """Yield each trial that is left; each has to be answered before the next."""
        while (trial := self.trial) is not None:
            yield trial
            if self.trial is trial:
                raise WrongStep(f"trial {trial.number} has no answer; call answer() before the next trial")

    def stop(self) -> None:
        """End the display that is on safely, and let none begin; from any thread."""
        self._stopped = True
        self.displays.stop()

    def show(self, number: int) -> RunResult:
        """Show display `number`, from 1, of the trial; return when it has safely ended.

        Raises
        ------
        Ended
            it tripped, was stopped, or could not be kept
        WrongStep
            there is no such display, or no trial any more
        """
        trial = self.trial
        if trial is None or not 1 <= number <= len(trial.levels):
            count = 0 if trial is None else len(trial.levels)
            raise WrongStep(f"show({number}): the trial has {count} displays; expected 1 to {count}")
        self.check_stopped()
        level, file = trial.levels[number - 1], self.study.file
        key = trial.condition.name, level
        rig = self._rigs[key] = self._rigs.get(key) or self.study.variant(trial.condition, level)
        words = [file.seed, self.folder.number, trial.number, number]
        meta = {"subject": self.folder.subject, "trial": str(trial.number), "display": str(number)}
        display = Run(
            rig,
            trial.condition.mode,
            file.seconds,
            int(np.random.SeedSequence(words).generate_state(1)[0]),
            outputs=Outputs(record=self.folder.recording(trial, number), meta=meta, force=True),
        )
        if number == 1:
            self._mark(f"trial {trial.number}")
        self._mark(f"display {number} begins")
        result = self.displays(display)
        self._mark(f"display {number} ends")
        if result.recording is not None:
            self._recorded(Path(result.recording))
        if result.exit_status or result.trip or result.stopped_by:
            why = result.trip or result.stopped_by or f"exit status {result.exit_status}"
            raise Ended(f"trial {trial.number}: {why}", result.exit_status)
        self.check_stopped()
        self._shown = max(self._shown, number)
        return result

    def check_stopped(self) -> None:
        """Raise `Ended` where the subject has stopped."""
        if self._stopped:
            raise Ended(BY_SUBJECT)

    def answer(self, answer: str, seconds: float | None = None) -> None:
        """Keep the answer to the trial; it is on the disk when this returns.

        Parameters
        ----------
        answer : "1" or "2" of two displays, a number of one; where nothing is asked "n/a"
        seconds : how long it took, where that was measured

        Raises
        ------
        WrongStep
            it is no answer, or not every display of the trial was shown
        coulombus.lab.study.study_folder.StudyFolderError
            it cannot be kept
        """
        trial = self.trial
        if trial is None or self._shown < len(trial.levels):
            raise WrongStep("answer(): not every display of the trial was shown; call show() for each first")
        if not is_answer(answer, trial, asked=bool(self.study.file.question)):
            form = "a number of 0 or more" if trial.reference is None else "1 or 2"
            raise WrongStep(f"answer({answer!r}): expected {form if self.study.file.question else 'n/a'}, as text")
        if seconds is not None and not (math.isfinite(seconds) and seconds >= 0):
            raise WrongStep(f"answer(seconds={seconds!r}): expected a number of 0 or more, or None")
        self.folder.keep(trial, answer, seconds)
        self._mark(f"answer {answer}")
        self._trials.answer(answer)
        self.answered, self._shown = trial.number, 0

    def came_to(self, ended: Ended | None = None) -> Session:
        """Return what the session has come to."""
        if ended is None:
            return Session(self.folder.subject, self.answered, self.trial is None)
        return Session(self.folder.subject, self.answered, False, str(ended), ended.exit_status)


def run_session(session: SubjectSession, people: People) -> Session:
    """Show and ask what is left of a subject's trials."""
    try:
        _go_through(session, people)
    except Ended as ended:
        return session.came_to(ended)
    return session.came_to()


def _go_through(session: SubjectSession, people: People) -> None:
    file, first = session.study.file, session.trial
    if first is None:
        return
    for text, notice in ((file.consent, "consent"), (file.instructions, "instructions")):
        if text and not people.go_on(text):
            session.folder.note(notice, "refused")
            raise Ended(BY_SUBJECT)
        if text:
            session.folder.note(notice, "given" if notice == "consent" else "told")
    for trial in session:
        done = trial.number - 1
        rest = file.break_after and done and done % file.break_after == 0 and trial is not first
        if rest and not people.go_on("Time for a break."):
            raise Ended(BY_SUBJECT)
        people.tell(_headline(trial, file.blinded))
        for number in range(1, len(trial.levels) + 1):
            if len(trial.levels) > 1:
                people.tell(f"now {number}")
            session.show(number)
        if not file.question:
            session.answer("n/a")
            continue
        began_s = None if people.clock is None else people.clock()
        answer = people.ask(trial)
        if answer is None:
            raise Ended(BY_SUBJECT)
        session.answer(answer, None if began_s is None or people.clock is None else people.clock() - began_s)


def _headline(trial: Trial, blinded: bool) -> str:
    text = f"trial {trial.number}" + (" (training)" if trial.training else "")
    return text if blinded else f"{text}: {trial.condition.name}, level {trial.level:g}"
