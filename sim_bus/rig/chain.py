r"""One step of up to three coupled bodies in a row, with dry friction on each; events are located exactly.

The couplings are springs and dampers with backlash.

With the mean speed :math:`u` of a step of length :math:`h` the implicit midpoint rule reads, for
body :math:`i` with its couplings to :math:`i \pm 1`,

.. math::

    \frac{2 m_i}{h}(u_i - v_i) + b_i u_i + T_{i,i+1} - T_{i-1,i} = L_i - \lambda_i, \qquad
    T_{i,j} = k\,(q_i - q_j \mp g + \tfrac{h}{2}(u_i - u_j)) + d\,(u_i - u_j),

a symmetric tridiagonal system in :math:`u`. Dry friction is set-valued,
:math:`\lambda_i \in F_i\,\mathrm{Sgn}(u_i)`: a body at rest sticks (:math:`u_i = 0`), unless it
would need more than :math:`F_i`; the system's matrix is symmetric, positive definite and has no
positive off-diagonal element, so the solution is unique. If a speed would change its sign within
the step, or a coupling its side of the backlash, the step is split at that instant, which is found
to rounding. So :math:`\lambda_i u_i \ge 0` in every part of a step, stuck is exactly
:math:`v_i = 0`, and each torque's work is its torque times :math:`h u_i`: the energy balance closes
to rounding, whatever the step's length.

Sources: V. Acary and B. Brogliato, Numerical Methods for Nonsmooth Dynamical Systems, 2008,
doi:10.1007/978-3-540-75392-6; backlash as a dead zone: M. Nordin and P.-O. Gutman, Automatica
38(10), 2002, doi:10.1016/S0005-1098(02)00047-X.

In the kernels: `p` a record of `sim_bus.rig.records.PlantRecord`, `d` its `detail`.
"""

from __future__ import annotations

from coulombus.kernels.decorator import inlined, kernel
from coulombus.sim_bus.rig.detail import DRY, ELEMENTS
from coulombus.sim_bus.rig.elements import foretold, wind
from coulombus.sim_bus.rig.own_friction import set_bristles, set_levels
from coulombus.sim_bus.rig.records import BODIES, DetailRecord, PlantRecord

__all__ = ["MOST_EVENTS", "move"]

MOST_EVENTS = 400
"""Largest number of events in a step; further events do not split it."""
MOST_GUESSES = 40
MOST_SWITCHES = 12
SOON = 1e-6
"""Fraction of a step after which the direction of a coupling at its side of the backlash is evaluated."""
NO_EVENT = -1


@inlined
def _side(value: float) -> int:
    return 1 if value > 0.0 else -1


@kernel
def _solve(d: DetailRecord) -> None:
    """Solve the tridiagonal system for the mean speeds by Cramer's rule, with one division for all bodies, and
    compute the friction of the stuck bodies.

    A body that is stuck or absent has the row u = 0.
    """
    main, load, side, level, u, react = d.main, d.load, d.side, d.level, d.u, d.react
    a0 = a1 = a2 = 1.0
    r0 = r1 = r2 = s0 = s1 = 0.0
    n = d.count
    if side[0] != 0:
        a0, r0 = main[0], load[0] - side[0] * level[0]
    if n > 1 and side[1] != 0:
        a1, r1 = main[1], load[1] - side[1] * level[1]
        if side[0] != 0:
            s0 = d.stiff[0]
    if n > 2 and side[2] != 0:
        a2, r2 = main[2], load[2] - side[2] * level[2]
        if side[1] != 0:
            s1 = d.stiff[1]
    right, left = a1 * a2 - s1 * s1, a0 * a1 - s0 * s0
    inverse = 1.0 / (a0 * right - s0 * s0 * a2)
    across = s0 * a2 * r1 + s0 * s1 * r2
    u[0] = (right * r0 + across) * inverse
    u[1] = (s0 * a2 * r0 + a0 * (a2 * r1 + s1 * r2)) * inverse
    u[2] = (s0 * s1 * r0 + s1 * a0 * r1 + left * r2) * inverse
    for i in range(BODIES):
        if i >= n:
            continue
        if side[i] != 0:
            react[i] = side[i] * level[i]
            continue
        u[i] = 0.0
        bears = load[i]
        if i > 0:
            bears += d.stiff[i - 1] * u[i - 1]
        if i + 1 < n:
            bears += d.stiff[i] * u[i + 1]
        react[i] = bears


