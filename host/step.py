"""The cycle's compiled step: process image in, set-points out. The same code in virtual time, in real time and in replay.

A cycle is: `begin` (SYNC) - `on_frame` for what arrives - `finish` (measure, watch, phase, law, limits, RPDOs). `on_time` puts them in
order for whoever has an event loop; a loop with a socket calls them itself.

    OFF -> STILL -> ENABLE -> SIGN -> SETTLE -> RUN -> SAFE -> DISABLE -> DONE
                       any doubt, in any phase  ->  SAFE

Safety that lives here: the brake's set-point is never negative and never becomes motor torque; the motor's torque is limited in
size, rate and per mille, is never accelerating near the speed limit, and is 0 when stale; arming is refused unless the handle is still,
little loaded, and motor, encoder and transducer agree on the sign.
"""

from __future__ import annotations

from typing import Any

from eds.cia402 import CONTROLWORD_TO_ENABLE, STATE_OF_STATUSWORD, PowerState
from eds.codec import pack, unpack
from eds.compiled import kernel
from host.records import Image, Phase, SignResult, Trip
from host.watch import measure, watch_devices, watch_motion
from wire.frame import push

__all__ = ["SOURCE_HOST", "begin", "finish", "on_frame", "on_time"]

SOURCE_HOST = -1
"""Station number of the host in a queue and in a log."""

NONE, LAW = int(Trip.NONE), int(Trip.LAW)
OFF, STILL, ENABLE, SIGN = int(Phase.OFF), int(Phase.STILL), int(Phase.ENABLE), int(Phase.SIGN)
SETTLE, RUN, SAFE, DISABLE, DONE = (
    int(Phase.SETTLE),
    int(Phase.RUN),
    int(Phase.SAFE),
    int(Phase.DISABLE),
    int(Phase.DONE),
)
CONTROLWORD, TARGET_TORQUE = int(Image.CONTROLWORD), int(Image.TARGET_TORQUE)
BRAKE_SETPOINT, STATUSWORD = int(Image.BRAKE_SETPOINT), int(Image.STATUSWORD)
SWITCHED_ON, OPERATION_ENABLED = int(PowerState.SWITCHED_ON), int(PowerState.OPERATION_ENABLED)
FAULT = int(PowerState.FAULT)
SWITCH_ON_DISABLED = int(PowerState.SWITCH_ON_DISABLED)
EMCY_MOTOR, EMCY_BRAKE = int(Trip.EMCY_MOTOR), int(Trip.EMCY_BRAKE)
NOT_STILL, HANDLE_LOADED, ENABLE_TIMEOUT = int(Trip.NOT_STILL), int(Trip.HANDLE_LOADED), int(Trip.ENABLE_TIMEOUT)
SIGN_NO_MOTION, SIGN_ENCODER = int(Trip.SIGN_NO_MOTION), int(Trip.SIGN_ENCODER)
DEADMAN = int(Trip.DEADMAN)
SIGN_TRANSDUCER, SIGN_TRAVEL, DRIVE_STATE = int(Trip.SIGN_TRANSDUCER), int(Trip.SIGN_TRAVEL), int(Trip.DRIVE_STATE)
AGREED, NO_HAND, REFUSED = int(SignResult.AGREED), int(SignResult.NO_HAND), int(SignResult.REFUSED)

SWITCH_ON_WORD = 0x07
ENABLE_WORD = 0x0F
DISABLE_CYCLES = 100  # how long a drive may take to say that it is disabled
STILL_COUNTS = 1
SIGN_TRAVEL_FACTOR = 4  # the ramp ends at this multiple of the counts that the encoder's verdict needs
SPEED_TAPER = 0.8  # above this share of the speed limit the motor may only brake


@kernel
def _enter(h: Any, phase: int) -> None:
    h.phase = phase
    h.phase_cycle = 0
    h.reference_counts = h.counts
    h.still = 0


@kernel
def _trip(c: Any, h: Any, trip: int, t_ns: int) -> None:
    """Go to the safe state; only the first reason counts."""
    if h.phase >= SAFE:
        return
    if h.phase == SIGN:
        h.sign_result = REFUSED
    h.trip = trip
    h.trip_ns = t_ns
    h.safe_from_Nm = min(h.brake_Nm, c.safe_brake_Nm)
    _enter(h, SAFE)


@kernel
def _count_still(h: Any) -> None:
    if not h.fresh or abs(h.counts - h.reference_counts) > STILL_COUNTS:
        h.reference_counts = h.counts
        h.still = 0
    else:
        h.still += 1


