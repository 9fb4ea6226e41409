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
Window: TypeAlias = tuple[float, float]

HOLD_LEAD_S, HOLD_TAIL_S = 0.8, 0.02
STICK_WINDOW_S = (0.35, 0.95)
SPECTRUM_SAMPLES = 512
"""Length of the segments of the averaged spectrum (Welch): about 2 Hz of resolution at 1 kHz."""


@dataclass(frozen=True)
class PhaseSpan:
    """One phase of the operator's schedule, as the recording's markers tell it; `index` is its place in the rig file."""

    index: int
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
    spans = zip(range(len(begins)), begins, ends, strict=True)
    return [PhaseSpan(i, kind, t, min(after, end)) for i, (t, kind), after in spans if kind != "end"]


def velocity(t_s: Floats, angle_rad: Floats, period_s: float) -> tuple[Floats, Floats]:
    """Return times [s] and backward difference [rad/s] of the angle; a gap of several periods is divided by its whole periods."""
    periods = np.maximum(np.rint(np.diff(t_s) / period_s), 1.0)
    return t_s[1:], np.diff(angle_rad) / (periods * period_s)


def _rms(values: Floats) -> float | None:
    return float(np.sqrt(np.mean(values**2))) if len(values) else None


def _peak_to_peak(counts: Floats) -> int:
    return int(np.ptp(counts)) if len(counts) else 0


def _windows(recording: Recording, spans: list[PhaseSpan]) -> tuple[list[Window], list[Window]]:
    """Return the hold windows and the stick windows [s]; a stick window ends with its dwell at the latest."""
    holds = [(s.begin_s + HOLD_LEAD_S, s.end_s - HOLD_TAIL_S) for s in spans if s.kind == "hold"]
    sticks = []
    for span in spans:
        stroke = recording.rig.phases[span.index]
        if stroke.kind == "stroke":
            dwell = span.begin_s + stroke.move_s
            while dwell < span.end_s:
                last = min(dwell + min(STICK_WINDOW_S[1], stroke.dwell_s), span.end_s)
                sticks.append((dwell + STICK_WINDOW_S[0], last))
                dwell += stroke.move_s + stroke.dwell_s
    return holds, sticks


def _inside(t: Floats, windows: list[Window]) -> npt.NDArray[np.bool_]:
    inside = np.zeros(len(t), bool)
    for begin, end in windows:
        inside |= (t >= begin) & (t < end)
    return inside


def measure(recording: Recording) -> Measures:
    """Return the figures of `recording`: all holds and all dwells together, were there several."""
    holds, sticks = _windows(recording, phases(recording))
    period = recording.rig.bus.period_s
    angle, target = recording["motor.position_rad"], recording["motor.target_torque_Nm"]
    handle = recording["brake.handle_torque_Nm"]
    t, v = velocity(angle.t_s, angle.values, period)
    hold, stick = _inside(t, holds), _inside(t, sticks)
    figures: dict[str, float | int | None] = {}
    if hold.any():
        counts = np.rint(angle.values / abs(recording.scale("motor.position_rad")))
        figures["hold_velocity_rms_rad_s"] = _rms(v[hold])
        figures["hold_counts_p2p"] = max(_peak_to_peak(counts[_inside(angle.t_s, [w])]) for w in holds)
        figures["torque_flips_per_s"] = _flips(target.values[_inside(target.t_s, holds)]) / (float(hold.sum()) * period)
        figures["hold_push_Nm"] = float(np.max(np.abs(handle.values[_inside(handle.t_s, holds)]), initial=0.0))
        if np.any(v[hold]):
            frequency, power = welch(v[hold], 1 / period, nperseg=min(SPECTRUM_SAMPLES, int(hold.sum())))
            figures["hold_peak_Hz"] = float(frequency[np.argmax(power)])
    if stick.any():
        figures["stick_velocity_rms_rad_s"] = _rms(v[stick])
    return Measures(**figures)  # type: ignore[arg-type]


def _flips(torque: Floats) -> int:
    """Return the number of sign changes of the non-zero values."""
    signs = np.sign(torque[torque != 0])
    return int(np.count_nonzero(np.diff(signs)))
