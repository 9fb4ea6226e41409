r"""Step "friction": the device's own friction, identified by the motor alone.

The results are Coulomb friction, viscous friction, inertia, Coulomb friction by sectors of the angle, and
the motor's cogging.

While the handle slides, motor and hand bear the device's friction together:

.. math:: \tau_m + f = J\,\dot v + (c + b\,|v|)\,\mathrm{sgn}(v)

The motor sweeps to and fro at three speeds with the handle free. The rig file's friction has no influence:
the exercise is in mode active, whose sign check may push with ``limits.sign_check_torque_Nm``, and
compensates nothing. Samples of the sign check, of the gain's ramp and of reversals are left out
(`recording.friction.sliding`).

Significant waves over the angle (`recording.friction.angle_waves`) are part of the fit, and so is a delay of
the measured torque. Each interval is that of the fit (`recording.friction.regression`), combined with the
intervals of the motor's torque and of the angle from earlier steps (`host.commission.step`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from coulombus.host.commission.samples import thinned
from coulombus.host.commission.step import (
    ANGLE,
    HANDLE_TORQUE,
    INERTIA,
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
    rounded,
)
from coulombus.host.cycle.output_limits import HYBRID_MARGIN
from coulombus.recording.friction.angle_waves import ALL_KINDS, wave_columns
from coulombus.recording.friction.equations import Equations, equations
from coulombus.recording.friction.identify import Identification, identified
from coulombus.recording.friction.regression import Column, Estimate, regress, widened
from coulombus.recording.friction.sliding import Floats, IdentifyError, Sliding, sliding
from coulombus.rigs.axis import Axis
from coulombus.rigs.rig import Rig

__all__ = [
    "FREE_HAND",
    "REVERSAL_S",
    "SECONDS",
    "WINDOW_S",
    "FrictionStep",
    "reversal_rad",
    "sweep_exercise",
    "sweep_risk",
]

FREE_HAND = (
    "operator.inertia_kg_m2=0.0",
    "operator.damping_Nms_rad=0.0",
    "operator.stiffness_Nm_rad=0.0",
    "operator.tremor_Nm=0.0",
)
"""Settings of the simulation without a hand on the handle."""

HALF_TRAVEL_RAD = 0.6
SPEEDS_RAD_S, SPEED_SHARE = (0.4, 1.0, 2.0), 0.2
RESPONSE_S, INTEGRAL_S = 0.02, 0.05
"""Time constants of the sweep's speed loop (with the rig file's inertia), and of its integral."""
SECONDS = 21.0
WINDOW_S, REVERSAL_S = 0.031, 0.003
"""Window and reversal time of the regression, shorter than for the felt friction, because the motor's torque
is measured.
"""
REVERSAL_SHARE = 0.025
"""Share of the sweep's half travel after a reversal in which a bearing's bristles may bend."""
SAMPLED_SHARE = 0.02
"""Relative 95 % error of the cogging's amplitude: the motor's torque is known at the samples alone, and the
sweep's control changes it between them.
"""
SECTORS = 8
LEAST_SECTOR = 12
UNEVEN = 0.1
"""Relative difference above which the friction counts as uneven between sectors."""


def sweep_exercise(rig: Rig, name: str, hand: Sequence[str], phases: Sequence[str] = ()) -> Exercise:
    """Return a run in which the motor sweeps the handle to and fro, within the sign check's torque.

    `phases`: schedule of the hand, for `SECONDS`; empty: no hand
    """
    axis = rig.one_axis()
    risk = sweep_risk(axis)
    gain = axis.mechanics.inertia_kg_m2 / RESPONSE_S
    user = (risk.motor_Nm, risk.travel_rad, gain, gain / INTEGRAL_S, *_speeds(axis))
    rest = f'{{kind="rest", duration_s={SECONDS}}}'
    return exercise(name, rig, "sweep", user, phases or [rest], motor_Nm=risk.motor_Nm, hand=hand)


def sweep_risk(axis: Axis) -> Risk:
    """Return the limits of the sweep."""
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


def reversal_rad(axis: Axis) -> float:
    """Return the angle after a reversal that is left out."""
    return REVERSAL_SHARE * sweep_risk(axis).travel_rad


def _speeds(axis: Axis) -> tuple[float, ...]:
    scale = min(1.0, SPEED_SHARE * axis.limits.speed_rad_s / SPEEDS_RAD_S[-1])
    return tuple(speed * scale for speed in SPEEDS_RAD_S)


class FrictionStep(Step):
    """Inherent friction, identified."""

    name = "friction"
    title = "inherent friction: Coulomb, viscous, by angle"

    def lacks(self, axis: Axis, inputs: Given) -> str | None:
        """Return the role that the rig lacks, or None."""
        lacks = lacks_roles(axis, "torque", "handle_torque")
        return lacks and f"{lacks}: motor and hand together tell the friction"

    def risk(self, axis: Axis, inputs: Given) -> Risk:
        """Return the limits of the sweep."""
        return sweep_risk(axis)

    def exercises(self, rig: Rig, inputs: Given) -> tuple[Exercise, ...]:
        """Return the sweep with the handle free."""
        return (sweep_exercise(rig, self.name, FREE_HAND),)

    def analyse(self, runs: Sequence[ExerciseResult], axis: Axis, inputs: Given) -> Outcome:
        """Return the friction, and the motor's limit that follows from it."""
        recording, mechanics = runs[0].recording, axis.mechanics
        try:
            slides = sliding(recording, WINDOW_S, REVERSAL_S, reversal_rad(axis))
            count = abs(recording.scale("motor.torque_Nm")) if recording.has("motor.torque_Nm") else 0.0
            identification = identified(slides, recording.path, WINDOW_S, mechanics.ratio, count, ALL_KINDS)
        except IdentifyError as error:
            raise CommissionError(
                f"{error}; is the handle free, and sign_check_torque_Nm more than its friction?"
            ) from error
        basis = f"{identification.samples} samples that slide, motor's sweep, coil off"
        device, torque, angle = identification.device, inputs.share(HANDLE_TORQUE), inputs.share(*ANGLE)
        edges, sectors = _by_sector(slides, identification)
        coulomb, remarks = _written(widened(device.coulomb_Nm, torque), sectors, torque)
        remarks += inputs.exact(
            {"the motor's torque (step motor)": (HANDLE_TORQUE,), "the ratio (step encoder)": ANGLE}
        )
        rows = [("mechanics.friction_Nm", "Coulomb friction", mechanics.friction_Nm, "Nm", coulomb)]
        if device.viscous_Nms_rad is not None:
            viscous = widened(device.viscous_Nms_rad, torque, angle)
            rows.append(
                ("mechanics.viscous_Nms_rad", "viscous friction", mechanics.viscous_Nms_rad, "Nm s/rad", viscous)
            )
        if device.inertia_kg_m2 is not None and device.inertia_kg_m2.value > 0:
            inertia = widened(device.inertia_kg_m2, torque, angle)
            rows.append((INERTIA, "inertia", mechanics.inertia_kg_m2, "kg m2", inertia))
        findings = [_finding(key, name, old, unit, estimate, basis) for key, name, old, unit, estimate in rows]
        wave = _Wave.from_identification(identification, torque)
        findings += _limit(axis, findings[0].new)
        findings += _cogging(axis, wave, basis)
        middles = 0.5 * (edges[:-1] + edges[1:])
        rows_of, _, bare = _device(slides, identification)
        curves: tuple[Curve, ...] = (
            Curve(
                "Friction against speed",
                "speed [rad/s]",
                "motor + hand, inertia taken off [Nm]",
                {"samples": (*thinned(rows_of.v, bare), "."), "fit": (*_line(identification), "-")},
            ),
            Curve(
                "Coulomb friction by angle",
                "angle [rad]",
                "[Nm]",
                {"sector": (middles.tolist(), [0.0 if Nm is None else Nm.value for Nm in sectors], "o-")},
            ),
        )
        if wave is not None:
            curves = (*curves, _cogging_curve(slides, identification, wave, mechanics.ratio))
        return Outcome(tuple(findings), (*remarks, *identification.remarks), curves)


