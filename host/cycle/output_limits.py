"""The largest outputs of motor and brake, and the source of each limit: rig file, drive or brake's object."""

from __future__ import annotations

from coulombus.host.laws.laws import BUILTIN_LAWS
from coulombus.host.laws.plane.plane_laws import PLANE_LAWS
from coulombus.rigs.axis import Axis

__all__ = [
    "HYBRID_MARGIN",
    "brake_bears_motor",
    "brake_end_Nm",
    "brake_limit",
    "brake_limit_raw",
    "law_pushes",
    "motor_limit",
    "motor_limit_Nm",
    "scale_Nm",
    "torque_step_Nm",
]

HYBRID_MARGIN = 1.2


def brake_limit_raw(axis: Axis) -> int:
    """Return the largest set-point of the brake's object: the high limit of the EDS file, or the largest
    value of its data type.
    """
    setpoint = axis.allocation.bound["brake_setpoint"]
    entry = setpoint.entry
    variable = axis.description(setpoint.node).variable(entry.index, entry.subindex)
    assert variable.whole is not None  # the rig's reader accepts only integers of at most 32 bits
    highest = int(variable.largest)
    lowest = variable.whole[0] if variable.low is None else int(variable.low)
    for raw, _ in setpoint.table:
        if not lowest <= raw <= highest:
            label = f"{entry.index:04X}h:{entry.subindex:02X}"
            raise axis.mistake(
                "role.brake_setpoint.table", f"raw counts from {lowest} to {highest}, which {label} takes"
            )
    return highest


def brake_end_Nm(axis: Axis) -> float:
    """Return the largest braking torque that the brake's object can express [Nm]: at its largest count, or
    at its table's last point.
    """
    setpoint = axis.allocation.bound["brake_setpoint"]
    return setpoint.table[-1][1] if setpoint.table else float(brake_limit_raw(axis) * setpoint.scale)


def law_pushes(axis: Axis) -> bool:
    """Return whether the axis' law is a built-in law that pushes back in mode hybrid."""
    name = axis.law.function.strip()
    builtin = BUILTIN_LAWS.get(name) or PLANE_LAWS.get(name)
    return builtin is not None and builtin.pushes


def motor_limit_Nm(axis: Axis, mode: str) -> float:
    """Return the largest motor torque at the handle [Nm] in a mode; the drive's limit 6072h is set to it.

    In `hybrid` the motor only compensates friction, so the limit is at most 1.2 times the identified
    friction. For a law or a world that pushes, and for a joint in the plane, whose motor gives what the brakes
    cannot, the rig file's limit holds.
    """
    limit = axis.mode[mode].motor_limit_Nm
    if mode != "hybrid" or axis.joint or law_pushes(axis) or axis.world is not None:
        return limit
    return min(limit, HYBRID_MARGIN * axis.mechanics.friction_Nm)


def motor_limit(axis: Axis, mode: str) -> tuple[float, str]:
    """Return the motor's largest torque in a mode [Nm], and the source of this limit."""
    limit = motor_limit_Nm(axis, mode)
    if limit < axis.mode[mode].motor_limit_Nm:
        return limit, f"the motor in mode {mode} (1.2 x mechanics.friction_Nm)"
    return limit, f"mode.{mode}.motor_limit_Nm (the drive's 6072h)"


def brake_limit(axis: Axis) -> tuple[float, str]:
    """Return the brake's largest torque [Nm], and the source of this limit."""
    setpoint, device_Nm = axis.allocation.bound["brake_setpoint"], brake_end_Nm(axis)
    if device_Nm >= axis.limits.brake_torque_Nm:
        return axis.limits.brake_torque_Nm, "limits.brake_torque_Nm"
    if setpoint.table:
        return device_Nm, "role.brake_setpoint.table"
    description, entry = axis.description(setpoint.node), setpoint.entry
    line = description.variable(entry.index, entry.subindex).line
    return device_Nm, f"the brake's {entry.index:04X}h:{entry.subindex:02X} ({description.path}:{line})"


def brake_bears_motor(axis: Axis, mode: str) -> bool:
    """Return whether the brake can hold the largest torque that the motor displays in a mode."""
    return brake_limit(axis)[0] >= motor_limit_Nm(axis, mode)


def torque_step_Nm(axis: Axis) -> float:
    """Return the motor's torque of one count of its set-point [Nm]."""
    return scale_Nm(axis, "motor.target_torque_Nm")


def scale_Nm(axis: Axis, key: str) -> float:
    """Return the torque of one raw count of a signal [Nm]; smaller differences are rounding."""
    return next(abs(signal.scale) for pdo in axis.pdos() for signal in pdo.signals if signal.key == key)
