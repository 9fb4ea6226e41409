r"""A brake on a linear plant: set-valued Coulomb friction, solved event by event, without time-stepping error.

.. math:: M\dot v + Bv + (\text{operator's states}) = f_h(t) - \psi,\qquad \psi \in c\,\mathrm{Sgn}(v)

Within a phase the system is linear and autonomous (`augmented`), so
a matrix exponential gives the state at any later instant. A phase ends at

- slip: the first zero of v. The handle sticks there if friction can balance the load; otherwise it
  continues to slip with the load's sign.
- stick: the first instant at which the load :math:`f_h - \text{spring}` exceeds c.

Events are searched on a grid much finer than the system's time constants, between grid points by
the sign of the derivative (which also finds two zeros in a step), and bisected to the last digit.

The operator's muscle force is the output of oscillators, so that it is integrated without error, too:

.. math:: f_h(t) = \sum_i \alpha_i s_i + \beta_i c_i, \qquad \dot s_i = \omega_i c_i,\quad \dot c_i = -\omega_i s_i,\quad s_i(0) = 0,\ c_i(0) = 1

Plant and oscillators together are one autonomous linear system; its matrix exponential contains the
plant's particular solution in closed form.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from coulombus.analysis.theory.linear import SampledPlant, continuous_model, exponential
from coulombus.analysis.theory.operators import Floats
from coulombus.analysis.theory.parameters import ParameterError, Parameters
from coulombus.kernels.decorator import kernel

__all__ = ["PAPER_FORCE", "HarmonicForce", "StickSlip", "augmented", "passive_motion", "work"]


@dataclass(frozen=True)
class HarmonicForce:
    """f_h [N] as (sine's amplitude, cosine's amplitude, angular frequency [rad/s]); a constant is a
    cosine of frequency 0.
    """

    terms: tuple[tuple[float, float, float], ...]

    def __post_init__(self) -> None:
        if not all(math.isfinite(value) for term in self.terms for value in term):
            raise ParameterError(f"operator's force {self.terms}: expected finite numbers")

    def oscillators(self, t: Floats) -> Floats:
        """Return sin(w_i t), cos(w_i t) for each term, one row a time."""
        turn = np.outer(t, [w for _, _, w in self.terms])
        both = np.stack((np.sin(turn), np.cos(turn)), axis=2)
        return both.reshape(len(turn), -1)

    @property
    def row(self) -> Floats:
        """f_h as a row over the oscillators."""
        return np.array([value for alpha, beta, _ in self.terms for value in (alpha, beta)])

    @property
    def matrix(self) -> Floats:
        """The oscillators' own dynamics."""
        n = 2 * len(self.terms)
        S = np.zeros((n, n))
        for i, (_, _, w) in enumerate(self.terms):
            S[2 * i, 2 * i + 1], S[2 * i + 1, 2 * i] = w, -w
        return S

    def __call__(self, t: Floats) -> Floats:
        """Return f_h(t) [N]."""
        force: Floats = self.oscillators(np.atleast_1d(t)) @ self.row
        return force


PAPER_FORCE = HarmonicForce(
    ((40.0, 0.0, math.pi**2 / 4), (1.0, 0.0, math.pi / 8), (0.0, -2.0, math.pi / 2), (0.0, 2.0, 0.0))
)
"""Section 4: 40 sin(pi^2/4 t) + sin(pi/8 t) + 2 [1 - cos(pi/2 t)]."""


def augmented(parameters: Parameters, force: HarmonicForce) -> tuple[Floats, Floats]:
    """Return the matrices of slip and of stick over (x, v, operator's states | oscillators | psi):
    Y' = A Y.

    In slip psi is constant; in stick x is constant, v = 0, and only the operator's own states evolve.
    """
    A, B, _ = continuous_model(parameters)
    n, m = len(B), 2 * len(force.terms)
    slip = np.zeros((n + m + 1, n + m + 1))
    slip[:n, :n] = A
    slip[:n, n : n + m] = np.outer(B, force.row)
    slip[:n, -1] = -B
    slip[n : n + m, n : n + m] = force.matrix
    stick = slip.copy()
    stick[:2] = 0.0
    stick[2:n, 1] = 0.0
    return slip, stick


