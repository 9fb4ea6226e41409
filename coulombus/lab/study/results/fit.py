r"""Psychometric functions fitted to the answers of a subject, with intervals.

The function and its posterior are those of `posterior`; :math:`JND = 0.6745\,\sigma` (from 50 % to
75 %). Each figure is the median of its posterior, each interval of 95 % runs from its 2.5 % to its
97.5 % quantile [Schütt et al. 2016, doi:10.1016/j.visres.2016.02.002]. Where the range of
:math:`\sigma` ends before its likelihood does, the interval has no end there.

Levels on one side of the reference tell the shift hardly from the slope: then the interval of the JND
is wide, and that of the point of subjective equality is mostly its prior.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.special import ndtr, ndtri

from coulombus.lab.study.results.goodness import drift, goodness
from coulombus.lab.study.results.posterior import Posterior, counted, orders, posterior, sigma_of_lapses

__all__ = ["LEAST_TRIALS", "Fit", "Magnitudes", "fit_answers", "fit_comparisons", "fit_magnitudes"]

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
    deviance, probability, overdispersion = goodness(answers, lapse)
    pse_drift, drift_probability = drift(x - reference, orders(second, len(x)), judged, lapse)
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
