"""Record of the plant in the plane."""

from __future__ import annotations

from typing import Annotated

from coulombus.kernels.records import FloatField, Record

__all__ = ["PlanePlantRecord"]


class PlanePlantRecord(Record):
    """Two links with brakes, motors and a hand; arrays of two hold joint or direction 1 and 2."""

    on: int  # 1: the plants of a rig's two axes are the joints of these links
    offset_rad: Annotated[FloatField, 2]  # the mechanism's angle where the joint's is 0
    sign: Annotated[FloatField, 2]  # sense of the joint in the mechanism
    start_rad: Annotated[FloatField, 2]  # the joint's angle where its axis' is 0
    h: float  # step [s]
    l1: float  # lengths of the links [m]
    l2: float
    a1: float  # the inertia's constant parts [kg m2]: a1 + 2 k cos, a2 + k cos; a3
    a2: float
    a3: float
    k: float
    viscous: Annotated[FloatField, 2]  # Nm s/rad
    inherent: Annotated[FloatField, 2]  # own friction of the joints, and off-state torque of the brakes [Nm]
    stiffness: Annotated[FloatField, 2]  # of the hand [N/m]
    damping: Annotated[FloatField, 2]  # of the hand [N s/m]
    hand_kg: float
    motor_decay: Annotated[FloatField, 2]  # decay of the motor's lag in a step
    coil_decay: Annotated[FloatField, 2]
    fluid_decay: Annotated[FloatField, 2]

    motor_want: Annotated[FloatField, 2]  # commands [Nm]
    brake_want: Annotated[FloatField, 2]
    goal_m: Annotated[FloatField, 2]  # target position of the hand at the step's begin
    goal_m_s: Annotated[FloatField, 2]

    push_N: Annotated[FloatField, 2]  # muscle force of the hand, in addition to its spring and damper

    angle: Annotated[FloatField, 2]  # the mechanism's angles [rad]
    v: Annotated[FloatField, 2]  # rad/s; 0 for a sticking joint
    motor_lagged: Annotated[FloatField, 2]
    coil: Annotated[FloatField, 2]
    fluid: Annotated[FloatField, 2]
    motor: Annotated[FloatField, 2]  # torque in the step [Nm]
    level: Annotated[FloatField, 2]  # largest friction in the step, brake and inherent [Nm]
    part_s: float  # elapsed part of the step [s]
    v_end: Annotated[FloatField, 2]
    load: Annotated[FloatField, 2]  # friction in the step, positive against a positive speed [Nm]
    hand_N: Annotated[FloatField, 2]  # force of the hand's spring and damper
    hand_Nm: Annotated[FloatField, 2]
    brake_Nm: Annotated[FloatField, 2]  # brake torque on the joint
    friction_Nm: Annotated[FloatField, 2]
    transduced_Nm: Annotated[FloatField, 2]  # transducer reading: hand's torque on the joint, with its mass
    shown_N: Annotated[FloatField, 2]  # force of motors, brakes and friction on the hand
    tip_m: Annotated[FloatField, 2]
    tip_m_s: Annotated[FloatField, 2]
    work_hand: Annotated[FloatField, 2]  # J
    work_motor: Annotated[FloatField, 2]
    work_brake: Annotated[FloatField, 2]
    work_friction: Annotated[FloatField, 2]
    work_viscous: Annotated[FloatField, 2]  # loss of the viscous friction [J]
    coil_square: Annotated[FloatField, 2]  # sum of the squared coil torques of a course [Nm^2]
