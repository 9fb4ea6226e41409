"""The phases of the cycle, compiled: what arms the rig, what the law's torque becomes, and how it is made safe.

    OFF -> STILL -> ENABLE -> SIGN -> SETTLE -> RUN -> SAFE -> DISABLE -> DONE
                       any doubt, in any phase  ->  SAFE

`host.cycle.step` calls the function of the present phase once in a cycle; `c` is the CONTROL record, `h` the HOST record of one axis.
"""

from __future__ import annotations

from typing import Any

from coulombus.compiled.decorator import kernel
from coulombus.eds.cia402 import PowerState
from coulombus.host.cycle.records import Phase, SignResult, Trip

__all__ = ["arm", "count_still", "enter", "run_law", "safe", "sign_check", "still", "trip_to_safe"]

ENABLE, SIGN, SETTLE = int(Phase.ENABLE), int(Phase.SIGN), int(Phase.SETTLE)
RUN, SAFE, DISABLE = int(Phase.RUN), int(Phase.SAFE), int(Phase.DISABLE)
SWITCHED_ON = int(PowerState.SWITCHED_ON)
NOT_STILL, HANDLE_LOADED, ENABLE_TIMEOUT = int(Trip.NOT_STILL), int(Trip.HANDLE_LOADED), int(Trip.ENABLE_TIMEOUT)
SIGN_NO_MOTION, SIGN_ENCODER = int(Trip.SIGN_NO_MOTION), int(Trip.SIGN_ENCODER)
SIGN_TRANSDUCER, SIGN_TRAVEL = int(Trip.SIGN_TRANSDUCER), int(Trip.SIGN_TRAVEL)
DEADMAN = int(Trip.DEADMAN)
AGREED, NO_HAND, REFUSED = int(SignResult.AGREED), int(SignResult.NO_HAND), int(SignResult.REFUSED)

STILL_COUNTS = 1
SIGN_TRAVEL_FACTOR = 4  # the ramp ends at this multiple of the counts that the encoder's verdict needs


@kernel
def enter(h: Any, phase: int) -> None:
    """Begin a phase."""
    h.phase = phase
    h.phase_cycle = 0
    h.reference_counts = h.counts
    h.still = 0


@kernel
def trip_to_safe(c: Any, h: Any, trip: int, t_ns: int) -> None:
    """Go to the safe state; only the first reason counts."""
    if h.phase >= SAFE:
        return
    if h.phase == SIGN:
        h.sign_result = REFUSED
    h.trip = trip
    h.trip_ns = t_ns
    h.safe_from_Nm = min(h.brake_Nm, c.safe_brake_Nm)
    enter(h, SAFE)


@kernel
def count_still(h: Any) -> None:
    """Count the cycles for which the handle has been still."""
    if not h.fresh or abs(h.counts - h.reference_counts) > STILL_COUNTS:
        h.reference_counts = h.counts
        h.still = 0
    else:
        h.still += 1


@kernel
def still(c: Any, h: Any, state: int, t_ns: int) -> None:
    """Wait, switched on and without torque, until the handle has been still and little loaded for long enough."""
    count_still(h)
    loaded = abs(h.handle_Nm) > c.still_handle_Nm
    if loaded or h.still == 0:
        h.still = 0
        h.handle_before_Nm = 0.0
        h.handle_samples = 0
    h.handle_before_Nm += h.handle_Nm
    h.handle_samples += 1
    if h.still >= c.still_cycles and state == SWITCHED_ON and h.deadman_ok:
        h.handle_before_Nm /= h.handle_samples
        enter(h, ENABLE)
    elif h.phase_cycle > c.still_timeout_cycles:
        if state != SWITCHED_ON:
            trip_to_safe(c, h, ENABLE_TIMEOUT, t_ns)
        elif h.still >= c.still_cycles:
            trip_to_safe(c, h, DEADMAN, t_ns)
        else:
            trip_to_safe(c, h, HANDLE_LOADED if loaded else NOT_STILL, t_ns)


@kernel
def arm(c: Any, h: Any, law: Any, t_ns: int) -> None:
    """Begin with the law: stuck where the handle is, its gain at 0."""
    law.stuck = 1
    law.x_stuck = h.counts * c.rad_count
    law.psi_Nm = 0.0
    law.brake_Nm = 0.0
    h.gain = 0.0
    h.armed_ns = t_ns
    enter(h, RUN)


@kernel
def sign_check(c: Any, h: Any, t_ns: int) -> float:
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
        trip_to_safe(c, h, SIGN_TRAVEL, t_ns)
        return 0.0
    if moved <= -c.sign_counts:
        trip_to_safe(c, h, SIGN_ENCODER, t_ns)
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
                    trip_to_safe(c, h, SIGN_NO_MOTION, t_ns)
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
        trip_to_safe(c, h, SIGN_TRANSDUCER, t_ns)
        return 0.0
    h.sign_result = AGREED if change < -c.sign_hand_Nm else NO_HAND
    enter(h, SETTLE)
    return u * h.sign_direction


@kernel
def run_law(c: Any, h: Any, psi: float, law: Any) -> float:
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
        h.brake_Nm = h.gain * setpoint
        if h.brake_Nm > c.brake_limit_Nm:
            if h.brake_Nm > c.brake_limit_Nm + c.brake_Nm_raw:  # less than a count is rounding
                h.clipped_setpoints += 1
            h.brake_Nm = c.brake_limit_Nm
    return h.gain * torque


@kernel
def safe(c: Any, h: Any) -> None:
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
        enter(h, DISABLE)
