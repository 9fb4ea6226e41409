r"""The device's own friction as parallel springs: generalised Maxwell-slip and Leuven models.

Each spring slips at its own torque.

Element :math:`j` bears :math:`F_j`, has the stiffness :math:`k_j` and the share :math:`w_j`. Its
end moves by :math:`z`; it winds, :math:`\dot F_j = k_j \dot z`, up to its level. With the level
:math:`g` of `sim_bus.rig.own_friction`

.. math::

    \text{gms:}\quad & z = q, \quad F = \sum F_j, \quad \text{at } w_j g \text{ it slips until the motion
    turns or stops:}\ \dot F_j = \mathrm{sgn}(v)\,C\,(w_j - |F_j|/g) \\
    \text{leuven:}\quad & \dot z = v - \frac{|v|}{g} \sum F_j, \quad F = \sum F_j + \sigma_1 \dot z,
    \quad \text{level } w_j F_s,\ F_s = g \text{ at rest}

A step is the midpoint rule in :math:`z` with :math:`g` and :math:`|v|` of its begin, linear in the
mean speed :math:`u`. The speed at its begin predicts which elements wind, slip or begin to slip,
and a step ends where that speed changes its sign. If z moves in the other direction nevertheless,
all elements of the body wind in that step. So the method is of first order, and stable at any
stiffness.

No element returns more energy than it has received: the energy :math:`F_j^2 / 2 k_j` after a step
is at most the energy before it plus the element's work in between. Both published laws can generate
energy: a slipping element of the generalised Maxwell-slip friction that follows a rising :math:`g`
faster than the motion winds it, and Leuven's if :math:`\sigma_1 |v| > 4 g`. The plant lets the
element wind only as far as the motion does, and uses :math:`\min(\sigma_1, 4 g / |v|)`.

Sources: F. Al-Bender, V. Lampaert, J. Swevers, IEEE Transactions on Automatic Control 50(11), 2005,
doi:10.1109/TAC.2005.858676; V. Lampaert, J. Swevers, F. Al-Bender, IEEE Transactions on Automatic
Control 47(4), 2002, doi:10.1109/9.995050.

In the kernels: `d` a record of `sim_bus.rig.records.DetailRecord`, `i` a body, `j` an element.
"""

from __future__ import annotations

import math

from coulombus.kernels.decorator import inlined, kernel
from coulombus.sim_bus.rig.records import DetailRecord

__all__ = ["elements_torque", "foretold", "set_elements", "stored_in_elements", "wind"]

WINDS = math.inf


@kernel
def set_elements(d: DetailRecord, i: int, g: float, at_rest: float) -> None:
    """Set the behaviour of a body's elements in the step that begins, by the level [Nm] at the present
    speed, `g`, and at rest, `at_rest`.
    """
    speed = abs(d.v[i])
    d.winds[i] = 0
    if d.slip_rate > 0.0:
        d.alpha[i] = 0.0
        d.bears[i] = g
        d.follows[i] = d.share[i] * d.slip_rate / g
        return
    d.alpha[i] = speed / g
    d.bears[i] = at_rest
    d.follows[i] = 0.0
    damping = d.share[i] * d.sigma_1
    d.bristle_damping[i] = damping if damping * speed <= 4.0 * g else 4.0 * g / speed


@inlined
def _way(d: DetailRecord, i: int, h: float) -> float:
    """Return the distance of z in a step of `h` at the speed of its begin, as if all elements wound; 0 if it
    cannot be predicted.
    """
    if d.winds[i] != 0:
        return 0.0
    if d.alpha[i] == 0.0:
        return float(h * d.v[i])
    bears = stiffness = 0.0
    for j in range(d.elements):
        bears += d.element_Nm[i, j]
        stiffness += d.element_k[j]
    return float(h * (d.v[i] - d.alpha[i] * bears) / (1.0 + 0.5 * h * d.alpha[i] * d.share[i] * stiffness))


