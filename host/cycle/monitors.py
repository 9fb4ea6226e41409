"""Per-cycle monitors, compiled: each returns a `Trip`, or `Trip.NONE`.

No monitor allocates memory. `c` is the CONTROL record of an axis, `h` its HOST record.
"""

from __future__ import annotations

from coulombus.eds.cia301 import NmtState
from coulombus.eds.cia402 import STATE_OF_STATUSWORD, VOLTAGE_ENABLED, PowerState
from coulombus.host.cycle.brake_model import expect
from coulombus.host.cycle.plausibility import compare_felt
from coulombus.host.cycle.records import ControlRecord, HostRecord, Image, Phase, Trip
from coulombus.kernels.decorator import kernel

__all__ = ["measure", "watch", "watch_devices", "watch_motion", "watch_switch"]

VOLTAGE_LOW_CYCLES = 2


@kernel
def measure(c: ControlRecord, h: HostRecord) -> int:
    """Convert the process image to position, velocity (backward difference) and handle torque.

    Return `Trip.ENCODER_JUMP` for an implausible step of the position.

    The position is unwrapped (6064h wraps after 2**32 counts). While it is stale, the velocity keeps its
    last value and the position's age grows.
    """
    h.drive = STATE_OF_STATUSWORD[h.image[Image.STATUSWORD] & 0x7F]
    h.brake_drive = STATE_OF_STATUSWORD[h.image[Image.BRAKE_STATUSWORD] & 0x7F] if c.brake_is_drive else h.drive
    h.handle_Nm = h.image[Image.HANDLE_TORQUE] * c.handle_Nm_raw + c.handle_offset_Nm
    h.fresh = 0
    h.position_age += 1
    if h.arrived & c.position_mask == 0:
        return Trip.NONE
    raw = h.image[Image.POSITION]
    if h.has_position == 0:
        h.has_position = 1
        h.raw_position = raw
        h.position_age = 0
        return Trip.NONE
    half = c.position_half
    moved = ((raw - h.raw_position + half) & (2 * half - 1)) - half
    if abs(moved) > c.jump_counts * h.position_age:
        return Trip.ENCODER_JUMP
    h.raw_position = raw
    h.counts += moved
    h.moved_counts = moved
    h.v_counts = moved / h.position_age
    h.position_age = 0
    h.fresh = 1
    return Trip.NONE


@kernel
def _pushes_unasked(c: ControlRecord, h: HostRecord) -> bool:
    """Return whether the motor's measured torque has been outside the envelope of its recent commands for
    more than `motor_mismatch_cycles`: too large, or in the opposite direction.

    The envelope decays to 0 with the drive's lag.
    """
    h.commanded_high_Nm = max(h.torque_Nm, h.commanded_high_Nm * c.motor_lag_decay)
    h.commanded_low_Nm = min(h.torque_Nm, h.commanded_low_Nm * c.motor_lag_decay)
    measured_Nm = h.image[Image.TORQUE] * c.torque_Nm_raw
    beyond_Nm = max(measured_Nm - h.commanded_high_Nm, h.commanded_low_Nm - measured_Nm)
    h.motor_mismatch = h.motor_mismatch + 1 if beyond_Nm > c.motor_mismatch_Nm else 0
    return bool(h.motor_mismatch > c.motor_mismatch_cycles)


@kernel
def _stored_J(h: HostRecord, way: float) -> float:
    """Return the energy that the hand stores in the world's wall, spring and field by this motion [J].

    What they return must have been stored before. So a spring that another program moves does net work,
    and a spring that stands still does none. Nothing is kept beyond what they can return.
    """
    stored_J = max(h.world_J + h.world_elastic_Nm * way, 0.0)
    gained_J = stored_J - h.world_J
    h.world_J = min(stored_J, h.world_most_J)
    return gained_J


