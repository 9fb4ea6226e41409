r"""What the hand feels made right, compiled: a velocity for slow motion, the level that the brake must
bear, a lead for its lags, and an observer of the motor's compensation.

    c : the CONTROL record of an axis        h : its HOST record

**Slow motion** (`slide_velocity`). A backward difference sees 0 or 1 count where the handle slides by
less than a count a cycle. The first-order adaptive window takes the longest stretch of at most
``velocity_window_cycles`` whose ends' straight line is off no sample between them by more than a
count: long when the handle creeps, one cycle when it starts. Source: F. Janabi-Sharifi, V. Hayward,
C.-S. J. Chen, IEEE Trans. Control Systems Technology 8(6), 2000, doi:10.1109/87.880606.

**Level** (`brake_level`). What a law says is what the hand is to feel. The device's own friction
:math:`c + b|v|` is already there, and the motor takes its :math:`m` off in slip and nothing in stick,
where it has no direction to push in. So the brake bears

.. math:: \lambda_b = \max(\lambda - c - b|v| + m,\ 0).

**Lead** (`lead`). Coil and fluid are two lags in series, :math:`T_c \dot c = u - c` and
:math:`T_f \dot f = c - f`. Their believed course is stepped along, and the set-point is

.. math:: c^* = f + 3 (\lambda_b - f), \qquad u = c + 2 (c^* - c), \qquad 0 \le u \le u_{max},

with which the fluid follows as if its lag were a third and the coil's a half of what they are. The
believed course gets the set-point that was limited, so a limit winds nothing up. Iron with hysteresis
between them (`[brake.iron]`) is inverted (`host.cycle.brake_hysteresis`): :math:`c^*` becomes the coil's torque
with which the fluid sees that. No measurement
enters: a wrong belief makes the brake late or early by the difference, and never unstable.

**Observer** (`observe`). With more compensation than there is friction the display gives energy. Time
domain passivity control (B. Hannaford, J.-H. Ryu, IEEE T-RA 18(1), 2002, doi:10.1109/70.988969)
keeps the balance that the hand's port must not overdraw,

.. math:: D_k = \min\left(D_{k-1} + (f_h - \lambda_b\,\mathrm{sgn}\,v - b v - \tfrac12 (1-s) c\,\mathrm{sgn}\,v)\,
          \Delta x,\ \max_{k-3..k} \tfrac12 J v^2\right), \qquad E_k = D_k - \min_{k-3..k} \tfrac12 J v^2

with the transducer's :math:`f_h`, the brake's expected torque and :math:`s` the share that is
compensated: what the hand gives must pay for brake, viscous friction, and half of what the
compensation is meant to leave. In stick, where the motor compensates nothing, nothing is charged:
what the encoder shows there is an elastic transmission that winds and unwinds. :math:`D` is what
has been paid and is still there: at most the kinetic energy, so credit is not kept. What the law has for the motor - all of it in active, a wall's
spring in hybrid - is no compensation: its work is taken off :math:`f_h`, in both directions. Law and
brake count as they acted on the way that the newest position ends. In active the balance begins anew
where the handle turns back within 50 ms: the limit cycle of a law on the motor is no doubt of the
compensation.

A sampled velocity is uneven where a device samples a little early or late; so of the last
`KINETIC_CYCLES` the largest kinetic energy limits what is paid and the smallest is what is owed. What
one uneven cycle shows neither eats a payment nor asks for one. From :math:`E = -E_0`
(``limits.passivity_J``) on the motor's share falls, to nothing at :math:`-2 E_0`, and in hybrid the
brake bears what the motor does not give. So the compensation settles at what there truly is to
compensate.
"""

from __future__ import annotations

from coulombus.host.cycle.brake_hysteresis import coil_for, magnetise
from coulombus.host.cycle.records import KINETIC_CYCLES, TRACK, ControlRecord, HostRecord, Phase
from coulombus.kernels.decorator import kernel

__all__ = ["brake_level", "expect", "lead", "observe", "slide_velocity"]

FLUID_LEAD, COIL_LEAD = 3.0, 2.0
CHATTER_NS = 50_000_000
"""A handle that turns back within this time is in the limit cycle of a law on the motor."""


@kernel
def slide_velocity(c: ControlRecord, h: HostRecord) -> None:
    """Set ``slide_counts`` [counts a cycle] from the positions of the last cycles; call it once a
    cycle, behind `watch.measure`.
    """
    h.slide_counts = h.v_counts
    if c.window_cycles <= 1 or not h.fresh:
        h.track_length = 0  # the window has no gaps
        return
    newest = h.counts
    low, high = -1e300, 1e300
    for k in range(1, min(h.track_length, c.window_cycles) + 1):
        moved = float(newest - h.track[(h.track_row - k) % TRACK])
        slope = moved / k
        if slope < low or slope > high:
            break
        h.slide_counts = slope
        low = max(low, (moved - 1.0) / k)
        high = min(high, (moved + 1.0) / k)
    h.track[h.track_row] = newest
    h.track_row = (h.track_row + 1) % TRACK
    h.track_length = min(h.track_length + 1, TRACK)


@kernel
def brake_level(c: ControlRecord, h: HostRecord, level_Nm: float, motor_Nm: float) -> float:
    """Return what the brake must bear [Nm] that the hand feels `level_Nm`, while the motor takes
    `motor_Nm` off the device's own friction.
    """
    v = abs(h.slide_counts * c.rad_count) * 1e9 / c.period_ns
    bears_Nm: float = max(level_Nm - c.friction_Nm - c.viscous * v + motor_Nm, 0.0)
    return bears_Nm


@kernel
def lead(c: ControlRecord, h: HostRecord, level_Nm: float) -> float:
    """Return the set-point [Nm] with which the brake's torque comes to `level_Nm` sooner than its
    lags let it.
    """
    if c.coil_step <= 0.0 and c.fluid_step <= 0.0 and c.iron_plays <= 0:
        return level_Nm
    seen_Nm = level_Nm if c.fluid_step <= 0.0 else h.fluid_Nm + FLUID_LEAD * (level_Nm - h.fluid_Nm)
    coil_Nm = coil_for(c, h, seen_Nm)
    if c.coil_step > 0.0:
        coil_Nm = h.coil_Nm + COIL_LEAD * (coil_Nm - h.coil_Nm)
    setpoint_Nm: float = min(max(coil_Nm, 0.0), c.brake_limit_Nm)
    return setpoint_Nm


@kernel
def expect(c: ControlRecord, h: HostRecord) -> None:
    """Step the brake's expected torque along by a cycle under the set-point that was sent.

    A set-point acts on the next SYNC. So the observer takes what was expected a cycle ago, but for a
    brake whose lags are not told: their stand-in is a little too long by itself.
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
