"""Samples of a recording for the steps: signals at each cycle, means in windows, and their intervals."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt
from scipy.special import stdtrit

from coulombus.eds.cia301 import CobId
from coulombus.host.commission.step import CommissionError
from coulombus.recording.measures import PhaseSpan, phases
from coulombus.recording.signals import Recording, Series

__all__ = [
    "Floats",
    "Mean",
    "counted_reach",
    "handle_torque",
    "held",
    "independent",
    "mean_in",
    "motion",
    "span_of",
    "sync_before",
    "thinned",
]

Floats: TypeAlias = npt.NDArray[np.float64]
Flags: TypeAlias = npt.NDArray[np.bool_]

CONFIDENCE = 0.95
CURVE_POINTS = 400


@dataclass(frozen=True)
class Mean:
    """A mean with half of its 95 % interval, and the scatter of single samples."""

    value: float
    reach: float
    deviation: float


def independent(values: Floats) -> float:
    r"""Return the effective number of independent samples of a stationary signal.

    .. math:: n_{eff} = n \Big/ \Bigl(1 + 2 \sum_{k=1}^{K} \rho_k\Bigr)

    with the autocorrelations :math:`\rho_k` up to the first pair of neighbours whose sum is not
    positive (C. J. Geyer, Statistical Science 7(4):473-483, 1992, doi:10.1214/ss/1177011137).
    """
    n = len(values)
    centred = values - np.mean(values)
    spectrum = np.fft.rfft(centred, 2 * n)
    covariance = np.fft.irfft(np.abs(spectrum) ** 2)[:n]
    if covariance[0] <= 1e-20 * n:
        return float(n)
    rho = covariance / covariance[0]
    pairs = rho[1 : 2 * ((n - 1) // 2) + 1].reshape(-1, 2).sum(axis=1)
    end = np.flatnonzero(pairs <= 0.0)
    total = float(np.sum(pairs[: end[0] if len(end) else len(pairs)]))
    return n / (1.0 + 2.0 * max(total, 0.0))


def counted_reach(deviation: float, count: float) -> float:
    r"""Return the largest error of a signal's mean due to its quantisation in counts.

    With the observed variance :math:`V` in counts squared:

    - Noise of :math:`\sigma` counts dithers the signal: the error is below
      :math:`\tfrac12 e^{-2 \pi^2 \sigma^2}`, with :math:`\sigma^2 = V - 1/12` (B. Widrow, I. Kollar,
      Quantization Noise, 2008, chapter 19).
    - Noise far below a count toggles between two values near the edge of a count, a share :math:`p`
      of the time in one of them: :math:`V = p (1 - p)`, and the error is up to
      :math:`|p - \tfrac12| = \sqrt{\tfrac14 - V}`.
    """
    if count == 0.0:
        return 0.0
    variance = (deviation / count) ** 2
    dithered = 0.5 * np.exp(-2 * np.pi**2 * max(variance - 1 / 12, 0.0))
    toggling = np.sqrt(max(0.25 - variance, 0.0))
    return float(count * max(dithered, toggling))


def mean_in(series: Series, begin_s: float, end_s: float, what: str, count: float = 0.0) -> Mean:
    """Return the mean of a signal in a window; `count`: one count of the signal, in its unit.

    Raises
    ------
    CommissionError
        the window has too few samples
    """
    values = np.asarray(series.values, np.float64)[(series.t_s >= begin_s) & (series.t_s < end_s)]
    worth = independent(values) if len(values) >= 10 else 0.0
    if worth < 3:
        raise CommissionError(f"{what}: {len(values)} samples in {max(end_s - begin_s, 0):.2f} s; do the step again")
    deviation = float(np.std(values, ddof=1))
    scatter = float(stdtrit(worth - 1, 0.5 + CONFIDENCE / 2)) * deviation / float(np.sqrt(worth))
    return Mean(float(np.mean(values)), float(np.hypot(scatter, counted_reach(deviation, count))), deviation)


def held(series: Series, t: Floats) -> Floats:
    """Return a signal's last value at or before each of `t`; 0 before its first value."""
    last = np.searchsorted(series.t_s, t, side="right") - 1
    values = np.asarray(series.values, np.float64)
    return np.where(last >= 0, values[np.maximum(last, 0)], 0.0) if len(values) else np.zeros(len(t))


def handle_torque(recording: Recording) -> Series:
    """Return the transducer's signal.

    Raises
    ------
    CommissionError
        the recording has no sample of it
    """
    series = recording.signals.get("brake.handle_torque_Nm")
    if series is None or not len(series):
        raise CommissionError("the transducer sent nothing: is its TPDO on the bus ('coulombus watch')?")
    return series


def motion(angle: Series, period_s: float, smooth: int) -> tuple[Floats, Floats]:
    """Return the speed [rad/s] and the acceleration [rad/s^2] at each sample of an angle: central
    differences, a mean over `smooth` samples after each.
    """
    window = np.ones(smooth) / smooth
    v = np.convolve(np.gradient(np.asarray(angle.values, np.float64), period_s), window, "same")
    return v, np.convolve(np.gradient(v, period_s), window, "same")


def sync_before(recording: Recording, t_s: Floats) -> Floats:
    """Return the time of the last SYNC before each time; that of the first SYNC if there is none before.

    Raises
    ------
    CommissionError
        the recording has no SYNC
    """
    frames = recording.frames
    sync = recording.t_s[(frames["can_id"] == CobId.SYNC) & (frames["length"] == 0)]
    if not len(sync):
        raise CommissionError("the recording has no SYNC: does the host send it on this bus?")
    before: Floats = sync[np.maximum(np.searchsorted(sync, t_s) - 1, 0)]
    return before


def span_of(recording: Recording, kind: str, number: int = 0) -> PhaseSpan:
    """Return a phase of the exercise's schedule by its kind.

    Raises
    ------
    CommissionError
        the run ended before it
    """
    spans = [span for span in phases(recording) if span.kind == kind]
    if len(spans) <= number or spans[number].end_s <= spans[number].begin_s:
        raise CommissionError(f"the run ended before its phase '{kind}' was over; do the step again")
    return spans[number]


def thinned(x: Floats, y: Floats, points: int = CURVE_POINTS) -> tuple[list[float], list[float]]:
    """Return about `points` points of a curve, for the report."""
    every = max(len(x) // points, 1)
    return [round(float(v), 6) for v in x[::every]], [round(float(v), 6) for v in y[::every]]
