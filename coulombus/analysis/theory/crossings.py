r"""Crossings of H*(jw) with -1/Psi(a): limit cycles predicted by the describing function, eq. (3).

For any real :math:`\Psi` the locus of :math:`-1/\Psi(a)` is on the negative real axis, so the
frequencies follow from :math:`\mathrm{Im}\,H^* = 0,\ \mathrm{Re}\,H^* < 0` alone, on the open
interval (0, fs/2). For Coulomb friction :math:`a = 4c|H^*|/\pi`.

Stability, by Nyquist's criterion with the gain :math:`\Psi(a)` frozen: an amplitude grows where H*
encircles :math:`-1/\Psi(a)` and decays where it does not. Coulomb's locus moves left as a grows, so
a crossing is stable if H* passes upwards there and no part further left encircles it. (The
perturbation :math:`s = j\omega + \sigma` of the harmonic balance gives only "upwards": it covers
only the root near the axis.) This is a prediction: `analysis.theory.orbits` has the exact motions.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from coulombus.analysis.theory.linear import SampledPlant, sample
from coulombus.analysis.theory.operators import Complexes, Floats
from coulombus.analysis.theory.parameters import Parameters

__all__ = ["Crossing", "Crossings", "crossings", "frequency_grid"]

LOWEST = 1e-6
"""Start of the search, as a share of the sampling rate."""


@dataclass(frozen=True)
class Crossing:
    """One intersection of H*(jw) with -1/Psi(a) for Coulomb friction."""

    frequency_Hz: float
    amplitude_m_s: float
    """Of v^, 4 c |H*| / pi."""
    h_real: float
    """H* there, in m/(Ns)."""
    stable: bool
    """The describing function's prediction."""


@dataclass(frozen=True)
class Crossings:
    """All crossings in (0, fs/2), by frequency; `text` reports if there is none."""

    found: tuple[Crossing, ...]

    @property
    def largest(self) -> Crossing | None:
        """The crossing of largest amplitude."""
        return max(self.found, key=lambda crossing: crossing.amplitude_m_s, default=None)

    @property
    def text(self) -> str:
        """Summary in one line."""
        if not self.found:
            return "no crossing: H*(jw) does not meet the negative real axis in (0, fs/2); the describing function predicts no limit cycle"
        return "; ".join(
            f"{c.frequency_Hz:.4g} Hz, {c.amplitude_m_s:.4g} m/s, {'stable' if c.stable else 'unstable'}"
            for c in self.found
        )


def frequency_grid(parameters: Parameters) -> Floats:
    """Return frequencies in (0, fs/2) [Hz], fine enough for the loop's delay: at least 100 per turn of the locus."""
    whole, _ = parameters.delay_parts
    fs = 1.0 / parameters.period_s
    points = 2000 + 200 * (whole + 1)
    low = np.geomspace(LOWEST * fs, 0.5 * fs / points, 600, endpoint=False)
    return np.concatenate((low, np.linspace(0.5 * fs / points, 0.5 * fs * (1 - 1e-6), points)))


def crossings(parameters: Parameters) -> Crossings:
    """Return the crossings of H*(jw) with the negative real axis, refined to 1e-12 of the
    frequency.
    """
    linear = sample(parameters)
    grid = frequency_grid(parameters)
    response = linear.response(_z(grid, parameters.period_s))
    change = np.flatnonzero((response.imag[:-1] * response.imag[1:] < 0) | (response.imag[:-1] == 0))
    places = []
    for i in change:
        f = brentq(_imaginary, grid[i], grid[i + 1], (linear,), xtol=1e-12 * grid[i], rtol=8.9e-16)
        h = complex(linear.response(_z(np.array([f]), parameters.period_s))[0])
        if h.real < 0 and abs(h.imag) < 1e-6 * abs(h.real):  # no pole, no positive axis
            places.append((float(f), h, 1 if response.imag[i + 1] > response.imag[i] else -1))
    end = float(linear.response(np.array([-1.0 + 0j]))[0].real)  # the locus and its mirror image meet at fs/2
    end_passes = -1 if response.imag[-1] > 0 else 1
    points = []
    for f, h, passes in places:
        turns = sum(2 * other for _, g, other in places if g.real < h.real) + (end_passes if end < h.real else 0)
        amplitude = 4 * parameters.friction_N * abs(h) / math.pi
        points.append(Crossing(f, amplitude, h.real, passes > 0 and turns == 0))
    return Crossings(tuple(points))


def _z(frequency_Hz: Floats, period_s: float) -> Complexes:
    z: Complexes = np.exp(2j * np.pi * frequency_Hz * period_s)
    return z


def _imaginary(frequency_Hz: float, linear: SampledPlant) -> float:
    return float(linear.response(_z(np.array([frequency_Hz]), linear.period_s))[0].imag)
