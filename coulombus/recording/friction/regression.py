r"""Least squares with regressor errors of known variance and correlated residuals.

An error of known variance in a regressor shrinks its coefficient; the normal equations are
corrected for it (W. A. Fuller, Measurement Error Models, 1987, section 2.2),

.. math:: \hat\beta = (X^T X - n \Sigma)^{-1} X^T y.

Neighbouring rows share samples, the sensors' quantisation and model errors. The covariance is
therefore that of clusters: a slide, or each `CLUSTER_EQUATIONS` of a long one. Each cluster's
residuals are corrected for its own leverage (CR2), and the intervals are 95 % of Student's t with
the degrees of freedom of the coefficient's clusters (Satterthwaite): R. M. Bell, D. F. McCaffrey,
Survey Methodology 28(2):169-181, 2002.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt
from scipy.special import stdtrit

from coulombus.recording.friction.sliding import IdentifyError

__all__ = [
    "CONFIDENCE",
    "Column",
    "Estimate",
    "Solution",
    "SpeedLevels",
    "clusters_of",
    "correction_reach",
    "covariance_of",
    "regress",
    "solve",
    "standard_errors",
    "widened",
]

Floats: TypeAlias = npt.NDArray[np.float64]
Integers: TypeAlias = npt.NDArray[np.int64]
Column: TypeAlias = tuple[Floats, float]
"""A regressor and its error variance."""

CONFIDENCE = 0.95
CLUSTER_EQUATIONS = 15
"""Equations per cluster, about 0.2 s of a slide: equations are a quarter of a window apart."""
LEAST_EQUATIONS = 4
"""Least equations of a cluster: a window's length."""
LEAST_CLUSTERS = 6
LEVEL_WIDTH = 0.25
"""Width of a level in the logarithm of the speed."""
LEVEL_SHARE = 0.3
"""Common share of the quantisation error, measured on simulated rigs; the rest averages over
cogging, noise and changes of speed.
"""


@dataclass(frozen=True)
class Estimate:
    """A fitted value and its 95 % confidence interval."""

    value: float
    low: float
    high: float

    @property
    def reach(self) -> float:
        """Half the width of the interval."""
        return 0.5 * (self.high - self.low)

    def __str__(self) -> str:
        return f"{self.value:#.4g} [{self.low:#.4g}, {self.high:#.4g}]"


@dataclass(frozen=True)
class Solution:
    """Solution of least squares with regressor errors of known variance.

    Columns of Z have unit mean square.
    """

    Z: Floats
    scale: Floats
    inverse: Floats
    error: Floats
    """Variances of the errors in the columns of Z, on the diagonal."""
    beta: Floats
    residual: Floats

    @property
    def rss(self) -> float:
        """Sum of the squared residuals."""
        return float(self.residual @ self.residual)


def solve(X: Floats, y: Floats, variances: Floats) -> Solution:
    """Solve least squares; `variances`: error variances of the columns of `X`.

    Raises
    ------
    IdentifyError
        the rows do not tell the coefficients apart
    """
    scale = np.sqrt(np.mean(X**2, axis=0))
    Z = X / scale
    error = np.diag(variances / scale**2)
    try:
        inverse = np.linalg.inv(Z.T @ Z - len(y) * error)
    except np.linalg.LinAlgError:
        raise IdentifyError(
            "the strokes do not tell the parameters apart: record strokes at two speeds or more"
        ) from None
    beta = inverse @ (Z.T @ y)
    return Solution(Z, scale, inverse, error, beta, y - Z @ beta)


