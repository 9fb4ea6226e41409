r"""Zames-Falb multipliers for the sampled loop: a tighter certificate than Tsypkin's, found by linear programming.

For an odd friction with slopes in [0, k] the loop is stable if there is an

.. math:: M(z) = 1 - \sum_{0<|i|\le n} h_i z^{-i},\qquad \sum|h_i| < 1,\qquad
          \mathrm{Re}\,\{M(e^{j\theta})\,(H^* + 1/k)\} \ge \varepsilon > 0\ \ \forall\theta

For a given k this is linear in :math:`h`, so a linear program finds the largest :math:`\varepsilon`
on a grid, and k is bisected. The result is then checked on a much finer grid, and proved between
its frequencies by a bound on the rate of change of the condition (`analysis.theory.proof`); the
slope is lowered until both hold.

Source: J. C. Willems, R. W. Brockett, Some new rearrangement inequalities having application in
stability analysis, IEEE T-AC 13, 1968; J. Carrasco et al., Convex searches for discrete-time
Zames-Falb multipliers, IEEE T-AC 65, 2020.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import linprog

from coulombus.analysis.theory.linear import SampledPlant
from coulombus.analysis.theory.operators import Complexes, Floats
from coulombus.analysis.theory.proof import Positive, cosine_polynomial, positive, rational

__all__ = ["Certificate", "margin", "multiplier_response", "verified", "zames_falb"]

FINER = 25
NORM = 1 - 1e-6
STEP = 1.002
"""Ratio of the bounds at which the bisection ends."""
LP_POINTS = 500


@dataclass(frozen=True)
class Certificate:
    """A multiplier that certifies a slope."""

    slope_Ns_m: float
    taps: tuple[float, ...]
    """h_-n ... h_-1, h_1 ... h_n."""
    norm: float
    """sum |h_i|, less than 1."""
    margin: float
    """Least Re{M (1 + k H*)} on the verification grid."""
    points: int
    """Number of that grid's frequencies."""
    proved: bool
    """Whether it is proved at every frequency, including between the grid's."""
    pieces: int
    """Number of frequency intervals in the proof."""


def _orders(count: int) -> Floats:
    half = count // 2
    return np.concatenate((np.arange(-half, 0), np.arange(1, half + 1))).astype(float)


def multiplier_response(taps: Floats, theta: Floats) -> Complexes:
    """Return M(e^{j theta})."""
    value: Complexes = 1.0 - np.exp(-1j * np.outer(theta, _orders(len(taps)))) @ taps
    return value


def margin(response: Complexes, taps: Floats, slope: float, theta: Floats) -> float:
    """Return min Re{M (1 + k H*)} over `theta` in rad a sample, where H* is `response`."""
    return float(np.min((multiplier_response(taps, theta) * (1.0 + slope * response)).real))


def _best(response: Complexes, theta: Floats, slope: float, taps: int) -> tuple[Floats, float]:
    """Return the taps of largest margin on `theta`, and this margin: h = p - q with p, q >= 0 and
    sum p + q <= NORM.
    """
    loop = 1.0 + slope * response
    # scaled by |loop| (at least 1e-3): rounding needs a larger margin where kH is large
    scale = np.maximum(np.abs(loop), 1e-3)
    turned = (np.exp(-1j * np.outer(theta, _orders(taps))) * loop[:, None]).real / scale[:, None]
    rows = np.hstack((turned, -turned, np.ones((len(theta), 1))))
    norm = np.append(np.ones(2 * taps), 0.0)
    solution = linprog(
        np.append(np.zeros(2 * taps), -1.0),
        A_ub=np.vstack((rows, norm)),
        b_ub=np.append(loop.real / scale, NORM),
        bounds=[(0, None)] * (2 * taps) + [(None, 1.0)],
        method="highs",
    )
    if solution.status != 0:
        return np.zeros(taps), -1.0
    h = solution.x[:taps] - solution.x[taps : 2 * taps]
    return h, float(solution.x[-1])


def verified(response: Complexes, taps: Floats, slope: float, theta: Floats) -> bool:
    """Return whether the certificate holds on `theta`, its norm included."""
    return float(np.sum(np.abs(taps))) < 1.0 and margin(response, taps, slope, theta) > 0.0


def zames_falb(
    linear: SampledPlant, grid_Hz: Floats, certified: float, limit: float | None, taps: int = 10
) -> Certificate | None:
    """Return the largest slope that a multiplier of 2 `taps` taps certifies, from `certified`
    (Tsypkin's) up to `limit` (Nyquist's).

    None if not even `certified` can be verified.
    """
    theta_all = np.append(2 * np.pi * grid_Hz * linear.period_s, np.pi)
    theta = theta_all[np.unique(np.linspace(0, len(theta_all) - 1, LP_POINTS).astype(int))]
    theta = np.concatenate(([0.0], theta)) if _finite_at_rest(linear) else theta
    fine = np.interp(np.linspace(0, len(theta_all) - 1, FINER * len(theta_all)), np.arange(len(theta_all)), theta_all)
    response, checked = linear.response(np.exp(1j * theta)), linear.response(np.exp(1j * fine))
    low, high = certified * 0.999, limit if limit is not None else certified * 1e6
    best = np.zeros(2 * taps)
    N, D = rational(linear)

    def proof(h: Floats, slope: float) -> Positive:
        return positive(cosine_polynomial(N, D, h, slope))

    if not verified(checked, best, low, fine):
        return None
    while high / low > STEP:
        slope = (low * high) ** 0.5
        h, least_margin = _best(response, theta, slope, 2 * taps)
        if least_margin > 1e-9 and verified(checked, h, slope, fine) and proof(h, slope).proved:
            low, best = slope, h
        else:
            high = slope
    norm, proved = float(np.sum(np.abs(best))), proof(best, low)
    least = margin(checked, best, low, fine)
    coefficients = tuple(float(x) for x in best)
    return Certificate(low, coefficients, norm, least, len(fine), proved.proved, proved.pieces)


def _finite_at_rest(linear: SampledPlant) -> bool:
    return linear.spectral_radius < 1.0 - 1e-12
