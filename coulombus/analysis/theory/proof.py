r"""Proof of positivity at all frequencies, including between grid points.

With :math:`H = N/D`, both polynomials in :math:`z^{-1}`, and a multiplier M of finite length,

.. math:: \mathrm{Re}\{M (1 + kH)\}\,|D|^2 = \mathrm{Re}\{M\,(D + kN)\,\overline{D}\}
          = \sum_{j=0}^{n} p_j \cos(j\theta)

is a cosine polynomial of known coefficients. Its derivatives are bounded for every angle,

.. math:: |p'| \le L_1 = \sum j |p_j|,\qquad |p''| \le L_2 = \sum j^2 |p_j|

so on an interval of half width r around m

.. math:: p(\theta) \ge p(m) - r\,|p'(m)| - \tfrac12 r^2 L_2.

The interval from 0 to pi is bisected until this bound is positive on each piece: a finite proof for
infinitely many frequencies. An allowance for rounding is subtracted from each value.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from coulombus.analysis.theory.linear import SampledPlant
from coulombus.analysis.theory.operators import Floats

__all__ = ["Positive", "cosine_polynomial", "positive", "rational"]

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
    order = np.arange(len(p))
    lipschitz = float(order @ np.abs(p))
    curvature = float(order**2 @ np.abs(p))
    allowance = ROUNDING * float(np.abs(p).sum())
    edges = np.linspace(0.0, np.pi, FIRST + 1)
    left, right = edges[:-1], edges[1:]
    pieces = 0
    for _ in range(DEEPEST):
        middle, r = 0.5 * (left + right), 0.5 * (right - left)
        turned = np.outer(middle, order)
        value, rate = np.cos(turned) @ p, -np.sin(turned) @ (order * p)
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