@kernel
def watch_motion(c: ControlRecord, h: HostRecord) -> int:
    """Check speed, travel, the motor's net work and torque, the coil's heat and the handle torque."""
    v = h.v_counts * c.rad_count * 1e9 / c.period_ns
    if abs(v) > c.speed_limit:
        return Trip.SPEED
    if abs(h.counts * c.rad_count) > c.travel_rad:
        return Trip.TRAVEL

    # Net work of the motor on the handle, over a sliding window. The push of a law that stores energy is
    # summed separately for each contact; the sum enters the window when the contact ends.
    torque = h.image[Image.TORQUE] * c.torque_Nm_raw + c.torque_commanded * h.torque_Nm
    way = h.moved_counts * c.rad_count if h.fresh else 0.0
    work = torque * way
    if c.is_joint:  # what the tip stores is weighed at the tip (`host.plane.tip_model`)
        work += h.world_elastic_Nm * way + h.unpaid_J
    elif h.world_elastic_Nm != 0.0 or h.world_J != 0.0:
        work += _stored_J(h, way)
    if c.stores:
        law_Nm = h.pushed_Nm - h.world_Nm
        work += law_Nm * way
        h.contact_J -= law_Nm * way
        if law_Nm == 0.0:
            work += h.contact_J
            h.contact_J = 0.0
        elif h.contact_J > c.net_work_J:
            return Trip.NET_WORK
    row = h.work_row
    h.work_sum += work - h.work[row]
    h.work[row] = work
    row += 1
    h.work_row = row if row < c.net_work_cycles else 0
    if h.work_sum > c.net_work_J:
        return Trip.NET_WORK

    if _pushes_unasked(c, h):
        return Trip.MOTOR_TORQUE

    # I2t of the coil: the squared current through a first-order lag
    current = h.image[Image.COIL_CURRENT] * c.coil_A_raw + c.coil_A_Nm * h.brake_Nm
    h.coil_A2 = current * current + (h.coil_A2 - current * current) * c.coil_decay
    if h.coil_A2 > c.coil_limit_A2:
        return Trip.COIL_I2T

    # In slip, the hand's torque equals the sum of brake, friction and motor; when stuck, it is at most that.
    expect(c, h)
    level = h.brake_lagged_Nm + c.friction_Nm
    if abs(h.v_counts) > c.velocity_band_counts:
        sign = 1.0 if v > 0.0 else -1.0
        mismatch = abs(h.handle_Nm - sign * level - c.viscous * v + torque)
    else:
        mismatch = abs(h.handle_Nm + torque) - level
    h.mismatch = h.mismatch + 1 if mismatch > c.mismatch_Nm else 0
    if compare_felt(c, h, torque) or h.mismatch > c.mismatch_cycles:
        return Trip.HANDLE_TORQUE
    return Trip.NONE


@kernel
def watch_devices(c: ControlRecord, h: HostRecord, t_ns: int) -> int:
    """Check EMCY, TPDOs, heartbeats, NMT states and the drive's supply."""
    if h.emcy != Trip.NONE:
        return h.emcy
    if h.missed_in_a_row >= c.missed_cycles or h.oldest_tpdo > c.missed_cycles:
        return Trip.TPDO_LOST
    for k in range(c.nodes):
        if c.heartbeat_timeout_ns[k] > 0 and t_ns - h.heard_ns[k] > c.heartbeat_timeout_ns[k]:
            h.suspect_node = k
            return Trip.HEARTBEAT_MOTOR if k == 0 else Trip.HEARTBEAT_BRAKE if k == 1 else Trip.HEARTBEAT_SENSOR
    for k in range(c.nodes):
        if h.nmt[k] != NmtState.OPERATIONAL:
            return Trip.NMT_STATE
    if h.fresh:  # the statusword comes with the position
        h.voltage_low = 0 if h.image[Image.STATUSWORD] & VOLTAGE_ENABLED else h.voltage_low + 1
    return Trip.VOLTAGE if h.voltage_low >= VOLTAGE_LOW_CYCLES else Trip.NONE


@kernel
def watch_switch(c: ControlRecord, h: HostRecord) -> None:
    """Read the dead man's switch, if it is an input of a device."""
    if c.deadman_slot >= 0:
        switch = h.image[c.deadman_slot]
        held = switch != 0 if c.deadman_mask == 0 else switch & c.deadman_mask == c.deadman_mask
        h.deadman_ok = 1 if held else 0


@kernel
def watch(c: ControlRecord, h: HostRecord, jump: int, t_ns: int) -> int:
    """Return the first trip of this cycle, in this order: encoder (`jump`), motion, devices, drive state,
    dead man's switch, stop requests.
    """
    trip = jump
    if trip == Trip.NONE:
        trip = watch_motion(c, h)
    if trip == Trip.NONE:
        trip = watch_devices(c, h, t_ns)
    enabled = h.drive == PowerState.OPERATION_ENABLED and h.brake_drive == PowerState.OPERATION_ENABLED
    if trip == Trip.NONE and Phase.ENABLE < h.phase < Phase.SAFE and not enabled:
        trip = Trip.DRIVE_STATE
    watch_switch(c, h)
    if trip == Trip.NONE and not h.deadman_ok and h.phase > Phase.STILL:
        trip = Trip.DEADMAN
    if trip == Trip.NONE and h.stop > 1:
        trip = h.stop
    return trip
