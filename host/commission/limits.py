"""Step "limits": limits of the rig file that contradict the measured noise and counts.

A limit that is narrower than the noise trips without a fault. A limit that is too wide protects against
nothing. A wider limit is only proposed if the present limit would trip without a fault. Nothing moves, and
the handle is free.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from coulombus.host.commission.friction import FREE_HAND
from coulombus.host.commission.samples import handle_torque, mean_in
from coulombus.host.commission.step import Exercise, ExerciseResult, Finding, Given, Outcome, Risk, Step, exercise
from coulombus.recording.signals import Recording
from coulombus.rigs.axis import Axis
from coulombus.rigs.rig import Rig

__all__ = ["LimitsStep"]

SECONDS = 4.0
NOISE_FACTOR = 6.0
"""Number of standard deviations that a day of samples at 1 kHz does not reach."""
JUMP_MARGIN = 1.5
JUMP_LOOSE = 10.0
"""Multiple of the counts at the speed limit above which a jump would not be detected."""


class LimitsStep(Step):
    """Limits that contradict the rig."""

    name = "limits"
    title = "limits against noise, counts and speed"

    def risk(self, axis: Axis, inputs: Given) -> Risk:
        """Return the risk: nothing moves."""
        return Risk("Nothing moves: encoder and transducer are read.", seconds=SECONDS)

    def exercises(self, rig: Rig, inputs: Given) -> tuple[Exercise, ...]:
        """Return a run without torque."""
        rest = f'{{kind="rest", duration_s={SECONDS}}}'
        return (exercise(self.name, rig, "hold", [0.0], [rest], hand=FREE_HAND),)

    def analyse(self, runs: Sequence[ExerciseResult], axis: Axis, inputs: Given) -> Outcome:
        """Return noise and jitter, and the checked limits."""
        return Outcome(tuple(_findings(runs[0].recording, axis)))


def _findings(recording: Recording, axis: Axis) -> Iterator[Finding]:
    limits, period = axis.limits, axis.bus.period_s
    angle = recording["motor.position_rad"]
    count = abs(recording.scale("motor.position_rad"))
    counts = np.rint(np.asarray(angle.values, np.float64) / count)
    jitter = int(np.max(np.abs(np.diff(counts)))) if len(counts) > 1 else 0
    basis = f"{len(counts)} samples at rest"
    yield Finding("", "encoder's jitter at rest", None, jitter, "counts/cycle", None, basis)
    band = axis.law.velocity_band_counts
    why = f"at rest the encoder moves by {jitter} counts a cycle; a band below that does not stick"
    yield Finding(
        "law.velocity_band_counts", "velocity band", band, max(band, jitter), "counts", None, why, band < jitter
    )
    fastest = limits.speed_rad_s * period / count
    jump, least_jump = limits.encoder_jump_counts, math.ceil(JUMP_MARGIN * fastest)
    why = f"limits.speed_rad_s is {fastest:.0f} counts a cycle, times {JUMP_MARGIN:g}"
    unfit = jump < fastest or jump > JUMP_LOOSE * fastest
    yield Finding(
        "limits.encoder_jump_counts", "encoder's jump", jump, least_jump if unfit else jump, "counts", None, why, unfit
    )
    if axis.allocation.bound.get("handle_torque") is None:
        return
    series = handle_torque(recording)
    mean = mean_in(series, float(series.t_s[0]), float(series.t_s[-1]), "the transducer at rest")
    least = abs(mean.value) + NOISE_FACTOR * mean.deviation
    yield Finding("", "transducer's noise, RMS", None, float(f"{mean.deviation:.3g}"), "Nm", None, basis)
    for key, old in (
        ("still_handle_torque_Nm", limits.still_handle_torque_Nm),
        ("handle_mismatch_Nm", limits.handle_mismatch_Nm),
    ):
        why = f"zero and {NOISE_FACTOR:g} x noise are {least:.4f} Nm"
        new = float(f"{2 * least:.3g}") if old < least else old
        yield Finding(
            f"limits.{key}", key.removesuffix("_Nm").replace("_", " "), old, new, "Nm", None, why, old < least
        )
