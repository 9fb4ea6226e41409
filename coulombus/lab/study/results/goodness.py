r"""How well a psychometric function fits: deviance, its probability by simulation, overdispersion.

The deviance compares the fitted chances :math:`p_i` with the observed shares :math:`y_i` of the
:math:`n_i` answers to each level in each order [Wichmann and Hill 2001, doi:10.3758/BF03194544, eq. 7]:

.. math:: D = 2 \sum_i n_i \left(y_i \log\frac{y_i}{p_i}
          + (1 - y_i) \log\frac{1 - y_i}{1 - p_i}\right).

With few answers a cell it is not distributed as chi-squared. So answers are simulated from the fitted
function at the same levels, and each simulated set is fitted again. The probability is the share of
simulated deviances that are as large, and the overdispersion is :math:`D` over their mean, which is 1
where each answer depends on its level alone. The levels of an adaptive method are held as they were
shown.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr, xlogy

from coulombus.lab.study.results.posterior import Answers

__all__ = ["goodness"]

Floats: TypeAlias = npt.NDArray[np.float64]

SIMULATIONS = 400
STEPS = 30
FARTHEST = 8.0
"""Largest distance from the middle, in sigma: beyond it every answer is the same."""


def goodness(answers: Answers, lapse: float) -> tuple[float, float, float]:
    """Return deviance, its probability and the overdispersion; the lapse rate is given.

    The same answers give the same bytes: the simulation has a seed of its own.
    """
    trials = answers.larger + answers.smaller
    scale = np.abs(answers.distance).max()
    design = np.stack([answers.distance / scale, np.ones_like(trials), answers.order], axis=1)
    design = design[:, design.any(axis=0)]
    chance = _fitted(answers.larger[None, :], trials, design, lapse)
    deviance = float(_deviance(answers.larger[None, :], trials, chance)[0])
    random = np.random.default_rng(0)
    simulated = random.binomial(trials.astype(int), chance[0], (SIMULATIONS, len(trials))).astype(float)
    others = _deviance(simulated, trials, _fitted(simulated, trials, design, lapse))
    share = (1 + int(np.sum(others >= deviance - 1e-9))) / (SIMULATIONS + 1)
    return deviance, share, deviance / max(float(others.mean()), 1e-9)


def _fitted(larger: Floats, trials: Floats, design: Floats, lapse: float) -> Floats:
    """Return the chances of most likelihood of each row of answers, by Fisher scoring."""
    weights = np.zeros((len(larger), design.shape[1]))
    chance = np.empty_like(larger)
    for _ in range(STEPS):
        middle = np.clip(weights @ design.T, -FARTHEST, FARTHEST)
        chance = np.clip(lapse / 2 + (1 - lapse) * ndtr(middle), 1e-9, 1 - 1e-9)
        slope = (1 - lapse) * np.exp(-(middle**2) / 2) / np.sqrt(2 * np.pi)
        spread = chance * (1 - chance)
        gradient = ((larger - trials * chance) * slope / spread) @ design
        information = np.einsum("sc,ci,cj->sij", trials * slope**2 / spread, design, design)
        information += 1e-6 * np.eye(design.shape[1])
        step = np.linalg.solve(information, gradient[..., None])[..., 0]
        weights += step / np.maximum(1.0, np.abs(step).max(axis=1, keepdims=True) / 2.0)
    return chance


def _deviance(larger: Floats, trials: Floats, chance: Floats) -> Floats:
    smaller = trials - larger
    full = xlogy(larger, larger / trials) + xlogy(smaller, smaller / trials)
    return np.asarray(2 * (full - xlogy(larger, chance) - xlogy(smaller, 1 - chance)).sum(axis=1), float)
