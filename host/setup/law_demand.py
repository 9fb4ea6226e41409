"""Limits of motor and brake against the law's peak output; a law that a limit would clip is refused.

The peak outputs of built-in laws follow from their parameters (`host.laws.law.Declaration.extremes`).
Those of a user's law are unknown before it runs. Clipping is then counted in every cycle
(``clipped_torque``, ``clipped_setpoints``) and reported at the end of the run.

`meanings_of` has the limits' effects on the handle, and limits without effect, for `check`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from coulombus.host.cycle.output_limits import (
    brake_limit,
    law_pushes,
    motor_limit,
    motor_limit_Nm,
    scale_Nm,
    torque_step_Nm,
)
from coulombus.host.laws.laws import BUILTIN_LAWS
from coulombus.host.laws.parameters import axis_parameters
from coulombus.host.plane.plane_host import load_plane
from coulombus.rigs.axis import Axis
from coulombus.rigs.kinematics.pose_kernels import condition
from coulombus.rigs.rig import Rig, RigError

__all__ = ["check_demand", "cut_off", "law_extremes", "meanings_of", "remarks"]

NO_EFFECT = "it never acts"


class Demand(NamedTuple):
    """A peak output of a law: the rig file's key that sets it, and its torque [Nm]."""

    key: str
    torque_Nm: float


def _motor(axis: Axis, mode: str) -> Iterator[RigError]:
    """Yield an error for each demand above the motor's limit: the law's, and the compensation's."""
    mode_keys, scale = axis.mode[mode], torque_step_Nm(axis)
    compensation = mode_keys.compensation * axis.mechanics.friction_Nm
    demands = [Demand(f"mode.{mode}.compensation", compensation)]
    if mode == "active":  # in slip the compensation is subtracted
        slip = f"mode.{mode}.F_d_Nm"
        demands = [Demand(key, Nm - compensation if key == slip else Nm) for key, Nm in _law(axis, mode)] + demands
    elif mode == "hybrid" and law_pushes(axis):  # push and compensation add up
        demands = [Demand(key, Nm + compensation) for key, Nm in _law(axis, mode)] + demands
    limit, whose = motor_limit(axis, mode)
    for key, torque_Nm in demands:
        if torque_Nm > limit + scale:
            yield axis.mistake(key, _expected(limit, torque_Nm, whose, key))


def _brake(axis: Axis, mode: str) -> Iterator[RigError]:
    """Yield an error for each demand of the law above the brake's limit, in modes in which the brake
    displays it.
    """
    if mode == "active":
        return
    scale, (limit, whose) = scale_Nm(axis, "brake.setpoint_Nm"), brake_limit(axis)
    for key, torque_Nm in _law(axis, mode):
        if torque_Nm > limit + scale:
            yield axis.mistake(key, _expected(limit, torque_Nm, whose, key))


def _tip(rig: Rig, mode: str) -> Iterator[RigError]:
    r"""Yield an error if a joint cannot bear the law's largest force at the arm's start, or the start is too near to
    a singular pose.

    A joint's torque is at most :math:`F |J_i|`. The brakes bear it, and in mode active the motors do.
    """
    model, kinematics = load_plane(rig, mode), rig.kinematics
    assert model is not None
    assert kinematics is not None
    pose = model.mechanism.pose(*kinematics.start_rad)
    condition_number = condition(pose)
    if not condition_number >= kinematics.least_condition:
        where, names = rig.origin.source().where(("kinematics", "start_rad"))[1], "kinematics.start_rad"
        yield RigError(
            [
                f"{where}: {names}: the Jacobian's condition is {condition_number:.2g} there, "
                f"and kinematics.least_condition is {kinematics.least_condition:g}: the arm would not be armed"
            ]
        )
        return
    law = model.law
    for name in () if law.declaration is None else law.declaration.extremes:
        force_N = float(getattr(law.parameters, name))
        for i, axis in enumerate(rig.axes):
            length_m = math.hypot(*(float(row[i]) for row in pose["jacobian"]))
            limit_Nm, whose = motor_limit(axis, mode) if mode == "active" else brake_limit(axis)
            limit_Nm += axis.mechanics.friction_Nm
            if force_N * length_m > limit_Nm:
                yield rig.axes[0].mistake(
                    f"law.{law.name}.{name}",
                    f"at most {limit_Nm / length_m:.4g} N at the start: {whose} of {axis.name} ends there",
                )


