"""The phases of the cycle, compiled: arming, display of the law, and safe state.

Each phase has one function. It runs one cycle of the phase, and returns the motor's torque [Nm] before
the limits and the next phase. `host.cycle.transitions` has the table of transitions and their
conditions. `enter` initialises a phase.

    c : the CONTROL record of an axis        h : its HOST record        axis : the `AxisRecord`, which holds both and the law
"""

from __future__ import annotations

import math

from coulombus.eds.cia402 import INTERNAL_LIMIT, PowerState
from coulombus.host.cycle.brake_model import brake_level, lead
from coulombus.host.cycle.hand_over import bear, hands_over, ramp_gain, take_over
from coulombus.host.cycle.passivity import observe
from coulombus.host.cycle.records import (
    KINETIC_CYCLES,
    AxisRecord,
    ControlRecord,
    HostRecord,
    Image,
    LawFunction,
    Phase,
    SignResult,
    Trip,
)
from coulombus.host.cycle.slow_velocity import slide_velocity
from coulombus.host.cycle.study_delay import forget, hold_back
from coulombus.host.cycle.transitions import BRAKE_CONTROLWORDS, CONTROLWORDS
from coulombus.host.world.local_model import add_model, follow_model
from coulombus.kernels.decorator import kernel

__all__ = [
    "advance",
    "count_still",
    "disable",
    "enable",
    "enter",
    "run",
    "run_joint",
    "safe",
    "settle",
    "sign_check",
    "split_law",
    "still",
    "trip_to_safe",
]

SIGN_TRAVEL_FACTOR = 4  # the ramp ends at this multiple of the counts that the encoder's verdict needs
SETTLE_STEPS = 5.0  # the sign check's torque falls this many times as fast as it rose
DISABLE_CYCLES = 100  # longest wait for the drive to report that it is disabled


@kernel
def _begin(h: HostRecord, phase: int) -> None:
    h.phase = phase
    h.phase_cycle = 0
    h.ready = 0
    h.reference_counts = h.counts
    h.still = 0


@kernel
def enter(axis: AxisRecord, phase: int, t_ns: int) -> None:
    """Begin a phase other than SAFE."""
    c, h, state = axis.control, axis.host, axis.state
    if phase == Phase.SIGN:
        h.sign_direction = 1
        h.sign_moved = 0
    elif phase == Phase.RUN:  # stuck at the handle's position, with gain 0
        state.stuck = 1
        state.x_stuck = h.counts * c.rad_count
        state.psi_Nm = 0.0
        state.brake_Nm = state.motor_Nm = 0.0
        h.gain = h.pushed_Nm = h.contact_J = 0.0
        h.share, h.port_J, h.track_length = 1.0, 0.0, 0
        for k in range(KINETIC_CYCLES):
            h.port_kinetic_J[k] = 0.0
        h.port_handle_Nm = h.handle_Nm
        h.port_pushed_Nm, h.port_way, h.port_slid_ns = 0.0, 0.0, 0
        h.displayed_Nm = 0.0
        h.end_cycles = 0
        h.felt_v_counts = h.mean_v_counts = h.felt_error_Nm = h.mean_error_Nm = h.mean_size_Nm = 0.0
        h.felt_wrong = 0
        for k in range(2):
            h.side[k], h.reversals[k] = 0, 0.0
        forget(h)
        h.armed_ns = t_ns
    _begin(h, phase)


@kernel
def trip_to_safe(c: ControlRecord, h: HostRecord, trip: int, t_ns: int) -> None:
    """Enter the safe state; only the first reason counts.

    The brake begins with the torque that the hand feels (`take_over`). After an orderly end's hand-over it
    bears that torque already.
    """
    if h.phase >= Phase.SAFE:
        return
    if h.phase == Phase.SIGN:
        h.sign_result = SignResult.REFUSED
    h.trip = trip
    h.trip_ns = t_ns
    if h.end_cycles == 0:
        take_over(c, h)
    h.brake_Nm = bear(c, h)
    _begin(h, Phase.SAFE)


