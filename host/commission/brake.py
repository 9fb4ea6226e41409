"""Step "brake": torque of the brake at each set-point, up and down a stair, in slip and at break-away.

A hand strokes the handle to and fro while the brake's set-point goes up and down a stair. In slip the hand
bears the brake's torque, the device's own friction and the inertia. The brake's torque is the difference to
the first stair, with the brake off. Up and down differ by the brake's hysteresis; the table has the mean of
both.

The interval of a point combines the scatter of its stairs' means over independent samples
(`host.commission.samples.independent`), that of the first stair, and the transducer's scale. Where up and
down differ by more than they scatter, it reaches to the farther of the two, so the interval holds both
branches. The table is given with the widest of these intervals.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from coulombus.host.commission.samples import Floats, handle_torque, held, independent, motion
from coulombus.host.commission.step import (
    SCALE,
    TABLE,
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
    rounded,
    strokes,
)
from coulombus.host.cycle.output_limits import brake_end_Nm
from coulombus.recording.signals import Recording
from coulombus.rigs.axis import Axis
from coulombus.rigs.rig import Rig

__all__ = ["BrakeStep"]

STROKING_HAND = (
    "operator.inertia_kg_m2=5e-4",
    "operator.stiffness_Nm_rad=40.0",
    "operator.damping_Nms_rad=1.0",
    "operator.tremor_Nm=0.0",
)
STEPS, STAIR_S, LEAD_S = 5, 2.4, 3.0
SPEED_RAD_S, MOVE_S, DWELL_S = 1.0, 1.0, 0.1
FOLLOWED_S = 0.4
"""Time after which coil and fluid have followed a new set-point."""
SLIP_SHARE = 0.5
"""Lowest speed that counts as slip, as a share of the typical stroke's."""
LEAST_SAMPLES = 40
SMOOTH = 15
TOP_SHARE = 0.95


@dataclass(frozen=True)
class _Stair:
    """Result of one stair."""

    raw: int
    up: bool
    slip_Nm: float
    """Mean of both directions."""
    reach_Nm: float
    """Half of its 95 % interval."""
    breakaway_Nm: float
    """Break-away torque; NaN if the handle never stuck."""


