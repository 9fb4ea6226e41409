"""The figures that tell a chattering display from a still one, all computed from a recording alone.

Velocity is the backward difference of the decoded 6064h at the handle, unfiltered. The windows are those of the markers that the recording
carries: the hold from 0.8 s after it begins to 0.02 s before it ends, and of the stroke each dwell from 0.35 s to 0.95 s.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import numpy.typing as npt
from scipy.signal import welch

from scope.recording import Recording

__all__ = ["HOLD_LEAD_S", "HOLD_TAIL_S", "STICK_WINDOW_S", "Measures", "PhaseSpan", "measure", "phases", "velocity"]

Floats: TypeAlias = npt.NDArray[np.float64]

HOLD_LEAD_S, HOLD_TAIL_S = 0.8, 0.02
STICK_WINDOW_S = (0.35, 0.95)
SPECTRUM_SAMPLES = 512
"""Length of the segments of the averaged spectrum (Welch): about 2 Hz of resolution at 1 kHz."""


@dataclass(frozen=True)
class PhaseSpan:
    """One phase of the operator's schedule, as the recording's markers tell it."""

    kind: str
    begin_s: float
    end_s: float


@dataclass(frozen=True)
class Measures:
    """Figures of one recording; None where the recording has no marker (or no data) for it."""

    hold_velocity_rms_rad_s: float | None = None
    hold_counts_p2p: int | None = None
    torque_flips_per_s: float | None = None
    stick_velocity_rms_rad_s: float | None = None
    hold_peak_Hz: float | None = None
    """Frequency of the largest peak in the averaged spectrum (Welch) of the velocity in the hold window."""
    hold_push_Nm: float | None = None
    """Largest handle torque that the transducer shows in the hold window."""


def phases(recording: Recording) -> list[PhaseSpan]:
    """Return the phases of the schedule from the markers ``phase KIND``; the last one ends at ``phase end`` or with the recording."""
    begins = [(t, text.split()[1]) for t, text in recording.markers if text.startswith("phase ")]
    if not begins:
        return []
    end = float(recording["motor.position_rad"].t_s[-1])
    ends = [t for t, _ in begins[1:]] + [end]
    return [PhaseSpan(kind, t, min(after, end)) for (t, kind), after in zip(begins, ends, strict=True) if kind != "end"]


def velocity(t_s: Floats, angle_rad: Floats, period_s: float) -> tuple[Floats, Floats]:
    """Return times [s] and backward difference [rad/s] of the angle; a gap of several periods is divided by its whole periods."""
    periods = np.maximum(np.rint(np.diff(t_s) / period_s), 1.0)
    return t_s[1:], np.diff(angle_rad) / (periods * period_s)


def _rms(values: Floats) -> float | None:
    return float(np.sqrt(np.mean(values**2))) if len(values) else None


def _within(t: Floats, begin: float, end: float) -> npt.NDArray[np.bool_]:
    inside: npt.NDArray[np.bool_] = (t >= begin) & (t < end)
    return inside


def measure(recording: Recording) -> Measures:
    """Return the figures of `recording`: all holds and all dwells together, were there several."""
    spans = phases(recording)
    period = recording.rig.bus.period_s
    angle = recording["motor.position_rad"]
    t, v = velocity(angle.t_s, angle.values, period)
    hold = np.zeros(len(t), bool)
    for span in spans:
        if span.kind == "hold":
            hold |= _within(t, span.begin_s + HOLD_LEAD_S, span.end_s - HOLD_TAIL_S)
    stick = np.zeros(len(t), bool)
    for span in spans:
        if span.kind != "stroke":
            continue
        stroke = next(phase for phase in recording.rig.phases if phase.kind == "stroke")
        dwell = span.begin_s + stroke.move_s
        while dwell < span.end_s:
            stick |= _within(t, dwell + STICK_WINDOW_S[0], min(dwell + STICK_WINDOW_S[1], span.end_s))
            dwell += stroke.move_s + stroke.dwell_s
    figures: dict[str, float | int | None] = {}
    if hold.any():
        seconds = float(hold.sum()) * period
        counts = np.rint(angle.values[1:][hold] / abs(recording.scale("motor.position_rad")))
        figures["hold_velocity_rms_rad_s"] = _rms(v[hold])
        figures["hold_counts_p2p"] = int(np.ptp(counts))
        target = recording["motor.target_torque_Nm"]
        figures["torque_flips_per_s"] = _flips(target.values[_like(target.t_s, t, hold)]) / seconds
        handle = recording["brake.handle_torque_Nm"]
        figures["hold_push_Nm"] = float(np.max(np.abs(handle.values[_like(handle.t_s, t, hold)]), initial=0.0))
        if np.any(v[hold]):
            frequency, power = welch(v[hold], 1 / period, nperseg=min(SPECTRUM_SAMPLES, int(hold.sum())))
            figures["hold_peak_Hz"] = float(frequency[np.argmax(power)])
    if stick.any():
        figures["stick_velocity_rms_rad_s"] = _rms(v[stick])
    return Measures(**figures)  # type: ignore[arg-type]


def _like(t_other: Floats, t: Floats, mask: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """Return the samples at `t_other` within the span that `mask` marks on `t` (one span, or several that join)."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], mask.view(np.int8), [0]))))
    inside = np.zeros(len(t_other), bool)
    for first, after in edges.reshape(-1, 2):
        inside |= (t_other >= t[first]) & (t_other <= t[after - 1])
    return inside


def _flips(torque: Floats) -> int:
    """Return the number of sign changes of the non-zero values."""
    signs = np.sign(torque[torque != 0])
    return int(np.count_nonzero(np.diff(signs)))
