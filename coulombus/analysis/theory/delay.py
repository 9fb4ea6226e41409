r"""Effect of CANopen: frequency and amplitude of the limit cycle over sampling rate and delay.

Predicted by the describing function (`analysis.theory.crossings`, the crossing of largest amplitude)
and simulated by the exact recursion (`analysis.theory.relay_loop`) from random starts. PDOs on the
next SYNC add one cycle of delay, PDOs on reception the frames' time on the bus.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from coulombus.analysis.theory.crossings import crossings
from coulombus.analysis.theory.parameters import Parameters
from coulombus.analysis.theory.relay_loop import SteadyMotion, settle

__all__ = ["DELAYS_S", "RATES_HZ", "DelayRow", "delay_row", "delay_table", "sign_changes"]

RATES_HZ = (250.0, 500.0, 1000.0, 2000.0, 4000.0)
DELAYS_S = (0.0, 0.5e-3, 1e-3, 2e-3)
STARTS, SECONDS, KEPT_S = 21, 40.0, 2.0


@dataclass(frozen=True)
class DelayRow:
    """One pair of sampling rate and delay; None if the describing function predicts no limit cycle."""

    sample_rate_Hz: float
    delay_s: float
    predicted_Hz: float | None
    simulated_Hz: float
    """Median over the starts of half the force's sign changes per second."""
    predicted_amplitude_m_s: float | None
    simulated_amplitude_m_s: float
    """Median over the starts of sqrt(2) std(v^): the amplitude of a sine of the same power."""
    slowest_Hz: float
    """Lowest frequency of the starts."""
    fastest_Hz: float
    """Highest frequency of the starts; it differs from the lowest if several motions are attractive."""


def sign_changes(force_N: np.ndarray[tuple[int], np.dtype[np.float64]]) -> int:
    """Return the number of sign changes among the non-zero values."""
    signs = np.sign(force_N[force_N != 0])
    return int(np.count_nonzero(signs[1:] != signs[:-1]))


def _frequency_Hz(motion: SteadyMotion) -> float:
    return sign_changes(motion.force_N) / 2 / KEPT_S  # one sample more than periods: every change has its period


def delay_row(parameters: Parameters, *, seed: int = 0) -> DelayRow:
    """Return predicted and simulated limit cycle of one loop: 21 starts of 40 s, the last 2 s of
    each.
    """
    predicted = crossings(parameters).largest
    motions = settle(parameters, starts=STARTS, seconds=SECONDS, kept_s=KEPT_S + parameters.period_s, seed=seed)
    frequencies = [_frequency_Hz(motion) for motion in motions]
    amplitudes = [float(np.sqrt(2) * np.std(motion.estimate_m_s[1:])) for motion in motions]
    return DelayRow(
        1.0 / parameters.period_s,
        parameters.delay_s,
        None if predicted is None else predicted.frequency_Hz,
        float(np.median(frequencies)),
        None if predicted is None else predicted.amplitude_m_s,
        float(np.median(amplitudes)),
        min(frequencies),
        max(frequencies),
    )


def delay_table(
    parameters: Parameters,
    *,
    rates_Hz: tuple[float, ...] = RATES_HZ,
    delays_s: tuple[float, ...] = DELAYS_S,
    seed: int = 0,
) -> tuple[DelayRow, ...]:
    """Return a row for every pair of sampling rate and delay; the other parameters stay."""
    return tuple(
        delay_row(replace(parameters, period_s=1.0 / rate, delay_s=delay), seed=seed)
        for rate in rates_Hz
        for delay in delays_s
    )