@kernel
def _phase_still(c: Any, h: Any, state: int, t_ns: int) -> None:
    """Wait, switched on and without torque, until the handle has been still and little loaded for long enough."""
    _count_still(h)
    loaded = abs(h.handle_Nm) > c.still_handle_Nm
    if loaded or h.still == 0:
        h.still = 0
        h.handle_before_Nm = 0.0
        h.handle_samples = 0
    h.handle_before_Nm += h.handle_Nm
    h.handle_samples += 1
    if h.still >= c.still_cycles and state == SWITCHED_ON and h.deadman_ok:
        h.handle_before_Nm /= h.handle_samples
        _enter(h, ENABLE)
    elif h.phase_cycle > c.still_timeout_cycles:
        if state != SWITCHED_ON:
            _trip(c, h, ENABLE_TIMEOUT, t_ns)
        elif h.still >= c.still_cycles:
            _trip(c, h, DEADMAN, t_ns)
        else:
            _trip(c, h, HANDLE_LOADED if loaded else NOT_STILL, t_ns)


@kernel
def _arm(c: Any, h: Any, law: Any, t_ns: int) -> None:
    law.stuck = 1
    law.x_stuck = h.counts * c.rad_count
    law.psi_Nm = 0.0
    law.brake_Nm = 0.0
    h.gain = 0.0
    h.armed_ns = t_ns
    _enter(h, RUN)


@kernel
def _phase_sign(c: Any, h: Any, t_ns: int) -> float:
    """Ramp a small motor torque until the handle moves: the encoder must count with it, the hand must resist.

    Returns the motor's torque [Nm]. The encoder's verdict falls at `sign_counts`; the ramp goes on to a few times that, so that the hand's
    mean torque over `sign_hand_cycles` (a tremor's period) tells the transducer's sign. The positive sense is tried first. A hand that rests
    on the handle may hold it by friction against that; then the negative sense is tried, and nothing that moves before the torque has
    turned its sign is evidence.
    """
    u = h.motor_Nm * h.sign_direction  # torque in the sense that is tried
    if u < 0.0:
        h.reference_counts = h.counts
    moved = (h.counts - h.reference_counts) * h.sign_direction
    if c.rad_count < 0.0:
        moved = -moved
    if abs(moved) > c.sign_travel_counts:
        _trip(c, h, SIGN_TRAVEL, t_ns)
        return 0.0
    if moved <= -c.sign_counts:
        _trip(c, h, SIGN_ENCODER, t_ns)
        return 0.0
    limit = min(c.sign_torque_Nm, c.motor_limit_pm * abs(c.Nm_pm))
    if moved < SIGN_TRAVEL_FACTOR * c.sign_counts and u < limit:
        u = min(u + c.sign_step_Nm, limit)
    if moved < c.sign_counts:
        h.handle_during_Nm = 0.0
        h.handle_samples = 0
        if u >= limit:
            h.still += 1
            if h.still > c.sign_hand_cycles:
                if h.sign_direction < 0:
                    _trip(c, h, SIGN_NO_MOTION, t_ns)
                    return 0.0
                h.sign_direction = -1
                h.still = 0
                return u
        return u * h.sign_direction
    h.handle_during_Nm += h.handle_Nm
    h.handle_samples += 1
    if h.handle_samples < c.sign_hand_cycles:
        return u * h.sign_direction
    change = (h.handle_during_Nm / h.handle_samples - h.handle_before_Nm) * h.sign_direction
    if change > c.sign_hand_Nm:
        _trip(c, h, SIGN_TRANSDUCER, t_ns)
        return 0.0
    h.sign_result = AGREED if change < -c.sign_hand_Nm else NO_HAND
    _enter(h, SETTLE)
    return u * h.sign_direction


@kernel
def _phase_run(c: Any, h: Any, psi: float, law: Any) -> float:
    """Split the law by mode: the brake bears it, or the motor shows it; the motor compensates the inherent friction in slip."""
    h.gain = min(h.gain + c.gain_step, 1.0)
    torque = 0.0
    if abs(h.v_counts) > c.velocity_band_counts:
        torque = c.compensation_Nm if h.v_counts * c.rad_count > 0.0 else -c.compensation_Nm
    if c.motor_active:
        torque -= psi
    if c.brake_active:
        setpoint = law.brake_Nm
        if not setpoint >= 0.0:  # negative or NaN
            h.negative_setpoints += 1
            setpoint = 0.0
        h.brake_Nm = min(h.gain * setpoint, c.brake_limit_Nm)
    return h.gain * torque


