"""The cycle's compiled step: process image in, set-points out. The same code in virtual time, in real time and in replay.

A cycle is: `begin` (SYNC) - `on_frame` for what arrives - `finish` (measure, watch, phase, law, limits, RPDOs), each for one axis. `host.cycle.axes`
calls them for all axes of a bus, `host.cycle.phases` has what a phase does.

Safety that lives here: the brake's set-point is never negative and never becomes motor torque; the motor's torque is limited in
size, rate and per mille, is never accelerating near the speed limit, and is 0 when stale; arming is refused unless the handle is still,
little loaded, and motor, encoder and transducer agree on the sign.
"""

from __future__ import annotations

from typing import Any

from coulombus.compiled.decorator import kernel
from coulombus.eds.cia402 import CONTROLWORD_TO_ENABLE, INTERNAL_LIMIT, STATE_OF_STATUSWORD, PowerState
from coulombus.eds.codec import pack, unpack
from coulombus.host.cycle.phases import arm, count_still, enter, run_law, safe, sign_check, still, trip_to_safe
from coulombus.host.cycle.records import Image, Phase, Trip
from coulombus.host.cycle.watch import measure, watch_devices, watch_motion
from coulombus.wire.frame import push

__all__ = ["SOURCE_HOST", "begin", "finish", "on_frame"]

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
NOT_STILL, ENABLE_TIMEOUT = int(Trip.NOT_STILL), int(Trip.ENABLE_TIMEOUT)
DEADMAN, DRIVE_STATE = int(Trip.DEADMAN), int(Trip.DRIVE_STATE)

SWITCH_ON_WORD = 0x07
ENABLE_WORD = 0x0F
DISABLE_CYCLES = 100  # how long a drive may take to say that it is disabled
SPEED_TAPER = 0.8  # above this share of the speed limit the motor may only brake


@kernel
def _limit_motor(c: Any, h: Any, wanted: float) -> float:
    """Return the motor torque [Nm] that may be sent: 0 when stale or not a number, then rate, speed and size."""
    if h.position_age > 1:
        return 0.0
    if wanted != wanted:
        h.clipped_torque += 1
        return 0.0
    limit, count = c.motor_limit_pm * abs(c.Nm_pm), abs(c.Nm_pm)
    if abs(wanted) > limit + count:  # less than a count is rounding
        h.clipped_torque += 1
    torque = min(max(wanted, h.motor_Nm - c.motor_rate_Nm), h.motor_Nm + c.motor_rate_Nm)
    v = h.v_counts * c.rad_count * 1e9 / c.period_ns
    if abs(v) > SPEED_TAPER * c.speed_limit and torque * v > 0.0:
        torque = 0.0
    torque = min(max(torque, -limit), limit)
    if h.phase == RUN and abs(torque - min(max(wanted, -limit), limit)) > count:
        h.slowed_torque += 1
    return torque


