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
set-point, so there is no wind-up.

**Iron** (`coil_for`, `magnetise`). The iron between the coil's torque :math:`c` and the fluid
(`[brake.iron]`) is a sum of play operators,

.. math::

    M(c) = w_0 c + \sum_j w_j P_j, \quad P_j \leftarrow \max(c - r_j, \min(c + r_j, P_j)), \quad
    w_0 = 1 - \sum_j w_j.

For a given state of the operators, :math:`M` never falls with :math:`c`. So bisection with a fixed number
of halvings finds the coil's torque for a given :math:`M`, and :math:`c^*` becomes the coil's torque that
gives this torque at the fluid. Beyond the ends, 0 and the brake's limit, the inverse continues with slope 1.

No measurement enters: a wrong model makes the torque wrong, late or early by the difference, and never
unstable; the limits act after it.

Source: play operators and their inverse: K. Kuhnen, European Journal of Control 9(4), 2003,
doi:10.3166/ejc.9.407-418. The simulated iron of the plant (`sim_bus.rig.mr_brake`) is separate code.
"""

from __future__ import annotations

from coulombus.host.cycle.records import ControlRecord, HostRecord
from coulombus.kernels.decorator import kernel

__all__ = ["DEFAULT_LAG_S", "brake_level", "coil_for", "expect", "lead", "magnetise", "rise", "seen_by_fluid"]

FLUID_LEAD, COIL_LEAD = 3.0, 2.0
HALVINGS = 40
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
def seen_by_fluid(c: ControlRecord, h: HostRecord, coil_Nm: float) -> float:
    """Return the torque at the fluid [Nm] if the coil's torque went to `coil_Nm` now."""
    total: float = c.iron_direct * coil_Nm
    for j in range(c.iron_plays):
        r = c.iron_r[j]
        total += c.iron_w[j] * max(coil_Nm - r, min(coil_Nm + r, h.iron_y[j]))
    return total


@kernel
def coil_for(c: ControlRecord, h: HostRecord, wanted_Nm: float) -> float:
    """Return the coil's torque [Nm] that gives `wanted_Nm` at the fluid."""
    if c.iron_plays <= 0:
        return wanted_Nm
    low, high = 0.0, c.brake_limit_Nm
    smallest_Nm, largest_Nm = seen_by_fluid(c, h, low), seen_by_fluid(c, h, high)
    if wanted_Nm <= smallest_Nm:
        return wanted_Nm - smallest_Nm
    if wanted_Nm >= largest_Nm:
        beyond: float = high + wanted_Nm - largest_Nm
        return beyond
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        if seen_by_fluid(c, h, middle) < wanted_Nm:
            low = middle
        else:
            high = middle
    coil_Nm: float = high
    return coil_Nm


@kernel
def magnetise(c: ControlRecord, h: HostRecord, coil_Nm: float) -> float:
    """Step the play operators to the coil's torque `coil_Nm`; return the torque at the fluid [Nm]."""
    if c.iron_plays <= 0:
        return coil_Nm
    for j in range(c.iron_plays):
        r = c.iron_r[j]
        h.iron_y[j] = max(coil_Nm - r, min(coil_Nm + r, h.iron_y[j]))
    return max(seen_by_fluid(c, h, coil_Nm), 0.0)


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
