r"""The operator's muscle force :math:`f_h(t)` as the output of oscillators, so that it is integrated without error.

.. math:: f_h(t) = \sum_i \alpha_i s_i + \beta_i c_i, \qquad \dot s_i = \omega_i c_i,\quad \dot c_i = -\omega_i s_i,\quad s_i(0) = 0,\ c_i(0) = 1

Plant and oscillators together are one autonomous linear system; its matrix exponential contains the
plant's particular solution in closed form.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from coulombus.analysis.theory.linear import SampledPlant, continuous_model, exponential
from coulombus.analysis.theory.operators import Floats
from coulombus.analysis.theory.parameters import ParameterError, Parameters

__all__ = ["PAPER_FORCE", "HarmonicForce", "augmented", "work"]


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