@kernel
def _refuse(h: HostRecord, trip: int) -> tuple[float, int]:
    """Leave the phase for the safe state, with the reason `trip`."""
    h.trip = trip
    return 0.0, Phase.SAFE


@kernel
def count_still(c: ControlRecord, h: HostRecord) -> None:
    """Count the cycles in a row in which the handle is still."""
    if not h.fresh or abs(h.counts - h.reference_counts) > c.still_counts:
        h.reference_counts = h.counts
        h.still = 0
    else:
        h.still += 1


@kernel
def still(c: ControlRecord, h: HostRecord) -> tuple[float, int]:
    """STILL: wait without torque, with the drive switched on, until the handle has been still and not
    loaded for long enough.
    """
    count_still(c, h)
    loaded = abs(h.handle_Nm) > c.still_handle_Nm
    if h.held:
        h.still = h.phase_cycle = 0
    if loaded or h.still == 0:
        h.still = 0
        h.handle_before_Nm = 0.0
        h.handle_samples = 0
    h.handle_before_Nm += h.handle_Nm
    h.handle_samples += 1
    switched_on = h.drive == PowerState.SWITCHED_ON and h.brake_drive == PowerState.SWITCHED_ON
    if h.still >= c.still_cycles and switched_on and h.deadman_ok:
        h.handle_before_Nm /= h.handle_samples
        return 0.0, Phase.ENABLE
    if h.phase_cycle > c.still_timeout_cycles:
        if not switched_on:
            return _refuse(h, Trip.ENABLE_TIMEOUT)
        if h.still >= c.still_cycles:
            return _refuse(h, Trip.DEADMAN)
        return _refuse(h, Trip.HANDLE_LOADED if loaded else Trip.NOT_STILL)
    return 0.0, Phase.STILL


@kernel
def enable(c: ControlRecord, h: HostRecord, t_ns: int) -> tuple[float, int]:
    """ENABLE: wait until the drive, and a brake with power states, report Operation Enabled.

    A mode with a motor continues with the sign check.
    """
    if h.drive == PowerState.OPERATION_ENABLED and h.brake_drive == PowerState.OPERATION_ENABLED:
        h.enabled_ns = t_ns
        h.torque_Nm = 0.0
        return 0.0, Phase.SIGN if c.sign_check else Phase.RUN
    if h.phase_cycle > c.enable_timeout_cycles:
        return _refuse(h, Trip.ENABLE_TIMEOUT)
    return 0.0, Phase.ENABLE


@kernel
def sign_check(c: ControlRecord, h: HostRecord) -> tuple[float, int]:
    """SIGN: ramp a small motor torque until the handle moves; the encoder must count in its direction, and
    the hand must resist.

    The encoder's sign is decided at `sign_counts`; the ramp continues to a few times that. If the handle
    is fast by then, the torque is reduced. The hand's mean torque over `sign_hand_cycles` (a tremor's
    period) decides the transducer's sign. The positive direction is tried first. A hand that rests on the
    handle may hold it by friction; then the negative direction is tried. Motion before the torque has
    changed its sign is not counted.
    """
    u = h.torque_Nm * h.sign_direction  # torque in the sense that is tried
    if u < 0.0:
        h.reference_counts = h.counts
    moved = (h.counts - h.reference_counts) * h.sign_direction
    if c.rad_count < 0.0:
        moved = -moved
    if abs(moved) > c.sign_travel_counts:
        return _refuse(h, Trip.SIGN_TRAVEL)
    if moved <= -c.sign_counts:
        return _refuse(h, Trip.SIGN_ENCODER)
    limit = min(c.sign_torque_Nm, c.motor_limit_raw * abs(c.motor_Nm_raw))
    if moved < SIGN_TRAVEL_FACTOR * c.sign_counts:
        u = min(u + c.sign_step_Nm, limit)
    elif abs(h.v_counts) > c.release_counts:  # a light handle without a hand would run away
        u = max(u - SETTLE_STEPS * c.sign_step_Nm, 0.0)
    if moved < c.sign_counts:
        h.handle_during_Nm = 0.0
        h.handle_samples = 0
        if u >= limit:
            h.still += 1
            if h.still > c.sign_hand_cycles:
                h.sign_moved = max(h.sign_moved, moved)
                if h.sign_direction < 0:
                    return _refuse(h, Trip.SIGN_NO_MOTION)
                h.sign_direction = -1
                h.still = 0
                return u, Phase.SIGN
        return u * h.sign_direction, Phase.SIGN
    h.handle_during_Nm += h.handle_Nm
    h.handle_samples += 1
    if h.handle_samples < c.sign_hand_cycles:
        return u * h.sign_direction, Phase.SIGN
    change = (h.handle_during_Nm / h.handle_samples - h.handle_before_Nm) * h.sign_direction
    if change > c.sign_hand_Nm:
        return _refuse(h, Trip.SIGN_TRANSDUCER)
    h.sign_result = SignResult.AGREED if change < -c.sign_hand_Nm else SignResult.NO_HAND
    return u * h.sign_direction, Phase.SETTLE


