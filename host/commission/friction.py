r"""The device's own friction, by the motor alone: Coulomb, viscous, inertia, Coulomb by sectors of
the angle, and the motor's cogging.

While the handle slides, motor and hand bear the device's friction together:

.. math:: \tau_m + f = J\,\dot v + (c + b\,|v|)\,\mathrm{sgn}(v)

The motor sweeps to and fro at three speeds with the handle free. The belief in the friction has no
part in it: the exercise is in mode active, whose sign check may push with
``limits.sign_check_torque_Nm``, and compensates nothing. Samples of the sign check, of the gain's
ramp and of reversals are left out (`recording.friction.sliding`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np

from coulombus.host.commission.samples import thinned
from coulombus.host.commission.step import (
    TRAVEL_SHARE,
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
)
from coulombus.host.cycle.output_limits import HYBRID_MARGIN
from coulombus.recording.friction.cogging import Cogging, find_cogging
from coulombus.recording.friction.friction_fit import Estimate
from coulombus.recording.friction.identify import Identification, identify
from coulombus.recording.friction.sliding import Floats, IdentifyError, Sliding, equations, sliding
from coulombus.rigs.axis import Axis
from coulombus.rigs.rig import Rig

__all__ = ["FREE_HAND", "Friction", "sweep_exercise"]

FREE_HAND = (
    "operator.inertia_kg_m2=0.0",
    "operator.damping_Nms_rad=0.0",
    "operator.stiffness_Nm_rad=0.0",
    "operator.tremor_Nm=0.0",
)
"""The simulated hand lets go of the handle."""

HALF_TRAVEL_RAD = 0.6
SPEEDS_RAD_S, SPEED_SHARE = (0.4, 1.0, 2.0), 0.2
RESPONSE_S, INTEGRAL_S = 0.02, 0.05
"""Of the sweep's speed loop: time constant by the inertia that is believed, and of its integral."""
SECONDS = 21.0
SECTORS = 8
LEAST_SECTOR = 12
LEAST_CHANGE = 0.005
"""From this share on a figure counts as another one: the model is no better."""
UNEVEN = 0.1
"""From this share on the friction counts as different from sector to sector."""


def sweep_exercise(rig: Rig, name: str, hand: Sequence[str]) -> Exercise:
    """Return a run in which the motor sweeps the handle to and fro, within the sign check's
    torque.
    """
    axis = rig.one_axis()
    risk = sweep_risk(axis)
    gain = axis.mechanics.inertia_kg_m2 / RESPONSE_S
    user = (risk.motor_Nm, risk.travel_rad, gain, gain / INTEGRAL_S, *_speeds(axis))
    rest = f'{{kind="rest", duration_s={SECONDS}}}'
    return exercise(name, rig, "sweep", user, [rest], motor_Nm=risk.motor_Nm, hand=hand)


def sweep_risk(axis: Axis) -> Risk:
    """Return what the sweep moves at most."""
    half = min(HALF_TRAVEL_RAD, TRAVEL_SHARE * axis.limits.travel_limit_rad)
    torque = axis.limits.sign_check_torque_Nm
    if axis.mode.active is not None:
        torque = min(torque, axis.mode.active.motor_limit_Nm)
    return Risk(
        moves="The motor turns the handle to and fro.",
        motor_Nm=torque,
        speed_rad_s=max(_speeds(axis)),
        travel_rad=half,
        seconds=SECONDS,
    )


def _speeds(axis: Axis) -> tuple[float, ...]:
    scale = min(1.0, SPEED_SHARE * axis.limits.speed_rad_s / SPEEDS_RAD_S[-1])
    return tuple(speed * scale for speed in SPEEDS_RAD_S)


