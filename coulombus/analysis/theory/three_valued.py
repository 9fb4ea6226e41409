r"""Periodic motions of the three-valued relay loop, for each choice of sgn(0).

With an encoder of resolution r the law sees :math:`\hat v_k = (n_k - n_{k-1}) r/T` in whole counts,
:math:`n_k = \mathrm{round}((x_k + \varphi)/r)`, and often zero. The law's output is then a choice:

- ``zero``: sgn(0) = 0; the force has three values
- ``plus``: sgn(0) = +1, a comparison with one sign
- ``hold``: the previous sign, a hysteresis

A pattern u of period p gives the periodic position :math:`x_k` exactly, as in
`analysis.theory.orbits`. The encoder's offset, :math:`\varphi` in [0, r), is unknown to the loop;
the counts change only where some :math:`x_k + \varphi` is on an edge. The p edges therefore divide
[0, r) into intervals, one test of each is enough, and the share of :math:`\varphi` for which the
pattern is a motion is exact. Half of the widest interval is the margin: a smaller disturbance of
the position changes no count.

Without an encoder (r = 0) :math:`\hat v_k = 0` occurs only by symmetry.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from coulombus.analysis.theory.linear import sample
from coulombus.analysis.theory.operators import Floats
from coulombus.analysis.theory.orbits import ROUNDING, patterns, word_of
from coulombus.analysis.theory.parameters import ParameterError, Parameters

__all__ = ["ZEROS", "ThreeValued", "Zero", "says", "three_valued_orbits"]

Zero: TypeAlias = Literal["zero", "plus", "hold"]

ZEROS: tuple[Zero, ...] = ("zero", "plus", "hold")
LONGEST_THREE = 10


@dataclass(frozen=True)
class ThreeValued:
    """One periodic motion, with zeros at samples without a count."""

    pattern: str
    """The force's signs, "+", "-" and "0", over one period, its first rotation in ASCII order."""
    period_samples: int
    frequency_Hz: float
    velocity_peak_m_s: float
    """max of the exact |x_k - x_{k-1}|/T, not rounded to counts."""
    share: float
    """Share of the encoder's offsets for which it is a motion."""
    margin_m: float
    """A smaller disturbance of the position changes no count; 0 without an encoder."""


def says(counts: npt.NDArray[np.float64], u: Floats, zero: Zero) -> Floats:
    """Return the law's signs for the steps `counts` (..., p), given its previous output `u` (..., p)."""
    value: Floats = np.sign(counts)
    if zero == "zero":
        return value
    other = np.ones_like(value) if zero == "plus" else np.roll(np.broadcast_to(u, value.shape), 1, axis=-1)
    sign: Floats = np.where(value == 0.0, other, value)
    return sign


def three_valued_orbits(
    parameters: Parameters, zero: Zero = "zero", *, longest: int = LONGEST_THREE
) -> tuple[ThreeValued, ...]:
    """Return every periodic motion of at most `longest` samples except rest, the largest velocity first.

    Raises
    ------
    ParameterError
        `zero` is not a valid choice, or the plant without its position is not stable
    """
    if zero not in ZEROS:
        raise ParameterError(f"zero = {zero!r}: expected one of {', '.join(ZEROS)}")
    linear = sample(parameters)
    if linear.spectral_radius >= 1.0 - 1e-12:
        raise ParameterError("the plant without its position is not stable: no periodic motion; give it damping")
    c, T, r = parameters.friction_N, parameters.period_s, parameters.resolution_m
    all_z = np.exp(2j * np.pi * np.arange(1, 240) / 240)
    rounding = ROUNDING * c * float(np.max(np.abs(linear.response(all_z))))
    motions = []
    for period in range(1, longest + 1):
        u = patterns(period, 3 if zero == "zero" else 2)
        z = np.exp(2j * np.pi * np.arange(period) / period)
        v = -c * np.fft.ifft(linear.response(z) * np.fft.fft(u, axis=1), axis=1).real
        moving = np.any(u != 0.0, axis=1) & (np.abs(v.sum(axis=1)) <= period * rounding)  # else it drifts
        for i in np.flatnonzero(moving):
            share, margin = _with_encoder(v[i], u[i], zero, r / T) if r > 0 else _exactly(v[i], u[i], zero, rounding)
            if share > 0.0:
                peak = float(np.max(np.abs(v[i])))
                motions.append(ThreeValued(word_of(u[i]), period, 1 / (period * T), peak, share, margin * T))
    return tuple(sorted(motions, key=lambda motion: -motion.velocity_peak_m_s))


def _exactly(v: Floats, u: Floats, zero: Zero, rounding: float) -> tuple[float, float]:
    seen = np.where(np.abs(v) <= rounding, 0.0, v)
    return float(np.array_equal(says(seen, u, zero), u) and bool(np.any(seen != 0.0))), 0.0


def _with_encoder(v: Floats, u: Floats, zero: Zero, count: float) -> tuple[float, float]:
    """Return the share of the encoder's offsets, and half of the widest interval in `count`'s unit."""
    x = np.cumsum(v) / count  # in counts, up to a constant
    edges = np.sort((0.5 - x) % 1.0)
    widths = np.diff(np.append(edges, edges[0] + 1.0))
    middles = edges + 0.5 * widths
    n = np.rint(x[None, :] + middles[:, None])
    steps = n - np.roll(n, 1, axis=1)
    ours = np.all(says(steps, u, zero) == u, axis=1) & (widths > 1e-9)
    return float(widths[ours].sum()), 0.5 * float(widths[ours].max(initial=0.0)) * count