def clusters_of(slide: Integers) -> list[Integers]:
    """Return the rows of each cluster: a slide, or equal parts of a long one."""
    long = min(max(len(slide) // (2 * LEAST_CLUSTERS), LEAST_EQUATIONS), CLUSTER_EQUATIONS)  # shorter ones for few data
    clusters: list[Integers] = []
    for rows in np.split(np.arange(len(slide)), np.flatnonzero(np.diff(slide)) + 1):
        clusters += np.array_split(rows, max(round(len(rows) / long), 1))
    return clusters


def standard_errors(s: Solution, clusters: list[Integers]) -> tuple[Floats, Floats]:
    """Return standard errors (CR2) and degrees of freedom (Satterthwaite) of the
    coefficients of X.
    """
    Z, inverse = s.Z, s.inverse
    covariance, spread = _sandwich(s, clusters)
    freedom = np.empty(Z.shape[1])
    for j in range(Z.shape[1]):
        Q = np.column_stack([-Z @ (inverse @ (Z[r].T @ w[:, j])) for r, w in zip(clusters, spread, strict=True)])
        for k, (rows, weight) in enumerate(zip(clusters, spread, strict=True)):
            Q[rows, k] += weight[:, j]
        gram = Q.T @ Q
        freedom[j] = np.trace(gram) ** 2 / np.sum(gram**2)
    return np.sqrt(np.maximum(np.diag(covariance), 0.0)) / s.scale, freedom


@dataclass(frozen=True)
class SpeedLevels:
    r"""Rows that share a quantisation error: those at one speed, with the sign of their direction.

    A controller that holds a speed repeats the same swing of a few counts :math:`\Delta`, or none.
    Its torque's quantisation error therefore does not average over the samples of a level: the
    share `LEVEL_SHARE` of a uniform error, :math:`\Delta/\sqrt{12}`, is treated as common to them.

    Attributes
    ----------
    of_row : level of each row
    sense : sign of each row's speed, because rounding is symmetrical
    error : its standard deviation [Nm]
    """

    of_row: Integers
    sense: Floats
    error: float

    @classmethod
    def from_speeds(cls, v: Floats, count: float) -> SpeedLevels:
        """Return the levels of rows at the speeds `v`, for a torque of resolution `count` [Nm]."""
        speed_class = np.floor(np.log(np.maximum(np.abs(v), 1e-9)) / LEVEL_WIDTH).astype(np.int64)
        return cls(speed_class - speed_class.min(), np.sign(v), LEVEL_SHARE * count / math.sqrt(12))

    def variance(self, s: Solution) -> Floats:
        """Return their contribution to the variance of each coefficient of X."""
        weights = s.Z @ s.inverse.T
        sums = np.stack([np.bincount(self.of_row, weights=column * self.sense) for column in weights.T])
        variances: Floats = np.sum(sums**2, axis=1) * self.error**2 / s.scale**2
        return variances


def correction_reach(s: Solution, X: Floats, y: Floats) -> Floats:
    """Return the shift of each coefficient of X by the correction for regressor errors.

    The spectrum of quantisation errors depends on the speed, so the correction is as uncertain as its own size.
    """
    plain = solve(X, y, np.zeros(X.shape[1]))
    moved: Floats = np.abs(s.beta - plain.beta) / s.scale
    return moved


def covariance_of(s: Solution, clusters: list[Integers]) -> Floats:
    """Return the covariance (CR2) of the coefficients of X."""
    return _sandwich(s, clusters)[0] / np.outer(s.scale, s.scale)


def _sandwich(s: Solution, clusters: list[Integers]) -> tuple[Floats, list[Floats]]:
    """Return the covariance of the coefficients of Z, and the weights of each cluster's residuals."""
    Z, inverse = s.Z, s.inverse
    meat = np.zeros_like(inverse)
    spread = []  # weights of each cluster's corrected residuals
    for rows in clusters:
        part = Z[rows]
        values, vectors = np.linalg.eigh(np.eye(len(rows)) - part @ inverse @ part.T)
        corrected = (vectors / np.sqrt(np.maximum(values, 1e-8))) @ vectors.T
        score = part.T @ corrected @ s.residual[rows] + len(rows) * (s.error @ s.beta)
        meat += np.outer(score, score)
        spread.append(corrected @ part @ inverse)
    return inverse @ meat @ inverse, spread


def regress(columns: Mapping[str, Column], y: Floats, slide: Integers) -> dict[str, Estimate]:
    """Return each column's coefficient with its 95 % interval.

    `slide`: slide number of each row.

    Raises
    ------
    IdentifyError
        too few clusters for an interval, or the rows do not tell the coefficients apart
    """
    clusters = clusters_of(slide)
    if len(clusters) < LEAST_CLUSTERS:
        raise IdentifyError(
            f"the handle slides in {len(clusters)} separate pieces; expected at least {LEAST_CLUSTERS}: record more strokes, to and fro"
        )
    X = np.column_stack([values for values, _ in columns.values()])
    solution = solve(X, y, np.array([variance for _, variance in columns.values()]))
    error, freedom = standard_errors(solution, clusters)
    reach = np.hypot(stdtrit(freedom, 0.5 + CONFIDENCE / 2) * error, correction_reach(solution, X, y))
    beta = solution.beta / solution.scale
    return {
        name: Estimate(float(beta[i]), float(beta[i] - reach[i]), float(beta[i] + reach[i]))
        for i, name in enumerate(columns)
    }


def widened(estimate: Estimate, *shares: float) -> Estimate:
    r"""Return an estimate widened by the uncertainty of earlier measured factors.

    .. math:: r^2 = r_0^2 + x^2 \sum_i s_i^2

    (the delta method for a product): `shares` are relative 95 % reaches :math:`s_i`.
    """
    reach = math.hypot(estimate.reach, *(estimate.value * share for share in shares))
    return Estimate(estimate.value, estimate.value - reach, estimate.value + reach)
