"""Step "display", the last: hold and stroke test of the rig's law with the measured values."""

from __future__ import annotations

from collections.abc import Sequence

from coulombus.host.commission.samples import thinned
from coulombus.host.commission.step import Curve, Exercise, ExerciseResult, Finding, Given, Outcome, Risk, Step
from coulombus.host.cycle.output_limits import motor_limit_Nm
from coulombus.recording.measures import measure
from coulombus.rigs.axis import Axis
from coulombus.rigs.rig import Rig

__all__ = ["DisplayStep"]

MODES = ("hybrid", "passive", "active")
SCHEDULE = (
    '{kind="rest", duration_s=2.0}',
    '{kind="hold", duration_s=4.0, push_F_s=0.5, frequency_Hz=0.5}',
    '{kind="stroke", duration_s=6.0, speed_rad_s=1.0, move_s=1.0, dwell_s=1.0}',
)
STILL_COUNTS = 2


class DisplayStep(Step):
    """Hold and stroke test."""

    name = "display"
    title = "hold and stroke test with the rig's own law"

    def _mode(self, axis: Axis) -> str:
        return next(mode for mode in MODES if mode in axis.mode)

    def risk(self, axis: Axis, inputs: Given) -> Risk:
        """Return the limits of the mode, from the rig file."""
        mode = self._mode(axis)
        mode_keys = axis.mode[mode]
        return Risk(
            f"The rig displays friction in mode {mode}: F_s {mode_keys.F_s_Nm:g} Nm, F_d {mode_keys.F_d_Nm:g} Nm.",
            motor_Nm=max(motor_limit_Nm(axis, mode), axis.limits.sign_check_torque_Nm if mode == "active" else 0.0),
            brake_Nm=axis.limits.brake_torque_Nm if mode != "active" else 0.0,
            seconds=12.0,
            operator="After 2 s push the handle, less than it bears, to and fro for 4 s; then stroke it, "
            "1 s each way, with a stop of 1 s between.",
        )

    def exercises(self, rig: Rig, inputs: Given) -> tuple[Exercise, ...]:
        """Return a run with the rig file's law."""
        schedule = f"phase=[{', '.join(SCHEDULE)}]"
        variant = rig.variant(schedule)
        return (Exercise(self.name, variant, self._mode(rig.one_axis()), variant.schedule_s, (schedule,)),)

    def analyse(self, runs: Sequence[ExerciseResult], axis: Axis, inputs: Given) -> Outcome:
        """Return the figures of the hold test: whether the handle stayed still while it was pushed."""
        recording = runs[0].recording
        measures = measure(recording)
        basis = f"mode {self._mode(axis)}, hold and stroke"
        rows = (
            ("hold: encoder peak to peak", measures.hold_counts_p2p, "counts"),
            ("hold: velocity, RMS", measures.hold_velocity_rms_rad_s, "rad/s"),
            ("hold: largest push", measures.hold_push_Nm, "Nm"),
            ("hold: torque sign changes", measures.torque_flips_per_s, "1/s"),
        )
        findings = tuple(Finding("", name, None, value, unit, None, basis) for name, value, unit in rows)
        remarks: tuple[str, ...] = ()
        if (
            measures.hold_counts_p2p is not None
            and measures.hold_counts_p2p > STILL_COUNTS
            and self._mode(axis) != "active"
        ):
            remarks = (
                f"the handle moved by {measures.hold_counts_p2p} counts while it was held: was the push below F_s?",
            )
        angle = recording["motor.position_rad"]
        curves = [
            Curve("Hold and stroke: angle", "time [s]", "[rad]", {"angle": (*thinned(angle.t_s, angle.values), "-")})
        ]
        hand = recording.signals.get("brake.handle_torque_Nm")
        if hand is not None and len(hand):
            lines = {"hand": (*thinned(hand.t_s, hand.values), "-")}
            curves.append(Curve("Hold and stroke: hand's torque", "time [s]", "[Nm]", lines))
        return Outcome(findings, remarks, tuple(curves))
