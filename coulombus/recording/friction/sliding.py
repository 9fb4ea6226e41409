r"""Select the samples of a recording that obey the regression of `recording.friction.identify`.

The equation :math:`f = J\,\dot v + [c + b\,|v|]\,\mathrm{sgn}(v) + f_0` holds for the felt torque
only while the display is steady. So a sample is taken only

- in the host's phase RUN with its gain at 1: not before the display, not in the sign check, not
  after the end or a trip. A recording has no phases, but the frames bound them: Operation Enabled,
  then the sign check's torque, then a handle at rest without torque for `SETTLE_S`;
- while the handle slides in one direction, faster than the law's band, and from `REVERSAL_S` after
  it began: by then the motor's lag and the PDOs' delay are over. Near the speed limit the host
  removes the motor's torque, so samples there are excluded, too;
- while the brake's set-point has been constant for `COIL_S`, so that its fluid has followed.

Omitted samples are counted by their first reason.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from coulombus.eds.cia402 import STATE_OF_STATUSWORD, PowerState
from coulombus.recording.host_telemetry import PHASE_RUN
from coulombus.recording.signals import Series, Source, series
from coulombus.system.errors import CoulombusError

__all__ = [
    "Floats",
    "IdentifyError",
    "Slide",
    "Sliding",
    "one_sense",
    "runs",
    "signals",
    "since",
    "sliding",
    "stretches",
]

Floats: TypeAlias = npt.NDArray[np.float64]
Flags: TypeAlias = npt.NDArray[np.bool_]

WINDOW_S = 0.061
"""Length of each equation's window."""
SPEED_SAMPLES = 15
"""Length of the shorter window for a sample's own speed, for Stribeck's term."""
REVERSAL_S = 0.02
"""Time ignored at the beginning of a slide."""
COIL_S = 0.25
"""Time of constant brake set-point, after which the fluid has followed to 1e-6."""
SETTLE_S = 0.05
"""Time of rest after the sign check (`host.cycle.controller.SETTLE_S`)."""
STILL_MARGIN_S = 0.05
SPEED_SHARE = 0.8
"""Share of the speed limit above which the host lets the motor only brake (`host.cycle.step.SPEED_TAPER`)."""
LEAST_SAMPLES = 100
EXERCISES = "coulombus.host.laws.exercises:"
"""Laws that display nothing: the handle then slides at any speed."""
TRAVEL_RAD_S, TRAVEL_COUNTS = 0.25, 6
"""At this speed an exercise's slide gives this many counts around each sample, none backwards."""


class IdentifyError(CoulombusError, ValueError):
    """The recording does not show friction; the text names the lack."""

    exit_status = 1


@dataclass(frozen=True)
class Slide:
    """Consecutive samples, one cycle apart, of a slide in one direction."""

    t_s: Floats
    x_rad: Floats
    hand_Nm: Floats
    """Torque of the transducer."""
    motor_Nm: Floats
    """Torque of the motor: the drive's 6077h, else the set-point."""


@dataclass(frozen=True)
class Sliding:
    """The part of a recording that obeys the regression."""

    slides: tuple[Slide, ...]
    period_s: float
    count_rad: float
    """The encoder's resolution at the handle."""
    coil_off: bool
    """Whether only samples without brake were taken."""
    left_out: dict[str, int]
    """Number of omitted samples by reason; may be 0."""
    remarks: tuple[str, ...]

    @property
    def samples(self) -> int:
        """Number of selected samples."""
        return sum(len(slide.t_s) for slide in self.slides)


