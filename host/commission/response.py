r"""The brake's answer to a step of its set-point: coil and fluid, as the hand feels them.

A hand strokes the handle while the brake is switched on and off. In slip the hand bears the brake's
torque and what the inertia takes; the mean over many steps answers like two lags in series,

.. math:: y(t) = 1 - \frac{\tau_f e^{-s/\tau_f} - \tau_c e^{-s/\tau_c}}{\tau_f - \tau_c}, \quad s = t - d > 0

with the coil's time constant :math:`\tau_c`, the slower fluid's :math:`\tau_f` and the delay d
since the SYNC before the set-point was sent. The two times at which 63 % and 95 % are reached need
no model.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import least_squares

from coulombus.host.commission.brake import STROKING_HAND
from coulombus.host.commission.samples import Floats, handle_torque, motion, sync_before
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
    lacks_roles,
    move_s,
    strokes,
)
from coulombus.recording.signals import Recording
from coulombus.rigs.axis import Axis
from coulombus.rigs.rig import Rig

__all__ = ["Response"]

BRAKE_NM, HALF_S, SECONDS = 0.6, 0.2, 24.0
SPEED_RAD_S, MOVE_S, DWELL_S = 1.5, 1.5, 0.1
BEFORE_S, AFTER_S, END_S = 0.02, 0.19, 0.04
SLIP_SHARE = 0.2
LEAST_STEPS = 12
SMOOTH = 5
"""Samples over which speed and acceleration are averaged."""


class Response(Step):
    """The brake's step response."""

    name = "response"
    title = "brake's answer to a step: delay, coil, fluid"

    def lacks(self, axis: Axis, given: Given) -> str | None:
        """Return what the rig has not."""
        return lacks_roles(axis, "handle_torque")

    def _brake(self, axis: Axis) -> float:
        return min(BRAKE_NM, axis.limits.brake_torque_Nm)

    def risk(self, axis: Axis, given: Given) -> Risk:
        """Return what the brake bears."""
        return Risk(
            "The brake is switched on and off five times in two seconds.",
            brake_Nm=self._brake(axis),
            speed_rad_s=SPEED_RAD_S,
            travel_rad=SPEED_RAD_S * move_s(axis, SPEED_RAD_S, MOVE_S),
            seconds=SECONDS,
            operator=f"Stroke the handle to and fro, about {SPEED_RAD_S:g} rad/s, "
            f"{move_s(axis, SPEED_RAD_S, MOVE_S):g} s each way, with a firm hand that does not give way to the brake.",
        )

    def exercises(self, rig: Rig, given: Given) -> tuple[Exercise, ...]:
        """Return the run with the steps."""
        move = move_s(rig.one_axis(), SPEED_RAD_S, MOVE_S)
        stroke = strokes(SECONDS, SPEED_RAD_S, move, DWELL_S)
        user = [0.0, HALF_S, self._brake(rig.one_axis())]
        return (exercise(self.name, rig, "square", user, [stroke], hand=STROKING_HAND),)

    def analyse(self, runs: Sequence[ExerciseResult], axis: Axis, given: Given) -> Outcome:
        """Return times and time constants; the rig file has no key for them."""
        t, y, steps = _mean_answer(runs[0].recording, axis)
        delay, coil, fluid = _fitted(t, y)
        basis = f"mean of {steps} steps in slip, inertia {axis.mechanics.inertia_kg_m2:g} kg m2 taken off"
        rows = (
            ("brake: 63 % after", _reached(t, y, 1 - np.exp(-1)), "ms"),
            ("brake: 95 % after", _reached(t, y, 0.95), "ms"),
            ("brake: delay", 1e3 * delay, "ms"),
            ("brake: faster lag (coil)", 1e3 * coil, "ms"),
            ("brake: slower lag (fluid)", 1e3 * fluid, "ms"),
        )
        findings = tuple(
            Finding("", name, None, round(float(value), 2), unit, None, basis) for name, value, unit in rows
        )
        ms = [round(float(t_s) * 1e3, 3) for t_s in t]
        lines = {
            "measured": (ms, [round(float(share), 4) for share in y], "."),
            "two lags": (ms, [round(float(share), 4) for share in _model(t, delay, coil, fluid)], "-"),
        }
        return Outcome(
            findings, curves=(Curve("Brake's answer to a step", "time since the SYNC before [ms]", "share", lines),)
        )