@kernel
def settle(c: ControlRecord, h: HostRecord) -> tuple[float, int]:
    """SETTLE: ramp the sign check's torque to 0, and wait until the handle is still, and all joints are."""
    count_still(c, h)
    torque_Nm = max(abs(h.torque_Nm) - SETTLE_STEPS * c.sign_step_Nm, 0.0) * h.sign_direction
    h.ready = 1 if torque_Nm == 0.0 and h.still >= c.settle_cycles else 0
    if h.ready and not h.held:
        return torque_Nm, Phase.RUN
    if h.phase_cycle > c.still_timeout_cycles and not h.held:
        return _refuse(h, Trip.NOT_STILL)
    return torque_Nm, Phase.SETTLE


@kernel
def split_law(axis: AxisRecord) -> float:
    """Split the law's output between brake and motor; return the motor's torque [Nm].

    In active the motor displays the law; in passive and hybrid the brake does. In hybrid the motor also
    displays `state.motor_Nm`, the part that a brake cannot produce.

    In slip the motor compensates the inherent friction, as far as the passivity observer allows. The
    withheld part of the compensation is added to the brake's set-point.
    """
    c, h = axis.control, axis.host
    ramp_gain(c, h)
    torque_Nm, given_Nm, withheld_Nm = 0.0, 0.0, 0.0
    sense = 0.0
    if abs(h.slide_counts) > c.slide_band_counts:
        sense = 1.0 if h.slide_counts * c.rad_count > 0.0 else -1.0
    pushed_Nm = 0.0
    if c.motor_active:
        pushed_Nm = axis.state.psi_Nm
    elif c.is_hybrid:
        pushed_Nm = axis.state.motor_Nm
    setpoint = axis.state.brake_Nm
    if axis.world.on:
        pushed_Nm, setpoint = add_model(axis.world, axis.motion, c.compensation_Nm, pushed_Nm, setpoint)
    sense, pushed_Nm, setpoint = hold_back(c, h, sense, pushed_Nm, setpoint)
    if sense != 0.0:
        given_Nm = h.share * c.compensation_Nm
        withheld_Nm = c.compensation_Nm - given_Nm
        torque_Nm = sense * given_Nm
        if withheld_Nm > 0.0:
            h.withheld_compensation += 1
    torque_Nm -= pushed_Nm
    h.pushed_Nm = h.gain * pushed_Nm
    if axis.world.on:
        h.world_Nm, h.world_elastic_Nm = h.gain * axis.world.world_Nm, h.gain * axis.world.elastic_Nm
        h.world_most_J = axis.world.most_J
    if h.end_cycles > 0:
        h.brake_Nm = bear(c, h)
    elif c.brake_active:
        if not setpoint >= 0.0:  # negative or NaN
            h.negative_setpoints += 1
            setpoint = 0.0
        if c.level_is_felt:
            setpoint = brake_level(c, h, setpoint, given_Nm)
        setpoint = _within_limit(c, h, h.gain * setpoint + withheld_Nm)
        h.brake_Nm = _at_its_rates(c, h, lead(c, h, setpoint))
    return h.gain * torque_Nm