class BrakeStep(Step):
    """The brake's table."""

    name = "brake"
    title = "brake's torque at each set-point, up and down"

    def lacks(self, axis: Axis, inputs: Given) -> str | None:
        """Return the role that the rig lacks, or None."""
        return lacks_roles(axis, "handle_torque")

    def _top(self, axis: Axis) -> float:
        """Return the highest stair [Nm] that limits, coil and set-point permit continuously."""
        coil = (
            axis.brake.coil_continuous_A / axis.brake.coil_A_Nm
            if axis.brake.coil_A_Nm > 0
            else axis.limits.brake_torque_Nm
        )
        return round(TOP_SHARE * min(axis.limits.brake_torque_Nm, brake_end_Nm(axis), coil), 3)

    def risk(self, axis: Axis, inputs: Given) -> Risk:
        """Return the brake's torque and the operator's strokes."""
        return Risk(
            "The brake's torque climbs a stair and comes down again.",
            brake_Nm=self._top(axis),
            speed_rad_s=SPEED_RAD_S,
            travel_rad=SPEED_RAD_S * move_s(axis, SPEED_RAD_S, MOVE_S),
            seconds=LEAD_S + STAIR_S * (2 * STEPS + 1),
            operator=f"Stroke the handle to and fro without a stop, about {SPEED_RAD_S:g} rad/s, "
            f"{move_s(axis, SPEED_RAD_S, MOVE_S):g} s each way, "
            "and keep to it against the brake.",
        )

    def exercises(self, rig: Rig, inputs: Given) -> tuple[Exercise, ...]:
        """Return the run with the stair."""
        axis = rig.one_axis()
        length = self.risk(axis, inputs).seconds
        move = move_s(axis, SPEED_RAD_S, MOVE_S)
        stroke = strokes(length, SPEED_RAD_S, move, DWELL_S)
        return (exercise(self.name, rig, "stair", [self._top(axis), STEPS, STAIR_S], [stroke], hand=STROKING_HAND),)

    def analyse(self, runs: Sequence[ExerciseResult], axis: Axis, inputs: Given) -> Outcome:
        """Return the table, the hysteresis, and the ratio of break-away to slip torque."""
        stairs = _stairs(runs[0].recording, axis)
        zero = stairs[0].slip_Nm  # before the iron has a history
        table: list[list[float]] = [[stairs[0].raw, 0.0]]
        reaches = [0.0]
        for raw in sorted({stair.raw for stair in stairs} - {stairs[0].raw}, key=lambda raw: abs(raw - stairs[0].raw)):
            here = [stair for stair in stairs if stair.raw == raw]
            torque = float(np.mean([stair.slip_Nm for stair in here])) - zero
            of_mean = math.hypot(*(stair.reach_Nm for stair in here)) / len(here)
            reaches.append(math.hypot(of_mean, stairs[0].reach_Nm, torque * inputs.share(SCALE)))
            table.append([raw, rounded(torque, reaches[-1])])
        if len(table) < 3:
            raise CommissionError(
                f"the handle slid on {len(table)} stairs only: stroke it without a stop, harder where it binds"
            )
        if any(later[1] <= earlier[1] for earlier, later in itertools.pairwise(table)):
            text = ", ".join(f"{raw:g}: {Nm:.3f} Nm" for raw, Nm in table)
            raise CommissionError(
                f"the brake's torque does not grow with the set-point ({text}): is the coil connected?"
            )
        ups = {stair.raw: stair for stair in stairs if stair.up}
        downs = {stair.raw: stair for stair in stairs if not stair.up}
        gap_reach = math.sqrt(2) * max(stair.reach_Nm for stair in stairs)
        pairs = [(ups[raw], downs[raw]) for raw in ups.keys() & downs.keys()]
        gap = max((abs(up.slip_Nm - down.slip_Nm) for up, down in pairs), default=0.0)
        torques = {raw: zero + torque for raw, torque in table}
        branches = [
            abs(stair.slip_Nm - torques[stair.raw]) + stair.reach_Nm
            for up, down in pairs
            if abs(up.slip_Nm - down.slip_Nm) > math.hypot(up.reach_Nm, down.reach_Nm)
            for stair in (up, down)
        ]
        reach = max(*reaches, *branches)
        remarks = inputs.exact({"the transducer's scale (step weight)": (SCALE,)})
        if branches:
            remarks = (
                *remarks,
                f"up and down differ by up to {gap:.3g} Nm, as iron or fluid remembers: the table's interval holds both "
                "branches; coulombus identify --iron fits the iron",
            )
        lets = [
            stair.breakaway_Nm / stair.slip_Nm
            for stair in stairs
            if stair.breakaway_Nm == stair.breakaway_Nm and stair.raw != stairs[0].raw
        ]
        setpoint = axis.allocation.bound["brake_setpoint"]
        believed = [_believed(axis, raw) for raw, _ in table]
        other = any(abs(was - Nm) > wide for was, (_, Nm), wide in zip(believed, table, reaches, strict=True))
        basis = f"{len(stairs)} stairs, slip both ways, up and down"
        old = [list(point) for point in setpoint.table] or None
        findings = (
            Finding(TABLE, "brake's table", old, table, "[raw, Nm]", reach, basis, changed=other),
            Finding("", "brake's hysteresis, up against down", None, round(gap, 4), "Nm", gap_reach, basis),
            Finding(
                "", "break-away against slip", None, round(float(np.mean(lets)), 3) if lets else None, "", None, basis
            ),
            Finding(
                "", "inherent friction in the stroke, coil off", None, round(zero, 4), "Nm", stairs[0].reach_Nm, basis
            ),
        )
        lines = {
            "up": (
                [float(stair.raw) for stair in stairs if stair.up],
                [stair.slip_Nm - zero for stair in stairs if stair.up],
                "o-",
            ),
            "down": (
                [float(stair.raw) for stair in stairs if not stair.up],
                [stair.slip_Nm - zero for stair in stairs if not stair.up],
                "s--",
            ),
            "believed": ([float(raw) for raw, _ in table], believed, ":"),
        }
        return Outcome(findings, remarks, (Curve("Brake's torque", "set-point [counts]", "[Nm]", lines),))


