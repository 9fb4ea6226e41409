r"""The simulated rig at the handle: motor, MR brake, inherent friction and the operator's hand.

One degree of freedom, angle :math:`x` [rad], speed :math:`v` [rad/s], all torques [Nm] at the
handle:

.. math::

    (m + m_o)\,\dot v + (b + b_o)\,v + k_o\,x = f_h(t) + \tau_m - \lambda_b - \lambda_f

with the operator :math:`f_h - f = Z_o v`, :math:`Z_o = m_o s + b_o + k_o/s` (paper, eq. 19). Brake
and inherent friction are set-valued: :math:`\lambda \in F\,\mathrm{Sgn}(v)`. They are *solved*,
never approximated by a steep function of speed: stuck is exactly :math:`v = 0`, and
:math:`\lambda v \ge 0` holds in every step, so neither can ever push.

A step is the implicit midpoint rule for the smooth part. If the speed would change its sign inside
a step, the step is split at the instant of the crossing: from there the handle sticks if the
friction can hold the load, else it slips in the other direction. The work of each torque is its
torque times the step's mean speed, so the energy balance

.. math:: W_{op} + W_m - W_{visc} + W_b + W_f = \Delta(\tfrac12 m v^2)

closes to rounding in every step, at any step size.

The device's own friction is Coulomb's with Stribeck's rise towards rest,

.. math:: F_f = F_c + \Delta F \exp(-(v/v_S)^2),

at the speed of the step's begin, and :math:`F_c + \Delta F` at rest: the course is then accurate to
first order in the step, and the energy balance still closes to rounding.

The motor follows its command with a first-order lag. Its cogging, :math:`-A\sin(k i x)` with
:math:`k` periods per revolution of the motor and :math:`i` motor revolutions per revolution of the
handle, is part of its torque; over a step it has the value of the step's begin. The brake's torque
capacity follows its command through two first-order lags in series, the coil and the fluid; its
off-state torque is always there.

The iron is between them. It keeps a share :math:`r` of the largest torque, and a current of the
opposite sign removes it: with the coil at :math:`c` (the torque that corresponds to its current)
and the remanent torque :math:`R`

.. math:: M = \max(c, R),\ R \leftarrow \max(R, r c) \quad (c \ge 0), \qquad
          R \leftarrow \min(R, \max(R_0 + c, 0)),\ M = \max(R, -R_0 - c) \quad (c < 0)

with :math:`R_0`, the :math:`R` at the instant at which the current changed its sign. The coil's
temperature is a thermal lag, :math:`\tau\dot T = T_{amb} + R_{th} R_{coil} i^2 - T`, and does not
affect the mechanics. An open coil carries no current; a short circuit draws the supply's current,
outside the winding.

    p : the `PlantRecord` of an axis
"""

from __future__ import annotations

import math

from coulombus.kernels.decorator import inlined, kernel
from coulombus.kernels.records import Floats, RecordArray, new_records
from coulombus.rigs.axis import Axis
from coulombus.rigs.plant import Operator, Plant
from coulombus.sim_bus.rig.detail import DETAIL_COLUMNS, detail_of
from coulombus.sim_bus.rig.operator import drawn
from coulombus.sim_bus.rig.records import PlantRecord

__all__ = [
    "COIL_INTACT",
    "COIL_OPEN",
    "COIL_SHORT",
    "TRUTH_COLUMNS",
    "advance",
    "coil_current",
    "coil_target",
    "drive_train",
    "encoder_rad",
    "heat_coil",
    "keep_truth",
    "magnetise",
    "motor_target",
    "new_plant",
    "plant_at_rest",
    "sample_noise",
    "settled",
    "transducer_Nm",
    "truth_columns",
]

COIL_INTACT, COIL_OPEN, COIL_SHORT = 0, 1, 2
SHORT_A = 25.0
"""Current that the driver supplies into a short circuit."""
NEGLIGIBLE_Nm = 1e-200
NOISE_FACTOR, NOISE_SUMMAND, NOISE_MASK = 0x5DEECE66D, 0xB, 0xFFFFFFFFFFFF
"""Generator of the transducer's noise: x -> factor x + summand, of 48 bits."""


TRUTH_COLUMNS = (
    "t_s",
    "angle_rad",
    "speed_rad_s",
    "operator_Nm",
    "motor_Nm",
    "brake_Nm",
    "friction_Nm",
    "operator_work_J",
    "motor_work_J",
    "brake_work_J",
    "friction_work_J",
    "viscous_loss_J",
    "kinetic_energy_J",
)
"""Columns of the true course at the plant's step; torques act on the handle at the end of the step that
ends at t (after the stop, if the speed crosses zero within it); the works are exact.
"""