@kernel
def _within_limit(c: ControlRecord, h: HostRecord, setpoint: float) -> float:
    """Return the brake's set-point [Nm], at most its limit."""
    if setpoint <= c.brake_limit_Nm:
        return setpoint
    if setpoint > c.brake_limit_Nm + c.brake_Nm_raw:  # less than a count is rounding
        h.clipped_setpoints += 1
        h.clipped = 1
    return float(c.brake_limit_Nm)


@kernel
def _at_its_rates(c: ControlRecord, h: HostRecord, setpoint: float) -> float:
    """Return the brake's set-point [Nm], which rises and falls from the last one by at most its limits.

    A fall that is too fast counts: the hand feels more than the law. A rise comes some milliseconds later.
    """
    lowest_Nm = min(h.brake_Nm - c.brake_fall_Nm, c.brake_limit_Nm)
    if not setpoint < lowest_Nm:
        return float(min(setpoint, h.brake_Nm + c.brake_rise_Nm))
    h.slowed_setpoints += 1
    h.clipped = 1
    return float(lowest_Nm)


@kernel
def run_joint(axis: AxisRecord, t_ns: int) -> tuple[float, int]:
    """RUN of a joint: bound the share that the law in the plane has given it (`host.cycle.joints`)."""
    c, h, state = axis.control, axis.host, axis.state
    if h.end_cycles > 0:
        h.brake_Nm = bear(c, h)
    elif c.brake_active:
        h.brake_Nm = _at_its_rates(c, h, _within_limit(c, h, max(state.brake_Nm, 0.0)))
    if h.full_gain_ns < 0 and h.gain >= 1.0:
        h.full_gain_ns = t_ns
    if h.image[Image.STATUSWORD] & INTERNAL_LIMIT:
        h.limited_by_drive += 1
    return -state.motor_Nm, Phase.RUN


@kernel
def run(axis: AxisRecord, law_function: LawFunction, t_ns: int) -> tuple[float, int]:
    """RUN: evaluate the law, and split its output between motor and brake."""
    c, h, motion, state = axis.control, axis.host, axis.motion, axis.state
    motion.x_rad = h.counts * c.rad_count
    slide_velocity(c, h)
    if c.passivity_J < math.inf:
        h.share = observe(c, h)
    motion.v_counts = h.slide_counts * (1.0 if c.rad_count > 0.0 else -1.0)
    motion.v_rad_s = h.slide_counts * c.rad_count * 1e9 / c.period_ns
    motion.handle_Nm = h.handle_Nm
    law = axis.law
    if axis.world.on:
        follow_model(axis.world, motion, axis.law, state)
        law = axis.world.law
    psi_Nm = law_function(motion, law, state)
    if not math.isfinite(psi_Nm):
        h.law_Nm = psi_Nm
        return _refuse(h, Trip.LAW)
    if not math.isfinite(state.brake_Nm):
        h.law_Nm = state.brake_Nm
        h.law_part = 1
        return _refuse(h, Trip.LAW)
    if not math.isfinite(state.motor_Nm):
        h.law_Nm = state.motor_Nm
        h.law_part = 2
        return _refuse(h, Trip.LAW)
    state.psi_Nm = psi_Nm
    torque_Nm = split_law(axis)
    if h.full_gain_ns < 0 and h.gain >= 1.0:
        h.full_gain_ns = t_ns
    if h.image[Image.STATUSWORD] & INTERNAL_LIMIT:
        h.limited_by_drive += 1
    return torque_Nm, Phase.RUN


