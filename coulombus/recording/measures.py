"""Figures that distinguish a chattering display from a steady one, computed from a recording alone.

Velocity is the backward difference of the decoded 6064h at the handle, unfiltered. The recording's
markers give the windows: the hold from 0.8 s after its beginning to 0.02 s before its end, and each
dwell of the stroke from 0.35 s to 0.95 s.

A recording is read once, block by block (`recording.reading.blocks`), so the memory is bounded: a
block is measured when its phases are known. Counts, flips and peaks do not depend on the
blocks, bit for bit. An RMS is the root of a sum of the blocks' sums, and the spectrum a mean of
their means: compared with one sum over everything, rounding differs by less than 1e-12 of their
value.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from coulombus.recording.block import Block, Source

__all__ = [
    "HOLDS",
    "HOLD_LEAD_S",
    "HOLD_TAIL_S",
    "MEASURED",
    "STICK_WINDOW_S",
    "Measures",
    "PhaseSpan",
    "measure",
    "phases",
    "velocity",
]

Floats: TypeAlias = npt.NDArray[np.float64]
Window: TypeAlias = tuple[float, float]

MEASURED = ("motor.position_rad", "motor.target_torque_Nm", "brake.handle_torque_Nm")
"""The signals of an axis from which figures are computed."""

HOLDS = ("hold", "tip_hold")
"""Kinds of phases in which the hand holds the handle, or the tip of an arm."""
HOLD_LEAD_S, HOLD_TAIL_S = 0.8, 0.02
STICK_WINDOW_S = (0.35, 0.95)
SPECTRUM_SAMPLES = 512
"""Length of the segments of the averaged spectrum (Welch): about 2 Hz of resolution at 1 kHz."""


@dataclass(frozen=True)
class PhaseSpan:
    """One phase of the operator's schedule, from the recording's markers; `index` is its place in the rig file."""

    index: int
    kind: str
    begin_s: float
    end_s: float


@dataclass(frozen=True)
class Measures:
    """Figures of one recording; None without a marker or data for the figure."""

    hold_velocity_rms_rad_s: float | None = None
    hold_counts_p2p: int | None = None
    torque_flips_per_s: float | None = None
    stick_velocity_rms_rad_s: float | None = None
    hold_peak_Hz: float | None = None
    """Frequency of the largest peak in the averaged spectrum (Welch) of the velocity in the hold
    window.
    """
    hold_push_Nm: float | None = None
    """Largest handle torque of the transducer in the hold window; None without a transducer."""


@dataclass
class _Phases:
    """The phases of the schedule in the blocks so far; the last one ends with them."""

    begins: list[tuple[float, str]] = field(default_factory=list)
    end_s: float = 0.0

    def add(self, block: Block) -> None:
        texts = [(t, text) for t, text in block.markers if text.startswith("phase ")]
        self.begins += [(t, text.removeprefix("phase ")) for t, text in texts]
        self.end_s = max([self.end_s, *block["motor.position_rad"].t_s[-1:].tolist()])

    def spans(self) -> list[PhaseSpan]:
        ends = ([t for t, _ in self.begins[1:]] + [self.end_s])[: len(self.begins)]  # empty if nothing was displayed
        spans = zip(range(len(self.begins)), self.begins, ends, strict=True)
        return [PhaseSpan(i, kind, t, min(after, self.end_s)) for i, (t, kind), after in spans if kind != "end"]


def phases(recording: Source) -> list[PhaseSpan]:
    """Return the phases of the schedule from the markers ``phase KIND``.

    The last one ends at ``phase end`` or with the recording.
    """
    schedule = _Phases()
    for block in recording:
        schedule.add(block)
    return schedule.spans()


def velocity(t_s: Floats, angle_rad: Floats, period_s: float) -> tuple[Floats, Floats]:
    """Return times [s] and backward difference [rad/s] of the angle; a gap is divided by its number of whole periods."""
    periods = np.maximum(np.rint(np.diff(t_s) / period_s), 1.0)
    return t_s[1:], np.diff(angle_rad) / (periods * period_s)


def _windows(recording: Source, spans: list[PhaseSpan]) -> tuple[list[Window], list[Window]]:
    """Return the hold windows and the stick windows [s]; a stick window ends no later than its dwell."""
    holds = [(s.begin_s + HOLD_LEAD_S, s.end_s - HOLD_TAIL_S) for s in spans if s.kind in HOLDS]
    sticks = []
    plan = recording.rig.one_axis().phases
    for span in spans:
        stroke = plan[span.index] if span.index < len(plan) else None  # files of several runs have more phases
        if stroke is not None and stroke.kind == "stroke":
            dwell = span.begin_s + stroke.move_s
            while dwell < span.end_s:
                last = min(dwell + min(STICK_WINDOW_S[1], stroke.dwell_s), span.end_s)
                sticks.append((dwell + STICK_WINDOW_S[0], last))
                dwell += stroke.move_s + stroke.dwell_s
    return holds, sticks


def _with_windows(recording: Source) -> Iterator[tuple[Block, list[Window], list[Window]]]:
    """Yield the blocks, each with the windows so far, as soon as no later marker changes them within the block."""
    schedule, waiting = _Phases(), deque[Block]()
    for block in recording:
        schedule.add(block)
        waiting.append(block)
        windows = _windows(recording, schedule.spans())
        while waiting and np.all(waiting[0]["motor.position_rad"].t_s[-1:] < schedule.end_s - HOLD_TAIL_S):
            yield waiting.popleft(), *windows
    windows = _windows(recording, schedule.spans())
    for block in waiting:
        yield block, *windows


def _inside(t: Floats, windows: list[Window]) -> npt.NDArray[np.bool_]:
    """Return which times are in one of the successive windows.

    A window that ends before it begins is empty.
    """
    edges = [edge for begin, end in windows if begin < end for edge in (begin, end)]
    inside: npt.NDArray[np.bool_] = np.searchsorted(edges, t, "right") % 2 == 1
    return inside


def measure(recording: Source) -> Measures:
    """Return the figures of `recording`, over all holds and all dwells."""
    period = recording.rig.bus.period_s
    hold, stick, spectrum, flips = _MeanSquare(), _MeanSquare(), _Spectrum(period), _Flips()
    counts: list[tuple[float, float]] = []
    push, pushed = 0.0, any(s.key == "brake.handle_torque_Nm" for pdo in recording.rig.pdos() for s in pdo.signals)
    last_t, last_angle = np.zeros((2, 0))
    for block, holds, sticks in _with_windows(recording):
        counts += [(np.inf, -np.inf)] * (len(holds) - len(counts))
        angle, target = block["motor.position_rad"], block["motor.target_torque_Nm"]
        t, v = velocity(np.append(last_t, angle.t_s), np.append(last_angle, angle.values), period)
        last_t, last_angle = (np.append(a, b)[-1:] for a, b in ((last_t, angle.t_s), (last_angle, angle.values)))
        v_hold = v[_inside(t, holds)]
        hold.add(v_hold)
        spectrum.add(v_hold)
        stick.add(v[_inside(t, sticks)])
        raw = np.rint(angle.values / abs(block.scale("motor.position_rad")))
        for k, window in enumerate(holds):
            inside = raw[_inside(angle.t_s, [window])]
            counts[k] = np.min(inside, initial=counts[k][0]), np.max(inside, initial=counts[k][1])
        flips.add(target.values[_inside(target.t_s, holds)])
        if pushed:
            handle = block["brake.handle_torque_Nm"]
            push = float(np.max(np.abs(handle.values[_inside(handle.t_s, holds)]), initial=push))
    if hold.count == 0:
        return Measures(stick_velocity_rms_rad_s=stick.root)
    return Measures(
        hold_velocity_rms_rad_s=hold.root,
        hold_counts_p2p=int(max(high - low for low, high in counts)),
        torque_flips_per_s=flips.count / (hold.count * period),
        stick_velocity_rms_rad_s=stick.root,
        hold_peak_Hz=spectrum.peak_Hz if hold.total else None,
        hold_push_Nm=push if pushed else None,
    )


@dataclass
class _MeanSquare:
    count: int = 0
    total: float = 0.0

    def add(self, values: Floats) -> None:
        self.count += len(values)
        self.total += float(np.sum(values**2))

    @property
    def root(self) -> float | None:
        """The root of the mean square; None without samples."""
        return float(np.sqrt(self.total / self.count)) if self.count else None


@dataclass
class _Flips:
    """Sign changes of the non-zero values."""

    count: int = 0
    sign: Floats = field(default_factory=lambda: np.zeros(0))

    def add(self, values: Floats) -> None:
        signs = np.append(self.sign, np.sign(values[values != 0]))
        self.count += int(np.count_nonzero(np.diff(signs)))
        self.sign = signs[-1:]


@dataclass
class _Spectrum:
    """Welch's averaged spectrum of the added samples, in segments of `SPECTRUM_SAMPLES` that overlap by half."""

    period_s: float
    frequency: Floats = field(default_factory=lambda: np.zeros(0))
    power: Any = 0.0
    rest: Floats = field(default_factory=lambda: np.zeros(0))
    """Samples not yet at the start of a segment."""

    def add(self, values: Floats) -> None:
        self.rest = np.append(self.rest, values)
        step = SPECTRUM_SAMPLES // 2
        more = len(self.rest) // step - 1
        if more > 0:
            self.frequency, power = _welch(self.rest[: (more + 1) * step], self.period_s, SPECTRUM_SAMPLES)
            self.power += more * power
            self.rest = self.rest[more * step :]

    @property
    def peak_Hz(self) -> float:
        """The frequency of the largest mean.

        With fewer samples than a segment, their own spectrum is used.
        """
        if not len(self.frequency):
            self.frequency, self.power = _welch(self.rest, self.period_s, len(self.rest))
        return float(self.frequency[np.argmax(self.power)])


def _welch(values: Floats, period_s: float, samples: int) -> tuple[Floats, Floats]:
    r"""Return frequencies [Hz] and Welch's one-sided power density in segments of this many samples.

    .. math:: P_k = \frac{2T}{\sum_n w_n^2}
              \left\langle\left|\sum_n w_n (v_n - \bar v)\,e^{-2\pi i k n / N}\right|^2\right\rangle

    with Hann's window, over segments that overlap by half; without the factor 2 at 0 and at half
    the sampling rate (doi:10.1109/TAU.1967.1161901). SciPy's `welch` has the same default values;
    SciPy is slow to load.
    """
    window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(samples) / samples) if samples > 1 else np.ones(1)
    segments = np.lib.stride_tricks.sliding_window_view(values, samples)[:: samples - samples // 2]
    spectra = np.fft.rfft(window * (segments - segments.mean(axis=1, keepdims=True)))
    power = np.mean(np.abs(spectra) ** 2, axis=0) * period_s / np.sum(window**2)
    power[1 : (samples + 1) // 2] *= 2
    return np.fft.rfftfreq(samples, period_s).astype(np.float64), power
