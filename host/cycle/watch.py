"""What the host watches in every cycle: each function returns the trip that its doubt demands, or `Trip.NONE`.

Compiled, allocation-free, no knowledge of phases: `host.cycle.step` calls them and decides. `c` is a CONTROL record, `h` a HOST record.
"""

from __future__ import annotations

from typing import Any

from coulombus.compiled.decorator import kernel
from coulombus.eds.cia301 import NmtState
from coulombus.eds.cia402 import VOLTAGE_ENABLED
from coulombus.host.cycle.records import Image, Trip

__all__ = ["measure", "watch_devices", "watch_motion"]

NONE = int(Trip.NONE)
SPEED, ENCODER_JUMP, NET_WORK = int(Trip.SPEED), int(Trip.ENCODER_JUMP), int(Trip.NET_WORK)
HANDLE_TORQUE, TRAVEL, COIL_I2T = int(Trip.HANDLE_TORQUE), int(Trip.TRAVEL), int(Trip.COIL_I2T)
VOLTAGE, TPDO_LOST, NMT_STATE = int(Trip.VOLTAGE), int(Trip.TPDO_LOST), int(Trip.NMT_STATE)
HEARTBEAT_MOTOR, HEARTBEAT_BRAKE = int(Trip.HEARTBEAT_MOTOR), int(Trip.HEARTBEAT_BRAKE)

STATUSWORD, POSITION, TORQUE = int(Image.STATUSWORD), int(Image.POSITION), int(Image.TORQUE)
HANDLE, COIL_CURRENT = int(Image.HANDLE_TORQUE), int(Image.COIL_CURRENT)
OPERATIONAL = int(NmtState.OPERATIONAL)
VOLTAGE_LOW_CYCLES = 2


@kernel
def measure(c: Any, h: Any) -> int:
    """Turn the process image into position, velocity (backward difference) and handle torque; may trip on an encoder jump.

    The position is followed modulo 2**32, as 6064h wraps. A stale position keeps the last velocity's value and ages.
    """
    h.handle_Nm = h.image[HANDLE] * c.handle_Nm_raw
    h.fresh = 0
    h.position_age += 1
    if h.arrived & c.position_mask == 0:
        return NONE
    raw = h.image[POSITION]
    if h.has_position == 0:
        h.has_position = 1
        h.raw_position = raw
        h.position_age = 0
        return NONE
    moved = ((raw - h.raw_position + 0x80000000) & 0xFFFFFFFF) - 0x80000000
    if abs(moved) > c.jump_counts * h.position_age:
        return ENCODER_JUMP
    h.raw_position = raw
    h.counts += moved
    h.v_counts = moved / h.position_age
    h.position_age = 0
    h.fresh = 1
    return NONE


@kernel
def watch_motion(c: Any, h: Any) -> int:
    """Watch speed, travel, the motor's net work, the handle torque and the coil's heat."""
    v = h.v_counts * c.rad_count * 1e9 / c.period_ns
    if abs(v) > c.speed_limit:
        return SPEED
    if abs(h.counts * c.rad_count) > c.travel_rad:
        return TRAVEL

    # net work of the motor on the handle, over a sliding window
    torque = h.image[TORQUE] * c.Nm_pm
    work = torque * h.v_counts * c.rad_count if h.fresh else 0.0
    row = h.work_row
    h.work_sum += work - h.work[row]
    h.work[row] = work
    row += 1
    h.work_row = row if row < c.net_work_cycles else 0
    if h.work_sum > c.net_work_J:
        return NET_WORK

    # I2t of the coil: a first-order lag of the squared current
    current = h.image[COIL_CURRENT] * c.coil_A_raw
    h.coil_A2 = current * current + (h.coil_A2 - current * current) * c.coil_decay
    if h.coil_A2 > c.coil_limit_A2:
        return COIL_I2T

    # The hand's torque must be what brake, friction and motor make of it: exactly so in slip, at most so when stuck.
    h.brake_lagged_Nm = h.brake_Nm + (h.brake_lagged_Nm - h.brake_Nm) * c.brake_lag_decay
    level = h.brake_lagged_Nm + c.friction_Nm
    if abs(h.v_counts) > c.velocity_band_counts:
        sign = 1.0 if v > 0.0 else -1.0
        mismatch = abs(h.handle_Nm - sign * level - c.viscous * v + torque)
    else:
        mismatch = abs(h.handle_Nm + torque) - level
    h.mismatch = h.mismatch + 1 if mismatch > c.mismatch_Nm else 0
    return HANDLE_TORQUE if h.mismatch > c.mismatch_cycles else NONE


@kernel
def watch_devices(c: Any, h: Any, t_ns: int) -> int:
    """Watch TPDOs, EMCY, heartbeats, NMT states and the drive's supply."""
    if h.emcy != NONE:
        return h.emcy
    if h.missed_in_a_row >= c.missed_cycles:
        return TPDO_LOST
    if c.motor_heartbeat_timeout_ns > 0 and t_ns - h.motor_heartbeat_ns > c.motor_heartbeat_timeout_ns:
        return HEARTBEAT_MOTOR
    if c.brake_heartbeat_timeout_ns > 0 and t_ns - h.brake_heartbeat_ns > c.brake_heartbeat_timeout_ns:
        return HEARTBEAT_BRAKE
    if h.motor_nmt != OPERATIONAL or h.brake_nmt != OPERATIONAL:
        return NMT_STATE
    if h.fresh:  # the statusword comes with the position
        h.voltage_low = 0 if h.image[STATUSWORD] & VOLTAGE_ENABLED else h.voltage_low + 1
    return VOLTAGE if h.voltage_low >= VOLTAGE_LOW_CYCLES else NONE
