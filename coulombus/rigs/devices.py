"""The devices of a rig and the roles of their objects: [motor], [brake], [sensor.NAME] and [role.NAME].

A role is a quantity that the host's cycle needs of the devices: a position, a torque set-point, a handle torque.
Without [role.NAME] the CANopen profile of the device's EDS file decides (`rigs.roles`).
"""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field

from coulombus.eds.drive_axis import MOST_DRIVE_AXES
from coulombus.rigs.model import MS, Milliseconds, Section

__all__ = [
    "MOST_PLAYS",
    "SENSOR_NAME",
    "TABLE_POINTS",
    "AngleRole",
    "Brake",
    "BrakeRole",
    "CurrentRole",
    "DeviceSection",
    "HandleRole",
    "Iron",
    "Motor",
    "Role",
    "Roles",
    "Sdo",
    "Sensor",
    "SpeedRole",
    "TemperatureRole",
    "TorqueRole",
    "drive_axis_of",
]


MOST_PLAYS = 8
OBJECT = r"^(|none|[0-9A-Fa-f]{4}(:[0-9A-Fa-f]{1,2})?)$"
SAYS_OBJECT: Any = {"expected": '"INDEX", "INDEX:SUB" (hexadecimal) or "none"'}
SENSOR_NAME = r"[a-z][a-z0-9_]{0,15}"
TABLE_POINTS = 16
"""Maximum number of points of a brake's table."""

SdoType = Literal[
    "BOOLEAN",
    "INTEGER8",
    "INTEGER16",
    "INTEGER32",
    "INTEGER64",
    "UNSIGNED8",
    "UNSIGNED16",
    "UNSIGNED32",
    "UNSIGNED64",
]


class Sdo(Section):
    """[[motor.sdo]], [[brake.sdo]], [[sensor.NAME.sdo]]: an object that bring-up writes at the rig file's request."""

    index: int = Field(ge=0x1000, le=0xFFFF, description="the object")
    sub: int = Field(0, ge=0, le=255, description="its sub-index")
    type: SdoType = Field(description="its data type, as CiA 301 names it")
    value: int = Field(ge=-(2**63), le=2**64 - 1, description="what is written")
    when: Literal["before", "after", "end"] = Field(
        "after", description="before the PDOs are mapped, after it, or at the end, when all else is set"
    )
    verify: bool = Field(True, description="read it back", json_schema_extra={"expected": "true or false"})


class DeviceSection(Section):
    """Keys that every device of the rig has."""

    node_id: int = Field(ge=1, le=127, description="the device's node id")
    eds: str = Field(min_length=1, description="EDS file: beside the rig file, else one of the package's")
    vendor_id: int | None = Field(
        None,
        ge=0,
        le=0xFFFFFFFF,
        description="1018:1, must match the device",
        json_schema_extra={"expected": "an integer from 0 to 4294967295", "range": "0 to 4294967295"},
    )
    product_code: int | None = Field(
        None,
        ge=0,
        le=0xFFFFFFFF,
        description="1018:2, must match the device",
        json_schema_extra={"expected": "an integer from 0 to 4294967295", "range": "0 to 4294967295"},
    )
    heartbeat_s: Milliseconds = Field(ge=1e-3, le=65.535, description="period of its heartbeat", json_schema_extra=MS)
    heartbeat_timeout_s: Milliseconds = Field(
        ge=1e-3, le=65.535, description="heartbeat older than this: lost, both ways", json_schema_extra=MS
    )
    response_us: float = Field(
        20.0, ge=0, le=1e6, description="longest time between SYNC and its TPDOs; the planner counts it"
    )
    sdo: tuple[Sdo, ...] = Field(
        (),
        strict=False,
        max_length=64,
        description="objects that bring-up writes besides its own",
        json_schema_extra={"expected": "[[motor.sdo]] in double brackets, once for each object"},
    )


class _Actuator(DeviceSection):
    setpoint_fault_s: Milliseconds = Field(
        ge=1e-3, le=65.535, description="RPDO deadline, EMCY 8250", json_schema_extra=MS
    )
    sync_timeout_s: Milliseconds = Field(ge=1e-3, le=65.535, description="no SYNC: EMCY 8700", json_schema_extra=MS)
    mode: int | None = Field(
        None,
        ge=-128,
        le=127,
        description="mode of operation 6060h of a CiA 402 drive",
        json_schema_extra={"expected": "an integer from -128 to 127", "range": "-128 to 127"},
    )
    drive_axis: int | None = Field(
        None, ge=1, le=MOST_DRIVE_AXES, description="which axis of a CiA 402 drive: objects from 6000h, 6800h ..."
    )


class Iron(Section):
    """[plant.iron], [brake.iron]: the brake's magnetic hysteresis, a sum of play operators."""

    play_Nm: tuple[Annotated[float, Field(gt=0, le=1e4)], ...] = Field(
        strict=False,
        min_length=1,
        max_length=MOST_PLAYS,
        description="half of each operator's play, as the torque of its coil current",
        json_schema_extra={"expected": f"a list of 1 to {MOST_PLAYS} numbers above 0, in Nm"},
    )
    weights: tuple[Annotated[float, Field(ge=0, le=1)], ...] = Field(
        strict=False,
        min_length=1,
        max_length=MOST_PLAYS,
        description="weight of each operator; what is left to 1 follows at once",
        json_schema_extra={"expected": "a list of as many numbers from 0 to 1 as play_Nm has, together at most 1"},
    )