@kernel
def begin(c: Any, h: Any, t_ns: int, out: Any) -> None:
    """Begin the cycle that is due at `t_ns`: count what the last one lost, send SYNC (and the host's heartbeat when due)."""
    if h.cycle > 0 and h.phase < SAFE and h.arrived != (1 << c.tpdos) - 1:
        h.lost_pdos += 1
    h.arrived = 0
    h.waiting = 1
    h.sync_ns = t_ns
    h.cycle += 1
    h.next_ns = t_ns + c.window_ns
    if c.sync_cob_id < 0:  # another axis of this bus leads
        return
    push(out, SOURCE_HOST, t_ns, c.sync_cob_id, 0, 0)
    if c.heartbeat_ns > 0 and t_ns >= h.heartbeat_due_ns:
        h.heartbeat_due_ns = t_ns + c.heartbeat_ns
        push(out, SOURCE_HOST, t_ns, 0x700 + c.host_id, 1, 5)


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
        known = False
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
    c: Any, h: Any, rpdos: Any, law_function: Any, motion: Any, law: Any, state: Any, t_ns: int, out: Any
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
        switch = h.image[c.deadman_slot]
        held = switch != 0 if c.deadman_mask == 0 else switch & c.deadman_mask == c.deadman_mask
        h.deadman_ok = 1 if held else 0
    if trip == NONE and not h.deadman_ok and h.phase > STILL:
        trip = DEADMAN
    if trip == NONE and h.stop > 1:
        trip = h.stop
    if trip != NONE or (h.stop != 0 and h.phase < SAFE):
        trip_to_safe(c, h, trip, t_ns)

    wanted = 0.0
    h.phase_cycle += 1
    controlword = CONTROLWORD_TO_ENABLE[drive] if drive >= 0 else 0
    if h.phase == STILL:
        if drive == SWITCHED_ON:
            controlword = SWITCH_ON_WORD
        still(c, h, drive, t_ns)
    elif h.phase == ENABLE:
        if drive == OPERATION_ENABLED:
            h.enabled_ns = t_ns
            h.motor_Nm = 0.0
            if c.sign_check:
                h.sign_direction = 1
                enter(h, SIGN)
            else:
                arm(c, h, state, t_ns)
        elif h.phase_cycle > c.enable_timeout_cycles:
            trip_to_safe(c, h, ENABLE_TIMEOUT, t_ns)
    elif h.phase == SIGN:
        wanted = sign_check(c, h, t_ns)
    elif h.phase == SETTLE:
        count_still(h)
        wanted = max(abs(h.motor_Nm) - 5.0 * c.sign_step_Nm, 0.0) * h.sign_direction
        if wanted == 0.0 and h.still >= c.settle_cycles:
            arm(c, h, state, t_ns)
        elif h.phase_cycle > c.still_timeout_cycles:
            trip_to_safe(c, h, NOT_STILL, t_ns)
    elif h.phase == RUN:
        motion.x_rad = h.counts * c.rad_count
        motion.v_counts = h.v_counts * (1.0 if c.rad_count > 0.0 else -1.0)
        motion.v_rad_s = h.v_counts * c.rad_count * 1e9 / c.period_ns
        motion.handle_Nm = h.handle_Nm
        psi = law_function(motion, law, state)
        if psi == psi and state.brake_Nm == state.brake_Nm:
            state.psi_Nm = psi
            wanted = run_law(c, h, psi, state)
            if h.full_gain_ns < 0 and h.gain >= 1.0:
                h.full_gain_ns = t_ns
            if h.image[STATUSWORD] & INTERNAL_LIMIT:
                h.limited_by_drive += 1
        else:  # not a number
            trip_to_safe(c, h, LAW, t_ns)

    if h.enabled_ns >= 0 and h.phase < SAFE:
        h.display_cycles += 1
    if SIGN <= h.phase <= RUN:
        controlword = ENABLE_WORD
        h.motor_Nm = _limit_motor(c, h, wanted)
    else:
        h.motor_Nm = 0.0
        if h.phase == SAFE:
            controlword = ENABLE_WORD if drive == OPERATION_ENABLED else 0
            safe(c, h)
        elif h.phase == DISABLE or h.phase == DONE or h.phase == OFF:
            controlword = 0
            h.brake_Nm = 0.0
            disabled = drive in (SWITCH_ON_DISABLED, FAULT)
            if h.phase == DISABLE and (disabled or h.phase_cycle > DISABLE_CYCLES):
                enter(h, DONE)

    h.image[CONTROLWORD] = controlword
    h.image[TARGET_TORQUE] = round(h.motor_Nm / c.Nm_pm)
    h.image[BRAKE_SETPOINT] = min(
        max(round(h.brake_Nm / c.brake_Nm_raw), 0), c.brake_limit_raw
    )  # unsigned, and no wrap
    for i in range(c.rpdos):
        push(out, SOURCE_HOST, t_ns, rpdos[i].cob_id, rpdos[i].length, pack(rpdos[i], h.image))
