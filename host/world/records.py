"""Records of a local model: what a world outside says, and its state in the cycle.

`ModelRecord` is also the message of the socket (`host.world.protocol`): the same bytes, little-endian.
Torques have the sign of the torque that acts on the handle. K and B of wall and spring resist. A model is
of one axis, or with `ModelParts.PLANE` of the tip of an arm: then its forces have the sign of the force that
acts on the tip.
"""

from __future__ import annotations

from enum import IntFlag
from typing import Annotated, Any

import numpy as np

from coulombus.host.laws.law import USER, LawRecord
from coulombus.kernels.records import FloatField, Record, RecordArray, dtype_of

__all__ = [
    "MODEL",
    "MOST_SAMPLES",
    "OFFERS",
    "PARAMETERS",
    "STATE",
    "LocalModelRecord",
    "ModelParts",
    "ModelRecord",
    "StateRecord",
    "offset_of",
]

MOST_SAMPLES = 64
"""Largest number of samples of a torque profile."""
PARAMETERS = 4 + USER
"""Number of the law's parameters in a model, by `host.cycle.records.Slot`."""
OFFERS = 8
"""Size of the ring of models; the writer keeps the model in use and those not yet taken."""


def offset_of(dtype: np.dtype[Any], *names: str) -> int:
    """Return the offset of a field, or of a field within a field, in bytes."""
    offset = 0
    for name in names:
        assert dtype.fields is not None
        dtype, place = dtype.fields[name][:2]
        offset += int(place)
    return offset


class ModelParts(IntFlag):
    """ModelParts of a model."""

    WALL = 1
    SPRING = 2
    FIELD = 4
    PROFILE = 8
    PARAMETERS = 16  # values of the law's parameters
    PLANE = 32  # the parts are those of the plane


class ModelRecord(Record):
    """A model, as sent."""

    head: int  # bits 0 to 15: kind of the record, bits 16 to 31: its size in bytes
    sequence: int  # number of the message, rising, from 1
    t_ns: int  # CLOCK_MONOTONIC of the sender; 0: not given
    life_ns: int  # time to live
    axis: int  # axis of the rig, from 0
    parts: int  # `ModelParts`
    law: float  # share of the rig's law, 0 to 1
    wall_x_rad: float  # where the wall begins
    wall_side: int  # 1: the wall is above wall_x_rad; -1: below
    wall_K_Nm_rad: float
    wall_B_Nms_rad: float
    spring_x_rad: float  # the point (proxy) that the spring pulls to
    spring_K_Nm_rad: float
    spring_B_Nms_rad: float
    spring_most_Nm: float  # largest torque of the spring
    field_Nm: float  # the field: torque on the handle field_Nm + field_Nm_rad x + field_Nms_rad v
    field_Nm_rad: float
    field_Nms_rad: float
    plane_wall_point_m: Annotated[FloatField, 2]  # a point of the wall's face
    plane_wall_normal: Annotated[FloatField, 2]  # unit vector out of the wall, at right angles to its face
    plane_wall_K_N_m: float
    plane_wall_B_Ns_m: float
    plane_spring_point_m: Annotated[FloatField, 2]  # the point (proxy) that the spring pulls to
    plane_spring_K_N_m: float
    plane_spring_B_Ns_m: float
    plane_spring_most_N: float  # largest force of the spring
    plane_field_N: Annotated[FloatField, 2]  # the field: force on the tip N + N_m x + Ns_m v
    plane_field_N_m: Annotated[FloatField, 4]  # a matrix by rows: xx, xy, yx, yy
    plane_field_Ns_m: Annotated[FloatField, 4]
    profile_direction: Annotated[FloatField, 2]  # unit vector of the profile's force in the plane
    profile: int  # number of the profile; another number than the last one plays it
    samples: int  # number of samples of the profile
    sample_ns: int  # time of each sample
    parameters: int  # bits of the parameters that the model sets, by slot
    parameter: Annotated[FloatField, PARAMETERS]  # values by slot
    sample: Annotated[FloatField, MOST_SAMPLES, np.float32]  # torque on the handle; in the plane force on the tip


MODEL = dtype_of(ModelRecord)