class Motor(_Actuator):
    """[motor]: the motor drive, CiA 402."""

    rated_torque_Nm: float = Field(gt=0, le=1e4, description="at the motor's shaft: 1000 per mille of 6071/6077")
    encoder_counts_rev: int = Field(ge=1, le=2**31 - 1, description="counts of 6064 in one turn of the motor")
    setpoint_zero_cycles: int = Field(ge=1, le=1000, description="set-point older than this many cycles: torque 0")


class Brake(_Actuator):
    """[brake]: the MR brake's driver: CiA 404, 401, or 402 in a torque or current mode."""

    rated_torque_Nm: float = Field(gt=0, le=1e4, description="largest braking torque at the handle")
    coil_A_Nm: float = Field(gt=0, le=100, description="coil current for each Nm commanded")
    coil_continuous_A: float = Field(gt=0, le=1000, description="continuous current of the coil")
    coil_time_constant_s: float = Field(gt=0, le=1e4, description="time constant of the coil's I2t watch")
    coil_lag_s: float = Field(
        0.0, ge=0, le=1, description="assumed lag of the coil, which the lead compensates; 0: none"
    )
    fluid_lag_s: float = Field(
        0.0, ge=0, le=1, description="assumed lag of the fluid, which the lead compensates; 0: none"
    )
    iron: Iron | None = Field(None, description="assumed magnetic hysteresis, which the host inverts")
    hold_s: Milliseconds = Field(
        ge=0, le=65.535, description="set-point lost: it is held this long ...", json_schema_extra=MS
    )
    ramp_s: Milliseconds = Field(
        ge=0, le=65.535, description="... then ramped to the fault value in this time", json_schema_extra=MS
    )


class Sensor(DeviceSection):
    """[sensor.NAME]: a further node that only measures: a torque transducer's amplifier, an encoder."""


def drive_axis_of(part: DeviceSection) -> int:
    """Return the number of the drive's axis that a device is, from 1; 1 if the rig file names none."""
    return (part.drive_axis or 1) if isinstance(part, _Actuator) else 1


class Role(Section):
    """[role.statusword], [role.controlword] and the brake's: the device and the object."""

    node: str = Field(
        "", description="the device: motor, brake, or a sensor's name", json_schema_extra={"expected": "a text"}
    )
    object: str = Field(
        "", pattern=OBJECT, description="which object of the device it is", json_schema_extra=SAYS_OBJECT
    )


def _scale(unit: str, where: str) -> Any:
    return Field(
        None,
        gt=0,
        le=1e6,
        description=f"{unit} for one raw count{where}",
        json_schema_extra={"expected": f"a number above 0, at most 1e6, in {unit}", "range": "above 0, at most 1e6"},
    )


class AngleRole(Role):
    """[role.position]."""

    scale_rad: float | None = _scale("rad", ", at the handle")


class TorqueRole(Role):
    """[role.torque_setpoint], [role.torque]."""

    scale_Nm: float | None = _scale("Nm", ", at the motor's shaft")


class SpeedRole(Role):
    """[role.velocity]."""

    scale_rad_s: float | None = _scale("rad/s", ", at the motor's shaft")


class HandleRole(Role):
    """[role.handle_torque]."""

    scale_Nm: float | None = _scale("Nm", "")
    offset_Nm: float = Field(0.0, ge=-1e4, le=1e4, description="torque at the raw count 0")


class CurrentRole(Role):
    """[role.coil_current]."""

    scale_A: float | None = _scale("A", "")


class TemperatureRole(Role):
    """[role.coil_temperature]."""

    scale_degC: float | None = _scale("degC", "")
    offset_degC: float = Field(0.0, ge=-1e4, le=1e4, description="temperature at the raw count 0")


def _monotone(table: tuple[tuple[int, float], ...]) -> tuple[tuple[int, float], ...]:
    if not table:
        return table
    raw, torque = zip(*table, strict=True)
    steps = [later - earlier for earlier, later in pairwise(raw)]
    grows = all(later > earlier for earlier, later in pairwise(torque))
    if len(table) < 2 or torque[0] != 0.0 or not grows or not (min(steps) > 0 or max(steps) < 0):
        raise ValueError("no monotone table from 0 Nm on")
    return table


Point = Annotated[tuple[int, float], Field(strict=False)]


class BrakeRole(Role):
    """[role.brake_setpoint]."""

    scale_Nm: float | None = _scale("Nm", "")
    table: Annotated[tuple[Point, ...], AfterValidator(_monotone)] = Field(
        (),
        strict=False,
        max_length=TABLE_POINTS,
        description="raw counts and braking torque at the handle",
        json_schema_extra={
            "expected": f"a list of 2 to {TABLE_POINTS} points [raw, Nm], from 0 Nm on, both columns monotone"
        },
    )


class Roles(Section):
    """[role.NAME]: the object and device of each role.

    Absent roles follow from the devices' profiles.
    """

    position: AngleRole | None = Field(None, description="the encoder's counts")
    torque_setpoint: TorqueRole | None = Field(None, description="the motor's torque that is commanded")
    torque: TorqueRole | None = Field(None, description="the motor's torque that is measured")
    velocity: SpeedRole | None = Field(None, description="the velocity that the drive tells; recorded only")
    statusword: Role | None = Field(None, description="the drive's statusword")
    controlword: Role | None = Field(None, description="the drive's controlword")
    brake_setpoint: BrakeRole | None = Field(None, description="the brake's set-point")
    brake_statusword: Role | None = Field(None, description="the statusword of a brake that is a CiA 402 drive")
    brake_controlword: Role | None = Field(None, description="its controlword")
    handle_torque: HandleRole | None = Field(None, description="the hand's torque on the handle")
    coil_current: CurrentRole | None = Field(None, description="the current in the brake's coil")
    coil_temperature: TemperatureRole | None = Field(None, description="the temperature of the brake's coil")