def _mean_answer(recording: Recording, axis: Axis) -> tuple[Floats, Floats, int]:
    """Return times since the SYNC before each step, the mean answer, and of how many steps it is.

    Raises
    ------
    CommissionError
        the handle slid through too few of them
    """
    period = recording.rig.bus.period_s
    angle, hand, setpoints = recording["motor.position_rad"], handle_torque(recording), recording["brake.setpoint_Nm"]
    if not len(angle):
        raise CommissionError("the recording has no position")
    sampled, sent = sync_before(recording, angle.t_s), sync_before(recording, setpoints.t_s)
    v, a = motion(angle, period, SMOOTH)
    torque = (
        np.interp(angle.t_s, hand.t_s, hand.values)
        - axis.mechanics.inertia_kg_m2 * a
        - axis.mechanics.viscous_Nms_rad * v
    )
    jumps = np.diff(np.asarray(setpoints.values, np.float64))
    edges = 1 + np.flatnonzero(np.abs(jumps) > 0.5 * np.max(np.abs(jumps), initial=0.0) + 1e-9)
    before, after, end = (round(time_s / period) for time_s in (BEFORE_S, AFTER_S, END_S))
    answers = []
    for edge in edges:
        at = int(np.searchsorted(sampled, sent[edge]))
        span = slice(at - before, at + after)
        if at < before or at + after > len(v) or np.min(np.abs(v[span])) < SLIP_SHARE * SPEED_RAD_S:
            continue
        if np.ptp(np.sign(v[span])) == 0.0:
            sensed = torque[span] * np.sign(v[at])
            low, high = np.mean(sensed[:before]), np.mean(sensed[-end:])
            if abs(high - low) > 1e-6:
                answers.append((sensed[before:] - low) / (high - low))
    if len(answers) < LEAST_STEPS:
        raise CommissionError(
            f"the handle slid through {len(answers)} steps; expected {LEAST_STEPS}: stroke it with a firmer hand"
        )
    t: Floats = np.asarray(np.arange(after) * period, np.float64)
    return t, np.mean(answers, axis=0), len(answers)


def _model(t: Floats, delay: float, coil: float, fluid: float) -> Floats:
    """Return the answer of two lags in series, the slower one last."""
    s = np.maximum(t - delay, 0.0)
    if fluid - coil < 1e-6:
        fluid = coil + 1e-6
    answer: Floats = 1 - (fluid * np.exp(-s / fluid) - coil * np.exp(-s / coil)) / (fluid - coil)
    return answer


def _fitted(t: Floats, y: Floats) -> tuple[float, float, float]:
    """Return delay and both time constants, the faster one first [s]."""
    start = float(_reached(t, y, 1 - np.exp(-1))) * 1e-3
    times = least_squares(
        lambda p: _model(t, p[0], min(p[1], p[2]), max(p[1], p[2])) - y,
        (0.05 * start, 0.2 * start, 0.8 * start),
        bounds=((0.0, 1e-5, 1e-5), (0.05, 0.2, 0.5)),
    ).x
    return float(times[0]), float(min(times[1:])), float(max(times[1:]))


def _reached(t: Floats, y: Floats, share: float) -> float:
    """Return when the answer reaches a share, for good [ms].

    Raises
    ------
    CommissionError
        it does not, within half a period of the steps
    """
    below = np.flatnonzero(y < share)
    k = int(below[-1]) if len(below) else 0
    if k + 1 >= len(y):
        raise CommissionError(
            f"the brake has not answered within {HALF_S:g} s: is the coil connected, and the hand firm?"
        )
    return float(1e3 * np.interp(share, y[k : k + 2], t[k : k + 2]))
