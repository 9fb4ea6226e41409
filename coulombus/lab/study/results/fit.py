r"""Psychometric functions fitted to the answers of a subject, with intervals.

The chance that a level :math:`x` is taken as larger than the reference is

.. math:: p(x) = \frac{\lambda}{2} + (1 - \lambda)\, \Phi\left(\frac{x - \mu}{\sigma}\right),

with the share :math:`\lambda = 0.01` of answers given without attention, the point of subjective
equality :math:`\mu`, and :math:`JND = 0.6745\,\sigma` (from 50 % to 75 %). The fit is the one of most
likelihood. An interval of 95 % holds the values whose profile likelihood
:math:`2 (\ell_{max} - \ell)` is below 3.84 [Wilks 1938]. Where all levels are above the reference,
:math:`\mu` is the reference: they do not tell a bias from a slope.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from scipy.special import ndtr, ndtri, xlog1py, xlogy

from coulombus.lab.study.trials import LAPSE

__all__ = ["Fit", "Magnitudes", "fit_comparisons", "fit_magnitudes"]

QUARTER = float(ndtri(0.75))
LIKELY = 3.841458820694124
"""The 95 % quantile of chi-squared with one degree of freedom."""
SIGMAS, MUS = 301, 121


@dataclass(frozen=True)
class Fit:
    """A psychometric function.

    Attributes
    ----------
    trials : answers that it is fitted to
    pse : point of subjective equality, in units of the level
    jnd : just noticeable difference, in units of the level
    jnd_95 : its interval; None: the answers bound it on neither side, or not on that one
    weber : `jnd` over the reference; None where that is 0
    right : share of right answers
    """

    trials: int
    pse: float
    jnd: float
    jnd_95: tuple[float | None, float | None]
    weber: float | None
    right: float

    def as_dict(self) -> dict[str, Any]:
        """Return it as plain values for JSON."""
        return asdict(self)

    def chance(self, level: Any) -> Any:
        """Return the chance that a level is taken as larger."""
        return LAPSE / 2 + (1 - LAPSE) * ndtr((level - self.pse) / (self.jnd / QUARTER))


def fit_comparisons(levels: Sequence[float], larger: Sequence[bool], reference: float) -> Fit:
    """Return the psychometric function of comparisons with a reference.

    Parameters
    ----------
    levels : of each trial, shape (n,)
    larger : whether the level was taken as larger than the reference, shape (n,)

    Raises
    ------
    ValueError
        there is no trial, or no level differs from the reference
    """
    x, took = np.asarray(levels, float), np.asarray(larger, bool)
    span = float(np.max(np.abs(x - reference), initial=0.0))
    if span == 0:
        raise ValueError("no level differs from the reference; expected trials with levels that do")
    shown, where = np.unique(x, return_inverse=True)
    hits = np.bincount(where, weights=took, minlength=len(shown))
    misses = np.bincount(where, weights=~took, minlength=len(shown))
    sigma = np.geomspace(span / 200, span * 20, SIGMAS)
    one_sided = x.min() >= reference or x.max() <= reference
    mu = np.array([reference]) if one_sided else np.linspace(reference - span, reference + span, MUS)
    p = LAPSE / 2 + (1 - LAPSE) * ndtr((shown - mu[:, None, None]) / sigma[:, None])
    likely = (xlogy(hits, p) + xlog1py(misses, -p)).sum(axis=-1)
    row, column = np.unravel_index(int(np.argmax(likely)), likely.shape)
    profile = likely.max(axis=0)
    inside = np.flatnonzero(2 * (profile.max() - profile) < LIKELY)
    low = None if inside[0] == 0 else float(sigma[inside[0] - 1] * QUARTER)
    high = None if inside[-1] == SIGMAS - 1 else float(sigma[inside[-1] + 1] * QUARTER)
    jnd = float(sigma[column] * QUARTER)
    weber = jnd / abs(reference) if reference else None
    right = float(np.mean(np.where(x == reference, 0.5, took == (x > reference))))
    return Fit(len(x), float(mu[row]), jnd, (low, high), weber, right)


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