class Friction(Step):
    """Inherent friction, identified."""

    name = "friction"
    title = "inherent friction: Coulomb, viscous, by angle"

    def lacks(self, axis: Axis, given: Given) -> str | None:
        """Return what the rig has not."""
        lacks = lacks_roles(axis, "torque", "handle_torque")
        return lacks and f"{lacks}: motor and hand together tell the friction"

    def risk(self, axis: Axis, given: Given) -> Risk:
        """Return what the sweep moves."""
        return sweep_risk(axis)

    def exercises(self, rig: Rig, given: Given) -> tuple[Exercise, ...]:
        """Return the sweep with the handle free."""
        return (sweep_exercise(rig, self.name, FREE_HAND),)

    def analyse(self, runs: Sequence[ExerciseResult], axis: Axis, given: Given) -> Outcome:
        """Return friction, and the motor's limit that goes with it."""
        recording = runs[0].recording
        try:
            identification = identify(recording)
            slides = sliding(recording)
        except IdentifyError as error:
            raise CommissionError(
                f"{error}; is the handle free, and sign_check_torque_Nm more than its friction?"
            ) from error
        basis = f"{identification.samples} samples that slide, motor's sweep, coil off"
        coulomb, viscous = identification.device.coulomb_Nm, identification.device.viscous_Nms_rad
        cogging = find_cogging(slides, axis.mechanics.ratio)
        if cogging is not None:
            coulomb, viscous = cogging.coulomb_Nm, cogging.viscous_Nms_rad
        wave = None if cogging is None else cogging.wave(axis.mechanics.ratio)
        edges, sectors = _by_sector(slides, identification, viscous, wave)
        remarks: list[str] = []
        value = coulomb.value
        known = [Nm for Nm in sectors if math.isfinite(Nm)]
        if known and min(known) < (1 - UNEVEN) * value:
            remarks.append(
                f"the friction is uneven, {min(known):.4f} to {max(known):.4f} Nm by angle; the smallest is taken, "
                "so that the compensation nowhere pushes by itself"
            )
            value = min(known)
        if coulomb.high < 0:
            raise CommissionError(
                f"Coulomb friction {coulomb} Nm: what brakes seems to push; do the steps zero, weight and motor first"
            )
        friction = round(max(value, 0.0), 4)
        mechanics = axis.mechanics
        findings = [
            _finding("mechanics.friction_Nm", "Coulomb friction", mechanics.friction_Nm, friction, "Nm", coulomb, basis)
        ]
        if viscous is not None:
            slope = round(max(viscous.value, 0.0), 5)
            old = mechanics.viscous_Nms_rad
            findings.append(
                _finding("mechanics.viscous_Nms_rad", "viscous friction", old, slope, "Nm s/rad", viscous, basis)
            )
        inertia = identification.device.inertia_kg_m2
        if inertia is not None and inertia.value > 0:
            old, new = mechanics.inertia_kg_m2, float(f"{inertia.value:.3g}")
            findings.append(_finding("mechanics.inertia_kg_m2", "inertia", old, new, "kg m2", inertia, basis))
        findings += _limit(axis, friction)
        findings += _cogging(axis, cogging, basis)
        middles = 0.5 * (edges[:-1] + edges[1:])
        curves: tuple[Curve, ...] = (
            Curve(
                "Friction against speed",
                "speed [rad/s]",
                "motor + hand, inertia taken off [Nm]",
                {"samples": (*thinned(*_device(slides, identification)), "."), "fit": (*_line(identification), "-")},
            ),
            Curve(
                "Coulomb friction by angle",
                "angle [rad]",
                "[Nm]",
                {"sector": (middles.tolist(), [Nm if math.isfinite(Nm) else 0.0 for Nm in sectors], "o-")},
            ),
        )
        if cogging is not None:
            curves = (*curves, _cogging_curve(cogging, axis.mechanics.ratio))
        return Outcome(tuple(findings), (*remarks, *identification.remarks), curves)


def _finding(key: str, name: str, old: float, new: float, unit: str, estimate: Estimate, basis: str) -> Finding:
    reach = 0.5 * (estimate.high - estimate.low)
    return Finding(
        key, name, old, new, unit, reach, basis, changed=abs(new - old) > max(reach, LEAST_CHANGE * abs(new))
    )


def _limit(axis: Axis, friction_Nm: float) -> list[Finding]:
    """Return the limit of the motor in hybrid that lets the compensation through, and no more."""
    mode = axis.mode.hybrid
    limit = round(HYBRID_MARGIN * friction_Nm, 4)
    if mode is None or mode.motor_limit_Nm >= mode.compensation * friction_Nm:
        return []
    why = f"{HYBRID_MARGIN:g} x mechanics.friction_Nm, else the compensation would be cut off"
    return [
        Finding("mode.hybrid.motor_limit_Nm", "motor's limit in hybrid", mode.motor_limit_Nm, limit, "Nm", None, why)
    ]


