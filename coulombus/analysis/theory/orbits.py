r"""Periodic motions of the sampled relay loop, exactly: every switching pattern up to a period.

A two-valued force :math:`\psi_k = c\,u_k` of period p drives a linear plant, so :math:`\hat v` has
the same period and is known without simulation: its discrete spectrum is :math:`-H(z)\,c\,U` at the
p-th roots of unity. The pattern is a motion of the loop if and only if the relay agrees with it,
:math:`u_k = \mathrm{sgn}\,\hat v_k` for all k: the margin :math:`\min_k u_k\hat v_k` is positive.

Local stability is then exact, too. A disturbance smaller than the margin changes no
sign, so it evolves by the plant alone: the motion is attractive if and only if the plant's own
:math:`\Phi` (without the position) has its eigenvalues inside the unit circle.

Source: Y. Z. Tsypkin, Relay Control Systems, 1984, chapter 3 (continuous time); the sampled case
needs no search for switching instants.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from coulombus.analysis.theory.linear import sample
from coulombus.analysis.theory.operators import Floats
from coulombus.analysis.theory.parameters import Parameters
from coulombus.analysis.theory.peak import between_samples
from coulombus.analysis.theory.relay_loop import settle

__all__ = ["LONGEST", "Orbit", "Orbits", "orbits", "pattern_of", "patterns", "word_of"]

LONGEST = 16
ROUNDING = 1e-9
"""Relative margin below which it is rounding error: "+" with a spring moves nothing.
"""
SETTLE_S, KEPT_SAMPLES = 20.0, 480
PLUS, MINUS, ZERO = "+", "-", "0"


@dataclass(frozen=True)
class Orbit:
    """One periodic motion of the loop."""

    pattern: str
    """Signs of the force over one period, its first rotation in ASCII order ("+" before "-")."""
    period_samples: int
    frequency_Hz: float
    """Frequency of the pattern's repetition."""
    velocity_peak_m_s: float
    """max |v^_k|."""
    margin_m_s: float
    """min u_k v^_k: the orbit exists if this is positive, and survives smaller disturbances of v^."""
    stable: bool
    """Locally attractive: exact, not a prediction."""
    share: float | None = None
    """Share of random starts that reached it; None without starts."""
    true_peak_m_s: float = 0.0
    """max |v| of the handle, including between the samples."""


@dataclass(frozen=True)
class Orbits:
    """All periodic motions up to a period, the largest velocity first."""

    found: tuple[Orbit, ...]
    longest: int
    starts: int
    elsewhere: float | None
    """Share of the starts that reached none of them: a longer period, or aperiodic."""

    @property
    def text(self) -> str:
        """Summary in one line."""
        if not self.found:
            return f"no periodic motion of at most {self.longest} samples exists"
        return "; ".join(
            f"{o.pattern} {o.frequency_Hz:.4g} Hz {o.velocity_peak_m_s:.3g} m/s"
            + ("" if o.share is None else f" ({o.share:.0%} of starts)")
            for o in self.found
        )


SIGNS = (1.0, -1.0, 0.0)


@lru_cache(maxsize=32)
def patterns(period: int, letters: int = 2) -> Floats:
    """Return all patterns of +-1 (of +1, -1 and 0 with three `letters`) whose shortest period is
    `period`, each once as its first rotation: Lyndon words (Duval, 1988).
    """
    words, word = [], [-1]
    while word:
        word[-1] += 1
        length = len(word)
        if length == period:
            words.append(word.copy())
        while len(word) < period:
            word.append(word[len(word) - length])
        while word and word[-1] == letters - 1:
            word.pop()
    return np.array([[SIGNS[letter] for letter in w] for w in words]).reshape(-1, period)


def word_of(signs: Floats) -> str:
    """Return a pattern as text."""
    return "".join(PLUS if sign > 0 else MINUS if sign < 0 else ZERO for sign in signs)


def pattern_of(signs: Floats, longest: int = LONGEST, *, zeros: bool = False) -> str | None:
    """Return the pattern that repeats in `signs` (its first rotation), or None if no period up to
    `longest` fits all of them, or if there are zeros where `zeros` allows none.
    """
    for period in range(1, min(longest, len(signs) // 2) + 1):
        if np.array_equal(signs[period:], signs[:-period]) and (zeros or np.all(signs != 0)):
            word = word_of(signs[:period])
            return min(word[i:] + word[:i] for i in range(period))
    return None


def orbits(parameters: Parameters, *, longest: int = LONGEST, starts: int = 0, seed: int = 0) -> Orbits:
    """Return every two-valued periodic motion of at most `longest` samples; `starts` random starts
    give the share of each.

    Only without an encoder: its rounding would also need the position's exact value.
    """
    exact = replace(parameters, resolution_m=0.0)
    linear = sample(exact)
    stable = linear.spectral_radius < 1.0 - 1e-12
    rounding = (
        ROUNDING * exact.friction_N * np.max(np.abs(linear.response(np.exp(2j * np.pi * np.arange(1, 240) / 240))))
    )
    cycles = []
    for period in range(1, longest + 1):
        u = patterns(period)
        z = np.exp(2j * np.pi * np.arange(period) / period)
        if not stable:  # a pole on the unit circle: infinite response, unless the pattern has no component there
            continue
        v = -exact.friction_N * np.fft.ifft(linear.response(z) * np.fft.fft(u, axis=1), axis=1).real
        margin = np.min(u * v, axis=1)
        for i in np.flatnonzero(margin > rounding):
            peak = between_samples(exact, u[i]).peak_m_s
            estimate = float(np.max(np.abs(v[i])))
            rate = 1 / (period * exact.period_s)
            cycles.append(Orbit(word_of(u[i]), period, rate, estimate, float(margin[i]), stable, true_peak_m_s=peak))
    cycles.sort(key=lambda orbit: -orbit.velocity_peak_m_s)
    if not starts:
        return Orbits(tuple(cycles), longest, 0, None)
    motions = settle(
        exact, starts=starts, seconds=SETTLE_S, kept_s=max(KEPT_SAMPLES, 4 * longest) * exact.period_s, seed=seed
    )
    reached = Counter(pattern_of(np.sign(motion.estimate_m_s), longest) for motion in motions)
    shared = tuple(replace(orbit, share=reached[orbit.pattern] / starts) for orbit in cycles)
    return Orbits(shared, longest, starts, 1.0 - sum(orbit.share or 0.0 for orbit in shared))
