"""The trials of a subject, one after the other, decided by the study, the subject's number and the
answers so far.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from coulombus.lab.study import methods
from coulombus.lab.study.orders import williams
from coulombus.lab.study.study import Condition, Constant, Free, Quest, Staircase, Study

__all__ = ["LAPSE", "Trial", "Trials", "is_answer"]

LAPSE = 0.01
"""Share of answers that are given without attention, as analysis and QUEST+ believe it."""
NUMBER = re.compile(r"[0-9]{1,12}(\.[0-9]{0,12})?|\.[0-9]{1,12}")
LARGEST = 1e9
"""A magnitude is smaller."""


@dataclass(frozen=True)
class Trial:
    """What is shown next.

    Attributes
    ----------
    number, block : counted from 1
    first : in which display the level is, 1 or 2; 0: there is one display
    """

    number: int
    block: int
    condition: Condition
    training: bool
    level: float
    reference: float | None
    first: int

    @property
    def levels(self) -> tuple[float, ...]:
        """The levels of the displays, in their order."""
        if self.reference is None:
            return (self.level,)
        return (self.level, self.reference) if self.first == 1 else (self.reference, self.level)

    def right(self, answer: str) -> bool:
        """Tell whether the answer names the display of the level."""
        return self.first != 0 and answer == str(self.first)


def is_answer(text: str, trial: Trial, *, asked: bool = True) -> bool:
    """Tell whether a text answers a trial: 1 or 2 of two displays, a number from 0 of one; n/a where
    nothing is asked.
    """
    if not asked:
        return text == "n/a"
    if trial.reference is not None:
        return text in ("1", "2")
    return NUMBER.fullmatch(text) is not None and float(text) < LARGEST


class Trials:
    """The trials of subject number `subject`, from 0."""

    def __init__(self, study: Study, subject: int) -> None:
        self._study = study
        self._rng = np.random.default_rng([study.file.seed, subject])
        rows = williams(len(study.conditions))
        self._order = rows[subject % len(rows)]
        self._methods = [self._method() for _ in study.conditions]
        self._training = [study.file.training] * len(study.conditions)
        self._number = self._place = 0
        self._now: Trial | None = None

    def _method(self) -> methods.Method:
        study, table = self._study, self._study.method
        if isinstance(table, Constant | Free):
            return methods.Fixed(table.levels, table.repeats, self._rng)
        if isinstance(table, Staircase):
            return methods.Staircase(
                table.start, (table.low, table.high), table.steps, table.down, table.up_ratio, table.trials
            )
        assert isinstance(table, Quest)
        assert study.file.reference is not None
        return methods.Quest(study.file.reference, (table.low, table.high), table.trials, LAPSE)

    def _condition(self) -> int | None:
        """Return which condition is next."""
        waiting = [place for place in self._order if self._training[place] or not self._methods[place].done]
        if not waiting:
            return None
        return waiting[int(self._rng.integers(len(waiting)))] if self._study.file.order == "mixed" else waiting[0]

    def next(self) -> Trial | None:
        """Return the trial that waits for its answer; None: there is none any more."""
        if self._now is None:
            chosen = self._condition()
            if chosen is None:
                return None
            file, training = self._study.file, self._training[chosen] > 0
            level = self._trained() if training else self._methods[chosen].level()
            first = 0 if file.reference is None else int(self._rng.integers(1, 3))
            self._number += 1
            self._place = chosen
            block = 1 if file.order == "mixed" else self._order.index(chosen) + 1
            condition = self._study.conditions[chosen]
            self._now = Trial(self._number, block, condition, training, level, file.reference, first)
        return self._now

    def _trained(self) -> float:
        table = self._study.method
        if isinstance(table, Constant | Free):
            return float(table.levels[int(self._rng.integers(len(table.levels)))])
        return table.start if isinstance(table, Staircase) else table.high

    def answer(self, answer: str) -> None:
        """Take the answer to the trial that waits for one."""
        now = self._now
        assert now is not None
        if now.training:
            self._training[self._place] -= 1
        else:
            self._methods[self._place].take(now.level, now.right(answer))
        self._now = None