def _cogging(axis: Axis, cogging: Cogging | None, basis: str) -> list[Finding]:
    """Return amplitude and periods; nothing where none stands out and none was believed."""
    mechanics = axis.mechanics
    if cogging is None and mechanics.cogging_Nm == 0:
        return []
    amplitude, periods, reach = 0.0, 0, None
    if cogging is not None:
        amplitude, periods, reach = round(cogging.amplitude_Nm, 5), cogging.periods, cogging.reach_Nm
    return [
        Finding(
            *("mechanics.cogging_Nm", "motor's cogging", mechanics.cogging_Nm, amplitude, "Nm", reach, basis),
            changed=abs(amplitude - mechanics.cogging_Nm) > max(reach or 0.0, LEAST_CHANGE * amplitude),
        ),
        Finding(
            *("mechanics.cogging_periods", "its periods a revolution", mechanics.cogging_periods, periods, "", None),
            basis,
            changed=periods != mechanics.cogging_periods,
        ),
    ]


def _cogging_curve(cogging: Cogging, ratio: float) -> Curve:
    """Return the cogging against the motor's angle, all revolutions one above the other."""
    turn = np.mod(cogging.x_rad * ratio, 2 * math.pi)
    angle = np.linspace(0, 2 * math.pi, 200)
    fit = cogging.wave(ratio)(angle / ratio)
    return Curve(
        "Cogging by the motor's angle",
        "motor's angle [rad]",
        "motor + hand, friction and inertia taken off [Nm]",
        {"samples": (*thinned(turn, cogging.torque_Nm), "."), "fit": (angle.tolist(), fit.tolist(), "-")},
    )


def _by_sector(
    slides: Sliding, identification: Identification, viscous: Estimate | None, wave: Callable[[Floats], Floats] | None
) -> tuple[Floats, list[float]]:
    """Return the edges of the angle's sectors, and the Coulomb friction in each; NaN where there
    are hardly any samples.

    `wave`: the cogging at an angle, which is taken off.
    """
    rows = equations(slides.slides, slides.period_s, slides.count_rad)
    x = rows.smooth([slide.x_rad - slide.x_rad[0] for slide in slides.slides])
    start = np.array([slide.x_rad[0] for slide in slides.slides])
    x = x / rows.weight.sum() + start[rows.slide]
    inertia = identification.device.inertia_kg_m2
    torque = rows.hand_Nm + rows.motor_Nm
    torque = (
        torque
        - (0.0 if viscous is None else viscous.value) * rows.v
        - (0.0 if inertia is None else inertia.value) * rows.a
    )
    if wave is not None:
        torque = torque - rows.smooth([wave(slide.x_rad) for slide in slides.slides])
    edges = np.linspace(x.min(), x.max(), SECTORS + 1)
    by_sector = []
    for k in range(SECTORS):
        inside = (x >= edges[k]) & (x <= edges[k + 1])
        ways = [torque[inside & (np.sign(rows.v) == sign)] * sign for sign in (1, -1)]
        enough = min(map(len, ways)) >= LEAST_SECTOR
        by_sector.append(float(np.mean([np.mean(way) for way in ways])) if enough else math.nan)
    return edges, by_sector


def _device(slides: Sliding, identification: Identification) -> tuple[Floats, Floats]:
    rows = equations(slides.slides, slides.period_s, slides.count_rad)
    inertia = identification.device.inertia_kg_m2
    return rows.v, rows.hand_Nm + rows.motor_Nm - (0.0 if inertia is None else inertia.value) * rows.a


def _line(identification: Identification) -> tuple[list[float], list[float]]:
    top = float(np.max(np.abs(identification.v_rad_s)))
    slope = 0.0 if identification.device.viscous_Nms_rad is None else identification.device.viscous_Nms_rad.value
    v = [-top, -1e-6, 1e-6, top]
    return v, [round(math.copysign(identification.device.coulomb_Nm.value, speed) + slope * speed, 6) for speed in v]
