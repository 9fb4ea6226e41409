r"""The local model in the cycle, compiled: wall, spring, field and torque profile beside the law.

A model acts from the cycle that takes it until its time to live is over. Then its share :math:`s` falls
from 1 to 0 along a ramp. Torques here have the sign of :math:`\psi`: a positive one resists motion in the
positive sense.

.. math:: \psi_{el} = \underbrace{\sigma K_w p}_{p > 0} + \mathrm{sat}(K_s (x - x_s)) - (a + b x), \qquad
          \psi_d = B v, \qquad p = \sigma (x - x_w)

The wall never pulls: its damping on the way out is at most :math:`K_w p`. A field with negative damping
and a profile drive; they are no part of :math:`\psi_{el}`.

- Active: the motor shows all of it.
- Hybrid: the motor shows what pushes, up to its limit. The brake shows the damping, and what the motor
  cannot show, as long as that resists.
- Passive: the brake shows what resists.

What resists is decided by the direction of motion; at rest by that of the hand's torque. Everything is
limited here before it is added to the law's output: size and rate of the motor's torque, size and fall of
the brake's. The limits behind it (`host.cycle.step`, `host.cycle.phases`) hold all the same.

    w : the `LocalModelRecord` of an axis        m : the `ModelRecord` in use
"""

from __future__ import annotations

from coulombus.host.laws.law import USER, LawRecord, LawStateRecord, MotionRecord
from coulombus.host.world.records import OFFERS, LocalModelRecord, ModelParts, ModelRecord
from coulombus.host.world.softening import come_back, feeds_a_swing, keep_stiffness, soften
from coulombus.kernels.decorator import kernel

__all__ = ["ACTIVE", "HYBRID", "PASSIVE", "add_model", "advance_model", "follow_model", "parameter_of", "sampled"]

PASSIVE, HYBRID, ACTIVE = 0, 1, 2
"""Values of `LocalModelRecord.mode`."""
ROUNDING_NM = 1e-9
WALL, SPRING, FIELD = int(ModelParts.WALL), int(ModelParts.SPRING), int(ModelParts.FIELD)
PROFILE, PARAMETERS = int(ModelParts.PROFILE), int(ModelParts.PARAMETERS)


@kernel
def _clip(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)


@kernel
def _adopt_newest(w: LocalModelRecord) -> bool:
    """Change to the newest model; return whether its field begins."""
    before = w.offered[w.taken % OFFERS].parts if w.share > 0.0 else 0
    w.taken = w.wanted
    m = w.offered[w.taken % OFFERS]
    keep_stiffness(w)
    w.left_ns = m.life_ns
    w.share = 1.0
    if m.parts & PROFILE and m.profile != w.profile:
        w.profile = m.profile
        w.profile_ns = -w.period_ns
    return bool(m.parts & FIELD and not before & FIELD)


@kernel
def advance_model(w: LocalModelRecord) -> bool:
    """Begin a cycle: take the newest model, count its time to live, and fade; return whether a field begins."""
    begins = False
    if w.wanted != w.taken:
        begins = _adopt_newest(w)
    elif w.left_ns > 0:
        w.left_ns -= w.period_ns
    if w.left_ns <= 0 and w.share > 0.0:
        w.share = max(w.share - w.ramp_step, 0.0)
        if w.share == 0.0:
            w.fades += 1
    w.law_share = w.rest + (w.offered[w.taken % OFFERS].law - w.rest) * w.share
    w.profile_ns += w.period_ns
    return begins


@kernel
def sampled(w: LocalModelRecord) -> float:
    """Return the present sample of the profile, 0 before its begin and after its end."""
    m = w.offered[w.taken % OFFERS]
    if m.parts & PROFILE and m.sample_ns > 0:
        row = w.profile_ns // m.sample_ns
        if row < m.samples:
            return float(m.sample[row])
    return 0.0


@kernel
def parameter_of(m: ModelRecord, slot: int, present: float, share: float) -> float:
    """Return a parameter between its value in the rig and its value in the model."""
    if m.parameters >> slot & 1:
        return present + (m.parameter[slot] - present) * share
    return present


