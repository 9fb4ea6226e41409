r"""The rig's loop alone, compiled: plant, encoder, the host's own law, a delayed set-point.

It has no bus and no nodes; maps use it.

.. math::

    (m + m_o)\,\dot v + (b + b_o)\,v + k_o x = u - \lambda, \qquad \lambda \in F\,\mathrm{Sgn}(v), \qquad \tau_m \dot u = u^* - u

A sample at :math:`kT` gives :math:`n_k = \lfloor x/q + 1/2 \rfloor` counts. The law is
`host.laws.laws`'s karnopp or coulomb itself, with counts as input; its torque :math:`u^*_k` acts
from :math:`kT + \tau`, a delay of whole cycles and a fraction.

Between events the plant is linear, so its transition matrix steps it exactly for any step. Where
the inherent friction changes sign (v = 0), the crossing is found on the Taylor series of the
solution: steps are short compared with the plant's rates, and the truncation error is less than
1e-9 of the step's motion. From there it sticks if the friction balances the load, and breaks away
at the instant at which a lagging motor exceeds it. Without inherent friction there is no such event
and no approximation. Two crossings within one step are missed; a step is at most a sample.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from coulombus.host.laws import laws
from coulombus.kernels.decorator import kernel
from coulombus.kernels.numba_inside import borrowed
from coulombus.kernels.records import Record, dtype_of

__all__ = ["LOOP", "RELAY", "STATS", "run_loops"]


class LoopRecord(Record):
    """The sampled loop."""

    inertia: float  # device and operator [kg m2]
    damping: float
    stiffness: float
    friction: float  # inherent Coulomb friction [Nm]
    compensation: float  # torque of the compensation in slip [Nm]
    lag: float  # of the motor [s]
    limit: float  # of the motor [Nm]
    torque_step: float  # resolution of the set-point [Nm], 0: none
    count: float  # encoder's resolution at the handle [rad]
    period: float
    delay: float  # from sampling to actuation [s]
    relay: int  # RELAY: coulomb, else karnopp
    K_p: float
    F_s: float
    F_d: float
    band_counts: float
    x0: float
    v0: float
    settle: float  # omitted [s] ...
    window: float  # ... before this is measured [s]


LOOP = dtype_of(LoopRecord)

RELAY = 1


class StatsRecord(Record):
    """The results of a run."""

    velocity_rms: float  # of v^ in the window [rad/s]
    late_rms: float  # of v^ in the window's second half
    counts_p2p: int
    reversals: int  # sign changes of the non-zero v^
    frequency: float  # half of these per second, from the first to the last [Hz]
    torque_flips: int  # sign changes of the non-zero set-point
    samples: int  # simulated, settling included


STATS = dtype_of(StatsRecord)

TERMS = 14
RECIPROCAL = 1.0 / np.arange(1, TERMS)
DELAY_CYCLES = 64  # a power of two
NOTHING = 1e-30  # a lag's residual below this is 0: tiny numbers are slow to compute with
SCRATCH = 148
STEP_RATE = 1.25  # with friction, a step times the plant's fastest rate is at most this

_karnopp = kernel(laws.karnopp)
_coulomb = kernel(laws.coulomb)


@kernel
def _transition(p: Any, h: float, out: Any) -> None:
    """Fill `out` (4 x 4) with exp(A h) of (x, v, u - u*, acceleration input), by scaling and
    squaring.
    """
    a = np.zeros((4, 4))
    a[0, 1] = 1.0
    a[1, 0] = -p.stiffness / p.inertia
    a[1, 1] = -p.damping / p.inertia
    a[1, 2] = 1.0 / p.inertia
    a[1, 3] = 1.0
    if p.lag > 0.0:
        a[2, 2] = -1.0 / p.lag
    norm = 0.0
    for i in range(4):
        total = 0.0
        for j in range(4):
            a[i, j] *= h
            total += abs(a[i, j])
        norm = max(norm, total)
    squarings = 0
    while norm > 0.25:
        norm *= 0.5
        squarings += 1
    a *= 0.5**squarings
    power = np.eye(4)
    result = np.eye(4)
    for k in range(1, 13):
        power = _product(power, a) / k
        result = result + power
    for _ in range(squarings):
        result = _product(result, result)
    out[:, :] = result


@kernel
def _product(a: Any, b: Any) -> Any:
    """Return a b (4 x 4), always in the same order of operations."""
    out = np.zeros((4, 4))
    for i in range(4):
        for j in range(4):
            total = 0.0
            for k in range(4):
                total += a[i, k] * b[k, j]
            out[i, j] = total
    return out


@kernel
def _series(p: Any, y: Any, target: float, sign: float, cx: Any, cv: Any, cw: Any) -> None:
    """Fill the Taylor coefficients of x, v and w = u - u* about the state `y` while v has the sign
    `sign`.
    """
    cx[0], cv[0], cw[0] = y[0], y[1], y[2]
    push = target - sign * p.friction
    per_inertia = 1.0 / p.inertia
    decay = -1.0 / p.lag if p.lag > 0.0 else 0.0
    damping, stiffness = p.damping, p.stiffness
    x, v, w = y[0], y[1], y[2]
    for n in range(TERMS - 1):
        part = RECIPROCAL[n]
        force = w - damping * v - stiffness * x + push
        push = 0.0
        x = v * part
        v = force * per_inertia * part
        w *= decay * part
        cx[n + 1], cv[n + 1], cw[n + 1] = x, v, w


@kernel
def _value(c: Any, t: float) -> float:
    total: float = c[TERMS - 1]
    for n in range(TERMS - 2, -1, -1):
        total = total * t + c[n]
    return total


@kernel
def _crossing(cv: Any, from_rest: bool, t_end: float) -> float:
    """Return the time at which v, of another sign at `t_end`, reaches zero: Newton's method with bisection."""
    low, high = 0.0, t_end
    first = 1 if from_rest else 0  # from rest v = t (c1 + c2 t + ...): the root is the bracket's
    start = cv[first]
    t = 0.5 * t_end
    for _ in range(60):
        total, slope = cv[TERMS - 1], 0.0
        for n in range(TERMS - 2, first - 1, -1):
            slope = slope * t + total
            total = total * t + cv[n]
        if total * start > 0.0:
            low = t
        else:
            high = t
        step = total / slope if slope != 0.0 else t_end
        if abs(step) <= 1e-14 * t_end:
            break
        t -= step
        if not low < t < high:
            t = 0.5 * (low + high)
    return t