@kernel
def _try_once(p: PlantRecord, h: float, hand: float, torque: float) -> None:
    """Compute the mean speeds with the predicted behaviour of the friction elements."""
    d = p.detail
    n = d.count
    rate = 2.0 / h
    for i in range(BODIES):
        if i >= n:
            continue
        inert = rate * d.total[i]
        d.main[i] = inert + d.viscous[i]
        d.load[i] = inert * d.v[i]
        if d.bristles != DRY and d.share[i] > 0.0:
            set_bristles(d, i, h)
            d.main[i] += d.given[i]
            d.load[i] -= d.held[i]
    d.load[0] += torque
    d.main[d.drum] += d.wet
    last = n - 1
    d.main[last] += p.operator_damping + 0.5 * h * p.operator_stiffness
    d.load[last] += hand - p.operator_stiffness * d.q[last]
    for j in range(BODIES - 1):
        if j + 1 >= n:
            continue
        d.tied[j] = d.stiff[j] = 0.0
        if d.contact[j] != 0 or d.gap[j] == 0.0:
            d.tied[j] = d.k[j] * (d.q[j] - d.q[j + 1] - d.contact[j] * d.gap[j])
            d.stiff[j] = 0.5 * h * d.k[j] + d.d[j]
        d.main[j] += d.stiff[j]
        d.main[j + 1] += d.stiff[j]
        d.load[j] -= d.tied[j]
        d.load[j + 1] += d.tied[j]
    at_rest = False
    for i in range(BODIES):
        if i >= n:
            continue
        d.side[i] = _side(d.v[i])
        if d.v[i] == 0.0 and d.level[i] > 0.0:
            d.side[i] = 0
            at_rest = True
    _solve(d)
    if not at_rest:
        return
    for _ in range(MOST_SWITCHES):
        again = False
        for i in range(BODIES):
            if i >= n:
                continue
            if d.v[i] != 0.0 or d.level[i] == 0.0:
                continue
            if d.side[i] == 0:
                if abs(d.react[i]) > d.level[i]:
                    d.side[i] = _side(d.react[i])
                    again = True
            elif d.u[i] * d.side[i] < 0.0:
                d.side[i] = 0
                again = True
        if not again:
            return
        _solve(d)


@kernel
def _try(p: PlantRecord, h: float, hand: float, torque: float) -> None:
    """Compute the mean speeds of a step of `h` [s], and which bodies stick in it."""
    _try_once(p, h, hand, torque)
    d = p.detail
    if d.bristles == ELEMENTS and d.slip_rate == 0.0:
        while not foretold(d):  # at most once per body
            _try_once(p, h, hand, torque)


@inlined
def _room(d: DetailRecord, j: int, moved: float) -> float:
    """Return the distance of coupling `j` to its side of the backlash, after its bodies have moved by `moved`
    against each other: negative beyond it.
    """
    between = d.q[j] - d.q[j + 1] + moved
    return float(d.contact[j] * between - d.gap[j] if d.contact[j] != 0 else d.gap[j] - abs(between))


@inlined
def _crosses(d: DetailRecord, event: int, h: float) -> float:
    """Return a value that is negative if the `event` lies within the tried step of `h`: for bodies 0 to 2 the
    speed at its end, for couplings 3 and 4 the distance to the backlash's side.
    """
    if event < 3:
        return float((2.0 * d.u[event] - d.v[event]) * _side(d.v[event]))
    j = event - 3
    return float(_room(d, j, h * (d.u[j] - d.u[j + 1])))


@inlined
def _parts(d: DetailRecord, j: int) -> float:
    """Return the speed at which coupling `j`, at its side of the backlash, separates in the tried step."""
    between = d.u[j] - d.u[j + 1]
    sense = d.contact[j] if d.contact[j] != 0 else -_side(d.q[j] - d.q[j + 1])
    return float(sense * between)


@kernel
def _next_event(d: DetailRecord, h: float, last: int) -> int:
    """Return an event within the tried step of `h` that is not `last`, else the event at its end, or
    `NO_EVENT`.
    """
    for i in range(BODIES):
        if i >= d.count:
            continue
        turns = d.level[i] > 0.0 or (d.bristles == ELEMENTS and d.share[i] > 0.0)
        if i != last and d.v[i] != 0.0 and turns and _crosses(d, i, h) < 0.0:
            return i
    for j in range(BODIES - 1):
        if j + 1 >= d.count:
            continue
        if 3 + j != last and d.gap[j] > 0.0 and _crosses(d, 3 + j, h) < 0.0:
            return 3 + j
    return NO_EVENT


