r"""Fig. 10: the paper's plant under the paper's force, with friction displayed actively and passively.

Active: the sampled law on a motor, exact between samples (`analysis.theory.relay_loop`). Passive: a
brake with set-valued friction, exact to the event (`analysis.theory.stick_slip`). Both start at rest
at t = 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.signal import butter, sosfiltfilt, welch

from coulombus.analysis.theory.delay import sign_changes
from coulombus.analysis.theory.linear import sample
from coulombus.analysis.theory.operators import Floats
from coulombus.analysis.theory.parameters import Parameters
from coulombus.analysis.theory.relay_loop import forced
from coulombus.analysis.theory.stick_slip import PAPER_FORCE, HarmonicForce, passive_motion, work

__all__ = ["Fig10", "Run", "active_run", "figure_10", "passive_run", "rms_above"]

CHATTER_FROM_HZ = 20.0


@dataclass(frozen=True)
class Run:
    """One run: traces at the samples, and figures that distinguish chatter from friction."""

    t_s: Floats
    x_m: Floats
    v_m_s: Floats
    """True velocity at the samples, not v^."""
    force_N: Floats
    """Applied psi at the samples."""
    stick_intervals_s: tuple[tuple[float, float], ...]
    velocity_rms_above_20Hz_m_s: float | None
    """None if the sampling rate has no such frequencies."""
    velocity_rms_above_100Hz_m_s: float | None
    force_rms_above_20Hz_N: float | None
    force_flips_per_s: float
    chatter_Hz: float | None
    """Peak of the velocity's spectrum (Welch) above 20 Hz; None if the force changes its sign fewer
    than 20 times per second.
    """


@dataclass(frozen=True)
class Fig10:
    """Both runs of Fig. 10 and the operator's force at the samples."""

    active: Run
    passive: Run
    f_h_N: Floats


def rms_above(values: Floats, cutoff_Hz: float, rate_Hz: float) -> float | None:
    """Return the RMS of `values` above a frequency: Butterworth of order 4, forwards and backwards,
    over all samples.
    """
    if cutoff_Hz >= rate_Hz / 2:
        return None
    sos = butter(4, cutoff_Hz, "highpass", fs=rate_Hz, output="sos")
    return float(np.sqrt(np.mean(sosfiltfilt(sos, values) ** 2)))


def _run(
    t: Floats, x: Floats, v: Floats, force: Floats, sticks: tuple[tuple[float, float], ...], parameters: Parameters
) -> Run:
    rate, seconds = 1.0 / parameters.period_s, len(t) * parameters.period_s
    flips = sign_changes(force) / seconds
    chatter = None
    if flips >= CHATTER_FROM_HZ and rate > 2 * CHATTER_FROM_HZ:
        frequency, power = welch(v, rate, nperseg=min(1024, len(v)))
        above = frequency >= CHATTER_FROM_HZ
        chatter = float(frequency[above][np.argmax(power[above])])
    return Run(
        t,
        x,
        v,
        force,
        sticks,
        rms_above(v, 20.0, rate),
        rms_above(v, 100.0, rate),
        rms_above(force, 20.0, rate),
        flips,
        chatter,
    )


def active_run(parameters: Parameters, force: HarmonicForce = PAPER_FORCE) -> Run:
    """Return the run with the motor: psi_k = c sgn(v^_k), held for a period, with the parameters'
    delay and encoder.

    A stick interval would be a span of at least two samples with a velocity of exactly zero.
    """
    linear = sample(parameters)
    steps = round(parameters.window_s / parameters.period_s)
    path, _, psi = forced(linear, parameters, work(linear, parameters, force, steps))
    t: Floats = np.arange(steps, dtype=np.float64) * parameters.period_s
    still = np.flatnonzero(np.diff(np.concatenate(([0], (path[:, 1] == 0.0).astype(int), [0]))))
    sticks = tuple((float(t[a]), float(t[b - 1])) for a, b in still.reshape(-1, 2) if b - a > 1)
    return _run(t, path[:, 0], path[:, 1], psi, sticks, parameters)


def passive_run(parameters: Parameters, force: HarmonicForce = PAPER_FORCE) -> Run:
    """Return the run with the brake: set-valued friction.

    Sampling, delay and encoder have no effect.
    """
    motion = passive_motion(parameters, force)
    return _run(motion.t_s, motion.x_m, motion.v_m_s, motion.force_N, motion.stick_intervals_s, parameters)


def figure_10(parameters: Parameters, force: HarmonicForce = PAPER_FORCE) -> Fig10:
    """Return both runs of Fig. 10."""
    active = active_run(parameters, force)
    return Fig10(active, passive_run(parameters, force), force(active.t_s))
