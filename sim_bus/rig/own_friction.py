r"""The device's true own friction: Coulomb, Stribeck, LuGre, by angle, temperature and time.

`sim_bus.rig.elements` has the generalised Maxwell-slip and Leuven models.

Its level at the speed :math:`v`, the angle :math:`q` of its body, the device's temperature
:math:`T` and the time :math:`t` is

.. math::

    g = (F_c + \mu |\tau_m| + \Delta F\,e^{-|v/v_S|^\delta})\,(1 + a \sin(n q + \varphi))\,(1 + c\,(T - T_0))\,(1 + r t),

never below 0, at the begin of a step. :math:`\mu |\tau_m|` is the friction of a gear that carries the
motor's torque. As dry friction it is the level of a set-valued element.
Bristles (LuGre) instead have the deflection :math:`z` and give

.. math:: F = \sigma_0 z + \sigma_1 \dot z, \qquad \dot z = v - \alpha z, \quad \alpha = \sigma_0 |v| / g,

by the midpoint rule with :math:`\alpha` of the step's begin: linear in the mean speed, stable at
any stiffness and step, of first order. With :math:`r = \sigma_0 |v|` one division is enough:
:math:`z` after a step of :math:`h` is
:math:`((g - \tfrac{h}{2} r) z + h g u) / (g + \tfrac{h}{2} r)`.

LuGre's friction can generate energy if :math:`\sigma_1 |v| > 4 g` (the quadratic form
:math:`\sigma_0\alpha z^2 + \sigma_1\alpha z\dot z + \sigma_1\dot z^2` is then indefinite); the
plant uses :math:`\min(\sigma_1, 4 g/|v|)` and so never does. With :math:`\sigma_1 = 0` and no
Stribeck rise this is Dahl's friction.

Sources: H. Olsson and others, Friction Models and Friction Compensation, European Journal of
Control 4(3), 1998, doi:10.1016/S0947-3580(98)70113-X; C. Canudas de Wit and others, IEEE
Transactions on Automatic Control 40(3), 1995, doi:10.1109/9.376053.

In the kernels: `p` a record of `sim_bus.rig.records.PlantRecord`, `d` its `detail`, `i` a body.
"""

from __future__ import annotations

import math

from coulombus.kernels.decorator import kernel
from coulombus.sim_bus.rig.detail import DRY, ELEMENTS
from coulombus.sim_bus.rig.elements import elements_torque, set_elements
from coulombus.sim_bus.rig.records import BODIES, DetailRecord, PlantRecord, wave

__all__ = ["set_bristles", "set_levels"]

NOTHING = 40.0
"""Exponent from which exp(-x) is negligible compared with 1."""
LEAST_Nm = 1e-9
"""Level of bristles if the friction has vanished: they need a level above 0."""


@kernel
def set_levels(p: PlantRecord, capacity: float) -> None:
    """Set the present level of each body's dry friction, with the brake's `capacity` [Nm] on the drum, and the
    bristles' parameters.
    """
    d = p.detail
    scale = (1.0 + d.friction_K * (d.degC - d.reference)) * (1.0 + d.friction_s * (p.t_ns * 1e-9))
    for i in range(BODIES):
        if i >= d.count:
            continue
        speed = abs(d.v[i])
        friction = level = 0.0
        if d.share[i] > 0.0:
            at_speed = friction = p.coulomb + d.load_share * abs(p.f_motor)
            if p.stribeck > 0.0 and speed == 0.0:
                friction += p.stribeck
            elif p.stribeck > 0.0:
                part = speed / p.stribeck_v
                part = part * part if d.exponent == 2.0 else part**d.exponent
                if part < NOTHING:
                    friction += p.stribeck * math.exp(-part)
            level = friction
            if d.angle_share > 0.0:
                friction *= 1.0 + d.angle_share * wave(d.waves[i], d.angle_rad * d.q[i] + d.angle_phase)
            friction = max(friction * scale, 0.0) * d.share[i]
        if i == d.drum:
            p.inherent = friction
        d.dry[i] = capacity if i == d.drum else 0.0
        if d.bristles == ELEMENTS:
            if d.share[i] > 0.0:
                at_rest = friction * (at_speed + p.stribeck) / level
                set_elements(d, i, max(friction, LEAST_Nm), max(at_rest, LEAST_Nm))
            friction = 0.0
        elif d.bristles != DRY:
            g = max(friction, LEAST_Nm)
            d.bears[i], d.rate_Nm_s[i] = g, d.share[i] * d.sigma_0 * speed
            damping = d.share[i] * d.sigma_1
            d.bristle_damping[i] = damping if damping * speed <= 4.0 * g else 4.0 * g / speed
            friction = 0.0
        d.level[i] = friction + d.dry[i]


@kernel
def set_bristles(d: DetailRecord, i: int, h: float) -> None:
    """Set the behaviour of a body's bristles or elements over a step of `h`: their torque is held + given u
    [Nm].
    """
    if d.bristles == ELEMENTS:
        elements_torque(d, i, h)
        return
    g, damping, rate = d.bears[i], d.bristle_damping[i], d.rate_Nm_s[i]
    half = 0.5 * h * rate
    inverse = 1.0 / (g + half)
    stiffness = (d.share[i] * d.sigma_0 * g - damping * rate) * inverse
    d.held[i], d.given[i] = stiffness * d.z[i], 0.5 * h * stiffness + damping
    d.kept[i], d.taken[i] = (g - half) * inverse, h * g * inverse
