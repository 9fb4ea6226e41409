r"""Delays: from the SYNC whose samples a set-point was computed from, to the torque that it makes.

Torque and brake are switched to and fro, below the friction, so that nothing moves. What the device
measures answers like :math:`y = 1 - e^{-(t - d)/\tau}`: motor's torque (6077h) and coil's current
are sampled at each SYNC, so :math:`\ln(1 - y)` over the SYNCs' times is a straight line that tells
delay d and time constant :math:`\tau`. With actuation on the next SYNC, d is one period.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import stdtrit

from coulombus.host.commission.friction import FREE_HAND
from coulombus.host.commission.samples import Floats, sync_before
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
)
from coulombus.recording.signals import Recording
from coulombus.rigs.axis import Axis
from coulombus.rigs.rig import Rig

__all__ = ["Delay"]

HALF_S, SECONDS, SKIP_S = 0.04, 5.0, 1.5
FRICTION_SHARE = 0.5
"""The motor stays so far below the friction: the handle does not move."""
BRAKE_NM = 1.0
SHARES = (0.03, 0.96)
"""Of the answer: what is below is noise, what is above quantisation."""
LEAST_EDGES = 10
SETTLED = 5
AFTER = 25


class _Answer(NamedTuple):
    """What the device answers to a step."""

    delay_us: float
    reach_us: float
    tau_ms: float | None
    """None: it answers within a cycle."""
    t_ms: list[float]
    y: list[float]


class Delay(Step):
    """Delay and time constant of motor and coil."""

    name = "delay"
    title = "delays: SYNC to torque and to coil current"

    def lacks(self, axis: Axis, given: Given) -> str | None:
        """Return what the rig has not."""
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

    def risk(self, axis: Axis, given: Given) -> Risk:
        """Return what is switched, and what the sign check before it may push with."""
        return Risk(
            "The motor's torque is switched to and fro, too little to move the handle; then the brake's.",
            motor_Nm=axis.limits.sign_check_torque_Nm if self._motor(axis) else 0.0,
            brake_Nm=self._brake(axis),
            seconds=SECONDS,
        )

    def exercises(self, rig: Rig, given: Given) -> tuple[Exercise, ...]:
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

    def analyse(self, runs: Sequence[ExerciseResult], axis: Axis, given: Given) -> Outcome:
        """Return delays and time constants; the rig file has no key for them."""
        rows = [
            ("motor's torque", "motor.target_torque_Nm", "motor.torque_Nm", bool(self._motor(axis))),
            ("coil's current", "brake.setpoint_Nm", "brake.coil_current_A", bool(self._brake(axis))),
        ]
        findings: list[Finding] = []
        lines: dict[str, tuple[Sequence[float], Sequence[float], str]] = {}
        for run, (name, command, answered) in zip(runs, (row[:3] for row in rows if row[3]), strict=True):
            answer = _answer(run.recording, command, answered)
            basis = f"steps of {command}, answered by {answered}, at each SYNC"
            tau = None if answer.tau_ms is None else round(answer.tau_ms, 3)
            findings += [
                Finding("", f"SYNC to {name}", None, round(answer.delay_us, 1), "us", answer.reach_us, basis),
                Finding("", f"time constant of the {name}", None, tau, "ms", None, basis),
            ]
            lines[name] = (answer.t_ms, answer.y, "o-")
        curve = Curve("Answer to a step", "time since the SYNC before it was sent [ms]", "share", lines)
        return Outcome(tuple(findings), curves=(curve,))


def _answer(recording: Recording, command_name: str, answered: str) -> _Answer:
    """Return the answer of `answered` to the steps of `command_name`.

    Raises
    ------
    CommissionError
        there are hardly any steps
    """
    target, value = recording[command_name], recording[answered]
    if not (len(target) and len(value)):
        raise CommissionError(f"{answered}: nothing was recorded of it")
    sampled, sent = sync_before(recording, value.t_s), sync_before(recording, target.t_s)
    y, command = np.asarray(value.values, np.float64), np.asarray(target.values, np.float64)
    size = 0.5 * (np.max(command) - np.min(command))
    edges = 1 + np.flatnonzero(np.abs(np.diff(command)) > size)
    begin_s = target.t_s[edges[0]] + SKIP_S if len(edges) else 0.0
    lags, delays, sizes = [], [], []
    shares: list[Floats] = []
    for edge, following in itertools.pairwise(edges):
        if target.t_s[edge] < begin_s or target.t_s[following] - target.t_s[edge] < 0.9 * HALF_S:
            continue
        first = int(np.searchsorted(sampled, sent[edge]))
        until_s = min(target.t_s[following], target.t_s[edge] + HALF_S)  # a brake that falls slowly has no edge down
        last = int(np.searchsorted(sampled, until_s)) - 1
        if first < SETTLED or last - first < AFTER:
            continue
        before, after = np.mean(y[first - SETTLED : first]), np.mean(y[last - SETTLED : last])
        if before != after:
            shares.append((y[first : first + AFTER] - before) / (after - before))
            lags.append(sampled[first : first + AFTER] - sent[edge])
            sizes.append(abs(after - before))
    if len(shares) < LEAST_EDGES:
        raise CommissionError(f"{answered}: {len(shares)} steps were answered; expected at least {LEAST_EDGES}")
    mean, at = np.mean(shares, axis=0), np.mean(lags, axis=0)
    rising = (mean > SHARES[0]) & (mean < SHARES[1])
    t_ms, y_mean = [round(float(v) * 1e3, 3) for v in at], [round(float(v), 4) for v in mean]
    if np.count_nonzero(rising) < 2:  # within a cycle: no line can be laid through it
        reached, cycle = float(at[int(np.argmax(mean > 0.5))]), float(at[1] - at[0])
        return _Answer(1e6 * reached, 1e6 * cycle, None, t_ms, y_mean)
    slope, offset = np.polyfit(at[rising], np.log(1 - mean[rising]), 1)
    # the scatter of the delay: of each step with the common time constant
    for lag, share in zip(lags, shares, strict=True):
        inside = rising & (share < 1.0)
        if np.any(inside):
            delays.append(float(np.mean(lag[inside] - np.log(1 - share[inside]) / slope)))
    reach = stdtrit(len(delays) - 1, 0.975) * np.std(delays, ddof=1) / np.sqrt(len(delays))
    rounding = abs(recording.scale(answered)) / float(np.mean(sizes)) / abs(slope)  # half a count at either end
    return _Answer(
        delay_us=float(-offset / slope * 1e6),
        reach_us=float(f"{max(reach, rounding) * 1e6:.2g}"),
        tau_ms=float(-1e3 / slope),
        t_ms=t_ms,
        y=y_mean,
    )
