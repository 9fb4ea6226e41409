r"""Model of the hysteresis of the brake's iron and its inverse, compiled.

The iron between the coil's torque :math:`c` and the fluid is a sum of play operators,

.. math::

    M(c) = w_0 c + \sum_j w_j P_j, \quad P_j \leftarrow \max(c - r_j, \min(c + r_j, P_j)), \quad
    w_0 = 1 - \sum_j w_j.

For a given state of the operators, :math:`M` never falls with :math:`c`. So bisection with a fixed number
of halvings finds the coil's torque for a given :math:`M`. Beyond the ends, 0 and the brake's limit, the
inverse continues with slope 1. No measurement enters: a wrong model makes the torque wrong by the
difference, and never unstable; the limits act after it.

Source: play operators and their inverse: K. Kuhnen, European Journal of Control 9(4), 2003,
doi:10.3166/ejc.9.407-418. The simulated iron of the plant (`sim_bus.rig.mr_brake`) is separate code.

    c : the CONTROL record of an axis        h : its HOST record
"""

from __future__ import annotations

from coulombus.host.cycle.records import ControlRecord, HostRecord
from coulombus.kernels.decorator import kernel

__all__ = ["coil_for", "magnetise", "seen_by_fluid"]

HALVINGS = 40


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
