"""Effects of a rig file's limits on the handle, and limits without effect, for `check`."""

from __future__ import annotations

from collections.abc import Iterator

from coulombus.host.cycle.output_limits import brake_limit, motor_limit_Nm
from coulombus.rigs.axis import Axis

__all__ = ["meanings_of"]

NO_EFFECT = "it never acts"


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
