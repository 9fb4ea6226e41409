"""What a law asks of motor and brake at most, held against what they can show: a law that a limit
cuts off is refused before it is armed.

Of the project's own laws the largest outputs follow from their parameters
(`host.laws.law.Declaration.extremes`). Those of a law of the user's own are not known before it runs; what is
cut off then is counted in every cycle (``clipped_torque``, ``clipped_setpoints``) and told at the
end of the run.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

from coulombus.host.laws.laws import BUILTIN_LAWS
from coulombus.host.laws.parameters import axis_parameters
from coulombus.rigs.axis import Axis
from coulombus.rigs.rig import Rig, RigError

__all__ = [
    "HYBRID_MARGIN",
    "brake_end_Nm",
    "brake_limit",
    "brake_limit_raw",
    "check_demand",
    "cut_off",
    "motor_limit",
    "motor_limit_Nm",
    "torque_step_Nm",
]


HYBRID_MARGIN = 1.2


class Demand(NamedTuple):
    """One extreme of a law: the key of the rig file that makes it, and its size [Nm]."""

    key: str
    torque_Nm: float


def brake_limit_raw(axis: Axis) -> int:
    """Return the largest set-point that the brake's object takes: the high limit of the EDS file,
    or what its data type holds.
    """
    one = axis.allocation.bound["brake_setpoint"]
    variable = axis.description(one.node).variable(one.entry.index, one.entry.subindex)
    assert variable.whole is not None  # the rig's reader takes integers of at most 32 bits alone
    most = int(variable.largest)
    least = variable.whole[0] if variable.low is None else int(variable.low)
    for raw, _ in one.table:
        if not least <= raw <= most:
            label = f"{one.entry.index:04X}h:{one.entry.subindex:02X}"
            raise axis.mistake("role.brake_setpoint.table", f"raw counts from {least} to {most}, which {label} takes")
    return most


def brake_end_Nm(axis: Axis) -> float:
    """Return the largest braking torque that the brake's object can say: that of its largest count,
    or of its table's last point.
    """
    one = axis.allocation.bound["brake_setpoint"]
    return one.table[-1][1] if one.table else float(brake_limit_raw(axis) * one.scale)


def _pushes(axis: Axis) -> bool:
    """Tell whether the axis' law is one of the project's own that pushes back in mode hybrid."""
    own = BUILTIN_LAWS.get(axis.law.function.strip())
    return own is not None and own.pushes


def motor_limit_Nm(axis: Axis, mode: str) -> float:
    """Return the largest motor torque at the handle [Nm] in a mode, which the drive's own limit
    6072h is set to.

    In `hybrid` the motor has friction to compensate and nothing else: at most 1.2 times the
    identified friction. Of a law that pushes, the rig file's limit is the limit.
    """
    limit = axis.mode[mode].motor_limit_Nm
    if mode != "hybrid" or _pushes(axis):
        return limit
    return min(limit, HYBRID_MARGIN * axis.mechanics.friction_Nm)


def motor_limit(axis: Axis, mode: str) -> tuple[float, str]:
    """Return the motor's largest torque in a mode [Nm], and whose limit that is."""
    limit = motor_limit_Nm(axis, mode)
    if limit < axis.mode[mode].motor_limit_Nm:
        return limit, f"the motor in mode {mode} (1.2 x mechanics.friction_Nm)"
    return limit, f"mode.{mode}.motor_limit_Nm (the drive's 6072h)"


def brake_limit(axis: Axis) -> tuple[float, str]:
    """Return the brake's largest torque [Nm], and whose limit that is."""
    one, device_Nm = axis.allocation.bound["brake_setpoint"], brake_end_Nm(axis)
    if device_Nm >= axis.limits.brake_torque_Nm:
        return axis.limits.brake_torque_Nm, "limits.brake_torque_Nm"
    if one.table:
        return device_Nm, "role.brake_setpoint.table"
    description = axis.description(one.node)
    line = description.variable(one.entry.index, one.entry.subindex).line
    return device_Nm, f"the brake's {one.entry.index:04X}h:{one.entry.subindex:02X} ({description.path}:{line})"


def torque_step_Nm(axis: Axis) -> float:
    """Return the motor's torque of one count of its set-point [Nm]."""
    return _scale(axis, "motor.target_torque_Nm")


def _motor(axis: Axis, mode: str) -> Iterator[RigError]:
    """Yield what the motor's limit cuts off: of the law in mode active, of the compensation in
    each.
    """
    chosen, scale = axis.mode[mode], torque_step_Nm(axis)
    compensation = chosen.compensation * axis.mechanics.friction_Nm
    wanted = [Demand(f"mode.{mode}.compensation", compensation)]
    if mode == "active":  # in slip the compensation takes its share off
        slip = f"mode.{mode}.F_d_Nm"
        wanted = [Demand(key, Nm - compensation if key == slip else Nm) for key, Nm in _law(axis, mode)] + wanted
    elif mode == "hybrid" and _pushes(axis):  # it pushes back while it compensates
        wanted = [Demand(key, Nm + compensation) for key, Nm in _law(axis, mode)] + wanted
    limit, whose = motor_limit(axis, mode)
    for key, torque_Nm in wanted:
        if torque_Nm > limit + scale:
            yield axis.mistake(key, _expected(limit, torque_Nm, whose))


def _brake(axis: Axis, mode: str) -> Iterator[RigError]:
    """Yield what the brake's limits cut off of the law in the modes in which the brake
    displays it.
    """
    if mode == "active":
        return
    scale, (limit, whose) = _scale(axis, "brake.setpoint_Nm"), brake_limit(axis)
    for key, torque_Nm in _law(axis, mode):
        if torque_Nm > limit + scale:
            yield axis.mistake(key, _expected(limit, torque_Nm, whose))


def _law(axis: Axis, mode: str) -> tuple[Demand, ...]:
    """Return what the rig's law displays at most in a mode; nothing where that is not known."""
    own = BUILTIN_LAWS.get(axis.law.function.strip())
    if own is None:
        return ()
    values, place = axis_parameters(axis, own), f"mode.{mode}" if own.uses_mode_keys else f"law.{own.name}"
    return tuple(Demand(f"{place}.{key}", getattr(values or axis.mode[mode], key)) for key in own.extremes)


def _expected(limit_Nm: float, torque_Nm: float, whose: str) -> str:
    return f"a torque of at most {limit_Nm:.6g} Nm, not {torque_Nm:.6g} Nm: {whose} ends there and would cut it off"


def _scale(axis: Axis, key: str) -> float:
    """Return the torque of one raw count of a signal [Nm]; less than that is rounding."""
    return next(abs(signal.scale) for pdo in axis.pdos() for signal in pdo.signals if signal.key == key)


def cut_off(rig: Rig, mode: str) -> list[str]:
    """Return what a limit of any axis would cut off of the law in this mode, each with
    ``file:line``, key and remedy.
    """
    found = (error for axis in rig.axes for part in (_motor, _brake) for error in part(axis, mode))
    return list(dict.fromkeys(text for error in found for text in error.errors))


def check_demand(rig: Rig, mode: str) -> None:
    """Refuse a law that a limit would cut off: what is felt would not be what the rig file says.

    Raises
    ------
    coulombus.rigs.rig.RigError
        with everything that would be cut off
    """
    found = cut_off(rig, mode)
    if found:
        raise RigError(found)
