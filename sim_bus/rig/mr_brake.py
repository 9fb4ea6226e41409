r"""The MR brake in detail: iron with minor loops, a fluid with separate rise and fall rates, and heat.

The iron is a sum of play operators over the coil's present torque :math:`c` (the torque that
corresponds to its current; negative for a current of the opposite sign),

.. math::

    M = w_0 c + \sum_j w_j P_j, \quad P_j \leftarrow \max(c - r_j, \min(c + r_j, P_j)), \quad
    w_0 = 1 - \sum_j w_j,

and :math:`|M|` acts on the fluid. The iron is rate-independent, its minor loops close, and a larger
loop erases a smaller one (return-point memory). After a set-point :math:`C \ge 2 r_j` and back to
0, :math:`\sum_j w_j r_j` remains; a pulse of :math:`-r_j` removes the part of one operator.

The fluid follows :math:`|M|` with one lag when it rises and another when it falls, both divided by
:math:`1 + s |v|`: chains form and break sooner in a fluid that is sheared. Its torque and its
viscous friction fall with the temperature, :math:`1 - k (T - T_0)` (never below 0) and
:math:`e^{-k_v (T - T_0)}`. The device has one temperature, which all friction and the coil heat,
by Euler's rule: :math:`C \dot T = P - (T - T_{amb}) / R`.

Sources: play operators: M. Brokate and J. Sprekels, Hysteresis and Phase Transitions, 1996,
doi:10.1007/978-1-4612-4048-8; K. Kuhnen, European Journal of Control 9(4), 2003,
doi:10.3166/ejc.9.407-418.

In the kernels: `p` a record of `sim_bus.rig.records.PlantRecord`, `d` its `detail`.
"""

from __future__ import annotations

import math

from coulombus.kernels.decorator import kernel
from coulombus.sim_bus.rig.records import DetailRecord, PlantRecord

__all__ = ["brake_capacity", "heat", "iron", "thin"]

PADE = 0.01


@kernel
def iron(d: DetailRecord, coil: float) -> float:
    """Apply the coil's present torque [Nm] to the iron; return the torque that acts on the fluid [Nm]."""
    total = d.direct * coil
    for j in range(d.plays):
        r = d.play_r[j]
        d.play_y[j] = max(coil - r, min(coil + r, d.play_y[j]))
        total += d.play_w[j] * d.play_y[j]
    return float(abs(total))


@kernel
def brake_capacity(p: PlantRecord, magnetised: float) -> float:
    """Advance the fluid by one step towards the iron's torque [Nm]; return the brake's torque capacity [Nm]."""
    d = p.detail
    rate = d.rise if magnetised >= p.fluid else d.fall
    if rate < 0.0:
        p.fluid = magnetised
    else:
        if d.shear > 0.0:
            rate *= 1.0 + d.shear * abs(d.v[d.drum])
            # Pade's approximation has an error of rate^3/12, and needs no exponential
            decay = (2.0 - rate) / (2.0 + rate) if rate < PADE else math.exp(-rate)
        else:
            decay = d.rise_decay if magnetised >= p.fluid else d.fall_decay
        p.fluid = magnetised + (p.fluid - magnetised) * decay
    return float(p.brake_gain * p.fluid * d.weak + p.off_state + p.obstacle_Nm)


@kernel
def thin(d: DetailRecord) -> None:
    """Apply the device's temperature to the fluid: it changes little within a call of the bus."""
    warmer = d.degC - d.reference
    d.weak = max(1.0 - d.torque_K * warmer, 0.0)
    d.wet = d.fluid_viscous * math.exp(-d.viscous_K * warmer)


@kernel
def heat(p: PlantRecord, lost_W: float, current_A: float) -> None:
    """Heat the device for one step by the friction's loss [W], and by the coil."""
    d = p.detail
    gained = lost_W + d.coil_ohm * current_A * current_A
    d.degC += d.heat_1_JK * gained - d.cooling * (d.degC - p.ambient)