@inlined
def _element(d: DetailRecord, i: int, j: int, h: float, way: float) -> tuple[float, float, float]:
    """Return the mean torque of an element in a step as (constant, per rad of z), and its torque after the
    step, or `WINDS`; `way` is the predicted distance of z.
    """
    force, level = d.element_Nm[i, j], d.element_w[j] * d.bears[i]
    stiffness = d.share[i] * d.element_k[j]
    if way != 0.0:
        sense = 1.0 if way > 0.0 else -1.0
        room = level - sense * force
        if d.element_slips[i, j] * sense > 0.0 or room <= 0.0:
            follows = h * d.follows[i]
            end = (force + follows * sense * level) / (1.0 + follows) if follows > 0.0 else sense * level
            return 0.5 * (force + end), 0.0, end
        if stiffness * abs(way) >= room:  # it winds for a part of the step
            part = room / (stiffness * abs(way))
            return sense * (1.0 - part) * level + part * force, 0.5 * stiffness * part * part, sense * level
    return force, 0.5 * stiffness, WINDS


@kernel
def elements_torque(d: DetailRecord, i: int, h: float) -> None:
    """Set the torque of the elements over a step of `h`: held + given u [Nm]; and the data of the step for
    `foretold` and `wind`.
    """
    way = _way(d, i, h)
    constant = slope = 0.0
    for j in range(d.elements):
        term, rises, _ = _element(d, i, j, h, way)
        constant += term
        slope += rises
    d.way[i], d.borne[i], d.rises[i] = way, constant, slope
    damping = d.bristle_damping[i] if d.slip_rate == 0.0 else 0.0
    each = (h * slope + damping) / (1.0 + h * d.alpha[i] * slope)
    d.held[i], d.given[i] = constant - each * d.alpha[i] * constant, each


@kernel
def foretold(d: DetailRecord) -> bool:
    """Tell whether z moves as predicted in the tried step; otherwise all elements of that body wind from now
    on, which is correct in either direction.
    """
    right = True
    for i in range(d.count):
        if d.share[i] > 0.0 and d.winds[i] == 0 and d.way[i] * (d.u[i] - d.alpha[i] * d.borne[i]) < 0.0:
            d.winds[i] = 1
            right = False
    return right


@kernel
def wind(d: DetailRecord, i: int, h: float, u: float) -> float:
    """Apply the step of `h` that was tried last, with the mean speed `u`; return the increase of the elements'
    energy [J].
    """
    way = d.way[i]
    z = h * (u - d.alpha[i] * d.borne[i]) / (1.0 + h * d.alpha[i] * d.rises[i])
    sense = -1.0 if z < 0.0 else 1.0
    stored = 0.0
    for j in range(d.elements):
        mean, rises, end = _element(d, i, j, h, way)
        force, stiffness = d.element_Nm[i, j], d.share[i] * d.element_k[j]
        slips = 0.0
        if end == WINDS:
            end = force + stiffness * z
            bound = max(d.element_w[j] * d.bears[i], sense * force)
            if sense * end > bound:
                end, slips = sense * bound, sense
        else:
            slips = -1.0 if way < 0.0 else 1.0
        bound = max(force * force + 2.0 * stiffness * (mean + rises * z) * z, 0.0)
        if end * end > bound:
            end = math.copysign(math.sqrt(bound), end)
        stored += (end * end - force * force) / (2.0 * stiffness)
        d.element_Nm[i, j], d.element_slips[i, j] = end, slips
    return stored


@kernel
def stored_in_elements(d: DetailRecord, i: int) -> float:
    """Return the energy in the elements of a body [J]."""
    stored = 0.0
    if d.share[i] > 0.0:
        for j in range(d.elements):
            stored += d.element_Nm[i, j] * d.element_Nm[i, j] / (2.0 * d.share[i] * d.element_k[j])
    return stored
