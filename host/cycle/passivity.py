r"""The passivity observer of the motor's compensation, compiled: an energy balance at the hand's port.

    c : the CONTROL record of an axis        h : its HOST record

With more compensation than there is friction the display gives energy. Time domain passivity control
(B. Hannaford, J.-H. Ryu, IEEE T-RA 18(1), 2002, doi:10.1109/70.988969) keeps the balance that the
hand's port must not overdraw,

.. math:: D_k = \min\left(D_{k-1} + (f_h - \lambda_b\,\mathrm{sgn}\,v - b v - \tfrac12 (1-s) c\,\mathrm{sgn}\,v)\,
          \Delta x,\ \max_{k-3..k} \tfrac12 J v^2\right), \qquad E_k = D_k - \min_{k-3..k} \tfrac12 J v^2

with the transducer's :math:`f_h`, the brake's expected torque and :math:`s` the share that is
compensated: what the hand gives must pay for brake, viscous friction, and half of what the
compensation is meant to leave. In stick, where the motor compensates nothing, nothing is charged:
what the encoder shows there is an elastic transmission that winds and unwinds. :math:`D` is what
has been paid and is still there: at most the kinetic energy, so credit is not kept. What the law has
for the motor - all of it in active, a wall's spring in hybrid - is no compensation: its work is taken
off :math:`f_h`, in both directions. Law and brake count as they acted on the way that the newest
position ends. In active the balance begins anew where the handle turns back within 50 ms: the limit
cycle of a law on the motor is no doubt of the compensation.

A sampled velocity is uneven where a device samples a little early or late; so of the last
`KINETIC_CYCLES` the largest kinetic energy limits what is paid and the smallest is what is owed. What
one uneven cycle shows neither eats a payment nor asks for one. From :math:`E = -E_0`
(``limits.passivity_J``) on the motor's share falls, to nothing at :math:`-2 E_0`, and in hybrid the
brake bears what the motor does not give. So the compensation settles at what there truly is to
compensate.
"""

from __future__ import annotations

from coulombus.host.cycle.records import KINETIC_CYCLES, ControlRecord, HostRecord, Phase
from coulombus.kernels.decorator import kernel

__all__ = ["observe"]

CHATTER_NS = 50_000_000
"""A handle that turns back within this time is in the limit cycle of a law on the motor."""


@kernel
def observe(c: ControlRecord, h: HostRecord) -> float:
    """Bring the balance at the hand's port on by a cycle; return the share of its compensation that
    the motor may give, 0 to 1.
    """
    v = h.v_counts * c.rad_count * 1e9 / c.period_ns
    handle_Nm = 0.5 * (h.handle_Nm + h.port_handle_Nm)
    running = h.phase == Phase.RUN and h.fresh
    if running:
        h.port_kinetic_J[h.port_row] = 0.5 * c.inertia * v * v
        h.port_row = (h.port_row + 1) % KINETIC_CYCLES
    most_J = least_J = h.port_kinetic_J[0]
    for k in range(1, KINETIC_CYCLES):
        most_J = max(most_J, h.port_kinetic_J[k])
        least_J = min(least_J, h.port_kinetic_J[k])
    if running:
        way = h.moved_counts * c.rad_count
        left_Nm = max(0.5 * (c.friction_Nm - c.compensation_Nm), 0.0)
        paid_J = (handle_Nm - h.port_pushed_Nm - c.viscous * v) * way - (h.port_brake_Nm + left_Nm) * abs(way)
        if abs(h.slide_counts) <= c.slide_band_counts:  # no compensation: an elastic part gives back what it took
            paid_J = max(paid_J, 0.0)
        h.port_J = min(h.port_J + paid_J, most_J)
        h.port_slid_ns += c.period_ns
        if way * h.port_way < 0.0:  # it turned back
            if c.motor_active and h.port_slid_ns < CHATTER_NS:
                h.port_J = most_J
            h.port_slid_ns = 0
        if way != 0.0:
            h.port_way = way
    h.port_handle_Nm, h.port_pushed_Nm = h.handle_Nm, h.pushed_Nm
    share: float = min(max(2.0 - (least_J - h.port_J) / c.passivity_J, 0.0), 1.0)
    return share
