"""Texts of the reasons for the safe state."""

from __future__ import annotations

from coulombus.eds.cia301 import CobId
from coulombus.host.cycle.records import Trip
from coulombus.kernels.records import Records
from coulombus.rigs.axis import Axis

__all__ = ["TRIP_TEXT", "trip_text"]

CLIPPING = ("clipped_torque", "slowed_torque", "clipped_setpoints", "slowed_setpoints")
"""Counters of the limits that change a law's output."""

TRIP_TEXT = {
    Trip.SPEED: "the handle was faster than limits.speed_rad_s",
    Trip.ENCODER_JUMP: "the encoder jumped by more than limits.encoder_jump_counts in a cycle",
    Trip.NET_WORK: "the motor put more than limits.net_work_J into the handle within limits.net_work_window_s: check mechanics.*_polarity",
    Trip.HANDLE_TORQUE: "the handle torque did not fit what brake, friction and motor display for limits.handle_mismatch_s",
    Trip.TRAVEL: "the handle left +- limits.travel_rad",
    Trip.VOLTAGE: "the drive lost its supply (statusword: voltage enabled is 0)",
    Trip.COIL_I2T: "the brake's coil would overheat (I2t above brake.coil_continuous_A)",
    Trip.TPDO_LOST: "no complete set of TPDOs for {missed_cycles} cycles (limits.missed_tpdo_cycles)",
    Trip.EMCY_MOTOR: "the motor drive sent an EMCY",
    Trip.EMCY_BRAKE: "the brake sent an EMCY",
    Trip.EMCY_SENSOR: "the sensor {node} sent an EMCY",
    Trip.HEARTBEAT_SENSOR: "the heartbeat of the sensor {node} was lost",
    Trip.HEARTBEAT_MOTOR: "the motor drive's heartbeat was lost",
    Trip.HEARTBEAT_BRAKE: "the brake's heartbeat was lost",
    Trip.DRIVE_STATE: "the drive left Operation Enabled without a command (or the brake, if it is a drive)",
    Trip.NMT_STATE: "a node left NMT state OPERATIONAL",
    Trip.TRANSMIT: "the bus did not take a frame",
    Trip.RECORDING: "the recording could not be written",
    Trip.OTHER_AXIS: "another axis went to its safe state",
    Trip.LAW: "the friction law {law} returned {returned}, which is not a finite number (law.function)",
    Trip.BUS_LOST: "the bus is gone: its process ended, or its interface went down",
    Trip.SECOND_HOST: "another sender uses identifiers that belong to this host: {foreign}",
    Trip.MOTOR_TORQUE: "the motor's measured torque (6077h) is off from its commands by more than limits.motor_mismatch_Nm",
    Trip.LAW_CLIPPED: "a limit acted on the friction law {law} in most cycles, so the hand did not feel this law: {clipped}",
    Trip.LAW_OSCILLATES: "the friction law {law} shakes the {shaken}, faster than friction oscillates at this bus.period_s",
    Trip.WORKSPACE: "the tip left the workspace kinematics.x_m, kinematics.y_m",
    Trip.SINGULAR: "the arm is too near to a singular pose (kinematics.least_condition)",
    Trip.DEADMAN: "the dead man's switch was not held",
    Trip.DATA_PLANE: "the data plane's process ended or hung",
    Trip.HOST: "the host's process failed, ended or hung",
    Trip.NOT_STILL: "arming refused: the handle was not still for limits.still_s within limits.still_timeout_s",
    Trip.HANDLE_LOADED: "arming refused: more than limits.still_handle_torque_Nm on the handle; let go of it, or check the transducer",
    Trip.ENABLE_TIMEOUT: "arming refused: the drive did not reach Operation Enabled",
    Trip.SIGN_NO_MOTION: "arming refused: the sign check's torque moved the handle by {sign_moved} of the {sign_counts} counts of "
    "limits.sign_check_counts: {still_because}",
    Trip.SIGN_ENCODER: "arming refused: motor and encoder disagree on the sign (mechanics.motor_polarity, mechanics.encoder_polarity)",
    Trip.SIGN_TRANSDUCER: "arming refused: the torque transducer's sign is wrong (mechanics.transducer_polarity)",
    Trip.SIGN_TRAVEL: "arming refused: the handle moved too far in the sign check",
}
"""Text of each trip, with the rig file's key that decides it; `trip_text` fills in the `{}`."""


def trip_text(axis: Axis, control: Records, host: Records) -> str | None:
    """Return the text of the reason for an axis' safe state, from its CONTROL and HOST records, or None."""
    trip = Trip(int(host["trip"][0]))
    if trip is Trip.NONE:
        return None
    node = axis.devices[int(host["suspect_node"][0])]
    part = ("", " for the brake", " for the motor")[int(host["law_part"][0])]
    reason = TRIP_TEXT[trip].format(
        missed_cycles=int(control["missed_cycles"][0]),
        node=node,
        law=axis.law.function,
        returned=f"{float(host['law_Nm'][0]):g} Nm{part}",
        foreign=_foreign(host),
        sign_moved=int(host["sign_moved"][0]),
        sign_counts=int(control["sign_counts"][0]),
        still_because=_still_because(host),
        shaken="motor" if host["reversals"][0][0] > host["reversals"][0][1] else "brake",
        clipped=", ".join(f"{name} {int(host[name][0])}" for name in CLIPPING if host[name][0])
        or "the joint's motor or brake cannot give its share of the force",
    )
    text = f"{trip.name}: {reason}"
    if trip is Trip.NOT_STILL and _starved(control, host):
        text += (
            f"; {int(host['lost_pdos'][0])} cycles lacked a TPDO within bus.tpdo_window_s, and a handle whose position does not "
            "come does not count as still"
        )
    if trip is Trip.NET_WORK and axis.world is not None:
        text += ", and whether the world outside gives more energy than it takes"
    if trip in (Trip.EMCY_MOTOR, Trip.EMCY_BRAKE, Trip.EMCY_SENSOR):
        text += f" (error code {int(host['emcy_code'][0]):04X}h)"
    return axis.spell_keys(text)


def _foreign(host: Records) -> str:
    """Return the description of the frame that another station sent (`Trip.SECOND_HOST`)."""
    can_id = int(host["foreign_id"][0])
    if can_id < 0:
        return "SYNC, or its heartbeat"
    service, node = can_id & 0x780, can_id & 0x7F
    if service == CobId.SDO_RX:
        return f"an SDO request that writes an object of node {node} (identifier {can_id:03X}h)"
    return f"a frame with the identifier {can_id:03X}h of its set-points (RPDO)"


def _still_because(host: Records) -> str:
    """Return the likely cause of too little motion in the sign check (`Trip.SIGN_NO_MOTION`)."""
    if host["sign_moved"][0] > 0:
        return "it is held, there is more friction than mechanics.friction_Nm, or the encoder is too coarse for so many"
    return (
        "is it held, is the motor not connected, or is there more friction than mechanics.friction_Nm? "
        "Then identify first: coulombus commission --step friction"
    )


def _starved(control: Records, host: Records) -> bool:
    """Return whether so many TPDOs were lost that even a handle at rest could not count as still for long
    enough.
    """
    c = control[0]
    return bool(host["lost_pdos"][0] * c["still_cycles"] >= c["still_timeout_cycles"])