def truth_columns(p: Plant) -> tuple[str, ...]:
    """Return the columns of the true course of a plant."""
    return (*TRUTH_COLUMNS, *DETAIL_COLUMNS) if p.in_detail else TRUTH_COLUMNS


def _decay(step_s: float, lag_s: float) -> float:
    return math.exp(-step_s / lag_s) if lag_s > 0 else 0.0


def new_plant(axis: Axis, seed: int = 0) -> RecordArray[PlantRecord]:
    """Return the plant of `axis` at rest at angle 0, as an array of one record; `seed` starts the
    transducer's noise.
    """
    return plant_at_rest(axis.simulation.plant, drawn(axis.simulation.operator, seed), axis.brake.coil_A_Nm, seed)


def plant_at_rest(p: Plant, hand: Operator, coil_A_Nm: float, seed: int = 0) -> RecordArray[PlantRecord]:
    """Return a plant with a hand on it, as `new_plant`; `coil_A_Nm` is the brake's current for each Nm."""
    plant = new_records(PlantRecord)
    r = plant[0]
    r["step_ns"] = round(p.step_s * 1e9)
    r["h"] = p.step_s
    r["inertia"], r["viscous"], r["coulomb"] = p.inertia_kg_m2, p.viscous_Nms_rad, p.coulomb_Nm
    r["stribeck"], r["stribeck_v"] = p.stribeck_Nm, p.stribeck_rad_s
    r["off_state"], r["brake_max"] = p.brake_off_state_Nm, p.brake_max_Nm
    r["operator_inertia"] = hand.inertia_kg_m2
    r["operator_damping"] = hand.damping_Nms_rad
    r["operator_stiffness"] = hand.stiffness_Nm_rad
    r["motor_decay"] = _decay(p.step_s, p.motor_lag_s)
    r["coil_decay"] = _decay(p.step_s, p.brake_coil_lag_s)
    r["fluid_decay"] = _decay(p.step_s, p.brake_fluid_lag_s)
    r["motor_Nm_pm"] = p.motor_polarity * p.motor_rated_torque_Nm * p.ratio / 1000
    r["motor_peak_pm"] = 1000 * p.motor_peak_ratio
    r["cogging"], r["cogging_rad"] = p.cogging_Nm, p.cogging_periods * p.ratio
    r["coil_A_Nm"] = coil_A_Nm
    r["counts_rad"] = p.encoder_polarity * p.encoder_counts_rev * p.ratio / (2 * math.pi)
    r["eccentric"], r["eccentric_rad"] = p.encoder_eccentricity_rad / p.ratio, p.ratio
    r["bias"], r["drift"] = p.transducer_bias_Nm, p.transducer_drift_Nm_s
    r["transducer_decay"] = _decay(p.step_s, p.transducer_lag_s)
    r["detail"] = detail_of(p, hand.inertia_kg_m2)
    r["filtered"] = int(p.transducer_lag_s > 0.0 or p.in_detail)
    r["coil_step"] = p.coil_step_A / coil_A_Nm
    r["noise"], r["transducer_polarity"] = p.transducer_noise_Nm, p.transducer_polarity
    r["temperature"], r["ambient"] = p.temperature_degC, p.ambient_degC
    r["K_A2"], r["thermal_s"] = p.coil_thermal_K_W * p.coil_resistance_ohm, p.coil_thermal_s
    r["remanence"], r["brake_gain"] = p.brake_remanence, p.brake_gain
    r["random"] = (seed * NOISE_FACTOR + 0x2545F491) & NOISE_MASK
    return plant


@kernel
def sample_noise(p: PlantRecord) -> float:
    """Return the next value of the transducer's noise: the sum of four uniform values, with unit variance,
    bounded at 3.5 sigma.
    """
    total = 0.0
    state = int(p.random)
    for _ in range(4):
        state = (state * NOISE_FACTOR + NOISE_SUMMAND) & NOISE_MASK
        total += state * 3.552713678800501e-15  # 2**-48
    p.random = state
    return (total - 2.0) * 1.7320508075688772


