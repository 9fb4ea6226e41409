r"""How well a psychometric function fits: deviance, its probability by simulation, overdispersion, drift.

The deviance compares the fitted chances :math:`p_i` with the observed shares :math:`y_i` of the
:math:`n_i` answers to each level in each order [Wichmann and Hill 2001, doi:10.3758/BF03194544, eq. 7]:

.. math:: D = 2 \sum_i n_i \left(y_i \log\frac{y_i}{p_i}
          + (1 - y_i) \log\frac{1 - y_i}{1 - p_i}\right).

With few answers a cell it is not distributed as chi-squared. So answers are simulated from the fitted
function at the same levels, and each simulated set is fitted again. The probability is the share of
simulated deviances that are as large, and the overdispersion is :math:`D` over their mean, which is 1
where each answer depends on its level alone. The levels of an adaptive method are held as they were
shown.

A point of subjective equality that drifts hides from the deviance where a method follows it: each
level is then judged as it should be. So the residuals are compared with the trials' order [section 4
of the same]: the score of a linear drift, :math:`U = \sum_j t_j (y_j - p_j)\, p_j' / (p_j (1 - p_j))` with
:math:`t` from -1 at the first trial to 1 at the last and :math:`p'` the slope, has the variance
:math:`V` that the fitted terms leave. :math:`U^2/V` is distributed as chi-squared with one degree of
freedom, and :math:`-2\,\sigma\,U/V` is the drift from the first trial to the last.
"""

from __future__ import annotations

from typing import TypeAlias

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr, xlogy
from scipy.stats import chi2

from coulombus.lab.study.results.posterior import Answers

__all__ = ["drift", "goodness"]

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
    design = _design(answers.distance, answers.order)
    chance, _ = _fit(answers.larger[None, :], trials, design, lapse)
    deviance = float(_deviance(answers.larger[None, :], trials, chance)[0])
    random = np.random.default_rng(0)
    simulated = random.binomial(trials.astype(int), chance[0], (SIMULATIONS, len(trials))).astype(float)
    others = _deviance(simulated, trials, _fit(simulated, trials, design, lapse)[0])
    share = (1 + int(np.sum(others >= deviance - 1e-9))) / (SIMULATIONS + 1)
    return deviance, share, deviance / max(float(others.mean()), 1e-9)


def drift(distance: Floats, order: Floats, larger: npt.NDArray[np.bool_], lapse: float) -> tuple[float, float]:
    """Return the drift of the point of subjective equality, and the probability of one as large by chance.

    Parameters
    ----------
    distance : of each trial's level from the reference, in the order of the trials, shape (n,)
    order : 1, -1 or 0 as in `posterior.Answers`, shape (n,)
    larger : whether the level was judged larger, shape (n,)
    lapse : share of the answers that are drawn at random

    Returns
    -------
    drift : from the first trial to the last, in units of the level; 0 where nothing tells it from the function
    probability : of a drift as large, either way, of a subject that has none
    """
    design = _design(distance, order)
    time = np.linspace(-1.0, 1.0, len(distance))
    chance, weights = _fit(larger[None, :].astype(float), np.ones(len(distance)), design, lapse)
    p, middle = chance[0], np.clip(design @ weights[0], -FARTHEST, FARTHEST)
    slope = _slope(middle, lapse)
    score = float(time @ ((larger - p) * slope / (p * (1 - p))))
    weight = slope**2 / (p * (1 - p))
    fitted = design.T @ (weight[:, None] * design) + 1e-6 * np.eye(design.shape[1])
    cross = design.T @ (weight * time)
    variance = float(time @ (weight * time) - cross @ np.linalg.solve(fitted, cross))
    if variance <= 1e-9 or weights[0, 0] <= 0.0:
        return 0.0, 1.0
    return -2.0 * score / variance * float(np.abs(distance).max()) / float(weights[0, 0]), float(
        chi2.sf(score**2 / variance, 1)
    )


def _design(distance: Floats, order: Floats) -> Floats:
    """Return a row for each cell or trial: its distance as a share of the largest, 1, and its order if there is one."""
    columns = np.stack([distance / np.abs(distance).max(), np.ones_like(distance), order], axis=1)
    return np.asarray(columns[:, columns.any(axis=0)])


def _slope(middle: Floats, lapse: float) -> Floats:
    """Return the derivative of the chance with respect to the distance in sigma."""
    return np.asarray((1 - lapse) * np.exp(-(middle**2) / 2) / np.sqrt(2 * np.pi))


def _fit(larger: Floats, trials: Floats, design: Floats, lapse: float) -> tuple[Floats, Floats]:
    """Return chances and weights of most likelihood of each row of answers, by Fisher scoring."""
    weights = np.zeros((len(larger), design.shape[1]))
    chance = np.empty_like(larger)
    for _ in range(STEPS):
        middle = np.clip(weights @ design.T, -FARTHEST, FARTHEST)
        chance = np.clip(lapse / 2 + (1 - lapse) * ndtr(middle), 1e-9, 1 - 1e-9)
        slope = _slope(middle, lapse)
        spread = chance * (1 - chance)
        gradient = ((larger - trials * chance) * slope / spread) @ design
        information = np.einsum("sc,ci,cj->sij", trials * slope**2 / spread, design, design)
        information += 1e-6 * np.eye(design.shape[1])
        step = np.linalg.solve(information, gradient[..., None])[..., 0]
        weights += step / np.maximum(1.0, np.abs(step).max(axis=1, keepdims=True) / 2.0)
    return chance, weights


def _deviance(larger: Floats, trials: Floats, chance: Floats) -> Floats:
    smaller = trials - larger
    full = xlogy(larger, larger / trials) + xlogy(smaller, smaller / trials)
    return np.asarray(2 * (full - xlogy(larger, chance) - xlogy(smaller, 1 - chance)).sum(axis=1), float)