class StateRecord(Record):
    """The state of an axis after a cycle, as sent."""

    head: int  # bits 0 to 15: kind of the record, bits 16 to 31: its size in bytes
    sequence: int  # number of the cycle
    t_ns: int  # CLOCK_MONOTONIC at which the cycle's SYNC was due; in virtual time the host's clock
    axis: int  # axis of the rig, from 0
    phase: int  # phase of the cycle (`host.cycle.records.Phase`); 5: the display runs
    trip: int  # reason of the safe state (`host.cycle.records.Trip`); 0: none
    x_rad: float  # the handle's position
    v_rad_s: float  # its velocity
    handle_Nm: float  # the hand's torque on the handle
    motor_Nm: float  # commanded torque of the motor on the handle
    brake_Nm: float  # commanded torque of the brake
    law_Nm: float  # output of the rig's law, with the sign of psi
    world_Nm: float  # what of motor_Nm the model gives
    world_brake_Nm: float  # what of brake_Nm the model gives
    tip_x_m: float  # position of an arm's tip; 0 without an arm, as all of the tip
    tip_y_m: float
    tip_vx_m_s: float  # its velocity
    tip_vy_m_s: float
    hand_x_N: float  # the hand's force on the tip
    hand_y_N: float
    world_x_N: float  # the model's force on the tip
    world_y_N: float
    share: float  # share of the model: 1, less while it fades, 0 without
    model: int  # `sequence` of the model in use; 0: none yet
    clipped: int  # cycles so far in which a limit changed the model's output
    softened: float  # share of the model's stiffness that is withheld, because the handle would swing
    lost: int  # states so far that this reader did not get
    sent_ns: int  # CLOCK_MONOTONIC at the end of the cycle; 0 in virtual time


STATE = dtype_of(StateRecord)


class LocalModelRecord(Record):
    """The local model of an axis in the cycle."""

    # set up by the host
    on: int  # 1: the rig file has [world]
    rest: float  # share of the law without a model: 1, or 0 for a free handle
    ramp_step: float  # fall of the share in a cycle after the time to live
    period_ns: int  # period of the cycle
    mode: int  # 0: the brake alone (passive), 1: motor and brake (hybrid), 2: the motor alone (active)
    motor_limit_Nm: float  # largest torque of the motor
    motor_rate_Nm: float  # largest change of the motor's torque in a cycle
    brake_limit_Nm: float  # largest torque of the brake
    brake_fall_Nm: float  # largest fall of the brake's torque in a cycle
    ahead_s: float  # time from the measured position to the effect of the torque
    acts_at_once: int  # 1: a command acts in its own cycle; 0: with the next SYNC
    drive_step: float  # 1 - exp(-period / lag of the drive)
    swing_band_rad: float  # way back that ends a swing: some counts of the encoder
    # messages
    offered: Annotated[RecordArray[ModelRecord], OFFERS]  # ring; model n is in row n % OFFERS
    published: int  # number of the newest model, written by the process that receives it
    wanted: int  # number of the newest model that the cycle knows; 0: none
    taken: int  # number of the model in use
    # state
    left_ns: int  # rest of the time to live
    share: float  # share of the model: 1, or less while it fades
    law_share: float  # share of the law
    law: LawRecord  # the law's parameters, with those of the model
    K_p_ratio: float  # stiffness of the stick spring in the last cycle, by that of the rig
    profile: int  # number of the last profile
    profile_ns: int  # time since it began
    field_from_rad: float  # position at which the field began
    field_from_m: Annotated[FloatField, 2]  # the tip's
    apart: int  # 1: the model's part has not come to 0 yet, because the rates hold it
    pushed_Nm: float  # motor's part of law and model in the last cycle, with the sign of psi
    brake_Nm: float  # brake's part of law and model in the last cycle
    # output of the last cycle
    world_Nm: float  # the model's part for the motor, with the sign of psi
    elastic_Nm: float  # what of that wall, spring and field return
    most_J: float  # largest energy that these can return
    world_brake_Nm: float  # the model's part for the brake
    # output of the last cycle of an arm, with the first joint
    psi_N: Annotated[FloatField, 2]  # the model's force, with the sign of psi
    push_N: Annotated[FloatField, 2]  # the part of it for the motors
    elastic_N: Annotated[FloatField, 2]  # what of that wall, spring and field return
    tip_m: Annotated[FloatField, 2]  # the tip's position
    stored_J: float  # energy that the hand has stored in wall, spring and field
    # swings of the handle (`host.world.softening`)
    softened: float  # share of the model's stiffness and damping that is withheld
    stiffness: float  # of the model in use: sum of its parts
    falls: int  # 0: the handle swings in its positive sense; 1: in the other
    swing_x_rad: float  # its position in the last cycle
    extreme_rad: float  # the farthest position of this swing
    turned_rad: float  # where it began
    swing_rad: float  # size of the swing before; 0: that was slow
    swing_ns: int  # time since it turned
    swings: int  # swings in a row that are too fast for a hand, and kept up
    driven_Nm: float  # what of the motor's part profile, driving field and constant field give, with the sign of psi
    driven_N: Annotated[FloatField, 2]  # the tip's
    acting_Nm: Annotated[FloatField, 2]  # the motor's parts that act now: of what is stiff or damps, and the rest
    before_Nm: Annotated[FloatField, 2]  # these parts of the cycle before
    given_J: Annotated[FloatField, 2]  # energy that they gave in this swing
    given_before_J: Annotated[FloatField, 2]  # and in the swing before
    demand: float  # largest torque of wall, spring and field in this swing, by the motor's limit
    demand_before: float  # and in the swing before
    # counters
    clipped: int  # cycles in which a limit changed the model's output
    fades: int  # models that faded to the end