def work(linear: SampledPlant, parameters: Parameters, force: HarmonicForce, steps: int) -> Floats:
    """Return the contribution of f_h to the state in each of `steps` periods (steps, states):
    exact, without phase drift of the oscillators.
    """
    slip, _ = augmented(parameters, force)
    n, m = len(linear.phi), 2 * len(force.terms)
    over = exponential(slip * parameters.period_s)[:n, n : n + m]
    t: Floats = np.arange(steps, dtype=np.float64) * parameters.period_s
    added: Floats = force.oscillators(t) @ over.T
    return added


MOST_EVENTS = 20_000
SERIES = 24
BISECTIONS = 60


@kernel
def _advance(A: Floats, start: Floats, t: float, out: Floats, term: Floats, product: Floats) -> None:
    """Write exp(A t) start into `out`: the exponential's series, for |A| t up to about 2."""
    n = len(start)
    for i in range(n):
        out[i] = start[i]
        term[i] = start[i]
    for order in range(1, SERIES):
        for i in range(n):
            total = 0.0
            for j in range(n):
                total += A[i, j] * term[j]
            product[i] = total * (t / order)
        for i in range(n):
            term[i] = product[i]
            out[i] += product[i]


@kernel
def _oscillate(frequencies: Floats, n: int, t: float, Y: Floats) -> None:
    for i in range(len(frequencies)):
        Y[n + 2 * i] = np.sin(frequencies[i] * t)
        Y[n + 2 * i + 1] = np.cos(frequencies[i] * t)


@kernel
def _dot(row: Floats, Y: Floats) -> float:
    total = 0.0
    for i in range(len(row)):
        total += row[i] * Y[i]
    return total


class _Model(NamedTuple):
    """The plant in its two phases, followed by the force's states and a constant state."""

    slip: Floats
    stick: Floats
    slip_step: Floats  # one step's exponentials, of the plant's states
    stick_step: Floats
    frequencies: Floats
    load: Floats
    n: int  # states of the plant
    friction: float


class _Motion(NamedTuple):
    """Output arrays of a run."""

    path: Floats
    force: Floats
    intervals: Floats


