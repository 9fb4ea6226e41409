r"""Absolute stability of friction with a slope of at most k: certified or not.

Tsypkin's criterion for a memoryless friction in the sector [0, k], eq. (17) for an ideal one (k to
infinity):

.. math:: \mathrm{Re}\,H^*(j\omega) + 1/k > 0 \quad \forall\,\omega \qquad\Rightarrow\qquad k < 1/|\min_\omega \mathrm{Re}\,H^*|

The circle criterion of the sampled loop is the same inequality. For the passive set, the least real
part of a disk counts: :math:`\mathrm{Re}\,r(j\omega)/(2b) - 1/(2b)`, which is :math:`-1/b` at fs/2;
so k < b. In continuous time, eq. (15), the disk lies in the closed right half plane, and every
slope is certified.

Tsypkin's criterion is sufficient. A loop that violates it is *not certified*; only an actual motion
proves that it oscillates (`analysis.theory.orbits`). Eq. (17) as printed is strict, yet H*(0) = 0
with a spring: so ideal Coulomb friction is never certified by it.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from scipy.optimize import minimize_scalar

from coulombus.analysis.theory.crossings import Crossings, crossings, frequency_grid
from coulombus.analysis.theory.linear import multiplier, plant, sample
from coulombus.analysis.theory.operators import Complexes, Floats
from coulombus.analysis.theory.orbits import Orbits, orbits
from coulombus.analysis.theory.parameters import Parameters
from coulombus.analysis.theory.zames_falb import Certificate, zames_falb

__all__ = [
    "AbsoluteStability",
    "Verdict",
    "absolute_stability",
    "circle_slope",
    "nyquist_slope",
    "passive_set_slope",
    "tsypkin_slope",
]


class Verdict(StrEnum):
    """Verdict on a loop, in order of strength on either side of "unknown"."""

    CERTIFIED = "certified"
    NOT_CERTIFIED = "not certified"
    LIMIT_CYCLE = "limit cycle shown"


@dataclass(frozen=True)
class AbsoluteStability:
    """Largest certified slopes [Ns/m] of a regularised friction; None if every slope is certified."""

    passive_set: float
    """For every passive operator, by Tsypkin's criterion; 0: none."""
    tsypkin: float | None
    """For the concrete operator, sector [0, k], no multiplier."""
    zames_falb: float | None
    """For the concrete operator and an odd friction with slopes in [0, k], by the multiplier of
    `certificate`.
    """
    nyquist: float | None
    """Stability limit of the linear loop: at this gain it oscillates. No certificate can exceed it."""
    passive_brake: float | None
    """With the brake, in continuous time, by the circle criterion; None: every slope."""
    certificate: Certificate | None
    ideal: Verdict
    """Ideal Coulomb friction, displayed actively."""
    text: str


def _z(frequency_Hz: Floats, period_s: float) -> Complexes:
    value: Complexes = np.exp(2j * np.pi * np.asarray(frequency_Hz) * period_s)
    return value


def tsypkin_slope(parameters: Parameters) -> float | None:
    """Return 1/|min Re H*| over (0, fs/2], refined between grid points; None if Re H* is nowhere
    negative.
    """
    linear = sample(parameters)
    grid = np.append(frequency_grid(parameters), parameters.nyquist_Hz)
    real = linear.response(_z(grid, parameters.period_s)).real
    lowest = float(np.min(real))
    for i in np.argsort(real)[:3]:
        low, high = grid[max(i - 1, 0)], grid[min(i + 1, len(grid) - 1)]
        best = minimize_scalar(
            lambda f: float(linear.response(_z(np.array([f]), parameters.period_s))[0].real),
            bounds=(low, high),
            method="bounded",
            options={"xatol": 1e-10 * high},
        )
        lowest = min(lowest, float(best.fun))
    return None if lowest >= 0 else -1.0 / lowest


def passive_set_slope(parameters: Parameters) -> float:
    """Return the slope [Ns/m] that Tsypkin's criterion certifies for every passive operator: b
    without a delay; 0 for b = 0.
    """
    b = parameters.damping_Ns_m
    grid = np.append(frequency_grid(parameters), parameters.nyquist_Hz)
    _, late = parameters.delay_parts
    if not late:  # r is a pure lag of at least one period: its real part reaches -1
        return b
    real = multiplier(grid, parameters).real
    i = int(np.argmin(real))
    best = minimize_scalar(
        lambda f: float(multiplier(np.array([f]), parameters)[0].real),
        bounds=(grid[max(i - 1, 0)], grid[min(i + 1, len(grid) - 1)]),
        method="bounded",
        options={"xatol": 1e-9 * grid[i]},
    )
    return 2 * b / (1 - min(float(real[i]), float(best.fun)))


def circle_slope(parameters: Parameters) -> float | None:
    """Return the slope that the circle criterion certifies for the brake, eq. (15): None (all), as
    Re P(jw) >= 0 for a passive hand.
    """
    s = np.zeros(4000, dtype=np.complex128)
    s.imag = np.geomspace(1e-3, 1e6, len(s))
    lowest = float(np.min(plant(s, parameters).real))
    return None if lowest >= -1e-15 else -1.0 / lowest


def nyquist_slope(intersections: Crossings) -> float | None:
    """Return the least gain at which the linear loop is marginally stable: 1/|H*| at the leftmost
    crossing; None without one.
    """
    return min((-1.0 / c.h_real for c in intersections.found), default=None)


def absolute_stability(parameters: Parameters, *, taps: int = 10, shown: Orbits | None = None) -> AbsoluteStability:
    """Return all slopes, and the verdict on ideal Coulomb friction."""
    linear = sample(parameters)
    intersections = crossings(parameters)
    tsypkin = tsypkin_slope(parameters)
    edge = linear.response(np.array([-1.0 + 0j]))[0].real  # at fs/2 the loop may be marginal as well
    limit = nyquist_slope(intersections)
    if edge < 0:
        limit = -1.0 / edge if limit is None else min(limit, -1.0 / edge)
    certificate = None
    if tsypkin is not None and linear.spectral_radius < 1:
        certificate = zames_falb(linear, frequency_grid(parameters), tsypkin, limit, taps)
    motions = orbits(parameters) if shown is None else shown
    if tsypkin is None:
        verdict, text = Verdict.CERTIFIED, "Re H* >= 0: every finite slope is certified by Tsypkin's criterion"
    elif any(orbit.stable for orbit in motions.found):
        verdict = Verdict.LIMIT_CYCLE
        text = f"ideal Coulomb friction: not certified, and a stable limit cycle is shown ({motions.found[0].pattern})"
    else:
        verdict, text = Verdict.NOT_CERTIFIED, "ideal Coulomb friction: not certified; no limit cycle is shown either"
    return AbsoluteStability(
        passive_set_slope(parameters),
        tsypkin,
        None if certificate is None else certificate.slope_Ns_m,
        limit,
        circle_slope(parameters),
        certificate,
        verdict,
        text,
    )