@kernel
def safe(c: ControlRecord, h: HostRecord) -> tuple[float, int]:
    """SAFE: no motor torque; release the brake slowly enough for a loaded hand.

    The set-point falls by at most `release_Nm` a cycle, and pauses while the handle is faster than
    `release_counts`. A valid transducer signal refines this: once the set-point is near the load, it
    falls to 0 over the whole remaining time; without a load it falls by `unloaded_Nm` a cycle. An upper
    bound falls by `release_Nm` a cycle and reaches 0 at `safe_longest_cycles`, so the hand is free by
    then.
    """
    left = c.safe_longest_cycles - h.phase_cycle
    load_Nm = abs(h.handle_Nm)
    believed = c.still_handle_Nm < math.inf and h.missed_in_a_row == 0 and h.trip != Trip.HANDLE_TORQUE
    fall_Nm = c.release_Nm
    if believed and load_Nm <= c.still_handle_Nm:
        fall_Nm = c.unloaded_Nm
    elif believed and h.level_Nm <= load_Nm + c.still_handle_Nm:
        fall_Nm = h.level_Nm / (left + 1)  # at most release_Nm, because of the upper bound below
    elif h.fresh and abs(h.v_counts) > c.release_counts:
        fall_Nm = 0.0
    h.level_Nm = max(min(h.level_Nm - fall_Nm, c.release_Nm * left), 0.0)
    h.brake_Nm = bear(c, h)
    return 0.0, Phase.SAFE if h.level_Nm > 0.0 or h.phase_cycle <= 1 else Phase.DISABLE


@kernel
def disable(h: HostRecord) -> tuple[float, int]:
    """DISABLE: no torque; wait until the drive reports that it is disabled, at most `DISABLE_CYCLES`."""
    h.brake_Nm = 0.0
    motor = h.drive == PowerState.SWITCH_ON_DISABLED or h.drive == PowerState.FAULT
    brake = h.brake_drive == PowerState.SWITCH_ON_DISABLED or h.brake_drive == PowerState.FAULT
    disabled = motor and brake
    return 0.0, Phase.DONE if disabled or h.phase_cycle > DISABLE_CYCLES else Phase.DISABLE


@kernel
def _act(axis: AxisRecord, law_function: LawFunction | None, t_ns: int) -> tuple[float, int]:
    """Run one cycle of the present phase, and set its controlword.

    `law_function` None: the axis is a joint of an arm, whose law was evaluated before. Return the motor's torque [Nm] and the next phase.
    """
    c, h = axis.control, axis.host
    h.image[Image.CONTROLWORD] = CONTROLWORDS[h.phase, h.drive]
    h.image[Image.BRAKE_CONTROLWORD] = BRAKE_CONTROLWORDS[h.phase, h.brake_drive]
    if h.phase == Phase.STILL:
        return still(c, h)
    if h.phase == Phase.ENABLE:
        return enable(c, h, t_ns)
    if h.phase == Phase.SIGN:
        return sign_check(c, h)
    if h.phase == Phase.SETTLE:
        return settle(c, h)
    if h.phase == Phase.RUN:
        return run_joint(axis, t_ns) if law_function is None else run(axis, law_function, t_ns)
    if h.phase == Phase.SAFE:
        return safe(c, h)
    if h.phase == Phase.DISABLE:
        return disable(h)
    h.brake_Nm = 0.0  # OFF, DONE
    return 0.0, h.phase


@kernel
def advance(axis: AxisRecord, law_function: LawFunction | None, doubt: int, t_ns: int) -> float:
    """Advance the axis' phase by one cycle; return the motor's torque [Nm] before the limits.

    A trip of a monitor (`doubt`) or of the phase itself, or a stop request, makes the axis safe in the
    same cycle. Only the first reason counts. At an orderly end the brake first takes over what the motor
    displays (`hands_over`). `law_function` None: see `run_joint`.
    """
    c, h = axis.control, axis.host
    if doubt == Trip.NONE and hands_over(c, h):
        if h.end_cycles == 0:
            take_over(c, h)
        h.end_cycles += 1
    elif doubt != Trip.NONE or h.stop != 0:
        trip_to_safe(c, h, doubt, t_ns)
    h.phase_cycle += 1
    torque_Nm, following = _act(axis, law_function, t_ns)
    if following == Phase.SAFE and h.phase < Phase.SAFE:
        trip_to_safe(c, h, h.trip, t_ns)
        torque_Nm, following = _act(axis, law_function, t_ns)
    if following != h.phase:
        enter(axis, following, t_ns)
    if h.enabled_ns >= 0 and h.phase < Phase.SAFE and h.end_cycles == 0:
        h.display_cycles += 1
    return torque_Nm
