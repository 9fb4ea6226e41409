r"""The stick spring in the sampled loop: its decay rate, and its largest stable stiffness.

Stuck, Karnopp's friction is :math:`\psi_k = K (x_k - x_{stuck})`, sampled, held and delayed by q T +
delta. A damping B may be added, :math:`\psi_k = K (x_k - x_{stuck}) + B \hat v_k` with
:math:`\hat v_k = (x_k - x_{k-1})/T`. The loop is linear; its step on (y, the delayed forces) has a spectral radius

.. math:: \rho(K) = \max_i |\lambda_i|

the asymptotic factor of a disturbance per sample: stable if rho < 1. Without a spring (K = 0) rho
is 1, because the position is arbitrary. If the hand has a spring, the distance between its rest
position and x_stuck is a constant, not a motion: its eigenvalue 1 does not count.

:math:`K_{max}` is the least K at which an eigenvalue leaves the unit circle. It is where the Nyquist
locus of :math:`G_x = H^* T/(1 - z^{-1})` meets the negative real axis: :math:`K_{max} = \min
1/|G_x|` over the frequencies with Im G_x = 0, Re G_x < 0, fs/2 included. With B it is found by
bisection of rho over K. The hand is included; `analysis.theory.bounds` has the bounds for every passive hand.

A *pure mass* m has closed forms without a delay. With :math:`a = K T^2/(2m)`, :math:`p = B T/(2m)`:

.. math:: \rho = \sqrt{1 + a}\ (B = 0,\ a \le 8), \qquad
          K_{max} = \frac{2B}{T}\,\frac{1 - p}{1 + p}, \qquad
          m_{crit} = \frac{B T}{2}\,\frac{1 + \kappa}{1 - \kappa},\quad \kappa = \frac{K T}{2 B}

The first is the root of the product of the two poles of :math:`z^2 - (2 - a) z + 1 + a`, which are
conjugate for a < 8. The others are Jury's criterion for :math:`z^3 + (a + p - 2) z^2 + (1 + a) z - p`.

Source: K. J. Astrom, B. Wittenmark, Computer-Controlled Systems, 3rd ed. 1997, chapter 3.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq

from coulombus.analysis.theory.crossings import frequency_grid
from coulombus.analysis.theory.linear import SampledPlant, sample
from coulombus.analysis.theory.operators import Complexes, Floats
from coulombus.analysis.theory.parameters import ParameterError, Parameters

__all__ = [
    "StuckSpring",
    "critical_mass",
    "largest_stiffness",
    "largest_stiffness_damped",
    "mass_critical",
    "mass_radius",
    "mass_stiffness",
    "spectral_radius",
    "stuck_spring",
    "unstable_poles",
]


CONSTANT = 1e-9
"""Distance from 0 [1/s] below which a pole of the hand is a spring's; distance below which a pole
is on the unit circle.
"""
SOFT_N_M, STIFF_N_M = 1e-3, 1e12
LIGHT_KG, HEAVY_KG, MASSES = 1e-4, 1e4, 161
"""Search range of `critical_mass`."""


@dataclass(frozen=True)
class StuckSpring:
    """A spring in the sampled loop."""

    stiffness_N_m: float
    radius: float
    """rho: it settles if below 1."""
    largest_N_m: float
    """K_max; infinite if the locus never meets the negative real axis."""

    @property
    def stable(self) -> bool:
        """Whether it settles."""
        return self.radius < 1.0


def _loop(linear: SampledPlant, K: float, B: float = 0.0) -> Floats:
    n, q = len(linear.phi), linear.whole_cycles
    size = n + q + 1 + (B > 0.0)
    loop = np.zeros((size, size))  # y, psi of 1, 2, ... q + 1 samples ago, and with B the previous x
    loop[:n, :n] = linear.phi
    now = np.zeros(size)
    now[0] = K
    if B > 0.0:
        now[0] += B / linear.period_s
        now[-1] = -B / linear.period_s
        loop[-1, 0] = 1.0
    loop[n] = now
    for k in range(1, q + 1):
        loop[n + k, n + k - 1] = 1.0
    at = now if q == 0 else np.eye(size)[n + q - 1]  # psi_{k-q}
    loop[:n] -= np.outer(linear.gamma_0, at)
    loop[:n, n + q] -= linear.gamma_1
    return loop


def _poles(parameters: Parameters, K: float, B: float) -> Complexes:
    values: Complexes = np.linalg.eigvals(_loop(sample(parameters), K, B)).astype(np.complex128)
    hand = parameters.operator.parts().A
    springs = int(np.sum(np.abs(np.linalg.eigvals(hand)) < CONSTANT)) if len(hand) else 0
    return values[np.argsort(np.abs(values - 1.0))[springs:]]


def spectral_radius(parameters: Parameters, stiffness_N_m: float, damping_Ns_m: float = 0.0) -> float:
    """Return rho of the loop with a spring of `stiffness_N_m`, and a damping."""
    return float(np.abs(_poles(parameters, stiffness_N_m, damping_Ns_m)).max())


def unstable_poles(parameters: Parameters, stiffness_N_m: float, damping_Ns_m: float = 0.0) -> int:
    """Return the number of eigenvalues of a sample's step outside the unit circle.

    A pair is a growing oscillation; a single one at z < -1 alternates from sample to sample.
    """
    return int(np.sum(np.abs(_poles(parameters, stiffness_N_m, damping_Ns_m)) > 1.0 + CONSTANT))


def largest_stiffness_damped(parameters: Parameters, damping_Ns_m: float) -> float:
    """Return K_max [N/m] with a damping of `damping_Ns_m`: above it rho exceeds 1. 0 if even a
    spring of `SOFT_N_M` does not settle, infinite above `STIFF_N_M`.
    """
    return _change(lambda K: spectral_radius(parameters, K, damping_Ns_m) < 1.0, SOFT_N_M, STIFF_N_M)


def critical_mass(parameters: Parameters, stiffness_N_m: float, damping_Ns_m: float = 0.0) -> float:
    """Return J_crit [kg]: with a larger mass at the handle, device and hand otherwise unchanged, the spring settles.

    0 if it settles with `LIGHT_KG`, infinite if it does not with `HEAVY_KG`. Stability need not be
    monotone in the mass: the result is the heaviest mass that does not settle.
    """

    def grows(mass_kg: float) -> bool:
        return spectral_radius(replace(parameters, mass_kg=mass_kg), stiffness_N_m, damping_Ns_m) >= 1.0

    grid = np.geomspace(LIGHT_KG, HEAVY_KG, MASSES)
    heavy = [k for k, mass in enumerate(grid) if grows(float(mass))]
    if not heavy:
        return 0.0
    if heavy[-1] == len(grid) - 1:
        return float("inf")
    return _change(grows, float(grid[heavy[-1]]), float(grid[heavy[-1] + 1]))


def _change(holds: Callable[[float], bool], low: float, high: float) -> float:
    """Return the point between `low` and `high` at which `holds` ends; 0 if it does not hold at
    `low`. The point is searched upwards from `low` by factors of 1.1.
    """
    if not holds(low):
        return 0.0
    step = low
    while holds(step):
        low = step
        step *= 1.1
        if low >= high:
            return float("inf")
    high = step
    while high - low > 1e-12 * high:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low


def mass_radius(mass_kg: float, stiffness_N_m: float, period_s: float) -> float:
    """Return rho of a pure mass on the held spring, without delay and damping: above 1 for every K.

    Raises
    ------
    ParameterError
        K T^2/(2 m) is above 8, and the poles are no longer conjugate
    """
    a = stiffness_N_m * period_s**2 / (2 * mass_kg)
    if not 0.0 <= a <= 8.0:
        raise ParameterError(f"K T^2/(2 m) = {a:g}: expected 0 to 8; use spectral_radius")
    return float(np.sqrt(1.0 + a))


def mass_stiffness(mass_kg: float, damping_Ns_m: float, period_s: float) -> float:
    """Return K_max [N/m] of a pure mass with the sampled damping B, without delay; 0 from B = 2 m/T upwards."""
    p = damping_Ns_m * period_s / (2 * mass_kg)
    return max(2 * damping_Ns_m / period_s * (1 - p) / (1 + p), 0.0)


def mass_critical(stiffness_N_m: float, damping_Ns_m: float, period_s: float) -> float:
    """Return the mass [kg] above which the spring K with the sampled damping B settles, without delay;
    infinite from K = 2 B/T upwards.
    """
    share = stiffness_N_m * period_s / (2 * damping_Ns_m) if damping_Ns_m > 0 else float("inf")
    return damping_Ns_m * period_s / 2 * (1 + share) / (1 - share) if share < 1 else float("inf")


def largest_stiffness(parameters: Parameters) -> float:
    """Return K_max [N/m]: from it upwards the stuck spring does not settle."""
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
    """Return the decay of a stuck spring of `stiffness_N_m` in the loop, and the largest stable stiffness."""
    return StuckSpring(stiffness_N_m, spectral_radius(parameters, stiffness_N_m), largest_stiffness(parameters))