def _law(axis: Axis, mode: str) -> tuple[Demand, ...]:
    """Return the peak outputs of the rig's law in a mode; empty if they are unknown."""
    builtin = BUILTIN_LAWS.get(axis.law.function.strip())
    if builtin is None:
        return ()
    parameters = axis_parameters(axis, builtin)
    section, table = (axis.mode[mode], f"mode.{mode}") if parameters is None else (parameters, f"law.{builtin.name}")
    return tuple(Demand(f"{table}.{key}", getattr(section, key)) for key in builtin.extremes)


def law_extremes(axis: Axis, mode: str) -> list[float]:
    """Return the peak outputs of the rig's law in a mode [Nm]; empty if they are unknown."""
    return [demand.torque_Nm for demand in _law(axis, mode)]


def _expected(limit_Nm: float, torque_Nm: float, whose: str, key: str) -> str:
    cut = f"{whose} ends there and would cut it off; raise that limit, or lower {key}"
    return f"a torque of at most {limit_Nm:.6g} Nm, not {torque_Nm:.6g} Nm: {cut}"


def cut_off(rig: Rig, mode: str) -> list[str]:
    """Return the texts of all demands that a limit of an axis would clip in this mode, each with
    ``file:line``, key and remedy.
    """
    if rig.kinematics is not None:
        return _texts(_tip(rig, mode))
    return _texts(error for axis in rig.axes for part in (_motor, _brake) for error in part(axis, mode))


def remarks(rig: Rig) -> list[str]:
    """Return warnings for valid but unlikely values, with ``file:line``: a friction that grows in slip."""
    errors = []
    for axis in rig.axes:
        for mode in axis.mode:
            displayed = {demand.key: demand.torque_Nm for demand in _law(axis, mode)}
            static, dynamic = f"mode.{mode}.F_s_Nm", f"mode.{mode}.F_d_Nm"
            if {static, dynamic} <= displayed.keys() and displayed[dynamic] > displayed[static]:
                expected = f"at most F_s_Nm ({displayed[static]:g}): this friction grows when it slips"
                errors.append(axis.mistake(dynamic, expected))
    return _texts(errors)


def _texts(errors: Iterable[RigError]) -> list[str]:
    """Return the errors' texts without duplicates."""
    return list(dict.fromkeys(text for error in errors for text in error.errors))


def check_demand(rig: Rig, mode: str) -> None:
    """Refuse a law that a limit would clip: the display would differ from the rig file.

    Raises
    ------
    coulombus.rigs.rig.RigError
        the text names every clipped demand
    """
    texts = cut_off(rig, mode)
    if texts:
        raise RigError(texts)


def meanings_of(axis: Axis, mode: str) -> Iterator[str]:
    """Yield a sentence for each limit of motor and brake in this mode."""
    limits, period_s = axis.limits, axis.bus.period_s
    motor_Nm, brake_Nm = motor_limit_Nm(axis, mode), brake_limit(axis)[0]
    if motor_Nm > 0.0:
        rate = limits.torque_rate_Nm_s
        yield axis.spell_keys(
            f"limits.torque_rate_Nm_s: mode {mode} reverses {motor_Nm:g} Nm in {2 * motor_Nm / rate * 1e3:.3g} ms"
            + (f": {NO_EFFECT}, a cycle is {period_s * 1e3:g} ms" if 2 * motor_Nm <= rate * period_s else "")
        )
        step_rad_s = motor_Nm / axis.mechanics.inertia_kg_m2 * period_s
        yield axis.spell_keys(
            f"mode.{mode}.motor_limit_Nm: it moves a free handle by {step_rad_s:.2g} rad/s in a cycle"
        )
    if limits.safe_brake_Nm is not None:
        yield axis.spell_keys("limits.safe_brake_Nm: it is of version 0.2 and without effect; delete it")
    if mode != "active" and brake_Nm > 0.0:
        fall = limits.brake_fall
        yield axis.spell_keys(
            f"limits.brake_fall_Nm_s: the law lets {brake_Nm:g} Nm go in {brake_Nm / fall * 1e3:.3g} ms"
            + (f": {NO_EFFECT}, a cycle is {period_s * 1e3:g} ms" if brake_Nm <= fall * period_s else "")
        )