@kernel
def _events(p: Any, y: Any, target: float, h: float, series: Any) -> None:
    """Advance `y` by `h` where v is zero or becomes zero: stick, break away, slip, repeatedly if necessary."""
    cx, cv, cw = series
    left = h
    for _ in range(16):
        if left <= 0.0:
            return
        if y[1] == 0.0:
            hold = target - p.stiffness * y[0]  # final value of the load
            load = hold + y[2]
            if abs(load) <= p.friction:
                decay = math.exp(-left / p.lag) if p.lag > 0.0 else 0.0
                end = hold + y[2] * decay
                if abs(end) <= p.friction:
                    y[2] *= decay
                    return
                level = p.friction if end > 0.0 else -p.friction
                t = p.lag * math.log(y[2] / (level - hold)) if p.lag > 0.0 else 0.0
                t = min(max(t, 0.0), left)
                y[2] *= math.exp(-t / p.lag) if p.lag > 0.0 else 1.0
                left -= t
                sign = 1.0 if end > 0.0 else -1.0
            else:
                sign = 1.0 if load > 0.0 else -1.0
        else:
            sign = 1.0 if y[1] > 0.0 else -1.0
        _series(p, y, target, sign, cx, cv, cw)
        from_rest = y[1] == 0.0
        t = left
        v = _value(cv, left)
        if v * sign < 0.0:
            t = _crossing(cv, from_rest, left)
            v = 0.0
        y[0] = _value(cx, t)
        y[2] = _value(cw, t)
        y[1] = v
        left -= t


@kernel
def _advance(p: Any, y: Any, target: float, phi: Any, h: float, steps: int, series: Any) -> None:
    """Advance (x, v, u - u*) by `steps` steps of `h` with the transition matrix `phi` of one."""
    for k in range(steps):
        v = y[1]
        if p.friction > 0.0 and v == 0.0:
            hold = target - p.stiffness * y[0]
            rest = y[2]
            if rest != 0.0:
                for _ in range(k, steps):
                    rest *= phi[2, 2]
            if (
                abs(hold + y[2]) <= p.friction and abs(hold + rest) <= p.friction
            ):  # the load moves from one to the other: stuck
                y[2] = rest if abs(rest) > NOTHING else 0.0
                return
            _events(p, y, target, h, series)
            continue
        push = target
        if v > 0.0:
            push -= p.friction
        elif v < 0.0:
            push += p.friction
        push /= p.inertia
        v1 = phi[1, 0] * y[0] + phi[1, 1] * v + phi[1, 2] * y[2] + phi[1, 3] * push
        if p.friction > 0.0 and v1 * v < 0.0:
            _events(p, y, target, h, series)
            continue
        y[0] = phi[0, 0] * y[0] + phi[0, 1] * v + phi[0, 2] * y[2] + phi[0, 3] * push
        y[2] = phi[2, 2] * y[2]
        y[1] = v1


@kernel
def _steps(p: Any, h: float) -> int:
    if p.friction == 0.0:
        return 1
    rate = p.damping / p.inertia + math.sqrt(p.stiffness / p.inertia)
    if p.lag > 0.0:
        rate += 1.0 / p.lag
    steps: int = math.ceil(h * rate / STEP_RATE)
    return max(1, steps)


