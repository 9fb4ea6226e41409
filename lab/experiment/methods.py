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

import math
from collections.abc import Sequence
from typing import Protocol

import numpy as np
from scipy.special import ndtr

__all__ = ["Fixed", "Method", "Quest", "Staircase", "target"]

SIGMAS, CANDIDATES = 60, 25


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
        self._waiting = [float(one) for one in rng.permutation(np.repeat(np.asarray(levels, float), repeats))][::-1]

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
    r"""QUEST+ for :math:`p = \Phi((x - x_{ref}) / \sigma)` [Watson 2017]: each trial shows the level
    after which the entropy of :math:`\log\sigma` is expected to be least. An implementation of this
    project's own, of that one parameter.
    """

    def __init__(self, reference: float, bounds: tuple[float, float], trials: int, lapse: float) -> None:
        low, high = bounds
        self._levels = np.linspace(low, high, CANDIDATES)
        span = high - reference
        self._sigma = np.geomspace(span / 100.0, span * 4.0, SIGMAS)
        p = ndtr((self._levels[:, None] - reference) / self._sigma[None, :])
        self._p = lapse / 2.0 + (1.0 - lapse) * p
        self._weight = np.full(SIGMAS, 1.0 / SIGMAS)
        self._left = trials

    @property
    def done(self) -> bool:
        """Whether all trials were answered."""
        return self._left <= 0

    def level(self) -> float:
        """Return what the next trial shows."""
        expected = np.zeros(CANDIDATES)
        for chance in (self._p, 1.0 - self._p):
            joint = chance * self._weight
            whole = joint.sum(axis=1)
            posterior = joint / whole[:, None]
            expected -= whole * np.where(posterior > 0, posterior * np.log(np.maximum(posterior, 1e-300)), 0).sum(
                axis=1
            )
        return round(float(self._levels[int(np.argmin(expected))]), 12)

    def take(self, level: float, right: bool) -> None:
        """Weigh each sigma by the chance that it gave to the answer."""
        self._left -= 1
        p = self._p[int(np.argmin(np.abs(self._levels - level)))]
        self._weight = self._weight * (p if right else 1.0 - p)
        self._weight /= self._weight.sum()
