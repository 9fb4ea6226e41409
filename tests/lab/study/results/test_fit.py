"""Fits of simulated studies whose threshold is known."""

import numpy as np
import pytest
from scipy.special import ndtr, ndtri

from coulombus.lab.study.methods import CANDIDATES, SIGMAS, Fixed, Quest, Staircase
from coulombus.lab.study.results.fit import fit_comparisons, fit_magnitudes

JND, REFERENCE = 0.15, 2.0
LAPSE = 0.01


class QuickQuest:
    """QUEST+ by its equation [Watson 2017], in arrays: the library takes 9 ms for a trial."""

    levels = np.round(np.linspace(2.0, 3.2, CANDIDATES), 12)
    sigmas = np.geomspace(1.2 / 100.0, 1.2 * 4.0, SIGMAS)
    right = LAPSE / 2 + (1 - LAPSE) * ndtr((levels[:, None] - REFERENCE) / sigmas)
    chances = np.array([1 - right, right])  # of an answer, at a level, where sigma is so

    def __init__(self):
        self._belief, self._left = np.full(SIGMAS, 1.0 / SIGMAS), 80

    @property
    def done(self):
        return self._left == 0

    def level(self):
        after = self._belief * self.chances
        share = after.sum(axis=2)
        after /= share[..., None]
        return self.levels[np.argmin((share * -(after * np.log(after)).sum(axis=2)).sum(axis=0))]

    def take(self, level, right):
        self._left -= 1
        self._belief = self._belief * self.chances[int(right), np.flatnonzero(self.levels == level)[0]]
        self._belief /= self._belief.sum()


METHODS = {
    "constant": lambda rng: Fixed([1.6, 1.8, 1.9, 2.1, 2.2, 2.4], 30, rng),
    "staircase": lambda rng: Staircase(2.8, (2.0, 3.2), [0.2, 0.1, 0.05], 2, 1.0, 120),
    "weighted": lambda rng: Staircase(2.8, (2.0, 3.2), [0.1, 0.05], 1, 3.0, 120),
    "quest": lambda rng: QuickQuest(),
}


def simulated(method, rng):
    levels, larger = [], []
    while not method.done:
        level = method.level()
        took = level + rng.normal() * JND / ndtri(0.75) > REFERENCE
        levels.append(level)
        larger.append(bool(took))
        method.take(level, bool(took == (level > REFERENCE)))
    return levels, larger


@pytest.mark.parametrize("kind", METHODS)
def test_the_interval_holds_the_true_threshold_in_90_to_99_of_100_studies(kind):
    held, found = 0, []
    for seed in range(100):
        rng = np.random.default_rng([20, seed])
        fit = fit_comparisons(*simulated(METHODS[kind](rng), rng), REFERENCE)
        low, high = fit.jnd_95
        held += (low or 0.0) <= JND <= (high or np.inf)
        found.append(fit.jnd)
    assert 90 <= held <= 99
    assert np.median(found) == pytest.approx(JND, rel=0.1)


@pytest.mark.parametrize("seed", range(2))
def test_quest_shows_the_level_that_its_equation_asks_for(seed):
    quick = simulated(QuickQuest(), np.random.default_rng([20, seed]))
    assert simulated(Quest(REFERENCE, (2.0, 3.2), 80, LAPSE), np.random.default_rng([20, seed])) == quick
    assert len(set(quick[0])) > 5


def test_a_fit_is_told_with_its_bias_and_weber_fraction():
    rng = np.random.default_rng(3)
    levels = np.repeat([1.6, 1.8, 2.0, 2.2, 2.4, 2.6], 2000)
    fit = fit_comparisons(levels, rng.random(len(levels)) < ndtr((levels - 2.1) / 0.25), REFERENCE)
    assert fit.pse == pytest.approx(2.1, abs=0.02)
    assert fit.jnd == pytest.approx(0.25 * ndtri(0.75), rel=0.05)
    assert fit.weber == fit.jnd / 2.0
    assert fit.chance(fit.pse) == pytest.approx(0.5)


def test_answers_that_bound_nothing_say_so():
    fit = fit_comparisons([2.2] * 5, [True] * 5, REFERENCE)
    assert fit.jnd_95[0] is None
    assert fit_comparisons([2.2, 2.2], [True, False], REFERENCE).jnd_95[1] is None
    with pytest.raises(ValueError, match="no level differs"):
        fit_comparisons([2.0], [True], REFERENCE)


def test_magnitudes_follow_a_power_law():
    levels = np.repeat([1.0, 1.5, 2.0, 3.0], 30)
    answers = 10 * levels**0.8 * np.exp(np.random.default_rng(1).normal(0, 0.1, len(levels)))
    found = fit_magnitudes(levels, answers)
    assert found.exponent_95[0] < 0.8 < found.exponent_95[1]
    assert found.exponent_95[1] - found.exponent_95[0] < 0.2
    assert fit_magnitudes([1.0, 1.0, 1.0], [1.0, 2.0, 3.0]) is None
