r"""Psychometric functions fitted to the answers of a subject, with intervals.

The function and its posterior are those of `posterior`; :math:`JND = 0.6745\,\sigma` (from 50 % to
75 %). Each figure is the median of its posterior, each interval of 95 % runs from its 2.5 % to its
97.5 % quantile [Schütt et al. 2016, doi:10.1016/j.visres.2016.02.002]. Where the range of
:math:`\sigma` ends before its likelihood does, the interval has no end there.

Levels on one side of the reference tell the shift hardly from the slope: then the interval of the JND
is wide, and that of the point of subjective equality is mostly its prior.

The goodness of a fit: deviance, its probability by simulation, overdispersion, drift.

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

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr, ndtri, xlogy
from scipy.stats import chi2

from coulombus.lab.study.results.posterior import CountedAnswers, Posterior, counted, orders, posterior, sigma_of_lapses

__all__ = ["LEAST_TRIALS", "Fit", "Magnitudes", "fit_answers", "fit_comparisons", "fit_magnitudes"]


Floats: TypeAlias = npt.NDArray[np.float64]

SIMULATIONS = 400
STEPS = 30
FARTHEST = 8.0
"""Largest distance from the middle, in sigma: beyond it every answer is the same."""


QUARTER = float(ndtri(0.75))
MANY_LAPSES = 0.1
LEAST_TRIALS = 20
"""A report fits no fewer answers than this: the function has four parameters."""
QUANTILES = (0.025, 0.5, 0.975)


@dataclass(frozen=True)
class Fit:
    """A psychometric function.

    Attributes
    ----------
    trials : answers that it is fitted to
    pse, pse_95 : point of subjective equality and its interval, in units of the level
    jnd : just noticeable difference, in units of the level
    jnd_95 : its interval; None: the answers bound it on neither side, or not on that one
    jnd_lapses : the JND if a tenth of the answers were lapses, which the prior takes to be rare and the
        answers themselves hardly tell
    weber : `jnd` over the reference; None where that is 0
    right : share of right answers
    lapse, lapse_95 : share of the answers that were drawn at random, and its interval
    bias, bias_95 : interval bias, in units of the level: above 0 the second display is judged larger;
        None where the order of the displays is unknown
    deviance, probability : how far the answers are from the function, and the share of simulated
        answers that are as far; below 0.05 the function does not describe the subject
    overdispersion : deviance over the mean of the simulated ones; 1: answers vary as they should
    drift, drift_probability : of the point of subjective equality from the first trial to the last, in units
        of the level, and the probability of one as large by chance
    one_sided : no level is on the other side of the reference, so shift and slope are hardly told apart
    """

    trials: int
    pse: float
    pse_95: tuple[float, float]
    jnd: float
    jnd_95: tuple[float | None, float | None]
    jnd_lapses: float
    weber: float | None
    right: float
    lapse: float
    lapse_95: tuple[float, float]
    bias: float | None
    bias_95: tuple[float, float] | None
    deviance: float
    probability: float
    overdispersion: float
    drift: float
    drift_probability: float
    one_sided: bool

    def as_dict(self) -> dict[str, Any]:
        """Return it as plain values for JSON."""
        return asdict(self)

    def chance(self, level: Any) -> Any:
        """Return the chance that a level is judged larger, the mean of both orders."""
        sigma, bias = self.jnd / QUARTER, self.bias or 0.0
        both = [ndtr((np.asarray(level) - self.pse + order * bias) / sigma) for order in (-1, 1)]
        return self.lapse / 2 + (1 - self.lapse) * (both[0] + both[1]) / 2


def fit_comparisons(
    levels: Sequence[float], larger: Sequence[bool], reference: float, second: Sequence[bool] | None = None
) -> Fit:
    """Return the psychometric function of comparisons with a reference.

    Parameters
    ----------
    levels : of each trial, shape (n,)
    larger : whether the level was judged larger than the reference, shape (n,)
    reference : in units of the level
    second : whether the level was the second display, shape (n,); None: unknown, no interval bias

    Raises
    ------
    ValueError
        there is no trial, or no level differs from the reference
    """
    return fit_answers(levels, larger, reference, second)[0]


def fit_answers(
    levels: Sequence[float], larger: Sequence[bool], reference: float, second: Sequence[bool] | None = None
) -> tuple[Fit, Posterior]:
    """Return the fit of `fit_comparisons` with the posterior that it is of."""
    x, judged = np.asarray(levels, float), np.asarray(larger, bool)
    answers = counted(levels, larger, reference, second)
    belief = posterior(answers)
    low, jnd, high = (float(sigma * QUARTER) for sigma in belief.sigma_at(QUANTILES))
    pse_low, pse, pse_high = (float(reference + shift) for shift in belief.distance_at(QUANTILES))
    lapse_low, lapse, lapse_high = (float(share) for share in belief.lapse_at(QUANTILES))
    bias_low, bias, bias_high = (float(bias) for bias in belief.bias_at(QUANTILES))
    deviance, probability, overdispersion = _goodness(answers, lapse)
    pse_drift, drift_probability = _drift(x - reference, orders(second, len(x)), judged, lapse)
    fit = Fit(
        trials=len(x),
        pse=pse,
        pse_95=(pse_low, pse_high),
        jnd=jnd,
        jnd_95=(None if belief.open_below else low, None if belief.open_above else high),
        jnd_lapses=QUARTER * sigma_of_lapses(answers, belief, MANY_LAPSES),
        weber=jnd / abs(reference) if reference else None,
        right=float(np.mean(np.where(x == reference, 0.5, judged == (x > reference)))),
        lapse=lapse,
        lapse_95=(lapse_low, lapse_high),
        bias=None if second is None else bias,
        bias_95=None if second is None else (bias_low, bias_high),
        deviance=deviance,
        probability=probability,
        overdispersion=overdispersion,
        drift=pse_drift,
        drift_probability=drift_probability,
        one_sided=bool(x.min() >= reference or x.max() <= reference),
    )
    return fit, belief


@dataclass(frozen=True)
class Magnitudes:
    """Stevens' power law of estimated magnitudes, log a = log k + n log x, by least squares.

    Attributes
    ----------
    exponent : n
    exponent_95 : its interval, of Student's t
    """

    trials: int
    exponent: float
    exponent_95: tuple[float, float]

    def as_dict(self) -> dict[str, Any]:
        """Return it as plain values for JSON."""
        return asdict(self)


def fit_magnitudes(levels: Sequence[float], answers: Sequence[float]) -> Magnitudes | None:
    """Return the power law of magnitudes; None of fewer than three above 0, or of one level."""
    from scipy.stats import linregress, t

    x, a = np.asarray(levels, float), np.asarray(answers, float)
    counted = (x > 0) & (a > 0)
    if counted.sum() < 3 or len(np.unique(x[counted])) < 2:
        return None
    line = linregress(np.log(x[counted]), np.log(a[counted]))
    half = float(t.ppf(0.975, int(counted.sum()) - 2)) * float(line.stderr)
    return Magnitudes(int(counted.sum()), float(line.slope), (float(line.slope) - half, float(line.slope) + half))


def _goodness(answers: CountedAnswers, lapse: float) -> tuple[float, float, float]:
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


def _drift(distance: Floats, order: Floats, larger: npt.NDArray[np.bool_], lapse: float) -> tuple[float, float]:
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
