"""Step "encoder": encoder and transmission by hand; the operator turns the handle from one mark to another.

The angle between the marks is known. The encoder's counts give its sign, and the number of counts in a turn
of the handle. That number is the product of the counts in a turn of the motor and the transmission's ratio.
The data sheet's counts are taken as correct, and the ratio is corrected.

The interval combines the accuracy of the marks, which only the operator knows (`Given.marks_reach_rad`), the
counts, and the scatter of the readings.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from coulombus.host.commission.samples import mean_in, span_of, thinned
from coulombus.host.commission.step import (
    CommissionError,
    Curve,
    Exercise,
    ExerciseResult,
    Finding,
    Given,
    Outcome,
    Risk,
    Step,
    exercise,
    rounded,
    strokes,
)
from coulombus.rigs.axis import Axis
from coulombus.rigs.rig import Rig

__all__ = ["FIRM_HAND", "EncoderStep"]

FIRM_HAND = (
    "operator.inertia_kg_m2=5e-4",
    "operator.stiffness_Nm_rad=4000.0",
    "operator.damping_Nms_rad=20.0",
    "operator.tremor_Nm=0.0",
)
"""Settings of a simulated hand that follows its course firmly."""

REST_S, MOVE_S, STAY_S = 3.0, 5.0, 5.0
SETTLED_S = 2.0
LEAST_RAD, MOST_RAD = 0.05, 50.0
LEAST_SHARE = 0.1


class EncoderStep(Step):
    """Sign of the encoder, and counts of a turn of the handle, which stay in the rig file as a second check of
    the position's scale.
    """

    name = "encoder"
    title = "encoder's sign and the ratio, by hand between two marks"

    def lacks(self, axis: Axis, inputs: Given) -> str | None:
        """Return the input that the operator has not given, or None."""
        if inputs.marks_rad is None:
            return "give --marks-rad: the angle between two marks at the handle"
        if not LEAST_RAD <= inputs.marks_rad <= min(MOST_RAD, 0.9 * axis.limits.travel_limit_rad):
            largest_rad = min(MOST_RAD, 0.9 * axis.limits.travel_limit_rad)
            return f"--marks-rad {inputs.marks_rad:g}: expected from {LEAST_RAD:g} to {largest_rad:.3g} (limits.travel_rad)"
        return None

    def risk(self, axis: Axis, inputs: Given) -> Risk:
        """Return the risk: only the hand moves the handle."""
        return Risk(
            "Only your hand moves the handle.",
            speed_rad_s=(inputs.marks_rad or 0.0) / MOVE_S,
            travel_rad=inputs.marks_rad or 0.0,
            seconds=REST_S + MOVE_S + STAY_S,
            operator=f"Set the handle to the first mark, and leave it for {REST_S:g} s; turn it within {MOVE_S:g} s "
            f"to the second mark, in the positive sense, and leave it there for {STAY_S:g} s.",
        )

    def exercises(self, rig: Rig, inputs: Given) -> tuple[Exercise, ...]:
        """Return a run without torque of motor and brake."""
        speed = (inputs.marks_rad or 0.0) / MOVE_S
        phases = (
            f'{{kind="rest", duration_s={REST_S}}}',
            strokes(MOVE_S + STAY_S, speed, MOVE_S, STAY_S),
        )
        return (exercise(self.name, rig, "hold", [0.0], phases, hand=FIRM_HAND),)

    def analyse(self, runs: Sequence[ExerciseResult], axis: Axis, inputs: Given) -> Outcome:
        """Return sign and ratio."""
        recording, marks = runs[0].recording, inputs.marks_rad or 0.0
        position = axis.allocation.bound["position"]
        count = abs(position.scale)
        angle = recording["motor.position_rad"]
        rest, stroke = span_of(recording, "rest"), span_of(recording, "stroke")
        first = mean_in(angle, rest.end_s - SETTLED_S, rest.end_s, "the first mark", count)
        second = mean_in(angle, stroke.end_s - SETTLED_S, stroke.end_s, "the second mark", count)
        turned = second.value - first.value
        if abs(turned) < LEAST_SHARE * marks:
            raise CommissionError(
                f"the encoder counts {turned:.4f} rad between marks {marks:g} rad apart: did the handle turn?"
            )
        counts = round(abs(turned) / count)
        share = math.hypot(first.reach, second.reach, inputs.marks_reach_rad) / abs(turned)
        factor = abs(turned) / marks
        other = abs(factor - 1) > share
        basis = f"{counts} counts between marks {marks:g} +- {inputs.marks_reach_rad:g} rad apart"
        polarity = axis.mechanics.encoder_polarity
        sign = polarity if turned > 0 else -polarity
        findings = [
            Finding(
                "mechanics.encoder_polarity",
                "encoder's sign",
                polarity,
                sign,
                "",
                None,
                basis,
                changed=sign != polarity,
            )
        ]
        if position.decided.startswith("role."):
            reach = share * count / factor
            new = rounded(count / factor, reach)
            key = "role.position.scale_rad"
            findings.append(Finding(key, "angle of a count", count, new, "rad", reach, basis, changed=other))
        else:
            ratio = axis.mechanics.ratio
            reach = share * ratio * factor
            new = rounded(ratio * factor, reach)
            findings.append(Finding("mechanics.ratio", "ratio", ratio, new, "", reach, basis, changed=other))
        turn_reach = share * counts * 2 * math.pi / marks
        counts_turn = rounded(counts * 2 * math.pi / marks, turn_reach)
        was = axis.mechanics.counts_turn
        findings.append(
            Finding(
                *("mechanics.counts_turn", "counts of a turn of the handle", was, counts_turn, ""),
                *(turn_reach, basis),
                changed=was is None or abs(was - counts_turn) > turn_reach,
            )
        )
        curve = Curve(
            "By hand from mark to mark",
            "time [s]",
            "angle [rad]",
            {"as it read": (*thinned(angle.t_s, angle.values), "-")},
        )
        return Outcome(tuple(findings), curves=(curve,))