@kernel
def _first_event(p: PlantRecord, h: float, event: int, hand: float, torque: float) -> tuple[float, int]:
    """Return the time to the first event of the tried step of `h`, and that event; `event` is an event within
    the step.

    The Illinois method finds the instant; the step up to it is tried last.
    """
    d = p.detail
    last = NO_EVENT
    for _ in range(MOST_SWITCHES):
        if event == NO_EVENT:
            break
        last = event
        low, high, f_high = 0.0, h, _crosses(d, event, h)
        begin = f_low = abs(d.v[event]) if event < 3 else _room(d, event - 3, 0.0)
        small = 1e-14 * (abs(f_low) + abs(f_high))
        back = f_low <= small  # it is at the event already
        if back and event >= 3:
            low = SOON * h
            _try(p, low, hand, torque)
        if back and (event < 3 or _parts(d, event - 3) <= 0.0):
            h = 0.0
            break
        if back:
            # it separates and returns: search without the root at 0
            f_low, f_high = _parts(d, event - 3), (f_high - begin) / high
            small = 1e-14 * (f_low + abs(f_high))
        for _ in range(MOST_GUESSES):
            h = high - f_high * (high - low) / (f_high - f_low)
            _try(p, h, hand, torque)
            value = _crosses(d, event, h)
            if back:
                value = (value - begin) / h
            if abs(value) <= small or high - low <= 1e-16:
                break
            if value < 0.0:
                high, f_high = h, value
                f_low *= 0.5
            else:
                low, f_low = h, value
                f_high *= 0.5
        event = _next_event(d, h, last)
    return h, last


@kernel
def _go(p: PlantRecord, h: float, hand: float, torque: float) -> None:
    """Apply the step of `h` that was tried last."""
    d = p.detail
    rate = 2.0 / h
    n, last, drum = d.count, d.count - 1, d.drum
    u_last, q_last = d.u[last], d.q[last]
    p.f_operator = (
        hand
        - p.operator_inertia * rate * (u_last - d.v[last])
        - p.operator_damping * u_last
        - p.operator_stiffness * (q_last + 0.5 * h * u_last)
    )
    p.w_operator += p.f_operator * u_last * h
    p.w_motor += torque * d.u[0] * h
    # local variables: a sum in memory waits for its last store
    f_friction, w_friction, w_viscous = 0.0, p.w_friction, p.w_viscous
    for j in range(BODIES - 1):
        if j + 1 >= n:
            continue
        if d.stiff[j] > 0.0:
            between = d.u[j] - d.u[j + 1]
            w_viscous += d.d[j] * between * between * h
    for i in range(BODIES):
        if i >= n:
            continue
        u = d.u[i]
        brake = 0.0
        friction = d.react[i]
        if i == drum:
            # stuck: the device's own friction bears as much as it can, the brake the rest
            free = d.level[i] - d.dry[i]
            friction = min(max(friction, -free), free)
            brake = d.react[i] - friction
            viscous = d.wet * u
            p.f_brake = -brake - viscous
            p.w_brake -= (brake + viscous) * u * h
        if d.bristles != DRY and d.share[i] > 0.0:
            friction += d.held[i] + d.given[i] * u
            # the work is only the loss: the bristles can return their stored energy
            if d.bristles == ELEMENTS:
                w_friction += wind(d, i, h, u)
            else:
                z = d.kept[i] * d.z[i] + d.taken[i] * u
                w_friction += 0.5 * d.share[i] * d.sigma_0 * (z * z - d.z[i] * d.z[i])
                d.z[i] = z
        f_friction -= friction
        w_friction -= friction * u * h
        w_viscous += d.viscous[i] * u * u * h
        d.q[i] += u * h
        d.v[i] = 0.0 if d.side[i] == 0 else 2.0 * u - d.v[i]
    p.f_friction, p.w_friction, p.w_viscous = f_friction, w_friction, w_viscous


@kernel
def move(p: PlantRecord, hand: float, torque: float, capacity: float) -> None:
    """Advance all bodies by one step of the plant under the hand's and the motor's torque, with the brake's
    `capacity` [Nm].
    """
    d = p.detail
    left = p.h
    set_levels(p, capacity)
    for _ in range(MOST_EVENTS):
        _try(p, left, hand, torque)
        h, event = left, _next_event(d, left, NO_EVENT)
        if event != NO_EVENT:
            h, event = _first_event(p, left, event, hand, torque)
        if h > 0.0:
            _go(p, h, hand, torque)
        if event == NO_EVENT:
            return
        d.events += 1
        if event < 3:
            d.v[event] = 0.0
        else:
            j = event - 3
            d.contact[j] = 0 if d.contact[j] != 0 else _side(d.q[j] - d.q[j + 1])
        left -= h
        if left <= 0.0:
            return
        set_levels(p, capacity)
    d.missed_events += 1
    _try(p, left, hand, torque)
    _go(p, left, hand, torque)
