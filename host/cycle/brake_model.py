r"""Model of the brake's coil, iron and fluid, compiled: brake level, lead compensation, expected torque.

    c : the CONTROL record of an axis        h : its HOST record

**Level** (`brake_level`). The law gives the torque :math:`\lambda` at the hand. The device's own friction
:math:`c + b|v|` is part of it. In slip the motor compensates :math:`m` of that friction; in stick it
compensates nothing, because there is no direction of motion. So the brake must give

.. math:: \lambda_b = \max(\lambda - c - b|v| + m,\ 0).

**Lead** (`lead`). Coil and fluid are two lags in series, :math:`T_c \dot c = u - c` and
:math:`T_f \dot f = c - f`. `expect` steps a model of both, and the set-point is

.. math:: c^* = f + 3 (\lambda_b - f), \qquad u = c + 2 (c^* - c), \qquad 0 \le u \le u_{max},

with which the fluid's lag is effectively a third, and the coil's a half. The model gets the limited
set-point, so there is no wind-up. Iron with hysteresis between coil and fluid (`[brake.iron]`) is
inverted (`host.cycle.brake_hysteresis`): :math:`c^*` becomes the coil's torque that gives this torque
at the fluid. No measurement enters: a wrong model makes the brake late or early by the difference, and
never unstable.
"""

from __future__ import annotations

from coulombus.host.cycle.brake_hysteresis import coil_for, magnetise
from coulombus.host.cycle.records import ControlRecord, HostRecord
from coulombus.kernels.decorator import kernel

__all__ = ["DEFAULT_LAG_S", "brake_level", "expect", "lead", "rise"]

FLUID_LEAD, COIL_LEAD = 3.0, 2.0
DEFAULT_LAG_S = 0.02
"""Time constant of the brake's torque for a rig file without its lags: coil and fluid of a typical MR brake."""


@kernel
def brake_level(c: ControlRecord, h: HostRecord, level_Nm: float, motor_Nm: float) -> float:
    """Return the brake torque [Nm] with which the hand feels `level_Nm`, while the motor compensates
    `motor_Nm` of the device's own friction.
    """
    v = abs(h.slide_counts * c.rad_count) * 1e9 / c.period_ns
    bears_Nm: float = max(level_Nm - c.friction_Nm - c.viscous * v + motor_Nm, 0.0)
    return bears_Nm


@kernel
def lead(c: ControlRecord, h: HostRecord, level_Nm: float) -> float:
    """Return the set-point [Nm] that brings the brake's torque to `level_Nm` faster than its lags."""
    if c.coil_step <= 0.0 and c.fluid_step <= 0.0 and c.iron_plays <= 0:
        return level_Nm
    seen_Nm = level_Nm if c.fluid_step <= 0.0 else h.fluid_Nm + FLUID_LEAD * (level_Nm - h.fluid_Nm)
    coil_Nm = coil_for(c, h, seen_Nm)
    if c.coil_step > 0.0:
        coil_Nm = h.coil_Nm + COIL_LEAD * (coil_Nm - h.coil_Nm)
    setpoint_Nm: float = min(max(coil_Nm, 0.0), c.brake_limit_Nm)
    return setpoint_Nm


@kernel
def rise(c: ControlRecord, h: HostRecord, level_Nm: float) -> float:
    """Return the set-point [Nm], at least the level, with which the brake's torque rises to `level_Nm` as fast as it can.

    The lead has the same gain for a brake without lags in the rig file, which has the default lag.
    """
    if c.coil_step <= 0.0 and c.fluid_step <= 0.0:
        setpoint_Nm = h.brake_lagged_Nm + FLUID_LEAD * COIL_LEAD * (level_Nm - h.brake_lagged_Nm)
    else:
        setpoint_Nm = lead(c, h, level_Nm)
    return float(min(max(setpoint_Nm, level_Nm), c.brake_limit_Nm))


@kernel
def expect(c: ControlRecord, h: HostRecord) -> None:
    """Step the brake's expected torque by one cycle with the set-point that was sent.

    A set-point acts on the next SYNC. So the passivity observer gets the torque expected a cycle ago. For
    a brake without lags in the rig file it gets the present one: the default lag is too long already.
    """
    if c.coil_step <= 0.0 and c.fluid_step <= 0.0:
        seen_Nm = magnetise(c, h, h.brake_Nm)
        h.brake_lagged_Nm = seen_Nm + (h.brake_lagged_Nm - seen_Nm) * c.brake_lag_decay
        h.port_brake_Nm = h.brake_lagged_Nm
        return
    h.port_brake_Nm = h.brake_lagged_Nm
    before = h.iron_Nm
    h.coil_Nm = h.brake_Nm if c.coil_step <= 0.0 else h.coil_Nm + (h.brake_Nm - h.coil_Nm) * c.coil_step
    h.iron_Nm = magnetise(c, h, h.coil_Nm)
    mean = 0.5 * (before + h.iron_Nm)
    h.fluid_Nm = mean if c.fluid_step <= 0.0 else h.fluid_Nm + (mean - h.fluid_Nm) * c.fluid_step
    h.brake_lagged_Nm = h.fluid_Nm
