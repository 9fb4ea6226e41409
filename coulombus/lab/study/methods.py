r"""The psychophysical methods: which level a trial shows, from the answers so far.

A method has its trials of one condition. `level` is what the next trial shows, `take` learns the
answer. Both draw from the generator that they are given and from nothing else: the same answers
lead to the same levels, which is how an interrupted session goes on.

A staircase goes down by :math:`s` after `down` right answers in a row, and up by :math:`r s` after a
wrong one. It comes to rest where both are as likely [Levitt 1971, Kaernbach 1991]:

.. math:: p^{n} s = (1 - p^{n})\, r s, \qquad p = \left(\frac{r}{1 + r}\right)^{1/n},

which is 70.7 % for :math:`n = 2, r = 1`.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Sequence
from typing import Any, Protocol

import numpy as np

from coulombus.system.errors import CoulombusError

__all__ = ["Fixed", "Method", "Quest", "QuestMissing", "Staircase", "target"]

SIGMAS, CANDIDATES = 60, 25


class QuestMissing(CoulombusError):
    """The library of QUEST+ is not installed; the text says how to get it."""

    exit_status = 2


class Method(Protocol):
    """The trials of one condition."""

    @property
    def done(self) -> bool:
        """Whether all trials were answered."""

    def level(self) -> float:
        """Return what the next trial shows."""

    def take(self, level: float, right: bool) -> None:
        """Learn of the answer at a level."""


def target(down: int, up_ratio: float) -> float:
    """Return the share of right answers at which a staircase comes to rest."""
    return math.pow(up_ratio / (1.0 + up_ratio), 1.0 / down)


class Fixed:
    """Each level so many times, in an order drawn at random: constant stimuli, magnitudes."""

    def __init__(self, levels: Sequence[float], repeats: int, rng: np.random.Generator) -> None:
        self._waiting = [float(level) for level in rng.permutation(np.repeat(np.asarray(levels, float), repeats))][::-1]

    @property
    def done(self) -> bool:
        """Whether all trials were answered."""
        return not self._waiting

    def level(self) -> float:
        """Return what the next trial shows."""
        return self._waiting[-1]

    def take(self, level: float, right: bool) -> None:
        """Go on to the next level."""
        self._waiting.pop()


class Staircase:
    """A staircase of `trials` trials within `low` and `high`; each reversal goes on to the next of
    `steps`, the last of which stays.
    """

    def __init__(
        self, start: float, bounds: tuple[float, float], steps: Sequence[float], down: int, up_ratio: float, trials: int
    ) -> None:
        self._level, self._bounds, self._steps = start, bounds, tuple(steps)
        self._down, self._up_ratio, self._left = down, up_ratio, trials
        self._right, self._going, self.reversals = 0, 0, 0

    @property
    def done(self) -> bool:
        """Whether all trials were answered."""
        return self._left <= 0

    def level(self) -> float:
        """Return what the next trial shows."""
        return self._level

    def take(self, level: float, right: bool) -> None:
        """Go down after `down` right answers, up after a wrong one."""
        self._left -= 1
        self._right = self._right + 1 if right else 0
        if right and self._right < self._down:
            return
        going = -1 if right else 1
        self._right = 0
        self.reversals += self._going == -going
        self._going = going
        step = self._steps[min(self.reversals, len(self._steps) - 1)]
        moved = self._level + (-step if right else step * self._up_ratio)
        self._level = round(min(max(moved, self._bounds[0]), self._bounds[1]), 12)


class Quest:
    r"""QUEST+ for :math:`p = \Phi((x - x_{ref}) / \sigma)` [Watson 2017], by the library questplus: each
    trial shows the level after which the entropy of :math:`\sigma` is expected to be least.

    Raises
    ------
    QuestMissing
        questplus is not installed
    """

    def __init__(self, reference: float, bounds: tuple[float, float], trials: int, lapse: float) -> None:
        low, high = bounds
        span = high - reference
        self._quest: Any = _questplus()(
            stim_domain={"intensity": np.round(np.linspace(low, high, CANDIDATES), 12)},
            param_domain={
                "mean": np.array([reference]),
                "sd": np.geomspace(span / 100.0, span * 4.0, SIGMAS),
                "lower_asymptote": np.array([lapse / 2.0]),
                "lapse_rate": np.array([lapse / 2.0]),
            },
            outcome_domain={"response": ["right", "wrong"]},
            func="norm_cdf",
            stim_scale="linear",
        )
        self._left = trials
        self._next: float | None = None

    @property
    def done(self) -> bool:
        """Whether all trials were answered."""
        return self._left <= 0

    @property
    def believed(self) -> float:
        """The mean of sigma as QUEST+ believes it."""
        return float(self._quest.param_estimate["sd"])

    def level(self) -> float:
        """Return what the next trial shows."""
        if self._next is None:
            self._next = float(self._quest.next_stim["intensity"])
        return self._next

    def take(self, level: float, right: bool) -> None:
        """Weigh each sigma by the chance that it gave to the answer."""
        self._left -= 1
        self._next = None
        self._quest.update(stim={"intensity": level}, outcome={"response": "right" if right else "wrong"})


def _questplus() -> Any:
    try:
        return importlib.import_module("questplus.qp").QuestPlus
    except ImportError:
        raise QuestMissing("the method \"quest\" needs questplus: pip install '.[study]' in the clone") from None
