"""What the steps read out of a recording: figures of each cycle, windows, and small regressions."""

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
    "Fit",
    "Floats",
    "Mean",
    "fit",
    "handle_torque",
    "held",
    "mean_in",
    "motion",
    "span_of",
    "sync_before",
    "thinned",
]

Floats: TypeAlias = npt.NDArray[np.float64]
Flags: TypeAlias = npt.NDArray[np.bool_]

INDEPENDENT_S = 0.02
"""Samples of a sensor so far apart count as independent of each other."""
CONFIDENCE = 0.95
CURVE_POINTS = 400


@dataclass(frozen=True)
class Mean:
    """A mean with half of its 95 % interval, and the scatter of single samples."""

    value: float
    reach: float
    deviation: float


def mean_in(series: Series, begin_s: float, end_s: float, what: str) -> Mean:
    """Return the mean of a signal in a window.

    Raises
    ------
    CommissionError
        there are hardly any samples in it
    """
    values = np.asarray(series.values, np.float64)[(series.t_s >= begin_s) & (series.t_s < end_s)]
    independent = (end_s - begin_s) / INDEPENDENT_S
    if len(values) < 10 or independent < 3:
        raise CommissionError(f"{what}: {len(values)} samples in {max(end_s - begin_s, 0):.2f} s; do the step again")
    deviation = float(np.std(values, ddof=1))
    return Mean(
        float(np.mean(values)),
        float(stdtrit(independent - 1, 0.5 + CONFIDENCE / 2) * deviation / np.sqrt(independent)),
        deviation,
    )


def held(series: Series, t: Floats) -> Floats:
    """Return a signal's last value at or before each of `t`, 0 before its first."""
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
    """Return the time of the last SYNC before each time, of the first where there is none before.

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


@dataclass(frozen=True)
class Fit:
    """Coefficients of a least-squares fit, half of their 95 % intervals, and the residual."""

    beta: Floats
    reach: Floats
    residual: Floats


def fit(columns: list[Floats], y: Floats, block: int) -> Fit:
    """Solve least squares; the intervals are those of means over `block` neighbours, which share
    their errors.

    Raises
    ------
    CommissionError
        the samples do not tell the coefficients apart
    """
    n = len(y) // block
    X = np.column_stack([np.asarray(c)[: n * block].reshape(n, block).mean(axis=1) for c in columns])
    Y = y[: n * block].reshape(n, block).mean(axis=1)
    freedom = n - X.shape[1]
    if freedom < 3 or np.linalg.matrix_rank(X) < X.shape[1]:
        raise CommissionError("the handle moved too little for this: let it move freely, to and fro")
    inverse = np.linalg.inv(X.T @ X)
    beta = inverse @ (X.T @ Y)
    residual = Y - X @ beta
    variance = float(residual @ residual) / freedom
    reach = stdtrit(freedom, 0.5 + CONFIDENCE / 2) * np.sqrt(variance * np.diag(inverse))
    return Fit(beta, reach, residual)


def thinned(x: Floats, y: Floats, points: int = CURVE_POINTS) -> tuple[list[float], list[float]]:
    """Return some hundred points of a curve, for the report."""
    every = max(len(x) // points, 1)
    return [round(float(v), 6) for v in x[::every]], [round(float(v), 6) for v in y[::every]]
