r"""The sampled relay loop, exact at the samples: compiled recursion and figures of its steady motion.

.. math:: y_{k+1} = \Phi y_k - \Gamma_0\psi_{k-q} - \Gamma_1\psi_{k-q-1} + w_k,\qquad
          \psi_k = c\,\mathrm{sgn}(\hat v_k),\quad \hat v_k = (x_k - x_{k-1})/T

Between samples the force is constant and the plant linear, so the matrices of
`analysis.theory.linear.sample` leave no integration error at the samples. :math:`w_k` is the
operator's force over the period, integrated exactly by the caller (`analysis.theory.fig10`). With an
encoder, :math:`x_k` is first rounded to its resolution.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from coulombus.analysis.theory.linear import SampledPlant, sample
from coulombus.analysis.theory.operators import Floats
from coulombus.analysis.theory.parameters import Parameters
from coulombus.kernels.decorator import kernel

__all__ = [
    "LARGEST_START",
    "RelayLoop",
    "RelayTraces",
    "SteadyMotion",
    "forced",
    "random_starts",
    "relay_steps",
    "settle",
    "steady",
]

LARGEST_START = (3e-3, 0.05)
"""|x0| [m] and |v0| [m/s] of random starts."""


class RelayLoop(NamedTuple):
    """The loop's constants."""

    phi: Floats
    gamma_0: Floats
    gamma_1: Floats
    whole: int  # cycles of delay
    period: float
    friction: float
    resolution: float  # 0: no encoder


class RelayTraces(NamedTuple):
    """Inputs and outputs per step."""

    work: Floats  # (steps or 0, states): the operator's part of each step
    path: Floats  # (steps or 0, states): receives y_k
    estimate: Floats  # receives the last samples of v^ ...
    force: Floats  # ... and as many of the force applied from t_k + delta


@kernel
def relay_steps(loop: RelayLoop, y: Floats, x_before: float, steps: int, traces: RelayTraces) -> None:
    """Step the loop `steps` times from `y` (changed in place) and `x_before` = x_{-1}."""
    phi, gamma_0, gamma_1, whole, period, friction, resolution = loop
    work, path, estimate, force = traces
    n = len(y)
    ring = np.zeros(whole + 2)
    after = np.empty(n)
    count = len(force)
    free = len(work) == 0
    keep_path = len(path) > 0
    before = np.rint(x_before / resolution) * resolution if resolution > 0.0 else x_before
    size = whole + 2
    slot = 0
    for k in range(steps):
        x = y[0]
        if resolution > 0.0:
            x = np.rint(x / resolution) * resolution
        v = (x - before) / period
        before = x
        psi = 0.0
        if v > 0.0:
            psi = friction
        elif v < 0.0:
            psi = -friction
        ring[slot] = psi
        i = slot - whole
        if i < 0:
            i += size
        j = i - 1
        if j < 0:
            j += size
        late, later = ring[i], ring[j]
        slot += 1
        if slot == size:
            slot = 0
        if keep_path:
            for row in range(n):
                path[k, row] = y[row]
        place = k - (steps - count)
        if place >= 0:
            estimate[place] = v
            force[place] = late
        for row in range(n):
            total = -gamma_0[row] * late - gamma_1[row] * later
            for column in range(n):
                total += phi[row, column] * y[column]
            after[row] = total
        if free:
            for row in range(n):
                y[row] = after[row]
        else:
            for row in range(n):
                y[row] = after[row] + work[k, row]


@dataclass(frozen=True)
class SteadyMotion:
    """The last samples of one start."""

    estimate_m_s: Floats
    """v^."""
    force_N: Floats
    """Applied psi."""


def random_starts(parameters: Parameters, count: int, seed: int) -> Floats:
    """Return `count` states (x, v, operator's states) with |x| <= 3 mm and |v| <= 0.05 m/s, springs deflected by x."""
    rest = parameters.operator.parts().rest
    x0, v0 = LARGEST_START
    draws = np.random.default_rng(seed).uniform(-1.0, 1.0, (count, 2))
    return np.column_stack((x0 * draws[:, 0], v0 * draws[:, 1], x0 * draws[:, :1] * rest))


_NONE = np.zeros((0, 0))


def _loop(linear: SampledPlant, p: Parameters) -> RelayLoop:
    return RelayLoop(
        linear.phi, linear.gamma_0, linear.gamma_1, linear.whole_cycles, p.period_s, p.friction_N, p.resolution_m
    )


def steady(linear: SampledPlant, parameters: Parameters, start: Floats, steps: int, count: int) -> SteadyMotion:
    """Run the loop without an operator's force from the state `start` and return its last `count`
    samples.
    """
    estimate, force = np.empty(count), np.empty(count)
    y = start.copy()
    before = start[0] - start[1] * parameters.period_s
    relay_steps(_loop(linear, parameters), y, before, steps, RelayTraces(_NONE, _NONE, estimate, force))
    return SteadyMotion(estimate, force)


def settle(parameters: Parameters, *, starts: int, seconds: float, kept_s: float, seed: int = 0) -> list[SteadyMotion]:
    """Run `starts` seeded random starts for `seconds` and return the last `kept_s` of each."""
    linear = sample(parameters)
    steps = round(seconds / parameters.period_s)
    count = min(steps, round(kept_s / parameters.period_s))
    return [steady(linear, parameters, start, steps, count) for start in random_starts(parameters, starts, seed)]


def forced(linear: SampledPlant, parameters: Parameters, work: Floats) -> tuple[Floats, Floats, Floats]:
    """Run the loop from rest under the operator's `work` (steps, states).

    Return the path (steps, states), v^ and the force applied.
    """
    steps, n = work.shape
    path, estimate, force = np.empty((steps, n)), np.empty(steps), np.empty(steps)
    relay_steps(_loop(linear, parameters), np.zeros(n), 0.0, steps, RelayTraces(work, path, estimate, force))
    return path, estimate, force
