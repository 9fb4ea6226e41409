r"""The just noticeable difference of a group, from the answers of its subjects.

The thresholds of the subjects are drawn from a log normal distribution:
:math:`\log\sigma_i \sim N(\theta, \tau^2)`. Each subject's answers enter by their whole likelihood of
:math:`\sigma_i`, so a subject whose answers tell little weighs little [Rouder and Lu 2005,
doi:10.3758/BF03196750]:

.. math:: p(\theta, \tau \mid answers) \propto p(\tau) \prod_i
          \int \sigma^2 L_i(\log\sigma)\, N(\log\sigma; \theta, \tau^2)\, d\log\sigma .

The factor :math:`\sigma^2` is that of the prior of a subject's fit (`posterior`): without it the
likelihood of some 80 answers puts :math:`\sigma` too low by a tenth, and a group of such subjects
repeats the error [bias reduction by a penalty: Firth 1993, doi:10.1093/biomet/80.1.27].
:math:`\theta` has a flat prior, :math:`\tau` a half normal prior of scale 0.5 [Gelman 2006,
doi:10.1214/06-BA117A]. The integrals are sums on a grid. The group's JND is
:math:`0.6745\,e^{\theta}`, the median of the subjects that the group stands for.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
from scipy.special import ndtri

from coulombus.lab.study.results.posterior import Posterior

__all__ = ["GroupFit", "hierarchical"]

Floats: TypeAlias = npt.NDArray[np.float64]

QUARTER = float(ndtri(0.75))
SPREAD_PRIOR = 0.5
NOTHING = -50.0
"""Log likelihood of what a subject's grid leaves out."""


@dataclass(frozen=True)
class GroupFit:
    """The hierarchical fit of a condition.

    Attributes
    ----------
    subjects : whose answers entered
    jnd, jnd_95 : of the group, in units of the level, and its interval
    spread, spread_95 : standard deviation of log JND between subjects
    subject_jnd : JND of each subject, drawn towards the group's as far as its answers leave it open
    """

    subjects: int
    jnd: float
    jnd_95: tuple[float, float]
    spread: float
    spread_95: tuple[float, float]
    subject_jnd: Mapping[str, float]

    def as_dict(self) -> dict[str, Any]:
        """Return it as plain values for JSON."""
        return asdict(self)


def hierarchical(posteriors: Mapping[str, Posterior]) -> GroupFit | None:
    """Return the group of subjects; None of fewer than two."""
    if len(posteriors) < 2:
        return None
    low = min(float(each.log_sigma[0]) for each in posteriors.values())
    high = max(float(each.log_sigma[-1]) for each in posteriors.values())
    log_sigma = np.linspace(low, high, 301)
    likelihood = _scaled(np.stack([_on(each, log_sigma) for each in posteriors.values()]))
    middle, spread = np.linspace(low, high, 121), np.geomspace(1.5 * (log_sigma[1] - log_sigma[0]), 2.0, 25)
    kernel = np.exp(-0.5 * ((log_sigma - middle[:, None, None]) / spread[:, None]) ** 2)
    kernel /= kernel.sum(axis=2, keepdims=True)
    each_subject = np.maximum(kernel @ likelihood.T, np.exp(2 * NOTHING))  # (middle, spread, subject)
    whole = np.log(each_subject).sum(axis=2) - 0.5 * (spread / SPREAD_PRIOR) ** 2 + np.log(spread)
    weight = np.exp(whole - whole.max())
    weight /= weight.sum()
    theta = _quantiles(middle, weight.sum(axis=1))
    tau = _quantiles(spread, weight.sum(axis=0))
    means = (kernel @ (likelihood * log_sigma).T) / each_subject
    jnds = np.exp(np.einsum("mt,mts->s", weight, means)) * QUARTER
    return GroupFit(
        subjects=len(posteriors),
        jnd=float(np.exp(theta[1]) * QUARTER),
        jnd_95=(float(np.exp(theta[0]) * QUARTER), float(np.exp(theta[2]) * QUARTER)),
        spread=float(tau[1]),
        spread_95=(float(tau[0]), float(tau[2])),
        subject_jnd=dict(zip(posteriors, jnds.tolist(), strict=True)),
    )


def _scaled(log_likelihood: Floats) -> Floats:
    """Return each row as a likelihood whose peak is 1."""
    return np.asarray(np.exp(log_likelihood - log_likelihood.max(axis=1, keepdims=True)), float)


def _on(subject: Posterior, log_sigma: Floats) -> Floats:
    """Return the log likelihood of a subject times sigma squared on another grid."""
    likelihood = subject.log_likelihood
    left = float(likelihood[0]) if subject.open_below else NOTHING
    right = float(likelihood[-1]) if subject.open_above else NOTHING
    return np.asarray(np.interp(log_sigma, subject.log_sigma, likelihood, left, right) + 2 * log_sigma, float)


def _quantiles(values: Floats, weight: Floats) -> Floats:
    share = np.cumsum(weight) - weight / 2
    return np.asarray(np.interp((0.025, 0.5, 0.975), share, values), float)