@dataclass(frozen=True)
class _Wave:
    """The cogging: its periods in a revolution, its amplitude, and the torque at an angle."""

    periods: int
    amplitude: Estimate
    at: Callable[[Floats], Floats]

    @classmethod
    def from_identification(cls, identification: Identification, torque_share: float) -> _Wave | None:
        """Return the cogging with the interval of its amplitude, by the delta method; None without cogging."""
        if identification.cogging is None:
            return None
        sine, cosine = (identification.device.others[f"cogging {name}"] for name in ("sine", "cosine"))
        size = math.hypot(sine.value, cosine.value)
        reach = math.hypot(sine.value * sine.reach, cosine.value * cosine.reach) / size
        amplitude = widened(Estimate(size, size - reach, size + reach), torque_share, SAMPLED_SHARE)
        return cls(identification.cogging.periods, amplitude, identification.cogging.wave(sine.value, cosine.value))


def _written(
    coulomb: Estimate, sectors: Sequence[Estimate | None], torque_share: float
) -> tuple[Estimate, tuple[str, ...]]:
    """Return the Coulomb friction to write, and a remark if it is that of a sector.

    Raises
    ------
    CommissionError
        the friction is negative
    """
    if coulomb.high < 0:
        raise CommissionError(
            f"Coulomb friction {coulomb} Nm: what brakes seems to push; do the steps zero, weight and motor first"
        )
    measured = [sector for sector in sectors if sector is not None]
    least = min(measured, key=lambda sector: sector.value, default=coulomb)
    if least.high >= (1 - UNEVEN) * coulomb.value:
        return coulomb, ()
    largest_Nm = max(sector.value for sector in measured)
    remark = (
        f"the friction is uneven, {least.value:.4f} to {largest_Nm:.4f} Nm by angle; the smallest is taken, "
        "so that the compensation nowhere pushes by itself"
    )
    return widened(least, torque_share), (remark,)