@kernel
def _run(p: Any, motion: Any, law: Any, state: Any, out: Any, work: Any, trace: Any) -> None:
    """Run one loop; `trace` (samples x 3: x, v, set-point) is filled up to its length.

    `work` has SCRATCH numbers.
    """
    T = p.period
    whole = math.floor(p.delay / T + 1e-9)
    early = min(max(p.delay - whole * T, 0.0), T)
    if early < 1e-9 * T:
        early = 0.0
    late = T - early
    # a borrowed array costs no reference count at each of a sample's calls
    phi_early, phi_late = borrowed(work[:16].reshape(4, 4)), borrowed(work[16:32].reshape(4, 4))
    series = borrowed(work[32:48]), borrowed(work[48:64]), borrowed(work[64:80])  # of x, v, w
    y, held = borrowed(work[80:84]), borrowed(work[84:148])
    steps_early, steps_late = _steps(p, early), _steps(p, late)
    _transition(p, early / steps_early, phi_early)
    _transition(p, late / steps_late, phi_late)
    y[0], y[1], y[2] = p.x0, p.v0, 0.0
    held[:] = 0.0

    law.K_p, law.F_s, law.F_d = p.K_p, p.F_s, p.F_d
    law.velocity_band_counts = p.band_counts
    law.paper_entry = 0
    law.brake_spring = 0
    counts = math.floor(p.x0 / p.count + 0.5)
    state.stuck, state.x_stuck, state.psi_Nm, state.brake_Nm = 1, counts * p.count, 0.0, 0.0
    motion.dt_s, motion.handle_Nm = T, 0.0

    first = round(p.settle / T)
    samples = first + round(p.window / T)
    half = (first + samples) // 2
    square, second, low, high = 0.0, 0.0, counts, counts
    last_sign, last_torque = 0.0, 0.0
    reversals, flips, began, ended = 0, 0, 0, 0
    before = 0.0  # acts until the set-point arrives
    for k in range(samples):
        previous = counts
        counts = math.floor(y[0] / p.count + 0.5)
        v_counts = counts - previous
        motion.x_rad = counts * p.count
        motion.v_counts = v_counts
        motion.v_rad_s = v_counts * p.count / T
        psi = _coulomb(motion, law, state) if p.relay == RELAY else _karnopp(motion, law, state)
        state.psi_Nm = psi
        torque = -psi
        if abs(v_counts) > p.band_counts:
            torque += p.compensation if v_counts > 0.0 else -p.compensation
        torque = min(max(torque, -p.limit), p.limit)
        if p.torque_step > 0.0:
            torque = math.floor(torque / p.torque_step + 0.5) * p.torque_step
        if k < trace.shape[0]:
            trace[k, 0], trace[k, 1], trace[k, 2] = y[0], y[1], torque
        if k >= first:
            if k == first:
                low, high = counts, counts
            square += motion.v_rad_s * motion.v_rad_s
            if k >= half:
                second += motion.v_rad_s * motion.v_rad_s
            low, high = min(low, counts), max(high, counts)
            if v_counts * last_sign < 0.0:
                reversals += 1
                if reversals == 1:
                    began = k
                ended = k
            if torque * last_torque < 0.0:
                flips += 1
        if v_counts != 0.0:
            last_sign = v_counts
        if torque != 0.0:
            last_torque = torque
        held[k & (DELAY_CYCLES - 1)] = torque
        after = held[(k - whole) & (DELAY_CYCLES - 1)] if k >= whole else 0.0
        if early > 0.0:
            _advance(p, y, before, phi_early, early / steps_early, steps_early, series)
        y[2] = y[2] + before - after if p.lag > 0.0 else 0.0
        _advance(p, y, after, phi_late, late / steps_late, steps_late, series)
        before = after

    out.velocity_rms = math.sqrt(square / max(samples - first, 1))
    out.late_rms = math.sqrt(second / max(samples - half, 1))
    out.counts_p2p = int(high - low)
    out.reversals, out.torque_flips, out.samples = reversals, flips, samples
    out.frequency = 0.5 * (reversals - 1) / ((ended - began) * T) if ended > began else 0.0


@kernel
def run_loops(loops: Any, motion: Any, law: Any, state: Any, out: Any, trace: Any) -> None:
    """Run each record of `loops` (LOOP) and write its figures to `out` (STATS).

    The last run fills `trace`.

    Parameters
    ----------
    motion, law, state : one record each of the law's MOTION, LAW, LAW_STATE
    trace : float64 (samples, 3), x [rad], v [rad/s] and set-point [Nm] at the samples; length 0:
        none
    """
    work = np.zeros(SCRATCH)
    for i in range(loops.shape[0]):
        _run(loops[i], motion[0], law[0], state[0], out[i], work, trace)