@kernel
def transducer_Nm(p: PlantRecord) -> float:
    """Return the transducer's reading of the hand's torque on the handle [Nm]: with filter, bias, drift,
    noise and polarity.
    """
    torque = p.f_operator if p.filtered == 0 else p.transduced
    offset = p.bias + p.drift * (p.t_ns * 1e-9)
    reads: float = p.transducer_polarity * (torque + offset + p.noise * sample_noise(p))
    return reads


@kernel
def encoder_rad(p: PlantRecord) -> float:
    """Return the encoder's angle [rad at the handle]."""
    angle: float = p.x
    return angle if p.eccentric == 0.0 else angle + p.eccentric * math.sin(p.eccentric_rad * angle)


@kernel
def coil_current(p: PlantRecord, brake_Nm: float) -> float:
    """Return the coil current [A] that the driver measures while it commands `brake_Nm`."""
    if p.coil_fault == COIL_SHORT and brake_Nm > 0.0:
        return SHORT_A
    current: float = p.coil * p.coil_A_Nm
    return 0.0 if p.coil_fault != COIL_INTACT else current


@kernel
def magnetise(p: PlantRecord) -> float:
    """Apply the coil's present current to the iron; return the torque that corresponds to it."""
    if p.coil > -1e-4 * p.brake_max:  # a lag only approaches 0
        p.remanent = max(p.remanent, p.remanence * p.coil)
        p.remanent_before = p.remanent
        return max(p.coil, p.remanent)
    left = p.remanent_before + p.coil
    p.remanent = min(p.remanent, max(left, 0.0))
    return max(p.remanent, -left)


@kernel
def heat_coil(p: PlantRecord, duration_s: float, square: float) -> None:
    """Heat the coil for `duration_s` with the mean `square` of its torque [Nm^2]."""
    target = p.ambient + p.K_A2 * square * p.coil_A_Nm * p.coil_A_Nm
    p.temperature = target + (p.temperature - target) * math.exp(-duration_s / p.thermal_s)


@inlined
def settled(value: float) -> float:
    """Return 0 for a value that has nearly decayed to 0: it would stay subnormal for ever, which slows the
    processor.
    """
    return 0.0 if abs(value) < NEGLIGIBLE_Nm else value


@inlined
def _inherent(p: PlantRecord) -> float:
    """Return the device's own friction at the present speed [Nm]."""
    if p.stribeck == 0.0:
        return float(p.coulomb)
    share = p.v / p.stribeck_v
    return float(p.coulomb + p.stribeck * math.exp(-share * share))


@kernel
def _move(p: PlantRecord, dt: float, drive: float, f_h: float, level: float, motor: float, capacity: float) -> float:
    """Advance by at most `dt` [s] without a change of the speed's sign.

    Return the remaining time [s].
    """
    x, v0 = p.x, p.v
    stiffness = p.operator_stiffness
    load = drive - stiffness * x
    if v0 == 0.0:
        if abs(load) <= level:  # stuck: the friction equals the load
            inherent = min(max(load, -p.inherent), p.inherent)
            p.f_friction = -inherent
            p.f_brake = inherent - load
            p.f_operator = f_h - stiffness * x
            return 0.0
        sign = 1.0 if load > 0.0 else -1.0
    else:
        sign = 1.0 if v0 > 0.0 else -1.0
    mass = p.inertia + p.operator_inertia
    damping = p.viscous + p.operator_damping
    c = 0.5 * dt * (damping + 0.5 * dt * stiffness)
    v1 = (v0 * (mass - c) + dt * (load - sign * level)) / (mass + c)
    left = 0.0
    if v1 * sign < 0.0:
        # The speed reaches zero inside the step, at the root of the midpoint rule (linear guess, one Newton
        # step).
        slope = load - sign * level - 0.5 * damping * v0
        t = -mass * v0 / slope
        curve = -0.25 * stiffness * v0
        t -= (mass * v0 + t * (slope + t * curve)) / (slope + 2.0 * t * curve)
        t = min(max(t, 0.0), dt)
        left = dt - t
        dt = t
        v1 = 0.0
    mean = 0.5 * (v0 + v1)
    way = mean * dt
    if dt > 0.0:
        p.f_operator = (
            f_h - p.operator_inertia * (v1 - v0) / dt - p.operator_damping * mean - stiffness * (x + 0.5 * way)
        )
    p.f_brake = -sign * capacity
    p.f_friction = -sign * p.inherent
    p.x = x + way
    p.v = v1
    p.w_operator += p.f_operator * way
    p.w_motor += motor * way
    p.w_brake += p.f_brake * way
    p.w_friction += p.f_friction * way
    p.w_viscous += p.viscous * mean * way
    return left