def _finding(key: str, name: str, old: float, unit: str, estimate: Estimate, basis: str) -> Finding:
    new = max(rounded(estimate.value, estimate.reach), 0.0)
    return Finding(key, name, old, new, unit, estimate.reach, basis, changed=abs(new - old) > estimate.reach)


def _limit(axis: Axis, friction_Nm: float) -> list[Finding]:
    """Return a new motor limit for hybrid, 1.2 times the friction, if the present one would clip the
    compensation.
    """
    mode = axis.mode.hybrid
    limit = round(HYBRID_MARGIN * friction_Nm, 4)
    if mode is None or mode.motor_limit_Nm >= mode.compensation * friction_Nm:
        return []
    why = f"{HYBRID_MARGIN:g} x mechanics.friction_Nm, else the compensation would be cut off"
    return [
        Finding("mode.hybrid.motor_limit_Nm", "motor's limit in hybrid", mode.motor_limit_Nm, limit, "Nm", None, why)
    ]


def _cogging(axis: Axis, wave: _Wave | None, basis: str) -> list[Finding]:
    """Return amplitude and periods; empty if no cogging is significant and the rig file has none."""
    mechanics = axis.mechanics
    if wave is None and mechanics.cogging_Nm == 0:
        return []
    amplitude, periods, reach = 0.0, 0, None
    if wave is not None:
        reach = wave.amplitude.reach
        amplitude, periods = rounded(wave.amplitude.value, reach), wave.periods
    return [
        Finding(
            *("mechanics.cogging_Nm", "motor's cogging", mechanics.cogging_Nm, amplitude, "Nm", reach, basis),
            changed=abs(amplitude - mechanics.cogging_Nm) > (reach or 0.0),
        ),
        Finding(
            *("mechanics.cogging_periods", "its periods a revolution", mechanics.cogging_periods, periods, "", None),
            basis,
            changed=periods != mechanics.cogging_periods,
        ),
    ]


