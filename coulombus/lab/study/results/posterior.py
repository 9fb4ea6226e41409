r"""The posterior of a psychometric function on a grid.

The chance that a level :math:`x` is judged larger than the reference :math:`x_{ref}` is

.. math:: p(x, s) = \frac{\lambda}{2} + (1 - \lambda)\,
          \Phi\left(\frac{x - x_{ref} - \delta + s\,\beta}{\sigma}\right),

with :math:`s = 1` where the level is the second display and :math:`-1` where it is the first. The shift
:math:`\delta` puts the point of subjective equality at :math:`x_{ref} + \delta`. A positive interval
bias :math:`\beta` favours the second display [García-Pérez and Alcalá-Quintana 2011,
doi:10.3758/s13414-011-0167-x]. A share :math:`\lambda` of the answers, the lapses, is drawn at random
[Wichmann and Hill 2001, doi:10.3758/BF03194544].

The posterior is the likelihood times a prior, on a grid of :math:`\log\sigma`, :math:`\delta/\sigma`,
:math:`\beta/\sigma` and :math:`\lambda` [Schütt, Harmeling, Macke and Wichmann 2016,
doi:10.1016/j.visres.2016.02.002]. The priors are

- :math:`\sigma`: Rayleigh, its mode the largest distance of a level from the reference;
- :math:`\delta/\sigma` and :math:`\beta/\sigma`: standard normal;
- :math:`\lambda`: Beta(1, 40), mean 2.4 %, at eight of its quantiles, from 0.2 to 6.7 %.

Two coarse grids find where the posterior is above :math:`e^{-9}` of its peak, a fine grid covers that.
`python -m benchmarks observers` measures how often the intervals hold the truth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt
from scipy.special import ndtr

__all__ = ["CountedAnswers", "Posterior", "counted", "orders", "posterior", "sigma_of_lapses"]

Floats: TypeAlias = npt.NDArray[np.float64]

LAPSES_BETA = 40.0
NARROWEST, WIDEST = 0.01, 5.0
"""Range of sigma, as shares of the largest distance of a level from the reference."""
NEGLIGIBLE = 9.0
"""The fine grid leaves out what is less likely than the peak by this factor of e, and by a share of each
answer on top: many answers have a narrow peak, which may stand between the points of a coarse grid.
"""
COARSE, POINTS = (25, 17, 11), (41, 40, 14)
"""Of a coarse and of the fine grid. Even numbers: no point of every sigma stands at a shift of 0."""
NEGLIGIBLE_WEIGHT = 1e-5
"""Points of the grid with less than this share of the largest weight have no part in a band."""
TINY = 1e-12


@dataclass(frozen=True)
class CountedAnswers:
    """Answers counted by level and order.

    Attributes
    ----------
    distance : of the level from the reference, in units of the level, shape (n,)
    order : 1: the level was the second display; -1: the first; 0: unknown, shape (n,)
    larger, smaller : how often the level was judged so, shape (n,)
    """

    distance: Floats
    order: Floats
    larger: Floats
    smaller: Floats


def orders(second: Sequence[bool] | None, trials: int) -> Floats:
    """Return the order of each trial's displays, as in `CountedAnswers`."""
    return np.zeros(trials) if second is None else np.where(np.asarray(second, bool), 1.0, -1.0)


def counted(
    levels: Sequence[float], larger: Sequence[bool], reference: float, second: Sequence[bool] | None
) -> CountedAnswers:
    """Return answers counted by level and order; `second`: whether the level was the second display."""
    judged = np.asarray(larger, bool)
    order = orders(second, len(judged))
    trials = np.stack([np.asarray(levels, float) - reference, order], axis=1)
    cells, where = np.unique(trials, axis=0, return_inverse=True)
    where = where.ravel()
    hits, misses = (np.asarray(np.bincount(where, answers, len(cells)), float) for answers in (judged, ~judged))
    return CountedAnswers(cells[:, 0], cells[:, 1], hits, misses)


@dataclass(frozen=True)
class Posterior:
    """A posterior on its grid.

    Attributes
    ----------
    log_sigma, shift, bias, lapse : the grid's axes; shift and bias in units of sigma
    weight : posterior, sums to 1, shape of the four axes
    log_likelihood : of sigma, the other parameters integrated over their priors, shape of `log_sigma`
    open_below, open_above : the range of sigma ends before its likelihood does
    """

    log_sigma: Floats
    shift: Floats
    bias: Floats
    lapse: Floats
    weight: Floats
    log_likelihood: Floats
    open_below: bool
    open_above: bool

    def sigma_at(self, shares: Sequence[float]) -> Floats:
        """Return quantiles of sigma."""
        return np.exp(_quantiles(self.log_sigma, self.weight.sum(axis=(1, 2, 3)), shares))

    def distance_at(self, shares: Sequence[float]) -> Floats:
        """Return quantiles of the distance of the point of subjective equality from the reference."""
        distance = np.exp(self.log_sigma)[:, None] * self.shift
        return _quantiles(distance.ravel(), self.weight.sum(axis=(2, 3)).ravel(), shares)

    def bias_at(self, shares: Sequence[float]) -> Floats:
        """Return quantiles of the interval bias, in units of the level."""
        bias = np.exp(self.log_sigma)[:, None] * self.bias
        return _quantiles(bias.ravel(), self.weight.sum(axis=(1, 3)).ravel(), shares)

    def lapse_at(self, shares: Sequence[float]) -> Floats:
        """Return quantiles of the lapse rate."""
        return _quantiles(self.lapse, self.weight.sum(axis=(0, 1, 2)), shares)

    def chance_at(self, distances: Floats, shares: Sequence[float]) -> Floats:
        """Return quantiles of the chance that a level is judged larger, the mean of both orders.

        Parameters
        ----------
        distances : of the levels from the reference, in units of the level, shape (n,)

        Returns
        -------
        quantiles at each distance, shape (n, number of shares)
        """
        weight = self.weight.ravel()
        likely = np.flatnonzero(weight > NEGLIGIBLE_WEIGHT * weight.max())
        sigma, shift, bias, lapse = np.unravel_index(likely, self.weight.shape)
        share, lapses = weight[likely] / weight[likely].sum(), self.lapse[lapse]
        rows = []
        for distance in distances:
            z = distance / np.exp(self.log_sigma[sigma]) - self.shift[shift]
            both = ndtr(z - self.bias[bias]) + ndtr(z + self.bias[bias])
            rows.append(_quantiles(lapses / 2 + (1 - lapses) * both / 2, share, shares))
        return np.asarray(rows, float)


