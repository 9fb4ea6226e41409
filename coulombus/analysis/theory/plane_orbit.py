r"""The limit cycle of motors alone that display Coulomb friction in the plane: predicted, and exact at the samples.

Near a pose the tip is a mass :math:`\Lambda = J^{-T} M J^{-1}` (with the hand's), which the motors' force
:math:`-\psi` accelerates, :math:`\psi = c\,\hat v/|\hat v|`. In the principal directions of :math:`\Lambda` the
loop is two equal sampled loops with the masses :math:`\lambda_1 \le \lambda_2`, which the law alone couples.

**Describing function.** The estimate moves on an ellipse, :math:`\hat v = (a_1\cos\theta, a_2\sin\theta)`. The
fundamental of the law's force has the gains

.. math:: \Psi_i = \frac{c}{\pi} \int_0^{2\pi} \frac{e_i^2(\theta)}{\sqrt{a_1^2\cos^2\theta + a_2^2\sin^2\theta}}\,d\theta,
          \qquad e_1 = \cos\theta,\ e_2 = \sin\theta,

which are real. With the response :math:`H(e^{j\vartheta})/\lambda_i` from force to estimate the harmonic balance is
:math:`\Psi_i H(e^{j\vartheta}) = -\lambda_i`. Its phase, :math:`\arg H = -\pi`, gives the frequency
:math:`\vartheta/(2\pi T)`. It is independent of masses, level and direction. Then
:math:`\Psi_2/\Psi_1 = \lambda_2/\lambda_1` gives the ellipse's shape, and :math:`\Psi_1 = \lambda_1/|H|` its size.
With equal masses the ellipse is a circle, :math:`\Psi = c/a`, the force has no harmonics, and the prediction is
exact. An ellipse is an approximation: where the larger mass is more than about three times the smaller, the exact
loop settles on a line along the direction of the smaller.

The response of a free mass with the motor's lag, a delay of one cycle, the mean speed over n cycles and its
extrapolation by the gain g over m cycles (:math:`\hat v_k = \bar v_k + g(\bar v_k - \bar v_{k-m})`) is
:math:`H(z) = z^{-1} X(z)\,\frac{1 - z^{-n}}{nT}\,(1 + g - g z^{-m})`, with the sampled position :math:`X` of a unit
mass behind the lag.

**Exact orbit.** Between samples the force is constant and the plant linear, so the recursion by matrix exponentials
is exact at the samples. `settled_orbit` runs it until its motion is steady. It includes the hand's damping and
stiffness. Friction of the joints is none in either.

Source of the method: A. Gelb, W. E. Vander Velde, Multiple-Input Describing Functions, 1968; of the sampled relay:
Y. Z. Tsypkin, Relay Control Systems, 1984. The ellipse in the plane is this project's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.linalg import expm
from scipy.optimize import brentq

__all__ = ["PredictedOrbit", "SettledOrbit", "TipLoop", "predicted_orbit", "response", "settled_orbit"]

Floats = npt.NDArray[np.float64]
Complexes = npt.NDArray[np.complex128]
ANGLES = 2000
SETTLE, KEPT = 3000, 4096
FIRST = 0.02
"""Start of the search for the frequency [rad a sample]."""


@dataclass(frozen=True)
class TipLoop:
    """The sampled loop of a tip.

    Attributes
    ----------
    period_s : the cycle
    friction_N : c, the law's level
    window_cycles : cycles over which the speed is the mean
    turn_cycles, turn_gain : m and g of the extrapolation; gain 0: none
    lag_s : of the motors
    """

    period_s: float
    friction_N: float
    window_cycles: int = 1
    turn_cycles: int = 1
    turn_gain: float = 0.0
    lag_s: float = 0.0


@dataclass(frozen=True)
class PredictedOrbit:
    """The describing function's limit cycle.

    Attributes
    ----------
    frequency_Hz : of the ellipse
    velocity_m_s : semi-axes of the tip's velocity along the directions of the smaller and the larger mass
    """

    frequency_Hz: float
    velocity_m_s: tuple[float, float]


@dataclass(frozen=True)
class SettledOrbit:
    """The exact loop's motion after it has settled.

    Attributes
    ----------
    frequency_Hz : of the largest peak of the velocity's spectrum
    velocity_m_s : sqrt(2) times the RMS of the tip's velocity along both principal directions
    """

    frequency_Hz: float
    velocity_m_s: tuple[float, float]


def _steps(loop: TipLoop, mass: float, damping: float = 0.0, stiffness: float = 0.0) -> tuple[Floats, Floats]:
    """Return the transition over a period of (x, v, force of the motor), and the part of the command."""
    a = np.array([[0.0, 1.0, 0.0], [-stiffness / mass, -damping / mass, 1.0 / mass], [0.0, 0.0, 0.0]])
    if loop.lag_s > 0.0:
        whole = np.zeros((4, 4))
        whole[:3, :3] = a
        whole[2, 2], whole[2, 3] = -1.0 / loop.lag_s, 1.0 / loop.lag_s
        step = np.asarray(expm(whole * loop.period_s))
        return step[:3, :3], step[:3, 3]
    step = np.asarray(expm(a * loop.period_s))  # the command is the force at once
    phi, gamma = step.copy(), step[:, 2].copy()
    phi[:, 2], gamma[2] = 0.0, 1.0
    return phi, gamma


def _at(loop: TipLoop, angles: npt.ArrayLike) -> tuple[Complexes, Complexes]:
    """Return H, and the ratio of the true velocity to the estimate, at each angle a sample, for a unit mass."""
    z = np.exp(1j * np.atleast_1d(angles))
    phi, gamma = _steps(loop, 1.0)
    x, v, _ = np.linalg.solve(z[:, None, None] * np.eye(3) - phi, gamma.astype(complex)[:, None])[..., 0].T
    n, m, g = loop.window_cycles, loop.turn_cycles, loop.turn_gain
    estimate = x * (1 - z**-n) / (n * loop.period_s) * (1 + g - g * z**-m)
    return estimate / z, v / estimate


def response(loop: TipLoop, frequency_Hz: float) -> complex:
    """Return H at a frequency, from force to estimated velocity of a unit mass [s/kg]."""
    return complex(_at(loop, 2 * math.pi * frequency_Hz * loop.period_s)[0][0])


def _gains(shape: float) -> tuple[float, float]:
    """Return Psi_1 a_1 / c and Psi_2 a_1 / c of an ellipse with a_2 / a_1 = shape."""
    angle = (np.arange(ANGLES) + 0.5) * (math.pi / 2 / ANGLES)
    first, second = np.cos(angle) ** 2, np.sin(angle) ** 2
    size = np.sqrt(first + shape**2 * second)
    scale = 4 / math.pi * (math.pi / 2 / ANGLES)
    return float(scale * (first / size).sum()), float(scale * (second / size).sum())


def predicted_orbit(loop: TipLoop, masses_kg: tuple[float, float]) -> PredictedOrbit:
    """Return the limit cycle that the describing function predicts, for ascending masses [kg]."""
    angles = np.linspace(FIRST, math.pi - 1e-6, 4000)
    phase = np.unwrap(np.angle(-_at(loop, angles)[0]))
    phase -= 2 * math.pi * round((phase[0] - math.pi / 2) / (2 * math.pi))  # at 0 the mass alone: -1/(j w)
    k = int(np.flatnonzero(phase <= 0.0)[0])

    def off(angle: float) -> float:
        return float(np.angle(-_at(loop, angle)[0][0]))

    angle = float(brentq(off, angles[k - 1], angles[k])) if k else float(angles[0])
    gain, true = (complex(each[0]) for each in _at(loop, angle))
    ratio = masses_kg[1] / masses_kg[0]

    def mismatch(shape: float) -> float:
        first, second = _gains(shape)
        return second / first - ratio

    shape = 1.0 if ratio <= 1.0 + 1e-9 else float(brentq(mismatch, 1e-3, 1.0)) if mismatch(1e-3) > 0.0 else 1e-3
    first_m_s = loop.friction_N * _gains(shape)[0] * abs(gain) / masses_kg[0] * abs(true)
    return PredictedOrbit(angle / (2 * math.pi * loop.period_s), (first_m_s, shape * first_m_s))


def settled_orbit(
    loop: TipLoop,
    masses_kg: tuple[float, float],
    damping_Ns_m: tuple[float, float] = (0.0, 0.0),
    stiffness_N_m: tuple[float, float] = (0.0, 0.0),
    seed: int = 0,
) -> SettledOrbit:
    """Return the motion of the exact loop from a random start, after it has settled.

    Parameters
    ----------
    damping_Ns_m, stiffness_N_m : along the principal directions
    """
    n, m, g = loop.window_cycles, loop.turn_cycles, loop.turn_gain
    phi, gamma = zip(
        *(_steps(loop, *each) for each in zip(masses_kg, damping_Ns_m, stiffness_N_m, strict=True)), strict=True
    )
    start = np.random.default_rng(seed).normal(size=2)
    state = [np.array([0.0, 0.01 * v, 0.0]) for v in start]
    back = n + m
    path = np.zeros((SETTLE + KEPT + back, 2))
    velocity = np.zeros((SETTLE + KEPT, 2))
    command = np.zeros(2)
    for k in range(SETTLE + KEPT):
        row = back + k
        for i in range(2):
            path[row, i], velocity[k, i] = state[i][0], state[i][1]
        mean = (path[row] - path[row - n]) / (n * loop.period_s)
        earlier = (path[row - m] - path[row - m - n]) / (n * loop.period_s)
        estimate = mean + g * (mean - earlier)
        for i in range(2):
            state[i] = phi[i] @ state[i] + gamma[i] * command[i]  # of the last cycle
        size = math.hypot(*estimate)
        command = -loop.friction_N * estimate / size if size > 0.0 else np.zeros(2)
    settled = velocity[SETTLE:]
    settled = settled - settled.mean(axis=0)
    spectrum = (np.abs(np.fft.rfft(settled * np.hanning(KEPT)[:, None], axis=0)) ** 2).sum(axis=1)
    frequency = float(np.argmax(spectrum)) / (KEPT * loop.period_s)
    first, second = np.sqrt(2 * (settled**2).mean(axis=0)).tolist()
    return SettledOrbit(frequency, (first, second))
