r"""The psychophysical methods: which level a trial shows, from the answers so far.

A method has its trials of one condition. `level` is what the next trial shows, `update` learns the
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
from scipy.special import ndtr, xlogy

__all__ = ["Fixed", "Method", "Mirrored", "Quest", "Staircase", "mirrored", "target"]

SIGMAS, CANDIDATES = 60, 25
SHIFTS = tuple(float(shift) for shift in np.linspace(-1.5, 1.5, 9))
"""Shifts of the point of subjective equality that QUEST+ weighs, in units of sigma."""


class Method(Protocol):
    """The trials of one condition."""

    @property
    def done(self) -> bool:
        """Whether all trials were answered."""

    def level(self) -> float:
        """Return what the next trial shows."""

    def update(self, level: float, right: bool) -> None:
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

    def update(self, level: float, right: bool) -> None:
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

    def update(self, level: float, right: bool) -> None:
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


class Mirrored:
    """Two staircases that take turns at random: one above the reference, its mirror image below.

    The middle between them is the point of subjective equality, and their distance tells the slope
    [García-Pérez and Alcalá-Quintana 2011, doi:10.3758/s13414-011-0167-x]. Of each two trials one is
    of each staircase; of an odd number of trials the last is above.
    """

    def __init__(self, reference: float, above: Staircase, below: Staircase, rng: np.random.Generator) -> None:
        self._reference, self._above, self._below, self._rng = reference, above, below, rng
        self._turns: list[bool] = []

    @property
    def done(self) -> bool:
        """Whether all trials were answered."""
        return self._above.done and self._below.done

    def level(self) -> float:
        """Return what the next trial shows."""
        if not self._turns:
            self._turns = [True] if self._below.done else [bool(k) for k in self._rng.permutation(2)]
        return self._above.level() if self._turns[-1] else mirrored(self._below.level(), self._reference)

    def update(self, level: float, right: bool) -> None:
        """Let the staircase of the trial learn of the answer. At the reference, `right` means that the
        level was judged larger.
        """
        if self._turns.pop():
            self._above.update(level, right)
        else:
            self._below.update(mirrored(level, self._reference), right != (level == self._reference))


def mirrored(level: float, reference: float) -> float:
    """Return the level as far on the other side of the reference."""
    return round(2 * reference - level, 12)


class Quest:
    r"""QUEST+ for :math:`p = \Phi((x - x_{ref}) / \sigma - m)` [Watson 2017, doi:10.1167/17.3.10]: each trial
    shows the level after which the entropy of sigma and shift together is expected to be least.

    Parameters
    ----------
    bounds : lowest and highest level; levels on both sides of the reference tell the shift best
    shifts : which m are possible, with the prior of the analysis, standard normal
    """

    def __init__(
        self,
        reference: float,
        bounds: tuple[float, float],
        trials: int,
        lapse: float,
        shifts: Sequence[float] = SHIFTS,
    ) -> None:
        low, high = bounds
        span = max(high - reference, reference - low)
        count = CANDIDATES if low >= reference else 2 * CANDIDATES - 1
        self._levels = np.round(np.linspace(low, high, count), 12)
        sigma, shift = np.geomspace(span / 100.0, span * 4.0, SIGMAS), np.asarray(shifts, float)
        middle = (self._levels[:, None, None] - reference) / sigma[:, None] - shift
        larger = (lapse / 2 + (1 - lapse) * ndtr(middle)).reshape(count, -1)
        self._chances = np.stack([1 - larger, larger])  # of an answer, at a level, for a pair (sigma, shift)
        belief = np.tile(np.exp(-(shift**2) / 2), (SIGMAS, 1)).ravel()
        self._belief, self._sigma = belief / belief.sum(), np.repeat(sigma, len(shift))
        self._reference, self._left = reference, trials
        self._next: float | None = None

    @property
    def done(self) -> bool:
        """Whether all trials were answered."""
        return self._left <= 0

    @property
    def believed(self) -> float:
        """The mean of sigma as QUEST+ believes it."""
        return float(self._belief @ self._sigma)

    def level(self) -> float:
        """Return what the next trial shows."""
        if self._next is None:
            after = self._belief * self._chances
            share = after.sum(axis=2, keepdims=True)
            entropy = -xlogy(after, after / share).sum(axis=2).sum(axis=0)
            self._next = float(self._levels[np.argmin(entropy)])
        return self._next

    def update(self, level: float, right: bool) -> None:
        """Weigh each pair by the chance that it gave to the answer. At the reference, `right` means that
        the level was judged larger.
        """
        self._left -= 1
        self._next = None
        larger = right if level >= self._reference else not right
        self._belief = self._belief * self._chances[int(larger), int(np.argmin(np.abs(self._levels - level)))]
        self._belief /= self._belief.sum()