@kernel
def _set_law(w: LocalModelRecord, law: LawRecord, state: LawStateRecord, x_rad: float) -> None:
    """Set `w.law`: the rig's parameters, with those of the model.

    While the handle is stuck, a change of K_p keeps the force: :math:`x_{stuck}` is shifted.
    """
    m, mixed = w.offered[w.taken % OFFERS], w.law
    share = w.share if m.parts & PARAMETERS else 0.0
    mixed.velocity_band_counts = law.velocity_band_counts
    mixed.paper_entry, mixed.brake_spring = law.paper_entry, law.brake_spring
    mixed.K_p = parameter_of(m, 0, law.K_p, share)
    mixed.F_s = parameter_of(m, 1, law.F_s, share)
    mixed.F_d = parameter_of(m, 2, law.F_d, share)
    for k in range(USER):
        mixed.user[k] = parameter_of(m, 4 + k, law.user[k], share)
    ratio = mixed.K_p / law.K_p if law.K_p > 0.0 else 1.0
    if state.stuck != 0 and ratio != w.K_p_ratio:
        state.x_stuck = x_rad - (x_rad - state.x_stuck) * (w.K_p_ratio / ratio)
    w.K_p_ratio = ratio


@kernel
def follow_model(w: LocalModelRecord, motion: MotionRecord, law: LawRecord, state: LawStateRecord) -> None:
    """Begin a cycle of an axis: advance the model, and set the law's parameters."""
    if feeds_a_swing(w, motion.x_rad):
        soften(w)
    if advance_model(w):
        w.field_from_rad = motion.x_rad
    _set_law(w, law, state, motion.x_rad)


@kernel
def _elastic(w: LocalModelRecord, x_rad: float) -> float:
    """Return what wall, spring and field exert [Nm]; set the energy that they can return at most."""
    m, elastic_Nm, most_J = w.offered[w.taken % OFFERS], 0.0, 0.0
    if m.parts & WALL:
        depth = m.wall_side * (x_rad - m.wall_x_rad)
        if depth > 0.0:
            wall_Nm = (1.0 - w.softened) * m.wall_K_Nm_rad * depth
            elastic_Nm += m.wall_side * wall_Nm
            most_J += min(wall_Nm, w.motor_limit_Nm) * depth
    if m.parts & SPRING:
        away = x_rad - m.spring_x_rad
        spring_Nm = _clip((1.0 - w.softened) * m.spring_K_Nm_rad * away, m.spring_most_Nm)
        elastic_Nm += spring_Nm
        most_J += min(abs(spring_Nm), w.motor_limit_Nm) * abs(away)
    if m.parts & FIELD:
        field_Nm = -(m.field_Nm + m.field_Nm_rad * x_rad)
        if m.field_Nm_rad != 0.0:
            field_Nm *= 1.0 - w.softened
        elastic_Nm += field_Nm
        most_J += min(abs(field_Nm), w.motor_limit_Nm) * abs(x_rad - w.field_from_rad)
    w.most_J = w.share * most_J
    return w.share * elastic_Nm


@kernel
def _damping(w: LocalModelRecord, x_rad: float, v: float) -> float:
    """Return what resists the motion [Nm]."""
    m, damping_Nm = w.offered[w.taken % OFFERS], 0.0
    if m.parts & WALL:
        depth = m.wall_side * (x_rad - m.wall_x_rad)
        if depth > 0.0:
            wall_Nm = m.wall_side * m.wall_B_Nms_rad * v  # positive: on the way in
            damping_Nm += m.wall_side * max(wall_Nm, -m.wall_K_Nm_rad * depth)
    if m.parts & SPRING:
        damping_Nm += _clip(m.spring_B_Nms_rad * v, m.spring_most_Nm)
    if m.parts & FIELD and m.field_Nms_rad < 0.0:
        damping_Nm -= m.field_Nms_rad * v
    return w.share * (1.0 - w.softened) * damping_Nm


@kernel
def _drive(w: LocalModelRecord, v: float) -> float:
    """Return what neither resists nor returns energy [Nm]: the profile, and a field that drives."""
    m, drive_Nm = w.offered[w.taken % OFFERS], -sampled(w)
    if m.parts & FIELD and m.field_Nms_rad > 0.0:
        drive_Nm -= m.field_Nms_rad * v
    return w.share * drive_Nm