@inlined
def motor_target(p: PlantRecord) -> float:
    """Return the torque of the motor's command [Nm at the handle]."""
    motor_pm = min(max(p.motor_pm, -p.motor_peak_pm), p.motor_peak_pm)
    return float(motor_pm * p.motor_Nm_pm)


@inlined
def coil_target(p: PlantRecord) -> float:
    """Return the target of the coil torque [Nm], which corresponds to its current."""
    target = min(max(p.brake_Nm, 0.0), p.brake_max)
    if p.reverse_A > 0.0:
        target = -min(p.reverse_A / p.coil_A_Nm, p.brake_max)
    if p.coil_fault != COIL_INTACT:
        target = 0.0
    if p.coil_step > 0.0:
        target = math.floor(target / p.coil_step + 0.5) * p.coil_step
    return float(target)


@inlined
def drive_train(p: PlantRecord, target: float, coil_wants: float, remembers: bool) -> tuple[float, float]:
    """Advance motor, coil and fluid by a step; return the motor's mean torque and the brake's capacity [Nm].

    `remembers`: the iron is not demagnetised, or its current is negative.
    """
    motor = target + (p.motor - target) * p.motor_decay
    torque = 0.5 * (p.motor + motor)
    if p.cogging > 0.0:
        torque -= p.cogging * math.sin(p.cogging_rad * p.x)
    p.motor = motor
    p.coil = coil_wants + (p.coil - coil_wants) * p.coil_decay
    iron = magnetise(p) if remembers else p.coil
    p.fluid = iron + (p.fluid - iron) * p.fluid_decay
    p.inherent = _inherent(p)
    return torque, p.brake_gain * p.fluid + p.off_state + p.obstacle_Nm


@inlined
def keep_truth(p: PlantRecord, out: Floats) -> None:
    """Write the first columns of the true course, `TRUTH_COLUMNS` up to the works."""
    out[0] = p.t_ns * 1e-9
    out[1] = p.x
    out[2] = p.v
    out[3] = p.f_operator
    out[4] = p.f_motor
    out[5] = p.f_brake
    out[6] = p.f_friction
    out[7] = p.w_operator
    out[8] = p.w_motor
    out[9] = p.w_brake
    out[10] = p.w_friction
    out[11] = p.w_viscous


@kernel
def advance(p: PlantRecord, f_h: Floats, per_knot: int, first: int, steps: int, truth: Floats, row: int) -> None:
    """Advance the plant by `steps` of its steps with constant commands (`motor_pm`, `brake_Nm`,
    `reverse_A`).

    Parameters
    ----------
    p : the `PlantRecord`
    f_h : float64 array, the operator's muscle torque [Nm] at knots of `per_knot` steps each, linear
        between them
    first : the first step, counted from f_h[0]
    truth : float64 array (rows, len(TRUTH_COLUMNS)); rows from `row` on are written unless `row` is
        negative
    """
    target, coil_wants = motor_target(p), coil_target(p)
    remembers = p.remanence > 0.0 or coil_wants < 0.0 or p.coil < 0.0
    square = 0.0
    h = p.h
    knot = first // per_knot
    within = first - knot * per_knot
    slope = (f_h[knot + 1] - f_h[knot]) / per_knot
    for k in range(steps):
        torque, capacity = drive_train(p, target, coil_wants, remembers)
        square += p.coil * p.coil
        level = capacity + p.inherent
        hand = f_h[knot] + slope * (within + 0.5)
        drive = hand + torque
        p.f_motor = torque
        left = _move(p, h, drive, hand, level, torque, capacity)
        if left > 0.0:
            p.inherent = _inherent(p)
            _move(p, left, drive, hand, capacity + p.inherent, torque, capacity)
        if p.transducer_decay > 0.0:
            p.transduced = p.f_operator + (p.transduced - p.f_operator) * p.transducer_decay
        p.t_ns += p.step_ns
        within += 1
        if within == per_knot and k + 1 < steps:
            within = 0
            knot += 1
            slope = (f_h[knot + 1] - f_h[knot]) / per_knot
        if row >= 0:
            out = truth[row + k]
            keep_truth(p, out)
            out[12] = 0.5 * p.inertia * p.v * p.v
    p.motor, p.coil, p.fluid = settled(p.motor), settled(p.coil), settled(p.fluid)
    if p.K_A2 > 0.0 and steps > 0:
        heat_coil(p, steps * h, square / steps)