def _believed(axis: Axis, raw: float) -> float:
    """Return the torque of a set-point according to the rig file [Nm]."""
    setpoint = axis.allocation.bound["brake_setpoint"]
    if not setpoint.table:
        return float(raw * abs(setpoint.scale))
    points = sorted(setpoint.table)
    return float(np.interp(raw, [at for at, _ in points], [Nm for _, Nm in points]))


def _stairs(recording: Recording, axis: Axis) -> list[_Stair]:
    """Return the results of the stairs on which the handle slid both ways, in their order.

    Raises
    ------
    CommissionError
        the first stair, with the brake off, is not among them
    """
    angle, hand = recording["motor.position_rad"], handle_torque(recording)
    signal = recording.signal("brake.setpoint_Nm")
    t, period = angle.t_s, recording.rig.bus.period_s
    raw = np.rint((held(recording["brake.setpoint_Nm"], t) - signal.offset) / signal.scale).astype(int)
    v, a = motion(angle, period, SMOOTH)
    torque = np.interp(t, hand.t_s, hand.values) - axis.mechanics.inertia_kg_m2 * a
    sent = recording["brake.setpoint_Nm"].t_s
    begin = float(sent[0]) if len(sent) else 0.0
    edges = [int(np.searchsorted(t, begin)), *(np.flatnonzero(np.diff(raw)) + 1).tolist(), len(t)]
    typical = np.median(np.abs(v[np.abs(v) > 0.1 * SPEED_RAD_S])) if np.any(np.abs(v) > 0.1 * SPEED_RAD_S) else np.inf
    stairs: list[_Stair] = []
    top = False
    for first, end in itertools.pairwise(edges):
        if t[end - 1] - t[first] < 0.75 * STAIR_S:  # the end of the run ramps the brake off
            continue
        inside = slice(first + round(FOLLOWED_S / period), end)
        stair = _stair(int(raw[first]), not top, v[inside], torque[inside], SLIP_SHARE * float(typical))
        top = top or abs(int(raw[first])) == int(np.max(np.abs(raw)))
        if stair is not None:
            stairs.append(stair)
        elif not stairs:
            raise CommissionError("the handle did not slide both ways with the brake off: stroke it to and fro")
    if not stairs:
        raise CommissionError("the run ended before the first stair; do the step again")
    return stairs


def _stair(raw: int, up: bool, v: Floats, torque: Floats, slip: float) -> _Stair | None:
    """Return the result of one stair; None if the handle did not slide both ways."""
    ways = [torque[np.sign(v) * (np.abs(v) > slip) == sign] * sign for sign in (1, -1)]
    if min(map(len, ways)) < LEAST_SAMPLES:
        return None
    stuck = np.abs(v) < 0.02 * slip
    lets = np.flatnonzero(stuck[:-1] & ~stuck[1:])
    # at break-away the hand's torque is largest
    peaks = [float(np.max(np.abs(torque[max(at - 10, 0) : at + 10]))) for at in lets]
    return _Stair(
        raw=raw,
        up=up,
        slip_Nm=float(np.mean([np.mean(way) for way in ways])),
        reach_Nm=0.5 * math.hypot(*(1.96 * float(np.std(way)) / math.sqrt(independent(way)) for way in ways)),
        breakaway_Nm=float(np.median(peaks)) if peaks else float("nan"),
    )