@kernel
def _sense(w: LocalModelRecord, motion: MotionRecord) -> float:
    """Return the direction of the motion; at rest that of the hand's torque; 0: unknown."""
    if abs(motion.v_counts) > w.law.velocity_band_counts:
        return 1.0 if motion.v_counts > 0.0 else -1.0
    if motion.handle_Nm == 0.0:
        return 0.0
    return 1.0 if motion.handle_Nm > 0.0 else -1.0


@kernel
def add_model(
    w: LocalModelRecord, motion: MotionRecord, compensation_Nm: float, law_Nm: float, law_brake_Nm: float
) -> tuple[float, float]:
    """Return the torques of law and model: the motor's, with the sign of psi, and the brake's [Nm].

    `law_Nm` and `law_brake_Nm` are the law's. The motor also compensates friction, with up to
    `compensation_Nm`, for which its limit leaves room.
    """
    base_Nm, base_brake_Nm = w.law_share * law_Nm, w.law_share * law_brake_Nm
    ahead_rad = motion.x_rad + motion.v_rad_s * w.ahead_s  # where the handle is when the torque acts
    elastic_Nm, damping_Nm = _elastic(w, ahead_rad), _damping(w, ahead_rad, motion.v_rad_s)
    drive_Nm = _drive(w, motion.v_rad_s)
    push_Nm = elastic_Nm + drive_Nm
    own_Nm = push_Nm + damping_Nm if w.mode == ACTIVE else push_Nm if w.mode == HYBRID else 0.0

    room_Nm = max(w.motor_limit_Nm - compensation_Nm, 0.0)
    wanted_Nm = base_Nm + own_Nm
    torque_Nm = min(max(wanted_Nm, min(-room_Nm, base_Nm)), max(room_Nm, base_Nm))
    limited = w.share > 0.0 or w.apart != 0
    if limited:
        torque_Nm = min(max(torque_Nm, w.pushed_Nm - w.motor_rate_Nm), w.pushed_Nm + w.motor_rate_Nm)
    w.world_Nm = torque_Nm - base_Nm
    m = w.offered[w.taken % OFFERS]
    constant_Nm = w.share * m.field_Nm if m.parts & FIELD and m.field_Nm_rad == 0.0 else 0.0
    w.driven_Nm = 0.0 if w.mode == PASSIVE else _clip(drive_Nm - constant_Nm, room_Nm)
    # by the position alone: else what a limited motor returns on the way out is not what the hand has put in
    stored_Nm = _elastic(w, motion.x_rad)
    w.elastic_Nm = 0.0 if w.mode == PASSIVE else _clip(stored_Nm, room_Nm)
    if room_Nm > 0.0:
        w.demand = max(w.demand, abs(elastic_Nm) / room_Nm)
    come_back(w, stored_Nm != 0.0)

    left_Nm = push_Nm - w.world_Nm  # what the motor does not show
    resisting_Nm = 0.0 if w.mode == ACTIVE else max(_sense(w, motion) * (left_Nm + damping_Nm), 0.0)
    wanted_brake_Nm = base_brake_Nm + resisting_Nm
    brake_Nm = min(wanted_brake_Nm, max(w.brake_limit_Nm, base_brake_Nm))
    if limited:
        brake_Nm = max(brake_Nm, min(w.brake_Nm - w.brake_fall_Nm, w.brake_limit_Nm))
        short_Nm = abs(wanted_Nm - torque_Nm) - resisting_Nm  # the brake shows what the motor cannot
        if short_Nm > ROUNDING_NM or abs(wanted_brake_Nm - brake_Nm) > ROUNDING_NM:
            w.clipped += 1
    w.world_brake_Nm = brake_Nm - base_brake_Nm
    w.apart = 1 if w.share > 0.0 or w.world_Nm != 0.0 or w.world_brake_Nm != 0.0 else 0
    w.pushed_Nm, w.brake_Nm = torque_Nm, brake_Nm
    return torque_Nm, brake_Nm