def _cogging_curve(slides: Sliding, identification: Identification, wave: _Wave, ratio: float) -> Curve:
    """Return the curve of the cogging against the motor's angle, with all revolutions overlaid."""
    rows, x, torque = _device(slides, identification)
    device = identification.device
    viscous = 0.0 if device.viscous_Nms_rad is None else device.viscous_Nms_rad.value
    rest = torque - np.sign(rows.v) * device.coulomb_Nm.value - viscous * rows.v
    angle = np.linspace(0, 2 * math.pi, 200)
    fit = wave.at(angle / ratio)
    return Curve(
        "Cogging by the motor's angle",
        "motor's angle [rad]",
        "motor + hand, friction and inertia taken off [Nm]",
        {
            "samples": (*thinned(np.mod(x * ratio, 2 * math.pi), rest), "."),
            "fit": (angle.tolist(), fit.tolist(), "-"),
        },
    )


def _by_sector(slides: Sliding, identification: Identification) -> tuple[Floats, list[Estimate | None]]:
    """Return the edges of the angle's sectors, and the Coulomb friction in each from a common fit; None for a
    sector with too few samples.
    """
    rows, x, _ = _device(slides, identification)
    edges = np.linspace(x.min(), x.max(), SECTORS + 1)
    sense = np.sign(rows.v)
    sector = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, SECTORS - 1)
    names = [
        f"sector {k}" if min(np.sum((sector == k) & (sense == sign)) for sign in (1, -1)) >= LEAST_SECTOR else None
        for k in range(SECTORS)
    ]
    columns: dict[str, Column] = {
        name: (sense * (sector == k), 0.0) for k, name in enumerate(names) if name is not None
    }
    columns |= {
        "viscous": (rows.v, rows.v_variance),
        "inertia": (rows.a, rows.a_variance),
        "offset": (np.ones_like(x), 0.0),
    }
    columns |= wave_columns([wave for wave in identification.waves if wave.kind != "uneven"], rows, slides.slides)
    inside = np.isin(sector, [k for k, name in enumerate(names) if name is not None])
    some = {name: (values[inside], variance) for name, (values, variance) in columns.items()}
    try:
        fitted = regress(some, (rows.hand_Nm + rows.motor_Nm)[inside], rows.slide[inside])
    except IdentifyError:
        return edges, [None] * SECTORS
    return edges, [None if name is None else fitted[name] for name in names]


def _device(slides: Sliding, identification: Identification) -> tuple[Equations, Floats, Floats]:
    """Return the equations, the angle of each, and its torque without the inertia's part."""
    rows = equations(slides.slides, slides.period_s, slides.count_rad, WINDOW_S)
    used = [slide for slide in slides.slides if len(slide.t_s) >= len(rows.weight)]
    start = np.array([slide.x_rad[0] for slide in used])
    x = rows.smooth([slide.x_rad - slide.x_rad[0] for slide in used]) / rows.weight.sum() + start[rows.slide]
    inertia = identification.device.inertia_kg_m2
    return rows, x, rows.hand_Nm + rows.motor_Nm - (0.0 if inertia is None else inertia.value) * rows.a


def _line(identification: Identification) -> tuple[list[float], list[float]]:
    top = float(np.max(np.abs(identification.v_rad_s)))
    slope = 0.0 if identification.device.viscous_Nms_rad is None else identification.device.viscous_Nms_rad.value
    v = [-top, -1e-6, 1e-6, top]
    return v, [round(math.copysign(identification.device.coulomb_Nm.value, speed) + slope * speed, 6) for speed in v]
