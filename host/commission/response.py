"""Step "response": the brake's response to a step of its set-point, coil and fluid, at the hand.

A hand strokes the handle while the brake is switched on and off. `host.commission.lag_fit` fits two lags in
series to the hand's torque. The 95 % intervals of the two time constants include that of the inertia, and
the hysteresis of the brake's table: iron that remembers a share of the torque follows later than the coil. A
remark says whether they may be equal within their intervals.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from coulombus.host.commission.brake import STROKING_HAND
from coulombus.host.commission.earlier import INERTIA, TABLE, rounded
from coulombus.host.commission.lag_fit import fit_lags, step_answer
from coulombus.host.commission.samples import thinned
from coulombus.host.commission.step import (
    Curve,
    Exercise,
    ExerciseResult,
    Finding,
    Given,
    Outcome,
    Risk,
    Step,
    exercise,
    lacks_roles,
    move_s,
    strokes,
)
from coulombus.host.cycle.output_limits import brake_end_Nm
from coulombus.rigs.axis import Axis
from coulombus.rigs.rig import Rig

__all__ = ["ResponseStep"]

BRAKE_NM, HALF_S, SECONDS = 0.6, 0.187, 24.0
"""The number of steps in a stroke is not an integer, so each step falls on another angle."""
SPEED_RAD_S, MOVE_S, DWELL_S = 1.5, 1.5, 0.1


class ResponseStep(Step):
    """The brake's step response."""

    name = "response"
    title = "brake's answer to a step: delay, coil, fluid"

    def lacks(self, axis: Axis, inputs: Given) -> str | None:
        """Return the role that the rig lacks, or None."""
        return lacks_roles(axis, "handle_torque")

    def _brake(self, axis: Axis) -> float:
        return min(BRAKE_NM, axis.limits.brake_torque_Nm)

    def risk(self, axis: Axis, inputs: Given) -> Risk:
        """Return the brake's torque and the operator's strokes."""
        return Risk(
            "The brake is switched on and off five times in two seconds.",
            brake_Nm=self._brake(axis),
            speed_rad_s=SPEED_RAD_S,
            travel_rad=SPEED_RAD_S * move_s(axis, SPEED_RAD_S, MOVE_S),
            seconds=SECONDS,
            operator=f"Stroke the handle to and fro, about {SPEED_RAD_S:g} rad/s, "
            f"{move_s(axis, SPEED_RAD_S, MOVE_S):g} s each way, with a firm hand that does not give way to the brake.",
        )

    def exercises(self, rig: Rig, inputs: Given) -> tuple[Exercise, ...]:
        """Return the run with the steps."""
        move = move_s(rig.one_axis(), SPEED_RAD_S, MOVE_S)
        stroke = strokes(SECONDS, SPEED_RAD_S, move, DWELL_S)
        user = [0.0, HALF_S, self._brake(rig.one_axis())]
        return (exercise(self.name, rig, "square", user, [stroke], hand=STROKING_HAND),)

    def analyse(self, runs: Sequence[ExerciseResult], axis: Axis, inputs: Given) -> Outcome:
        """Return times and time constants; the rig file has no key for them."""
        mechanics = axis.mechanics
        wave_rad = mechanics.cogging_periods * mechanics.ratio if mechanics.cogging_Nm > 0 else None
        fit = fit_lags(runs[0].recording, mechanics.inertia_kg_m2, inputs.share(INERTIA), wave_rad)
        iron_share = inputs.share(TABLE) * brake_end_Nm(axis) / self._brake(axis)
        basis = f"{fit.samples} samples in slip, inertia {mechanics.inertia_kg_m2:g} kg m2 taken off"
        findings = tuple(
            Finding("", name, None, rounded(1e3 * value, 1e3 * reach), "ms", 1e3 * reach, basis)
            for name, (value, reach) in fit.figures(iron_share).items()
        )
        remarks = inputs.exact({"the inertia (step friction)": (INERTIA,), "the brake's table (step brake)": (TABLE,)})
        if fit.together:
            remarks += ("coil and fluid cannot be told apart: their lags may be equal within the intervals",)
        t = np.linspace(0.0, float(fit.curve[0][-1]), 200)
        lines = {
            "measured": (*thinned(1e3 * fit.curve[0], fit.curve[1]), "."),
            "two lags": (*thinned(1e3 * t, step_answer(t, *fit.best)), "-"),
        }
        curve = Curve("Brake's answer to a step", "time since the SYNC before [ms]", "share", lines)
        return Outcome(findings, remarks, (curve,))
