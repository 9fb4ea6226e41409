"""The record of the plant in the plane."""

from __future__ import annotations

from typing import Annotated

from coulombus.kernels.records import FloatField, Record

__all__ = ["PlanePlantRecord"]


class PlanePlantRecord(Record):
    """Two links with brakes, motors and a hand; of two numbers each, joint or direction 1 and 2."""

    h: float  # step [s]
    l1: float  # lengths of the links [m]
    l2: float
    a1: float  # the inertia's constant parts [kg m2]: a1 + 2 k cos, a2 + k cos; a3
    a2: float
    a3: float
    k: float
    viscous: Annotated[FloatField, 2]  # Nm s/rad
    inherent: Annotated[FloatField, 2]  # the joints' own friction and the brakes' off-state torque [Nm]
    stiffness: Annotated[FloatField, 2]  # the hand's [N/m]
    damping: Annotated[FloatField, 2]  # N s/m
    hand_kg: float
    motor_decay: float  # of a step
    coil_decay: float
    fluid_decay: float

    motor_want: Annotated[FloatField, 2]  # commands [Nm]
    brake_want: Annotated[FloatField, 2]
    goal_m: Annotated[FloatField, 2]  # where the hand wants to be at the step's begin
    goal_m_s: Annotated[FloatField, 2]

    push_N: Annotated[FloatField, 2]  # the hand's muscles, beside its spring and damper

    angle: Annotated[FloatField, 2]  # the mechanism's angles [rad]
    v: Annotated[FloatField, 2]  # rad/s; 0 of a joint that sticks
    motor_lagged: Annotated[FloatField, 2]
    coil: Annotated[FloatField, 2]
    fluid: Annotated[FloatField, 2]
    motor: Annotated[FloatField, 2]  # torque in the step [Nm]
    level: Annotated[FloatField, 2]  # largest friction in the step, brake and inherent [Nm]
    part_s: float  # how much of the step has passed
    v_end: Annotated[FloatField, 2]
    load: Annotated[FloatField, 2]  # friction in the step, positive against a positive speed [Nm]
    hand_N: Annotated[FloatField, 2]  # the hand's spring and damper
    hand_Nm: Annotated[FloatField, 2]
    brake_Nm: Annotated[FloatField, 2]  # on the joint
    friction_Nm: Annotated[FloatField, 2]
    transduced_Nm: Annotated[FloatField, 2]  # the hand's torque on the joint, with its mass: the transducers'
    shown_N: Annotated[FloatField, 2]  # on the hand: motors, brakes, friction
    tip_m: Annotated[FloatField, 2]
    tip_m_s: Annotated[FloatField, 2]
    work_hand: float  # J
    work_motor: Annotated[FloatField, 2]
    work_brake: Annotated[FloatField, 2]
    work_friction: Annotated[FloatField, 2]
    loss_viscous: float
