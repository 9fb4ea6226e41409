r"""Zames-Falb multipliers for the sampled loop: a tighter certificate than Tsypkin's, found by linear programming.

For an odd friction with slopes in [0, k] the loop is stable if there is an

.. math:: M(z) = 1 - \sum_{0<|i|\le n} h_i z^{-i},\qquad \sum|h_i| < 1,\qquad
          \mathrm{Re}\,\{M(e^{j\theta})\,(H^* + 1/k)\} \ge \varepsilon > 0\ \ \forall\theta

For a given k this is linear in :math:`h`, so a linear program finds the largest :math:`\varepsilon`
on a grid, and k is bisected. The result is then checked on a much finer grid, and proved between
its frequencies by a bound on the rate of change of the condition (`positive`); the
slope is lowered until both hold.

**Proof** (`positive`). With :math:`H = N/D`, both polynomials in :math:`z^{-1}`, and a multiplier M of finite length,

.. math:: \mathrm{Re}\{M (1 + kH)\}\,|D|^2 = \mathrm{Re}\{M\,(D + kN)\,\overline{D}\}
          = \sum_{j=0}^{n} p_j \cos(j\theta)

is a cosine polynomial of known coefficients. Its derivatives are bounded for every angle,

.. math:: |p'| \le L_1 = \sum j |p_j|,\qquad |p''| \le L_2 = \sum j^2 |p_j|

so on an interval of half width r around m

.. math:: p(\theta) \ge p(m) - r\,|p'(m)| - \tfrac12 r^2 L_2.

The interval from 0 to pi is bisected until this bound is positive on each piece: a finite proof for
infinitely many frequencies. An allowance for rounding is subtracted from each value.

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

__all__ = [
    "Certificate",
    "Positive",
    "cosine_polynomial",
    "margin",
    "multiplier_response",
    "positive",
    "rational",
    "verified",
    "zames_falb",
]

ROUNDING = 1e-12
"""Allowance for rounding, as a share of the sum of the coefficients' moduli."""
RADIUS = 1.1
DEEPEST = 40
FIRST = 256
MOST_PIECES = 400_000


@dataclass(frozen=True)
class Positive:
    """The verdict on a cosine polynomial over all angles."""

    proved: bool
    lipschitz: float
    """L_1: largest change of the polynomial per rad."""
    pieces: int
    """Number of intervals in the proof."""
    where_rad: float
    """An angle in the unproved piece; NaN if all are proved."""


def rational(linear: SampledPlant) -> tuple[Floats, Floats]:
    """Return N and D of H = N/D, coefficients of z^0, z^-1 ...: D is the characteristic polynomial of
    the plant without its position, N the response times D at the roots of unity, transformed.
    """
    D: Floats = np.poly(linear.velocity_states).real.astype(np.float64)
    size = len(D) + linear.whole_cycles + 2
    z = RADIUS * np.exp(2j * np.pi * np.arange(size) / size)  # off the unit circle, to avoid poles
    values = linear.response(z) * np.polyval(D[::-1], 1.0 / z)
    N: Floats = np.fft.ifft(values).real * RADIUS ** np.arange(size)
    return N, D


def cosine_polynomial(N: Floats, D: Floats, taps: Floats, slope: float) -> Floats:
    """Return p_0 ... p_n of Re{M (D + k N) conj(D)}, with M(z) = 1 - sum h_i z^-i and `taps` = h_-n ...
    h_-1, h_1 ... h_n.
    """
    half = len(taps) // 2
    M = np.concatenate((-taps[:half], [1.0], -taps[half:]))  # of z^half ... z^-half
    loop = np.zeros(max(len(N), len(D)))
    loop[: len(D)] += D
    loop[: len(N)] += slope * N
    two_sided = np.convolve(np.convolve(M, loop), D[::-1])
    middle = half + len(D) - 1  # index of z^0
    p = np.zeros(max(middle, len(two_sided) - 1 - middle) + 1)
    for k, value in enumerate(two_sided):
        p[abs(k - middle)] += value
    return p


def positive(p: Floats) -> Positive:
    """Prove that sum p_j cos(j theta) > 0 for every theta, or return where the proof fails."""
    harmonic = np.arange(len(p))
    lipschitz = float(harmonic @ np.abs(p))
    curvature = float(harmonic**2 @ np.abs(p))
    allowance = ROUNDING * float(np.abs(p).sum())
    edges = np.linspace(0.0, np.pi, FIRST + 1)
    left, right = edges[:-1], edges[1:]
    pieces = 0
    for _ in range(DEEPEST):
        middle, r = 0.5 * (left + right), 0.5 * (right - left)
        turned = np.outer(middle, harmonic)
        value, rate = np.cos(turned) @ p, -np.sin(turned) @ (harmonic * p)
        if np.any(value <= allowance):
            return Positive(False, lipschitz, pieces, float(middle[np.argmin(value)]))
        open_ = value - r * np.abs(rate) - 0.5 * r * r * curvature <= allowance
        pieces += int(np.sum(~open_))
        if not np.any(open_):
            return Positive(True, lipschitz, pieces, float("nan"))
        left, middle, right = left[open_], middle[open_], right[open_]
        left, right = np.concatenate((left, middle)), np.concatenate((middle, right))
        if len(left) > MOST_PIECES:
            break
    return Positive(False, lipschitz, pieces, float(0.5 * (left[0] + right[0])))


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
