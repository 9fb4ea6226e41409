r"""Step "motor": sign and torque constant of the motor, against the transducer, with a yielding hand.

While the handle slides,

.. math:: f = -k\,(\tau_m + \delta\,\dot\tau_m) + F(v)\,\mathrm{sgn}(v) + J\dot v + f_0

with the motor's torque :math:`\tau_m` according to the rig file, delayed by :math:`\delta`, the friction
F (`recording.friction.friction_fit`), and the hand's torque f from the transducer. Cogging, ripple and uneven
friction are added where significant (`recording.friction.angle_waves`), and so is a gear's friction that grows with
the motor's torque: the hand is the load. k is the ratio of the true to the
assumed torque. Its interval is that of clusters (`recording.friction.regression`), combined with the
transducer's scale. The interval of the torque constant also includes the ratio's.

The hand must resist, so that f and the motor's torque cover their range. It must turn the handle slowly, so
that the cogging is visible over an angle. The sign check, which comes first, detects a motor that turns in
the wrong direction; the encoder's sign is known from the step encoder.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from coulombus.host.commission.friction import (
    REVERSAL_S,
    SECONDS,
    WINDOW_S,
    reversal_rad,
    sweep_exercise,
    sweep_risk,
)
from coulombus.host.commission.samples import thinned
from coulombus.host.commission.step import (
    ANGLE,
    HANDLE_TORQUE,
    SCALE,
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
    move_s,
    rounded,
    strokes,
)
from coulombus.recording.friction.angle_waves import ALL_KINDS, find_waves, wave_columns
from coulombus.recording.friction.equations import equations
from coulombus.recording.friction.friction_fit import MOTOR, fit_friction, load_column
from coulombus.recording.friction.identify import torque_delay
from coulombus.recording.friction.regression import Column, widened
from coulombus.recording.friction.sliding import IdentifyError, sliding
from coulombus.rigs.axis import Axis
from coulombus.rigs.rig import Rig

__all__ = ["LOAD_SHARE", "MotorStep"]

LEAST_SHARE = 0.3
MOST_REACH = 0.03
"""Widest useful interval: beyond it, the motor's torque changed with the direction of motion alone, as
friction does.
"""
SIGN = "SIGN_ENCODER"
LOAD_SHARE = "friction that grows with the motor's torque, as a share of it"
STILL_S, SPEED_RAD_S, MOVE_S, DWELL_S = 4.0, 0.2, 2.3, 0.2
"""The hand waits for the sign check, then moves.

A cogging of few periods that is only visible near one angle could not be distinguished from the hand's
stiffness, and would change the motor's torque.
"""


def _move_s(axis: Axis) -> float:
    return move_s(axis, SPEED_RAD_S, MOVE_S)


class MotorStep(Step):
    """Sign and torque constant of the motor."""

    name = "motor"
    title = "motor's sign and torque constant, against the transducer"

    def lacks(self, axis: Axis, inputs: Given) -> str | None:
        """Return the role that the rig lacks, or None."""
        return lacks_roles(axis, "torque", "handle_torque")

    def risk(self, axis: Axis, inputs: Given) -> Risk:
        """Return the limits of the sweep."""
        operator = (
            f"Hold the handle loosely, as a soft spring does, and keep holding it. Leave it where it is for {STILL_S:g} s; "
            f"then turn it slowly to and fro, about {SPEED_RAD_S:g} rad/s, {_move_s(axis):g} s each way, "
            "and let the motor push it off its way."
        )
        return replace(sweep_risk(axis), operator=operator)

    def exercises(self, rig: Rig, inputs: Given) -> tuple[Exercise, ...]:
        """Return the sweep against the hand."""
        phases = (
            f'{{kind="rest", duration_s={STILL_S}}}',
            strokes(SECONDS - STILL_S, SPEED_RAD_S, _move_s(rig.one_axis()), DWELL_S),
        )
        return (replace(sweep_exercise(rig, self.name, (), phases), may_trip=(SIGN,)),)

    def analyse(self, runs: Sequence[ExerciseResult], axis: Axis, inputs: Given) -> Outcome:
        """Return the sign, or the torque constant."""
        mechanics, rated = axis.mechanics, axis.motor.rated_torque_Nm
        if runs[0].trip is not None:
            old = mechanics.motor_polarity
            why = f"the sign check: {SIGN}; the encoder's sign is as the step encoder left it"
            return Outcome((Finding("mechanics.motor_polarity", "motor's sign", old, -old, "", None, why),), again=True)
        try:
            slides = sliding(runs[0].recording, WINDOW_S, REVERSAL_S, reversal_rad(axis))
            rows = equations(slides.slides, slides.period_s, slides.count_rad, WINDOW_S)
            waves = find_waves(slides, mechanics.ratio, ALL_KINDS, None)
            columns: dict[str, Column] = torque_delay(rows, slides) | wave_columns(waves, rows, slides.slides)
            columns |= load_column(rows, slides.slides, columns)
            columns[MOTOR] = -rows.motor_Nm, 0.0
            fit = fit_friction(rows, rows.hand_Nm, None, columns)
        except IdentifyError as error:
            raise CommissionError(f"{error}; hold the handle more loosely") from error
        gain = widened(fit.others[MOTOR], inputs.share(SCALE))
        k, reach = gain.value, gain.reach
        if reach > MOST_REACH or k < LEAST_SHARE:
            raise CommissionError(
                f"the motor's torque reads {k:.3f} +- {reach:.3f} of what is believed: hold the handle, so that it "
                "resists the motor, and give way slowly"
            )
        rated_reach = rated * k * math.hypot(reach / k, inputs.share(*ANGLE))
        new = rounded(rated * k, rated_reach)
        at_handle = rated * mechanics.ratio
        basis = f"{len(rows.v)} windows, the hand's torque against the motor's; ratio {mechanics.ratio:g}"
        changed = abs(new - rated) > rated_reach
        findings: tuple[Finding, ...] = (
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
            Finding("motor.rated_torque_Nm", "torque at 1000 per mille", rated, new, "Nm", rated_reach, basis, changed),
            Finding(
                *("", HANDLE_TORQUE, at_handle, rounded(k * at_handle, reach * at_handle), "Nm", reach * at_handle),
                basis,
                changed,
            ),
        )
        if fit.load_share is not None:
            share, reach = fit.load_share.value / k, fit.load_share.reach / k
            findings += (Finding("", LOAD_SHARE, 0.0, rounded(share, reach), "", reach, basis),)
        rest = rows.hand_Nm - fit.friction_Nm(rows.v) - fit.inertia_and_offset_Nm(rows.a)
        rest -= sum(fit.others[name].value * values for name, (values, _) in columns.items() if name != MOTOR)
        ends = [float(np.min(rows.motor_Nm)), float(np.max(rows.motor_Nm))]
        curve = Curve(
            "Hand against motor",
            "motor's torque by the rig file [Nm]",
            "hand's torque, friction taken off [Nm]",
            {"windows": (*thinned(rows.motor_Nm, rest), "."), "fit": (ends, [-k * torque for torque in ends], "-")},
        )
        exact = inputs.exact({"the transducer's scale (step weight)": (SCALE,), "the ratio (step encoder)": ANGLE})
        return Outcome(findings, exact, (curve,))