def _nearest(series: Series, t: Floats, within_s: float) -> Floats:
    """Return the series' values nearest to `t`; NaN if none is `within_s`."""
    if not len(series):
        return np.full(len(t), np.nan)
    after = np.clip(np.searchsorted(series.t_s, t), 1, max(len(series) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(series) - 1)
    closer = np.where(np.abs(series.t_s[before] - t) <= np.abs(series.t_s[after] - t), before, after)
    values: Floats = np.asarray(series.values, np.float64)[closer]
    return np.where(np.abs(series.t_s[closer] - t) <= within_s, values, np.nan)


def since(flags: Flags) -> npt.NDArray[np.int64]:
    """Return the number of samples for which `flags` has been true, including the present one."""
    index = np.arange(len(flags))
    return index - np.maximum.accumulate(np.where(flags, -1, index))


def runs(flags: Flags) -> list[tuple[int, int]]:
    """Return start and end of each run of true values."""
    edges = np.flatnonzero(np.diff(np.concatenate(([0], flags.astype(np.int8), [0]))))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def _armed(counts: Floats, target: Floats, settle: int, within: int) -> int | None:
    """Return the sample of an enabled stretch at which the law begins, or None.

    Without any motor torque there was no sign check. Otherwise the law begins when the handle has
    been at rest within some counts, without torque, for `settle` samples after the check.
    """
    driven = np.flatnonzero(target != 0.0)
    if not len(driven):
        return 0
    still, reference = 0, math.nan
    for i in range(int(driven[0]), len(counts)):
        if target[i] != 0.0 or not abs(counts[i] - reference) <= within:
            reference, still = counts[i], 0
        else:
            still += 1
        if still >= settle:
            return i + 1
    return None


def _at_full_gain(recording: Source, t: Floats) -> Flags:
    """Return the samples in which the host reports the law at full gain."""
    phase, gain = series(recording, "host.phase", "host.gain")
    return np.asarray((phase.held(t, 0.0) == PHASE_RUN) & (gain.held(t, 0.0) >= 1.0 - 1e-9))


def _displayed(recording: Source, t: Floats, counts: Floats) -> tuple[Flags, tuple[str, ...]]:
    """Return the samples in the host's phase RUN at full gain, and the assumptions made."""
    if recording.has("host.phase"):  # a law that moves the handle leaves no rest after the sign check
        return _at_full_gain(recording, t), ()
    axis, period = recording.rig.one_axis(), recording.rig.bus.period_s
    statusword, target = series(recording, "motor.statusword", "motor.target_torque_Nm")
    ends = sorted(
        at
        for block in recording
        for at, text in block.markers
        if text in ("phase end", "safe") or text.startswith("trip ")
    )
    marked = any(text.startswith(("run ", "phase ")) for block in recording for _, text in block.markers)
    if not len(statusword):
        return np.ones(len(t), bool), (
            "no statusword was recorded, so the phases of the host are not known: what slides in the arming is fitted, too",
        )
    words = statusword.held(t, 0.0).astype(np.int64)
    enabled = (np.asarray(STATE_OF_STATUSWORD)[words & 0x7F] == PowerState.OPERATION_ENABLED) & (t >= statusword.t_s[0])
    torque = target.held(t, 0.0)
    within = axis.limits.still_counts(recording.scale("motor.position_rad"))
    shown, notes = np.zeros(len(t), bool), list[str]()
    for first, end in runs(enabled):
        armed = _armed(counts[first:end], torque[first:end], round(SETTLE_S / period), within)
        if armed is None and not marked and len(torque[first:end]):
            notes.append(
                "the sign check is not seen to end, so the phases are not known: all samples with the drive enabled count"
            )
            armed = 0
        if armed is None:
            continue
        begin_s = t[min(first + armed, end - 1)] + axis.law.gain_ramp_s
        inside = [at for at in ends if t[first] <= at]
        # in the safe state the drive stays enabled, without torque, until the brake is off
        end_s = inside[0] if inside else t[end - 1] - axis.limits.safe_hold_s - axis.limits.safe_ramp_s - STILL_MARGIN_S
        shown[first:end] = (t[first:end] >= begin_s) & (t[first:end] < end_s)
    return shown, tuple(dict.fromkeys(notes))


class _SelectedSamples:
    """Selected samples, and the reasons for the others: each counts for its first reason only."""

    def __init__(self, n: int) -> None:
        self.good = np.ones(n, bool)
        self.left_out: dict[str, int] = {}

    def keep(self, reason: str, flags: Flags) -> None:
        """Omit samples outside `flags`, for `reason`."""
        self.left_out[reason] = int(np.sum(self.good & ~flags))
        self.good &= flags


class Signals(NamedTuple):
    """Signals of the handle, cycle by cycle."""

    t: Floats
    x: Floats
    moved: Floats
    """Counts since the previous cycle."""
    hand: Floats
    motor: Floats
    brake: Floats
    shown: Flags
    """Whether the display is at full gain."""
    notes: tuple[str, ...]
    count_rad: float
    """An encoder count at the handle [rad]."""


def signals(recording: Source) -> Signals:
    """Return the signals of the handle, cycle by cycle.

    Raises
    ------
    IdentifyError
        the rig has no transducer, there is no sample, or the recording's stamps decrease
    """
    period = recording.rig.bus.period_s
    names = ("motor.position_rad", "brake.handle_torque_Nm")
    if not recording.has(names[1]):
        raise IdentifyError(
            f"{recording.path}: the rig {recording.rig.name!r} does not measure the hand's torque, and without it what is felt at the "
            "handle is not known; give the rig a transducer ([role.handle_torque])"
        )
    measured = recording.has("motor.torque_Nm")
    gathered = series(
        recording, *names, "motor.torque_Nm" if measured else "motor.target_torque_Nm", "brake.setpoint_Nm"
    )
    angle, transducer, drive_torque, setpoint = gathered
    for name, signal in zip(names, gathered, strict=False):
        if not len(signal):
            raise IdentifyError(
                f"{recording.path}: no sample of {name}; record a run of the rig {recording.rig.name!r} with strokes, or give --rig"
            )
    if any(np.any(np.diff(signal.t_s) < 0.0) for signal in gathered):
        raise IdentifyError(
            f"{recording.path}: its stamps go back, as in a file joined from several; sort it with 'reordercap IN OUT', or take one run"
        )
    t, x = angle.t_s, np.asarray(angle.values, np.float64)
    count = abs(recording.scale("motor.position_rad"))
    counts = np.rint(x / count)
    moved = np.diff(counts, prepend=counts[:1])
    hand, motor = _nearest(transducer, t, 0.5 * period), _nearest(drive_torque, t, 0.5 * period)
    brake = setpoint.held(t, 0.0)
    shown, notes = _displayed(recording, t, counts)
    if not measured:
        motor = drive_torque.held(t, 0.0)
        notes += ("the motor's torque is not measured: the device's own friction is with the torque that it was told",)
    return Signals(t, x, moved, hand, motor, brake, shown, notes, count)


def stretches(recording: Source) -> tuple[Slide, ...]:
    """Return runs of consecutive samples of the display at full gain, including rest.

    Raises
    ------
    IdentifyError
        the rig has no transducer, there is hardly a sample, or the recording's stamps decrease
    """
    period, seen = recording.rig.bus.period_s, signals(recording)
    good = seen.shown & np.isfinite(seen.x) & np.isfinite(seen.hand) & np.isfinite(seen.motor)
    gaps = np.abs(np.diff(seen.t, prepend=seen.t[:1] - period) - period) >= 0.5 * period
    edges = [(a, b) for first, end in runs(good) for a, b in _apart(first, end, gaps)]
    slides = tuple(
        Slide(seen.t[a:b], seen.x[a:b], seen.hand[a:b], seen.motor[a:b]) for a, b in edges if b - a >= LEAST_SAMPLES
    )
    if not slides:
        raise IdentifyError(
            f"{recording.path}: {int(good.sum())} samples are in the display at full gain; expected at least {LEAST_SAMPLES} in a row: "
            "record strokes, to and fro"
        )
    return slides


def _apart(first: int, end: int, gaps: Flags) -> list[tuple[int, int]]:
    """Split a run of samples at missing cycles."""
    cuts = first + 1 + np.flatnonzero(gaps[first + 1 : end])
    return list(pairwise([first, *cuts.tolist(), end]))


def one_sense(
    moved: Floats, period_s: float, count_rad: float, slow_rad_s: float = TRAVEL_RAD_S
) -> tuple[Flags, Floats]:
    """Return the samples within a motion in one direction, and the direction.

    `moved`: counts since the previous sample; `slow_rad_s`: the slowest motion to detect.
    """
    n, half = len(moved), max(math.ceil(0.5 * TRAVEL_COUNTS / (slow_rad_s * period_s / count_rad)), 1)
    window = np.ones(2 * half + 1)
    span = np.convolve(moved, window, "same")
    ways = [np.convolve(moved * sign > 0.0, window, "same") > 0.5 for sign in (1, -1)]
    flags = (np.abs(span) >= TRAVEL_COUNTS) & ~(ways[0] & ways[1])
    whole = np.convolve(flags, window, "same") > 2 * half + 0.5  # the neighbouring samples slide, too
    return whole & (np.arange(n) >= half), np.sign(span)


def sliding(
    recording: Source, window_s: float = WINDOW_S, reversal_s: float = REVERSAL_S, reversal_rad: float = 0.0
) -> Sliding:
    """Return the samples of a recording that obey the regression.

    Parameters
    ----------
    window_s : length of each equation's window
    reversal_s : time ignored at the beginning of a slide. Felt friction needs `REVERSAL_S`. With
        the motor's torque measured by the drive, a few milliseconds are enough.
    reversal_rad : angle ignored at the beginning of a slide: there a bearing's bristles still bend

    Raises
    ------
    IdentifyError
        the rig has no transducer; hardly a sample qualifies (the text counts the reasons); or the
        recording's stamps decrease
    """
    axis, period = recording.rig.one_axis(), recording.rig.bus.period_s
    size = 2 * max(round(0.5 * (window_s / period - 1)), 2) + 1
    t, x, moved, hand, motor, brake, shown, notes, count = signals(recording)

    samples = _SelectedSamples(len(t))
    samples.keep("not in the display at full gain (arming, gain ramp, after the end)", shown)
    whole = np.isfinite(x) & np.isfinite(hand) & np.isfinite(motor) & np.isfinite(brake)
    samples.keep("a signal is missing in the cycle, or no number", whole)
    even = np.abs(np.diff(t, prepend=t[:1] - period) - period) < 0.5 * period
    samples.keep("a cycle is missing before it", even & (np.abs(moved) <= axis.limits.encoder_jump_counts))
    moves, sense = np.abs(moved) > axis.law.velocity_band_counts, moved
    if axis.law.function.startswith(EXERCISES):
        moves, sense = one_sense(moved, period, count)
    samples.keep("the handle does not slide", moves)
    slow = np.abs(moved) * count / period <= SPEED_SHARE * axis.limits.speed_rad_s
    samples.keep(f"faster than {SPEED_SHARE:g} of the speed limit", slow)
    one_way = samples.good & np.concatenate(([False], sense[1:] * sense[:-1] > 0.0))
    one_way[1:] &= samples.good[:-1]
    slid = since(one_way)
    moved_rad = np.abs(x - x[np.maximum(np.arange(len(x)) - slid, 0)])
    near = f"within {reversal_s * 1e3:g} ms" + (f" or {reversal_rad:.3g} rad" if reversal_rad > 0.0 else "")
    samples.keep(f"{near} of a stop or a reversal", (slid >= round(reversal_s / period)) & ~(moved_rad < reversal_rad))
    constant = since(np.concatenate(([True], brake[1:] == brake[:-1]))) >= round(COIL_S / period)
    off = constant & (brake == 0.0)
    coil_off = int(np.sum(samples.good & off)) >= LEAST_SAMPLES
    samples.keep(f"brake on, or changed within {COIL_S * 1e3:g} ms", off if coil_off else constant)

    long = np.zeros(len(t), bool)
    spans = []
    for first, end in runs(samples.good):
        for a, b in _one_way(first, end, sense):
            if b - a >= max(size, SPEED_SAMPLES):
                spans.append((a, b))
                long[a:b] = True
    samples.keep(f"a slide shorter than the window of {size * period * 1e3:g} ms", long)
    if int(np.sum(long)) < LEAST_SAMPLES:
        why = "; ".join(f"{n}: {reason}" for reason, n in samples.left_out.items() if n)
        raise IdentifyError(
            f"{recording.path}: {int(np.sum(long))} of {len(t)} samples slide as friction is fitted; expected at least {LEAST_SAMPLES}: "
            f"record strokes, to and fro, at two speeds or more. Left out: {why}"
        )
    if not coil_off:
        notes += (
            "hardly a sample slides with the coil off: what is felt, and what is called the device's own, include the brake's display",
        )
    slides = tuple(Slide(t[a:b], x[a:b], hand[a:b], motor[a:b]) for a, b in spans)
    return Sliding(slides, period, count, coil_off, samples.left_out, notes)


def _one_way(first: int, end: int, sense: Floats) -> list[tuple[int, int]]:
    """Split a run of samples at changes of direction (only a jump can cause them)."""
    turns = first + 1 + np.flatnonzero(np.sign(sense[first + 1 : end]) != np.sign(sense[first : end - 1]))
    edges = [first, *turns.tolist(), end]
    return list(pairwise(edges))
