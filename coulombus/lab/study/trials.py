"""The trials of a subject, one after the other, decided by the study, the subject's number and the
answers so far.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from coulombus.lab.study import methods
from coulombus.lab.study.study import Condition, Constant, Free, Quest, Staircase, Study

__all__ = ["LAPSE", "Trial", "Trials", "is_answer", "williams"]

LAPSE = 0.01
"""Share of answers that are drawn at random, as QUEST+ believes it."""
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

    def larger_named(self, answer: str) -> bool:
        """Tell whether the answer names the larger display; of two equal ones that of the level."""
        below = self.reference is not None and self.level < self.reference
        return self.right(answer) != below


def is_answer(text: str, trial: Trial, *, asked: bool = True) -> bool:
    """Tell whether a text answers a trial: 1 or 2 of two displays, a number from 0 of one; n/a where
    nothing is asked.
    """
    if not asked:
        return text == "n/a"
    if trial.reference is not None:
        return text in ("1", "2")
    return NUMBER.fullmatch(text) is not None and float(text) < LARGEST


def _staircase(table: Staircase, trials: int) -> methods.Staircase:
    bounds = (table.low, table.high)
    return methods.Staircase(table.start, bounds, table.steps, table.down, table.up_ratio, trials)


class Trials:
    """The trials of subject number `subject`, from 0."""

    def __init__(self, study: Study, subject: int) -> None:
        self._study = study
        self._rng = np.random.default_rng([study.file.seed, subject])
        rows = williams(len(study.conditions))
        self._order = rows[subject % len(rows)]
        self._methods = [self._method() for _ in study.conditions]
        self._training = [study.file.training] * len(study.conditions)
        self._firsts: dict[tuple[int, float | None, bool], list[int]] = {}
        self._number = self._place = 0
        self._now: Trial | None = None

    def _method(self) -> methods.Method:
        study, table = self._study, self._study.method
        if isinstance(table, Constant | Free):
            return methods.Fixed(table.levels, table.repeats, self._rng)
        reference = study.file.reference
        assert reference is not None
        if isinstance(table, Quest):
            low = table.low if table.sides == "above" else methods.mirrored(table.high, reference)
            return methods.Quest(reference, (low, table.high), table.trials, LAPSE)
        assert isinstance(table, Staircase)
        if table.sides == "above":
            return _staircase(table, table.trials)
        below = table.trials // 2
        above = _staircase(table, table.trials - below)
        return methods.Mirrored(reference, above, _staircase(table, below), self._rng)

    def _first(self, place: int, level: float, training: bool) -> int:
        """Return in which display the level is. At each level of constant stimuli, and else over the
        trials of a condition, both orders are met as often: four trials have each order twice.
        """
        table = self._study.method
        key = (place, level if isinstance(table, Constant) else None, training)
        waiting = self._firsts.setdefault(key, [])
        if not waiting:
            pairs = 1 if isinstance(table, Constant) else 2
            waiting += [int(first) for first in self._rng.permutation([1, 2] * pairs)]
        return waiting.pop()

    def _condition(self) -> int | None:
        """Return which condition is next."""
        waiting = [place for place in self._order if self._training[place] or not self._methods[place].done]
        if not waiting:
            return None
        return waiting[int(self._rng.integers(len(waiting)))] if self._study.file.order == "mixed" else waiting[0]

    def next(self) -> Trial | None:
        """Return the trial that waits for its answer; None: there is none any more."""
        if self._now is None:
            place = self._condition()
            if place is None:
                return None
            file, training = self._study.file, self._training[place] > 0
            level = self._trained() if training else self._methods[place].level()
            first = 0 if file.reference is None else self._first(place, level, training)
            self._number += 1
            self._place = place
            block = 1 if file.order == "mixed" else self._order.index(place) + 1
            condition = self._study.conditions[place]
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
            self._methods[self._place].update(now.level, now.larger_named(answer))
        self._now = None


def williams(count: int) -> list[list[int]]:
    """Return the rows of a Williams design [Williams 1949]: in each row every condition once, over all rows
    each in every place as often, and behind each other one as often. An odd `count` takes twice as many rows.
    """
    first = [0] + [(k + 1) // 2 if k % 2 else count - k // 2 for k in range(1, count)]
    rows = [[(place + shift) % count for place in first] for shift in range(count)]
    return rows if count % 2 == 0 else rows + [row[::-1] for row in rows]