@kernel
def _phase_safe(c: Any, h: Any) -> None:
    """Motor torque is 0 already; hold the brake until the handle is still, then ramp it off, then disable."""
    if h.ramp_cycle == 0:
        h.brake_Nm = h.safe_from_Nm
        still = h.fresh and abs(h.v_counts) <= STILL_COUNTS and h.phase_cycle > 1
        if still or h.phase_cycle >= c.safe_hold_cycles or h.safe_from_Nm == 0.0:
            h.ramp_cycle = 1
        return
    left = c.safe_ramp_cycles - h.ramp_cycle
    h.ramp_cycle += 1
    h.brake_Nm = h.safe_from_Nm * max(left, 0) / c.safe_ramp_cycles
    if left <= 0:
        _enter(h, DISABLE)


@kernel
def _limit_motor(c: Any, h: Any, wanted: float) -> float:
    """Return the motor torque [Nm] that may be sent: 0 when stale or not a number, then rate, speed and size."""
    if h.position_age > 1:
        return 0.0
    if wanted != wanted:
        h.clipped_torque += 1
        return 0.0
    torque = min(max(wanted, h.motor_Nm - c.motor_rate_Nm), h.motor_Nm + c.motor_rate_Nm)
    v = h.v_counts * c.rad_count * 1e9 / c.period_ns
    if abs(v) > SPEED_TAPER * c.speed_limit and torque * v > 0.0:
        torque = 0.0
    limit = c.motor_limit_pm * abs(c.Nm_pm)
    if abs(torque) <= limit:
        return torque
    h.clipped_torque += 1
    return limit if torque > 0.0 else -limit


@kernel
def begin(c: Any, h: Any, t_ns: int, queue: Any, header: Any) -> None:
    """Begin the cycle that is due at `t_ns`: count what the last one lost, send SYNC (and the host's heartbeat when due)."""
    if h.cycle > 0 and h.phase < SAFE and h.arrived != (1 << c.tpdos) - 1:
        h.lost_pdos += 1
    h.arrived = 0
    h.waiting = 1
    h.sync_ns = t_ns
    h.cycle += 1
    h.next_ns = t_ns + c.window_ns
    push(queue, header, SOURCE_HOST, t_ns, c.sync_cob_id, 0, 0)
    if c.heartbeat_ns > 0 and t_ns >= h.heartbeat_due_ns:
        h.heartbeat_due_ns = t_ns + c.heartbeat_ns
        push(queue, header, SOURCE_HOST, t_ns, 0x700 + c.host_id, 1, 5)


@kernel
def on_frame(c: Any, h: Any, tpdos: Any, t_ns: int, can_id: int, length: int, data: int) -> int:
    """Take a frame from the bus; return 1 when it completes this cycle's TPDOs, 2 when the control plane wants it, else 0."""
    for i in range(c.tpdos):
        if tpdos[i].cob_id == can_id:
            if length != tpdos[i].length:
                h.malformed_pdos += 1
                return 0
            unpack(tpdos[i], data, h.image)
            h.arrived |= 1 << i
            return 1 if h.waiting and h.arrived == (1 << c.tpdos) - 1 else 0
    function, node = can_id & 0x780, can_id & 0x7F
    if can_id > 0x7FF:
        h.stray_frames += 1
        return 0
    if function == 0x700 and length == 1:
        state = data & 0x7F
        known = node == c.motor_id or node == c.brake_id
        if node == c.motor_id:
            known = h.motor_nmt == state
            h.motor_nmt = state
            h.motor_heartbeat_ns = t_ns
        elif node == c.brake_id:
            known = h.brake_nmt == state
            h.brake_nmt = state
            h.brake_heartbeat_ns = t_ns
        return 0 if known else 2
    if function == 0x580:
        return 2
    if function == 0x080 and length == 8 and (node == c.motor_id or node == c.brake_id):
        code = data & 0xFFFF
        if code != 0 and h.emcy == NONE:
            h.emcy = EMCY_MOTOR if node == c.motor_id else EMCY_BRAKE
            h.emcy_code = code
        return 2
    h.stray_frames += 1
    return 0


