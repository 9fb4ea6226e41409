r"""Passivity observer of the motor's compensation, compiled: an energy balance at the hand's port.

    c : the CONTROL record of an axis        h : its HOST record

If the compensation exceeds the friction, the display generates energy. Time domain passivity control
(B. Hannaford, J.-H. Ryu, IEEE T-RA 18(1), 2002, doi:10.1109/70.988969) computes an energy balance at the
hand's port that must not become too negative,

.. math:: D_k = \min\left(D_{k-1} + (f_h - \lambda_b\,\mathrm{sgn}\,v - b v - \tfrac12 (1-s) c\,\mathrm{sgn}\,v)\,
          \Delta x,\ \max_{k-3..k} \tfrac12 J v^2\right), \qquad E_k = D_k - \min_{k-3..k} \tfrac12 J v^2

with the transducer's torque :math:`f_h`, the brake's expected torque :math:`\lambda_b` and the compensated
share :math:`s`.

- Energy: the hand's work must cover brake, viscous friction, and half of the friction that the
  compensation is meant to leave. :math:`D` is the surplus. It is at most the kinetic energy, so no
  credit accumulates.
- Stick: the motor compensates nothing, so nothing is subtracted. The encoder only shows the wind-up of
  an elastic transmission there.
- Law: the law's part for the motor (all of it in active, a wall's spring in hybrid) is not
  compensation. Its work is subtracted from that of :math:`f_h`, in both directions. Law and brake count
  with the torques that acted during the motion to the newest position.
- Limit cycle: in active the balance restarts if the handle turns back within 50 ms. This is the limit
  cycle of a law on the motor, and no sign of too much compensation.
- Jitter: the sampled velocity is uneven if a device samples a little early or late. So of the last
  `KINETIC_CYCLES` cycles the largest kinetic energy bounds :math:`D`, and the smallest is subtracted in
  :math:`E`. A single uneven cycle changes neither.

The motor's share falls from 1 at :math:`E = -E_0` (``limits.passivity_J``) to 0 at :math:`-2 E_0`. In
hybrid the brake gives the withheld part. So the compensation settles at the friction that is really
present.
"""

from __future__ import annotations

from coulombus.host.cycle.records import KINETIC_CYCLES, ControlRecord, HostRecord, Phase
from coulombus.kernels.decorator import kernel

__all__ = ["observe"]

CHATTER_NS = 50_000_000
"""Longest time between two reversals in the limit cycle of a law on the motor."""


@kernel
def observe(c: ControlRecord, h: HostRecord) -> float:
    """Advance the energy balance at the hand's port by one cycle; return the share of its compensation
    that the motor may give, 0 to 1.
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
        if abs(h.slide_counts) <= c.slide_band_counts:  # no compensation: an elastic part returns its energy
            paid_J = max(paid_J, 0.0)
        h.port_J = min(h.port_J + paid_J, most_J)
        h.port_slid_ns += c.period_ns
        if way * h.port_way < 0.0:  # the handle turned back
            if c.motor_active and h.port_slid_ns < CHATTER_NS:
                h.port_J = most_J
            h.port_slid_ns = 0
        if way != 0.0:
            h.port_way = way
    h.port_handle_Nm, h.port_pushed_Nm = h.handle_Nm, h.pushed_Nm
    share: float = min(max(2.0 - (least_J - h.port_J) / c.passivity_J, 0.0), 1.0)
    return share