@kernel
def _run(model: _Model, period: float, finer: int, motion: _Motion) -> int:
    """Run from rest; returns the number of stick intervals (the last one may still be open: its end
    is then the window's).
    """
    slip, stick, slip_step, stick_step, frequencies, load, n, friction = model
    path, force, intervals = motion
    N = len(slip)
    Y, at, term, product = np.zeros(N), np.zeros(N), np.zeros(N), np.zeros(N)
    step = period / finer
    steps = len(path) * finer
    _oscillate(frequencies, n, 0.0, Y)
    begin_load = _dot(load, Y)
    stuck = abs(begin_load) <= friction
    sense = 0.0 if stuck else (1.0 if begin_load > 0.0 else -1.0)
    Y[N - 1] = sense * friction
    count = 0
    if stuck:
        intervals[0, 0] = 0.0
        count = 1
    t = 0.0
    events = 0
    for k in range(steps):
        if k % finer == 0:
            for i in range(n):
                path[k // finer, i] = Y[i]
            force[k // finer] = _dot(load, Y) if stuck else sense * friction
        end = (k + 1) * step
        whole = True
        while True:
            A = stick if stuck else slip
            rest = end - t
            if whole:
                E = stick_step if stuck else slip_step
                for i in range(n):
                    total = 0.0
                    for j in range(N):
                        total += E[i, j] * Y[j]
                    at[i] = total
                _oscillate(frequencies, n, end, at)
                at[N - 1] = Y[N - 1]
            else:
                _advance(A, Y, rest, at, term, product)
            # g > 0: the phase is over; `rises` is the sign of dg/dt
            if stuck:
                toward = 1.0 if _dot(load, Y) > 0.0 else -1.0
                toward_end = 1.0 if _dot(load, at) > 0.0 else -1.0
                g_end = abs(_dot(load, at)) - friction
                rise, rise_end = 0.0, 0.0
                for i in range(N):
                    if load[i] != 0.0:
                        rise += toward * load[i] * _dot(A[i], Y)
                        rise_end += toward_end * load[i] * _dot(A[i], at)
            else:
                g_end = -sense * at[1]
                # at breakaway dv/dt is 0 up to rounding, of either sign: no maximum of g is searched there
                rise = -sense * _dot(A[1], Y) if Y[1] != 0.0 else 0.0
                rise_end = -sense * _dot(A[1], at)
            high = rest
            over = g_end > 0.0
            if not over and rise > 0.0 and rise_end < 0.0:  # g has a maximum within the step: find it
                a, b = 0.0, rest
                for _ in range(BISECTIONS):
                    middle = 0.5 * (a + b)
                    _advance(A, Y, middle, at, term, product)
                    slope = 0.0
                    if stuck:
                        side = 1.0 if _dot(load, at) > 0.0 else -1.0
                        for i in range(N):
                            if load[i] != 0.0:
                                slope += side * load[i] * _dot(A[i], at)
                    else:
                        slope = -sense * _dot(A[1], at)
                    if slope > 0.0:
                        a = middle
                    else:
                        b = middle
                g = abs(_dot(load, at)) - friction if stuck else -sense * at[1]
                over = g > 0.0
                high = b
                if not over:
                    _advance(A, Y, rest, at, term, product)
            if not over or events >= MOST_EVENTS:
                for i in range(N):
                    Y[i] = at[i]
                t = end
                break
            low = 0.0
            if not stuck and Y[1] == 0.0:  # slip has just begun at v = 0: skip this zero
                low = high
                for _ in range(30):
                    low *= 0.5
                    _advance(A, Y, low, at, term, product)
                    if -sense * at[1] < 0.0:
                        break
                else:
                    low = 0.0
            for _ in range(BISECTIONS):
                middle = 0.5 * (low + high)
                _advance(A, Y, middle, at, term, product)
                g = abs(_dot(load, at)) - friction if stuck else -sense * at[1]
                if g > 0.0:
                    high = middle
                else:
                    low = middle
            events += 1
            _advance(A, Y, high, at, term, product)
            for i in range(n):
                Y[i] = at[i]
            t += high
            _oscillate(frequencies, n, t, Y)
            whole = False
            Y[1] = 0.0
            pull = _dot(load, Y)
            if stuck:
                intervals[count - 1, 1] = t
                stuck = False
                sense = 1.0 if pull > 0.0 else -1.0
            elif abs(pull) <= friction:
                stuck = True
                sense = 0.0
                if count < len(intervals):
                    count += 1
                intervals[count - 1, 0] = t
            else:
                sense = 1.0 if pull > 0.0 else -1.0
            Y[N - 1] = sense * friction
    if stuck:
        intervals[count - 1, 1] = steps * step
    return count


@dataclass(frozen=True)
class StickSlip:
    """Motion of the braked plant at the samples, and its stick intervals."""

    t_s: Floats
    x_m: Floats
    v_m_s: Floats
    force_N: Floats
    """psi: c against the motion in slip, the balanced load in stick."""
    stick_intervals_s: tuple[tuple[float, float], ...]


def passive_motion(parameters: Parameters, force: HarmonicForce) -> StickSlip:
    """Return the motion from rest under `force` over the parameters' window, sampled at their period."""
    slip, stick = augmented(parameters, force)
    _, B, load_row = continuous_model(parameters)
    n = len(B)
    load = np.concatenate((-load_row, force.row, [0.0]))
    T = parameters.period_s
    fastest = max(float(np.max(np.abs(np.linalg.eigvals(slip)))), float(np.linalg.norm(slip[:n, :n], 2)) / 4, 1e-9)
    finer = max(1, int(np.ceil(4 * fastest * T)))
    samples = round(parameters.window_s / T)
    path, psi = np.empty((samples, n)), np.empty(samples)
    intervals = np.zeros((MOST_EVENTS, 2))
    slip_step, stick_step = (np.ascontiguousarray(exponential(phase * (T / finer))[:n]) for phase in (slip, stick))
    frequencies = np.array([w for _, _, w in force.terms])
    model = _Model(slip, stick, slip_step, stick_step, frequencies, load, n, parameters.friction_N)
    count = _run(model, T, finer, _Motion(path, psi, intervals))
    pairs = tuple((float(begin), float(end)) for begin, end in intervals[:count])
    t: Floats = np.arange(samples, dtype=np.float64) * T
    return StickSlip(t, path[:, 0], path[:, 1], psi, pairs)