@kernel
def finish(
    c: Any, h: Any, rpdos: Any, law_function: Any, motion: Any, law: Any, state: Any, t_ns: int, queue: Any, header: Any
) -> None:
    """Finish the cycle at `t_ns`: measure, watch, advance the phase, ask the law, limit, and send the RPDOs."""
    h.waiting = 0
    h.next_ns = h.sync_ns + c.period_ns
    if t_ns > h.next_ns:
        h.missed_deadlines += 1
    complete = h.arrived == (1 << c.tpdos) - 1
    h.missed_in_a_row = 0 if complete else h.missed_in_a_row + 1
    drive = STATE_OF_STATUSWORD[h.image[STATUSWORD] & 0x7F]

    trip = measure(c, h)
    if trip == NONE:
        trip = watch_motion(c, h)
    if trip == NONE:
        trip = watch_devices(c, h, t_ns)
    if trip == NONE and ENABLE < h.phase < SAFE and drive != OPERATION_ENABLED:
        trip = DRIVE_STATE
    if c.deadman_slot >= 0:
        h.deadman_ok = 1 if h.image[c.deadman_slot] != 0 else 0
    if trip == NONE and not h.deadman_ok and h.phase > STILL:
        trip = DEADMAN
    if trip == NONE and h.stop > 1:
        trip = h.stop
    if trip != NONE or (h.stop != 0 and h.phase < SAFE):
        _trip(c, h, trip, t_ns)

    wanted = 0.0
    h.phase_cycle += 1
    controlword = CONTROLWORD_TO_ENABLE[drive] if drive >= 0 else 0
    if h.phase == STILL:
        if drive == SWITCHED_ON:
            controlword = SWITCH_ON_WORD
        _phase_still(c, h, drive, t_ns)
    elif h.phase == ENABLE:
        if drive == OPERATION_ENABLED:
            h.enabled_ns = t_ns
            h.motor_Nm = 0.0
            if c.sign_check:
                h.sign_direction = 1
                _enter(h, SIGN)
            else:
                _arm(c, h, state, t_ns)
        elif h.phase_cycle > c.enable_timeout_cycles:
            _trip(c, h, ENABLE_TIMEOUT, t_ns)
    elif h.phase == SIGN:
        wanted = _phase_sign(c, h, t_ns)
    elif h.phase == SETTLE:
        _count_still(h)
        wanted = max(abs(h.motor_Nm) - 5.0 * c.sign_step_Nm, 0.0) * h.sign_direction
        if wanted == 0.0 and h.still >= c.settle_cycles:
            _arm(c, h, state, t_ns)
        elif h.phase_cycle > c.still_timeout_cycles:
            _trip(c, h, NOT_STILL, t_ns)
    elif h.phase == RUN:
        motion.x_rad = h.counts * c.rad_count
        motion.v_counts = h.v_counts * (1.0 if c.rad_count > 0.0 else -1.0)
        motion.v_rad_s = h.v_counts * c.rad_count * 1e9 / c.period_ns
        motion.handle_Nm = h.handle_Nm
        psi = law_function(motion, law, state)
        if psi == psi and state.brake_Nm == state.brake_Nm:
            state.psi_Nm = psi
            wanted = _phase_run(c, h, psi, state)
        else:  # not a number
            _trip(c, h, LAW, t_ns)

    if h.enabled_ns >= 0 and h.phase < SAFE:
        h.display_cycles += 1
    if SIGN <= h.phase <= RUN:
        controlword = ENABLE_WORD
        h.motor_Nm = _limit_motor(c, h, wanted)
    else:
        h.motor_Nm = 0.0
        if h.phase == SAFE:
            controlword = ENABLE_WORD if drive == OPERATION_ENABLED else 0
            _phase_safe(c, h)
        elif h.phase == DISABLE or h.phase == DONE or h.phase == OFF:
            controlword = 0
            h.brake_Nm = 0.0
            disabled = drive in (SWITCH_ON_DISABLED, FAULT)
            if h.phase == DISABLE and (disabled or h.phase_cycle > DISABLE_CYCLES):
                _enter(h, DONE)

    h.image[CONTROLWORD] = controlword
    h.image[TARGET_TORQUE] = round(h.motor_Nm / c.Nm_pm)
    h.image[BRAKE_SETPOINT] = min(
        max(round(h.brake_Nm / c.brake_Nm_raw), 0), c.brake_limit_raw
    )  # unsigned, and no wrap
    for i in range(c.rpdos):
        push(queue, header, SOURCE_HOST, t_ns, rpdos[i].cob_id, rpdos[i].length, pack(rpdos[i], h.image))


@kernel
def on_time(
    c: Any, h: Any, rpdos: Any, law_function: Any, motion: Any, law: Any, state: Any, t_ns: int, queue: Any, header: Any
) -> None:
    """Do what is due at `t_ns` and set `next_ns`: the end of the window for TPDOs, or the next cycle."""
    if h.waiting:
        finish(c, h, rpdos, law_function, motion, law, state, t_ns, queue, header)
    if t_ns >= h.sync_ns + c.period_ns or h.cycle == 0:
        begin(c, h, t_ns, queue, header)
