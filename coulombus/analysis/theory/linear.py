r"""The loop's linear part: eqs. (6)-(14), in the z-domain exactly and as a sum of aliases.

.. math:: G(s) = \frac{1-e^{-Ts}}{s^2}\,P(s)\,e^{-s\tau},\quad P(s) = \frac{1}{ms+b+Z_o(s)},\quad
          D^*(s) = \frac{1-e^{-Ts}}{T},\quad H^*(s) = D^*(s)\,G^*(s)

`SampledPlant` steps the plant by matrix exponentials. With a delay :math:`\tau = qT + \delta` the
force of the step is :math:`u_{k-q-1}` for :math:`\delta` and :math:`u_{k-q}` for the rest, which is
the modified z-transform in state space:

.. math:: H(z) = \tfrac1T z^{-1}\,\bigl[R(zI-\Phi)^{-1}\Gamma(z) + g(z)\bigr],\quad \Gamma(z) = \Gamma_0 z^{-q} + \Gamma_1 z^{-q-1}

with the state (v, operator) and the displacement over a step as the output; so the differentiator's
zero at z = 1 and the integrator's pole are cancelled analytically, not in floating point.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import zeta

from coulombus.analysis.theory.operators import Complexes, Floats
from coulombus.analysis.theory.parameters import ParameterError, Parameters

__all__ = [
    "Disk",
    "SampledPlant",
    "alias_sum",
    "alias_terms",
    "alias_weights",
    "continuous_model",
    "exponential",
    "frequency_response",
    "multiplier",
    "passive_disk",
    "plant",
    "sample",
]

ALIASES = 200
TAIL_TERMS = 30
SERIES = 18


def plant(s: Complexes, parameters: Parameters) -> Complexes:
    """Return P(s) = 1 / (m s + b + Z_o(s)), eq. (15), in m/(Ns)."""
    p = parameters
    value: Complexes = 1.0 / (p.mass_kg * s + p.damping_Ns_m + p.operator(s))
    return value


def continuous_model(parameters: Parameters) -> tuple[Floats, Floats, Floats]:
    """Return A, B and the load row of the state (x, v, operator's states): y' = A y + B f.

    The load row gives the operator's force without its mass and damper, the spring's for the
    paper's hand: with the handle held, friction must balance f_h - load @ y.
    """
    parts = parameters.operator.parts()
    n = len(parts.B)
    mass = parameters.mass_kg + parts.inertia
    A, B, load = np.zeros((n + 2, n + 2)), np.zeros(n + 2), np.zeros(n + 2)
    A[0, 1] = 1.0
    A[1, 1] = -(parameters.damping_Ns_m + parts.damping) / mass
    A[1, 2:] = -parts.C / mass
    A[2:, 1] = parts.B
    A[2:, 2:] = parts.A
    B[1] = 1.0 / mass
    load[2:] = parts.C
    return A, B, load


def exponential(A: Floats) -> Floats:
    """Return exp(A) of a small matrix by scaling, the series, and squaring.

    Equal to scipy.linalg.expm up to rounding (a test compares them), but without BLAS, whose
    threads cost more than the arithmetic of a dozen rows.
    """
    squarings = max(0, math.ceil(math.log2(max(float(np.linalg.norm(A, 1)), 1e-300))) + 1)
    scaled = A * 0.5**squarings
    identity = np.eye(len(A))
    total = identity.copy()
    for order in range(SERIES, 0, -1):
        total = identity + scaled @ total / order
    for _ in range(squarings):
        total = total @ total
    return total


def _zoh(A: Floats, B: Floats, t: float) -> tuple[Floats, Floats]:
    n = len(B)
    block = np.zeros((n + 1, n + 1))
    block[:n, :n], block[:n, n] = A * t, B * t
    e = exponential(block)
    return e[:n, :n], e[:n, n]


@dataclass(frozen=True)
class SampledPlant:
    """One period of the plant: y_{k+1} = phi y_k + gamma_0 f_{k-q} + gamma_1 f_{k-q-1}, y = (x, v,
    operator's states).
    """

    period_s: float
    phi: Floats
    gamma_0: Floats
    gamma_1: Floats
    whole_cycles: int
    """q of the delay q T + delta."""

    @property
    def velocity_states(self) -> Floats:
        """Phi without the position: it decides whether a periodic motion of the velocity is attractive."""
        return self.phi[1:, 1:]

    @property
    def spectral_radius(self) -> float:
        """Largest modulus of an eigenvalue of `velocity_states`."""
        return float(np.max(np.abs(np.linalg.eigvals(self.velocity_states))))

    def response(self, z: Complexes) -> Complexes:
        """Return H(z), from the force psi to minus v^, in m/(Ns)."""
        z = np.asarray(z, dtype=np.complex128)
        n = len(self.phi) - 1
        g0, g1 = self.gamma_0, self.gamma_1
        late, later = z**-self.whole_cycles, z ** -(self.whole_cycles + 1)
        forced = late[..., None] * g0[1:] + later[..., None] * g1[1:]
        inverse = np.linalg.solve(z[..., None, None] * np.eye(n) - self.velocity_states, forced[..., None])[..., 0]
        step = inverse @ self.phi[0, 1:] + late * g0[0] + later * g1[0]
        value: Complexes = step / (z * self.period_s)
        return value


def sample(parameters: Parameters) -> SampledPlant:
    """Return the exact step of the plant over one period, with the loop's delay."""
    A, B, _ = continuous_model(parameters)
    q, late = parameters.delay_parts
    T = parameters.period_s
    phi, whole = _zoh(A, B, T)
    rest, gamma_0 = _zoh(A, B, T - late)
    gamma_1 = rest @ _zoh(A, B, late)[1] if late else np.zeros_like(whole)
    return SampledPlant(T, phi, gamma_0, gamma_1, q)


def frequency_response(frequency_Hz: Floats, parameters: Parameters) -> Complexes:
    """Return H*(jw), exact, at `frequency_Hz`."""
    return sample(parameters).response(np.exp(2j * np.pi * np.asarray(frequency_Hz) * parameters.period_s))


def alias_sum(frequency_Hz: Floats, parameters: Parameters, aliases: int = ALIASES) -> Complexes:
    r"""Return H*(jw) by eq. (10): the aliases -`aliases` ...

    `aliases` one by one, the tail by Hurwitz' zeta.

    Beyond the plant's poles :math:`P(s)/s^2 = \sum_j c_j s^{-j}`, and
    :math:`\sum_{k>N} (k+\omega/\omega_s)^{-j}` is :math:`\zeta(j, N+1+\omega/\omega_s)`. With a
    fraction of a cycle of delay the aliases' phases rotate and there is no such tail; more terms
    are summed instead, and the truncation error falls with the cube of their number. Not for w = 0,
    where single terms are infinite.
    """
    T, tau = parameters.period_s, parameters.delay_s
    w = 2 * np.pi * np.atleast_1d(np.asarray(frequency_Hz, dtype=np.float64))
    ws = 2 * np.pi / T
    _, fraction = parameters.delay_parts
    n = aliases if not fraction else max(aliases, 20_000)
    total = np.zeros(len(w), dtype=np.complex128)
    k = np.arange(-n, n + 1)
    for i, omega in enumerate(w):
        s = 1j * (omega + k * ws)
        terms = plant(s, parameters) / s**2 * np.exp(-1j * k * ws * fraction)
        total[i] = np.sum(terms[np.argsort(np.abs(terms))])
    if not fraction:
        u = w / ws
        for j, coefficient in enumerate(_at_infinity(parameters), start=2):
            tail = zeta(j, n + 1 + u) + (-1) ** j * zeta(j, n + 1 - u)
            total += coefficient * (1j * ws) ** -j * tail
    value: Complexes = (1 - np.exp(-1j * w * T)) ** 2 / T**2 * total * np.exp(-1j * w * tau)
    return value


def alias_weights(frequency_Hz: Floats, parameters: Parameters, orders: int = 10) -> Floats:
    r"""Return the weight of each alias in eq. (12)'s sum, (frequencies, 2 `orders` + 1): of -`orders` ...
    `orders`.

    .. math:: w_k(\omega) = \frac{|1 - e^{-j\omega T}|^2}{T^2 (\omega + k\omega_s)^2}
              = \frac{\sin^2(\omega T/2)}{(\omega T/2 + k\pi)^2}, \qquad \sum_{k=-\infty}^{\infty} w_k = 1

    They are positive, so the region of a passive hand remains a disk of the same radius. The first
    alias, k = -1, has the same weight as the frequency itself at fs/2, and weight 0 at 0.
    """
    half = np.pi * np.atleast_1d(np.asarray(frequency_Hz, dtype=np.float64)) * parameters.period_s
    turns = np.arange(-orders, orders + 1)
    weights: Floats = np.sinc((half[:, None] + turns * np.pi) / np.pi) ** 2
    return weights


def alias_terms(frequency_Hz: Floats, parameters: Parameters, orders: int = 10) -> Complexes:
    """Return the terms of eq. (10), (frequencies, 2 `orders` + 1): the contribution of each alias
    to H*(jw); not for w = 0.
    """
    T, tau = parameters.period_s, parameters.delay_s
    w = 2 * np.pi * np.atleast_1d(np.asarray(frequency_Hz, dtype=np.float64))[:, None]
    s = 1j * (w + np.arange(-orders, orders + 1) * (2 * np.pi / T))
    terms: Complexes = (1 - np.exp(-1j * w * T)) ** 2 / T**2 * plant(s, parameters) / s**2 * np.exp(-s * tau)
    return terms


def _at_infinity(parameters: Parameters) -> Floats:
    """Return c_2, c_3 ... of P(s)/s^2 = sum c_j s^-j by long division of P = D / ((m s + b) D + N)
    in 1/s.
    """
    operator = parameters.operator
    below = np.polyadd(
        np.polymul([parameters.mass_kg, parameters.damping_Ns_m], operator.denominator), operator.numerator
    )
    below = np.trim_zeros(below, "f")
    lag = len(below) - len(operator.denominator)
    above = np.zeros(TAIL_TERMS)
    above[lag : lag + len(operator.denominator)] = operator.denominator
    series = np.zeros(TAIL_TERMS)
    for i in range(TAIL_TERMS):
        terms = min(i, len(below) - 1)
        series[i] = (above[i] - below[1 : terms + 1] @ series[i - terms : i][::-1]) / below[0]
    return series


def multiplier(frequency_Hz: Floats, parameters: Parameters) -> Complexes:
    r"""Return r(jw) of eq. (12) in closed form: exp(-jwT), one period of pure lag, plus the delay.

    :math:`\sum_k (\omega + k\omega_s)^{-2} = T^2 / (2(1-\cos\omega T))` turns eq. (12) into
    :math:`e^{-j\omega T}`; the remaining sum sign in eq. (13) is an error. A fraction
    :math:`\delta` of the delay weights two periods: :math:`(1-\delta/T) + (\delta/T)\,e^{-j\omega
    T}`.
    """
    q, late = parameters.delay_parts
    lag = np.exp(-2j * np.pi * np.asarray(frequency_Hz) * parameters.period_s)
    share = late / parameters.period_s
    value: Complexes = lag ** (q + 1) * (1 - share + share * lag)
    return value


@dataclass(frozen=True)
class Disk:
    """Region of H*(jw) for all passive operators: a disk at each frequency, corrected eqs. (11)-(14)."""

    frequency_Hz: Floats
    center: Complexes
    radius: Floats


def passive_disk(frequency_Hz: Floats, parameters: Parameters) -> Disk:
    """Return centre r(jw)/(2b) and radius 1/(2b), both in m/(Ns).

    The weights of eq. (10)'s terms sum to 1 in modulus, so the radius is 1/(2b) with any delay.
    """
    b = parameters.damping_Ns_m
    if b == 0:
        raise ParameterError("damping_Ns_m = 0: the region of (m s + b + Z_o)^-1 is a half-plane, not a disk")
    frequency = np.asarray(frequency_Hz, dtype=np.float64)
    return Disk(frequency, multiplier(frequency, parameters) / (2 * b), np.full(len(frequency), 0.5 / b))
