r"""The spring that sticks, in the sampled loop: how fast it settles, and how stiff it may be.

Stuck, Karnopp's friction is :math:`\psi_k = K (x_k - x_{stuck})`, sampled, held and delayed by q T +
delta. The loop is linear; its step on (y, the forces under way) has a spectral radius

.. math:: \rho(K) = \max_i |\lambda_i|

by which a disturbance changes at most from one sample to the next in the long run: stable while rho <
1. Without a spring (K = 0) rho is 1, for the position may be anywhere. Where the hand has a spring of
its own, the way between its rest and x_stuck is a constant, and no motion: its eigenvalue, 1, does not
count.

:math:`K_{max}` is the least K at which an eigenvalue leaves the unit circle. It is where the Nyquist
locus of :math:`G_x = H^* T/(1 - z^{-1})` meets the negative real axis: :math:`K_{max} = \min
1/|G_x|` over the frequencies with Im G_x = 0, Re G_x < 0, fs/2 included. The hand counts; what holds
for every passive hand is in `analysis.theory.bounds`.

Source: K. J. Astrom, B. Wittenmark, Computer-Controlled Systems, 3rd ed. 1997, chapter 3.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from coulombus.analysis.theory.crossings import frequency_grid
from coulombus.analysis.theory.linear import SampledPlant, sample
from coulombus.analysis.theory.operators import Complexes, Floats
from coulombus.analysis.theory.parameters import Parameters

__all__ = ["StuckSpring", "largest_stiffness", "spectral_radius", "stuck_spring"]


CONSTANT = 1e-9
"""A pole of the hand so near to 0 [1/s] is that of a spring."""


@dataclass(frozen=True)
class StuckSpring:
    """A spring in the sampled loop."""

    stiffness_N_m: float
    radius: float
    """rho: below 1 it settles."""
    largest_N_m: float
    """K_max; infinite where the locus never meets the negative real axis."""

    @property
    def stable(self) -> bool:
        """Whether it settles."""
        return self.radius < 1.0


def _loop(linear: SampledPlant, K: float) -> Floats:
    n, q = len(linear.phi), linear.whole_cycles
    loop = np.zeros((n + q + 1, n + q + 1))  # y, and psi of one sample ago, two, ... q + 1
    loop[:n, :n] = linear.phi
    now = np.zeros(n + q + 1)
    now[0] = K
    loop[n] = now
    for k in range(1, q + 1):
        loop[n + k, n + k - 1] = 1.0
    at = now if q == 0 else np.eye(n + q + 1)[n + q - 1]  # psi_{k-q}
    loop[:n] -= np.outer(linear.gamma_0, at)
    loop[:n, n + q] -= linear.gamma_1
    return loop


def spectral_radius(parameters: Parameters, stiffness_N_m: float) -> float:
    """Return rho of the loop with a spring of `stiffness_N_m`."""
    values = np.linalg.eigvals(_loop(sample(parameters), stiffness_N_m))
    hand = parameters.operator.parts().A
    springs = int(np.sum(np.abs(np.linalg.eigvals(hand)) < CONSTANT)) if len(hand) else 0
    kept = np.argsort(np.abs(values - 1.0))[springs:]
    return float(np.abs(values[kept]).max())


def largest_stiffness(parameters: Parameters) -> float:
    """Return K_max [N/m]: from there on the stuck spring does not settle."""
    linear, T = sample(parameters), parameters.period_s
    grid = frequency_grid(parameters)

    def response(f: Floats) -> Complexes:
        z = np.exp(2j * np.pi * f * T)
        value: Complexes = linear.response(z) * T / (1.0 - 1.0 / z)
        return value

    values = response(grid)
    reals = []
    for i in np.flatnonzero(values.imag[:-1] * values.imag[1:] < 0):
        f = brentq(lambda f: float(response(np.array([f]))[0].imag), grid[i], grid[i + 1], xtol=1e-12 * grid[i])
        reals.append(float(response(np.array([f]))[0].real))
    reals.append(float((linear.response(np.array([-1.0 + 0j])) * T / 2.0)[0].real))
    return min((-1.0 / real for real in reals if real < 0), default=float("inf"))


def stuck_spring(parameters: Parameters, stiffness_N_m: float) -> StuckSpring:
    """Return how a stuck spring of `stiffness_N_m` settles in the loop, and the largest that does."""
    return StuckSpring(stiffness_N_m, spectral_radius(parameters, stiffness_N_m), largest_stiffness(parameters))
