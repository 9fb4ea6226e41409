r"""Largest possible motion of the loop: l1 norm of its response, and velocity between samples.

**The l1 bound.** With the impulse response :math:`h_k` from the friction to :math:`-\hat v` and any
:math:`|\psi_k| \le c`, for any law,

.. math:: |\hat v_k| \le c \sum_{i=0}^{\infty} |h_i| = c\,\|h\|_1 .

No self-sustained motion of the display can be larger. The bound is sharp: the sequence
:math:`\psi_{k-i} = -c\,\mathrm{sgn}\,h_i` reaches it. The sum is truncated when the remainder,
bounded by the powers of the plant's step, is below a share of it.

**Between samples** a periodic motion is known as well: its state at the samples is the fixed point of
a period, and from there the plant is stepped by matrix exponentials to any instant. This gives the
extremes of the true velocity; a backward difference gives only its mean over a sample.

Source of the bound: M. A. Dahleh, I. J. Diaz-Bobillo, Control of Uncertain Systems: A Linear
Programming Approach, 1995, chapter 2.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from coulombus.analysis.theory.linear import SampledPlant, continuous_model, exponential, sample
from coulombus.analysis.theory.operators import Floats
from coulombus.analysis.theory.parameters import ParameterError, Parameters

__all__ = ["Between", "between_samples", "l1_bound", "l1_norm"]

LEFT = 1e-9
"""Share of the norm that may be truncated."""
MOST_TERMS = 4_000_000
LOOKS = 16
"""Instants evaluated in each interval of constant force."""


def l1_norm(linear: SampledPlant) -> float:
    r"""Return :math:`\|h\|_1` [m/(Ns)] of the response from psi to minus v^.

    Raises
    ------
    ParameterError
        the plant without its position is not stable: the sum diverges
    """
    if linear.spectral_radius >= 1.0 - 1e-12:
        raise ParameterError("the plant without its position is not stable: no l1 norm; give it damping")
    phi, row = linear.velocity_states, linear.phi[0, 1:]
    total, state = 0.0, np.zeros(len(phi))
    for k in range(linear.whole_cycles + 2):  # the force enters over two samples: gamma_0, then gamma_1
        step = float(row @ state)
        state = phi @ state
        if k == linear.whole_cycles:
            step += linear.gamma_0[0]
            state = state + linear.gamma_0[1:]
        if k == linear.whole_cycles + 1:
            step += linear.gamma_1[0]
            state = state + linear.gamma_1[1:]
        total += abs(step)
    power, doubled = phi, 1  # phi^doubled, with a norm below 1/2: the remainder is halved each time
    while float(np.linalg.norm(power, 2)) > 0.5:
        power, doubled = power @ power, 2 * doubled
        if doubled > MOST_TERMS:
            raise ParameterError("the plant hardly damps: the l1 norm's sum is too long; give it more damping")
    while True:
        block = 0.0
        for _ in range(doubled):
            block += abs(float(row @ state))
            state = phi @ state
        total += block
        if block <= LEFT * total:
            return total / linear.period_s


def l1_bound(parameters: Parameters) -> float:
    """Return the largest self-sustained |v^| [m/s] of a display of at most `friction_N`."""
    return parameters.friction_N * l1_norm(sample(parameters))


@dataclass(frozen=True)
class Between:
    """A periodic motion of the loop between its samples."""

    t_s: Floats
    """Instants within one period, starting at a sample."""
    v_m_s: Floats
    """The handle's true velocity there."""
    peak_m_s: float
    """Its largest modulus, including between the instants."""
    rms_m_s: float


def between_samples(parameters: Parameters, signs: Floats) -> Between:
    """Return the motion under the periodic force c u_k, u = `signs`, as commanded at its samples.

    Raises
    ------
    ParameterError
        the plant without its position is not stable: a periodic force has no periodic motion
    """
    linear = sample(parameters)
    if linear.spectral_radius >= 1.0 - 1e-12:
        raise ParameterError("the plant without its position is not stable: no periodic motion; give it damping")
    A, B, _ = continuous_model(parameters)
    A, B = A[1:, 1:], B[1:]
    q, late = parameters.delay_parts
    p, n = len(signs), len(B)
    psi = parameters.friction_N * np.asarray(signs, dtype=np.float64)
    pieces = [
        (duration, -psi[(k - q - lag) % p])
        for k in range(p)
        for duration, lag in ((late, 1), (parameters.period_s - late, 0))
        if duration > 0.0
    ]
    whole: Floats = np.eye(n)
    forced: Floats = np.zeros(n)
    for duration, force in pieces:
        step = _step(A, B, duration)
        whole, forced = step[:n, :n] @ whole, step[:n, :n] @ forced + step[:n, n] * force
    y: Floats = np.linalg.solve(np.eye(n) - whole, forced).astype(np.float64)
    times: list[Floats] = []
    speeds: list[Floats] = []
    squares, peak, t = 0.0, 0.0, 0.0
    for duration, force in pieces:
        small = _step(A, B, duration / LOOKS)
        course: list[Floats] = [y]
        for _ in range(LOOKS):
            course.append(small[:n, :n] @ course[-1] + small[:n, n] * force)
        v = np.array([state[0] for state in course])
        rate = np.array([float(A[0] @ state + B[0] * force) for state in course])
        peak = max(peak, float(np.abs(v).max()))
        for i in np.flatnonzero(rate[:-1] * rate[1:] < 0):

            def at(h: float, start: Floats = course[i], force: float = force) -> Floats:
                transition = _step(A, B, h)
                state: Floats = transition[:n, :n] @ start + transition[:n, n] * force
                return state

            h = brentq(lambda h: float(A[0] @ at(h) + B[0] * force), 0.0, duration / LOOKS)  # noqa: B023
            peak = max(peak, abs(float(at(h)[0])))
        times.append(t + np.arange(LOOKS) * duration / LOOKS)
        speeds.append(v[:-1])
        simpson = np.ones(LOOKS + 1)
        simpson[1:-1:2], simpson[2:-1:2] = 4.0, 2.0
        squares += float(simpson @ v**2) * duration / (3 * LOOKS)
        y, t = course[-1], t + duration
    return Between(np.concatenate(times), np.concatenate(speeds), peak, (squares / t) ** 0.5)


def _step(A: Floats, B: Floats, h: float) -> Floats:
    block = np.zeros((len(B) + 1, len(B) + 1))
    block[:-1, :-1], block[:-1, -1] = A * h, B * h
    return exponential(block)