def _quantiles(values: Floats, weight: Floats, shares: Sequence[float]) -> Floats:
    ranking = np.argsort(values, kind="stable")
    share = np.cumsum(weight[ranking]) - weight[ranking] / 2
    return np.asarray(np.interp(shares, share, values[ranking]), float)


def posterior(answers: CountedAnswers) -> Posterior:
    """Return the posterior of sigma, shift, interval bias and lapse rate.

    Where no order is known the interval bias is 0.

    Raises
    ------
    ValueError
        no level differs from the reference
    """
    span = float(np.max(np.abs(answers.distance), initial=0.0))
    if span == 0:
        raise ValueError("no level differs from the reference; expected trials with levels that do")
    edges = float(np.log(span * NARROWEST)), float(np.log(span * WIDEST))
    axes: list[Floats] = [np.linspace(edges[0], edges[1], 25), np.linspace(-3, 3, 17), np.zeros(1)]
    if answers.order.any():
        axes[2] = np.linspace(-2, 2, 11)
    trials = float((answers.larger + answers.smaller).sum())
    for points, an_answer in ((COARSE, 0.05), (POINTS, 0.01)):
        coarse = _log_posterior(answers, axes, _lapses(4), span)
        negligible = NEGLIGIBLE + an_answer * trials
        axes = [_zoomed(coarse, axis, k, points[k], negligible) for k, axis in enumerate(axes)]
    lapse = _lapses(8)
    fine = _log_posterior(answers, axes, lapse, span)
    weight = np.exp(fine - fine.max())
    sigma = weight.sum(axis=(1, 2, 3))
    likelihood = np.log(sigma) - _log_prior_of_sigma(axes[0], span)
    peak = float(likelihood.max())
    bounded = 1.92  # half the 95 % quantile of chi-squared with one degree of freedom [Wilks 1938]
    return Posterior(
        axes[0],
        axes[1],
        axes[2],
        lapse,
        weight / weight.sum(),
        likelihood - peak,
        open_below=bool(np.isclose(axes[0][0], edges[0]) and likelihood[0] > peak - bounded),
        open_above=bool(np.isclose(axes[0][-1], edges[1]) and likelihood[-1] > peak - bounded),
    )


def sigma_of_lapses(answers: CountedAnswers, belief: Posterior, lapse: float) -> float:
    """Return the median of sigma if a share `lapse` of the answers are lapses."""
    span = float(np.max(np.abs(answers.distance)))
    supposed = _log_posterior(answers, (belief.log_sigma, belief.shift, belief.bias), np.array([lapse]), span)
    weight = np.exp(supposed - supposed.max()).sum(axis=(1, 2, 3))
    (log_sigma,) = _quantiles(belief.log_sigma, weight / weight.sum(), (0.5,))
    return float(np.exp(log_sigma))


def _lapses(count: int) -> Floats:
    """Return the middle quantiles of the prior of the lapse rate: all are as likely."""
    middles = (np.arange(count) + 0.5) / count
    return np.asarray(1 - (1 - middles) ** (1 / LAPSES_BETA), float)


def _log_prior_of_sigma(log_sigma: Floats, span: float) -> Floats:
    """Return the Rayleigh prior of sigma as a density of log sigma, without its constant."""
    return np.asarray(2 * log_sigma - 0.5 * (np.exp(log_sigma) / span) ** 2, float)


def _log_posterior(answers: CountedAnswers, axes: Sequence[Floats], lapses: Floats, span: float) -> Floats:
    log_sigma, shift, bias = axes
    scaled = answers.distance / np.exp(log_sigma)[:, None]
    chance = ndtr(scaled[:, None, None, :] - shift[None, :, None, None] + answers.order * bias[None, None, :, None])
    whole = np.empty((*chance.shape[:3], len(lapses)))
    for k, lapse in enumerate(lapses):
        p = np.clip(lapse / 2 + (1 - lapse) * chance, TINY, 1 - TINY)
        whole[..., k] = np.log(p) @ answers.larger + np.log1p(-p) @ answers.smaller
    whole += _log_prior_of_sigma(log_sigma, span)[:, None, None, None]
    whole -= 0.5 * shift[None, :, None, None] ** 2 + 0.5 * bias[None, None, :, None] ** 2
    return whole


def _zoomed(log_posterior: Floats, axis: Floats, k: int, count: int, negligible: float) -> Floats:
    """Return an axis of `count` values over what is not negligible."""
    if len(axis) == 1:
        return axis
    profile = log_posterior.max(axis=tuple(other for other in range(4) if other != k))
    inside = np.flatnonzero(profile > profile.max() - negligible)
    return np.linspace(axis[max(inside[0] - 1, 0)], axis[min(inside[-1] + 1, len(axis) - 1)], count)
