r"""Step "delay": time from the SYNC whose samples give a set-point, to the torque of that set-point.

Motor torque and brake are switched to and fro, below the friction, so that nothing moves. The measured
signal responds with one lag,

.. math:: y(t) = A\,(1 - e^{-(t - d)/\tau}), \quad t > d,

sampled at each SYNC. Delay d, time constant :math:`\tau` and size A are fitted by least squares to the mean
over all steps. With actuation on the next SYNC, d is one period.

The covariance is that of the delta method, :math:`\sigma^2 (J^T J)^{-1}` with the fit's Jacobian J. A
sample's :math:`\sigma^2` is the sum of the scatter from step to step, divided by the number of steps, and
of the error of its count, :math:`\Delta^2/12`, which does not average out over equal steps
(`host.commission.samples.counted_reach`).
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.optimize import least_squares
from scipy.special import stdtrit

from coulombus.host.commission.friction import FREE_HAND
from coulombus.host.commission.samples import Floats, counted_reach, sync_before
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
)
from coulombus.recording.signals import Recording
from coulombus.rigs.axis import Axis
from coulombus.rigs.rig import Rig

__all__ = ["DelayStep"]

HALF_S, SECONDS, SKIP_S = 0.04, 5.0, 1.5
FRICTION_SHARE = 0.5
"""Motor torque as a share of the friction, with which the handle does not move."""
BRAKE_NM = 1.0
LEAST_SHARE = 0.03
"""Share of the response below which a sample counts as noise."""
LEAST_EDGES = 10
CLEAN_SHARE = 0.02
"""Largest variation of the command before and after a valid step, as a share of its size."""
SETTLED = 5
AFTER = 25


class _StepResponse(NamedTuple):
    """Response of the device to a step, with half of the 95 % intervals."""

    delay_us: float
    delay_reach_us: float
    tau_ms: float | None
    """None: the response is complete within a cycle."""
    tau_reach_ms: float | None
    t_ms: list[float]
    y: list[float]


class DelayStep(Step):
    """Delay and time constant of motor and coil."""

    name = "delay"
    title = "delays: SYNC to torque and to coil current"

    def lacks(self, axis: Axis, inputs: Given) -> str | None:
        """Return the roles that the rig lacks, or None."""
        bound = axis.allocation.bound
        if bound.get("torque") is None and bound.get("coil_current") is None:
            return "the rig has neither a role torque nor a role coil_current"
        return None

    def _motor(self, axis: Axis) -> float:
        if axis.allocation.bound.get("torque") is None:
            return 0.0
        return min(FRICTION_SHARE * axis.mechanics.friction_Nm, axis.limits.sign_check_torque_Nm)

    def _brake(self, axis: Axis) -> float:
        return min(BRAKE_NM, axis.limits.brake_torque_Nm) if axis.allocation.bound.get("coil_current") else 0.0

    def risk(self, axis: Axis, inputs: Given) -> Risk:
        """Return the switched torques, and the limit of the sign check before them."""
        return Risk(
            "The motor's torque is switched to and fro, too little to move the handle; then the brake's.",
            motor_Nm=axis.limits.sign_check_torque_Nm if self._motor(axis) else 0.0,
            brake_Nm=self._brake(axis),
            seconds=SECONDS,
        )

    def exercises(self, rig: Rig, inputs: Given) -> tuple[Exercise, ...]:
        """Return the motor's run and the brake's."""
        axis = rig.one_axis()
        rest = [f'{{kind="rest", duration_s={SECONDS}}}']
        motor, brake = self._motor(axis), self._brake(axis)
        limit = axis.limits.sign_check_torque_Nm
        if axis.mode.active is not None:
            limit = min(limit, axis.mode.active.motor_limit_Nm)
        exercises = []
        if motor:
            exercises.append(
                exercise("delay-motor", rig, "square", [motor, HALF_S, 0.0], rest, motor_Nm=limit, hand=FREE_HAND)
            )
        if brake:
            exercises.append(exercise("delay-brake", rig, "square", [0.0, HALF_S, brake], rest, hand=FREE_HAND))
        return tuple(exercises)

    def analyse(self, runs: Sequence[ExerciseResult], axis: Axis, inputs: Given) -> Outcome:
        """Return delays and time constants; the rig file has no key for them."""
        rows = [
            ("motor's torque", "motor.target_torque_Nm", "motor.torque_Nm", 2 * self._motor(axis)),
            ("coil's current", "brake.setpoint_Nm", "brake.coil_current_A", self._brake(axis)),
        ]
        findings: list[Finding] = []
        lines: dict[str, tuple[Sequence[float], Sequence[float], str]] = {}
        for run, (name, command, answered, size) in zip(runs, (row for row in rows if row[3]), strict=True):
            answer = _answer(run.recording, command, answered, size)
            basis = f"steps of {command}, answered by {answered}, at each SYNC"
            delay = rounded(answer.delay_us, answer.delay_reach_us)
            findings.append(Finding("", f"SYNC to {name}", None, delay, "us", answer.delay_reach_us, basis))
            tau, reach = answer.tau_ms, answer.tau_reach_ms
            tau = None if tau is None or reach is None else rounded(tau, reach)
            findings.append(Finding("", f"time constant of the {name}", None, tau, "ms", reach, basis))
            lines[name] = (answer.t_ms, answer.y, "o-")
        curve = Curve("Answer to a step", "time since the SYNC before it was sent [ms]", "share", lines)
        return Outcome(tuple(findings), curves=(curve,))


def _answer(recording: Recording, command_name: str, answered: str, size: float) -> _StepResponse:
    """Return the response of `answered` to the steps of `command_name`, which have the size `size`.

    Raises
    ------
    CommissionError
        there are too few steps
    """
    t, answers = _steps(recording, command_name, answered, size)
    if len(answers) < LEAST_EDGES:
        raise CommissionError(f"{answered}: {len(answers)} steps were answered; expected at least {LEAST_EDGES}")
    mean = np.mean(answers, axis=0)
    top = float(np.mean(mean[-SETTLED:]))
    t_ms, shares = [round(float(v) * 1e3, 3) for v in t], [round(float(v / top), 4) for v in mean]
    count = abs(recording.scale(answered))
    scatter = float(np.sqrt(np.mean(np.var(answers, axis=0, ddof=1))))
    # error of a difference of two counted values (mean before a step, sample after it), and the scatter
    sigma = float(np.hypot(2 * counted_reach(scatter, count) / np.sqrt(12), scatter / np.sqrt(len(answers))))
    first = int(np.argmax(mean > max(LEAST_SHARE * top, 2 * sigma)))
    if mean[first] > (1 - LEAST_SHARE) * top:  # complete within a cycle: no fit is possible
        reached, cycle = float(t[first]), float(t[1] - t[0])
        return _StepResponse(1e6 * (reached - cycle / 2), 1e6 * cycle / 2, None, None, t_ms, shares)
    delay, tau, reach = _fitted(t[first:], mean[first:], top, sigma)
    return _StepResponse(1e6 * delay, 1e6 * float(reach[0]), 1e3 * tau, 1e3 * float(reach[1]), t_ms, shares)


def _fitted(t: Floats, y: Floats, top: float, sigma: float) -> tuple[float, float, Floats]:
    """Return delay and time constant of the responding samples, and half of their 95 % intervals [s]."""
    half = float(np.interp(0.63 * top, y, t))
    fit = least_squares(
        lambda p: (p[2] * (1 - np.exp(-(t - p[0] * half) / (p[1] * half))) - y) / top,
        (0.5 * t[0] / half, 0.5, top),
        x_scale=(1.0, 1.0, top),
    )
    covariance = (sigma / top) ** 2 * np.linalg.pinv(fit.jac.T @ fit.jac)
    reach = stdtrit(max(len(t) - 3, 1), 0.975) * np.sqrt(np.diag(covariance)[:2]) * half
    return float(fit.x[0] * half), float(fit.x[1] * half), reach


def _steps(recording: Recording, command_name: str, answered: str, size: float) -> tuple[Floats, list[Floats]]:
    """Return the times since the SYNC before a step was sent, and each step's response without its sign.

    Raises
    ------
    CommissionError
        the signals were not recorded
    """
    target, value = recording[command_name], recording[answered]
    if not (len(target) and len(value)):
        raise CommissionError(f"{answered}: nothing was recorded of it")
    sampled, sent = sync_before(recording, value.t_s), sync_before(recording, target.t_s)
    y, command = np.asarray(value.values, np.float64), np.asarray(target.values, np.float64)
    edges = 1 + np.flatnonzero(np.abs(np.diff(command)) > 0.5 * size)  # the ramp of the sign check has none
    begin_s = target.t_s[edges[0]] + SKIP_S if len(edges) else 0.0
    lags: list[Floats] = []
    answers: list[Floats] = []
    for edge, following in itertools.pairwise(edges):
        if target.t_s[edge] < begin_s or target.t_s[following] - target.t_s[edge] < 0.9 * HALF_S:
            continue
        level = command[max(edge - SETTLED, 0) : edge], command[edge : edge + AFTER // 2]
        if max(map(np.ptp, level)) > CLEAN_SHARE * size:  # a released brake falls in several steps
            continue
        first = int(np.searchsorted(sampled, sent[edge]))
        until_s = min(target.t_s[following], target.t_s[edge] + HALF_S)
        last = int(np.searchsorted(sampled, until_s)) - 1
        if first < SETTLED or last - first < AFTER:
            continue
        answer = y[first : first + AFTER] - np.mean(y[first - SETTLED : first])
        sign = np.sign(np.mean(answer[-SETTLED:]))
        if sign != 0.0:
            answers.append(sign * answer)
            lags.append(sampled[first : first + AFTER] - sent[edge])
    return (np.mean(lags, axis=0) if lags else np.zeros(0)), answers
