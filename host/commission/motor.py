r"""The motor: its sign and its torque constant, against the transducer, with a hand that gives way.

While the handle slides, :math:`f = -k\,\tau_m + c\,\mathrm{sgn}(v) + b v + J\dot v + f_0`, with the
motor's torque :math:`\tau_m` as it is believed and the hand's torque f as the transducer reads it:
k is what the belief is short of. The hand must resist, so that f and the motor's torque go from one
end to the other. The sign check, which comes first, tells a motor that turns the wrong way; the
encoder's sign is known from the step encoder.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from coulombus.host.commission.friction import sweep_exercise, sweep_risk
from coulombus.host.commission.samples import fit, thinned
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
    lacks_roles,
)
from coulombus.recording.friction.sliding import IdentifyError, equations, sliding
from coulombus.rigs.axis import Axis
from coulombus.rigs.rig import Rig

__all__ = ["Motor"]

WINDOW_S = 0.021
"""Length of the window behind each equation: the hand lets the handle go a short way only."""
BLOCK = 4
"""Neighbours overlap by three quarters."""
LEAST_SHARE = 0.3
LEAST_CHANGE = 0.01
MOST_REACH = 0.03
"""A wider interval tells nothing: the motor's torque changed with the sense of motion alone, as
friction does.
"""
SIGN = "SIGN_ENCODER"


class Motor(Step):
    """Sign and torque constant of the motor."""

    name = "motor"
    title = "motor's sign and torque constant, against the transducer"

    def lacks(self, axis: Axis, given: Given) -> str | None:
        """Return what the rig has not."""
        return lacks_roles(axis, "torque", "handle_torque")

    def risk(self, axis: Axis, given: Given) -> Risk:
        """Return what the sweep moves."""
        operator = "Hold the handle loosely: give way as a soft spring does, and keep holding it."
        return replace(sweep_risk(axis), operator=operator)

    def exercises(self, rig: Rig, given: Given) -> tuple[Exercise, ...]:
        """Return the sweep against the hand."""
        return (replace(sweep_exercise(rig, self.name, ()), may_trip=(SIGN,)),)

    def analyse(self, runs: Sequence[ExerciseResult], axis: Axis, given: Given) -> Outcome:
        """Return the sign, or the torque constant."""
        mechanics, rated = axis.mechanics, axis.motor.rated_torque_Nm
        if runs[0].trip is not None:
            old = mechanics.motor_polarity
            why = f"the sign check: {SIGN}; the encoder's sign is as the step encoder left it"
            return Outcome((Finding("mechanics.motor_polarity", "motor's sign", old, -old, "", None, why),), again=True)
        try:
            slides = sliding(runs[0].recording, WINDOW_S)
            rows = equations(slides.slides, slides.period_s, slides.count_rad, WINDOW_S)
        except IdentifyError as error:
            raise CommissionError(f"{error}; hold the handle more loosely") from error
        columns = [rows.motor_Nm, np.sign(rows.v), rows.v, rows.a, np.ones_like(rows.v)]
        solution = fit(columns, rows.hand_Nm, BLOCK)
        k, reach = -float(solution.beta[0]), float(solution.reach[0])
        if reach > MOST_REACH or k < LEAST_SHARE:
            raise CommissionError(
                f"the motor's torque reads {k:.3f} +- {reach:.3f} of what is believed: hold the handle, so that it "
                "resists the motor, and give way slowly"
            )
        new = float(f"{rated * k:.4g}")
        basis = f"{len(rows.v)} windows, the hand's torque against the motor's; ratio {mechanics.ratio:g}"
        changed = abs(k - 1) > max(reach, LEAST_CHANGE)
        findings = (
            Finding(
                "mechanics.motor_polarity",
                "motor's sign",
                mechanics.motor_polarity,
                mechanics.motor_polarity,
                "",
                None,
                basis,
                False,
            ),
            Finding(
                "motor.rated_torque_Nm", "torque at 1000 per mille", rated, new, "Nm", rated * reach, basis, changed
            ),
        )
        rest = rows.hand_Nm - np.column_stack(columns[1:]) @ solution.beta[1:]
        ends = [float(np.min(rows.motor_Nm)), float(np.max(rows.motor_Nm))]
        curve = Curve(
            "Hand against motor",
            "motor's torque as believed [Nm]",
            "hand's torque, friction taken off [Nm]",
            {"windows": (*thinned(rows.motor_Nm, rest), "."), "fit": (ends, [-k * torque for torque in ends], "-")},
        )
        return Outcome(findings, curves=(curve,))
