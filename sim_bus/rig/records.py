"""Records of the simulated rig: the plant of an axis, and its coupling to other vendors' devices."""

from __future__ import annotations

import math
from typing import Annotated

from coulombus.kernels.decorator import constant, kernel
from coulombus.kernels.records import FloatField, IntegerField, Record, RecordArray, dtype_of
from coulombus.rigs.devices import TABLE_POINTS
from coulombus.rigs.plant_detail import MOST_ELEMENTS

__all__ = [
    "AXIS",
    "BODIES",
    "DETAIL",
    "MOST_SHOWN",
    "NOT_BEGUN",
    "NO_HAND",
    "PLANT",
    "Coupling",
    "DetailRecord",
    "PlanePlantRecord",
    "PlantRecord",
    "RigAxis",
    "ShownRecord",
    "WaveRecord",
    "wave",
]


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


MOST_SHOWN = 6
NOT_BEGUN, NO_HAND = constant(-1), constant(-2)
"""Starts of an operator's schedule that waits for Operation Enabled, and of an axis that nobody holds."""
BODIES = 3
PLAYS = 8


class WaveRecord(Record):
    """Sine of an angle that moves a little in each step.

    A zeroed record is recomputed at once if the angle is not near 0.
    """

    at: float
    sine: float
    cosine: float


class DetailRecord(Record):
    """Parts of the plant beyond one rigid body (`sim_bus.rig.detail`)."""

    on: int  # 1: the plant needs `sim_bus.rig.plant_step.advance_detailed`
    count: int  # number of bodies
    drum: int  # the body with the brake
    # bodies: parameters and state
    mass: Annotated[FloatField, BODIES]  # inertia of the device's bodies, without the hand
    total: Annotated[FloatField, BODIES]  # inertia with the hand
    viscous: Annotated[FloatField, BODIES]
    share: Annotated[FloatField, BODIES]  # share of the device's own friction
    q: Annotated[FloatField, BODIES]
    v: Annotated[FloatField, BODIES]
    # couplings
    k: Annotated[FloatField, BODIES - 1]
    d: Annotated[FloatField, BODIES - 1]
    gap: Annotated[FloatField, BODIES - 1]  # half of the backlash
    contact: Annotated[IntegerField, BODIES - 1]  # 1, -1: in contact on either side; 0: within the backlash
    # the device's own friction
    bristles: int  # `DRY`, `LUGRE`, `ELEMENTS`
    sigma_0: float
    sigma_1: float
    z: Annotated[FloatField, BODIES]
    elements: int
    element_k: Annotated[FloatField, MOST_ELEMENTS]
    element_w: Annotated[FloatField, MOST_ELEMENTS]  # sum: 1
    slip_rate: float  # C of the generalised Maxwell-slip friction; 0: Leuven's
    element_Nm: Annotated[FloatField, (BODIES, MOST_ELEMENTS)]
    element_slips: Annotated[FloatField, (BODIES, MOST_ELEMENTS)]  # 1, -1: it slips in this direction; 0: it winds
    waves: Annotated[RecordArray[WaveRecord], BODIES + 2]  # sines: of each body's friction, of ripple and cogging
    angle_share: float
    angle_rad: float  # periods in one revolution of the handle
    angle_phase: float
    load_share: float  # of the motor's torque
    friction_K: float  # share per kelvin
    friction_s: float  # share per second
    exponent: float
    # motor
    ripple: float
    ripple_rad: float
    ripple_phase: float
    # fluid and iron of the brake
    fluid_viscous: float
    viscous_K: float
    torque_K: float
    rise: float  # step / lag; negative: no lag
    fall: float
    rise_decay: float
    fall_decay: float
    shear: float  # s/rad: the lag is divided by 1 + shear |v|
    plays: int
    play_r: Annotated[FloatField, PLAYS]
    play_w: Annotated[FloatField, PLAYS]
    play_y: Annotated[FloatField, PLAYS]
    direct: float
    # heat
    heat_1_JK: float  # step / capacity; 0: the temperature is constant
    cooling: float  # step / (resistance capacity)
    reference: float
    degC: float
    coil_ohm: float
    # transducer
    crosstalk: float
    # values of the present step
    weak: float  # factor of the fluid's torque at its temperature
    wet: float  # viscous friction of the fluid at its temperature
    level: Annotated[FloatField, BODIES]
    dry: Annotated[FloatField, BODIES]  # part of the level from the brake
    side: Annotated[IntegerField, BODIES]  # direction of slip; 0: stuck
    u: Annotated[FloatField, BODIES]  # mean speed
    main: Annotated[FloatField, BODIES]  # the system's diagonal
    load: Annotated[FloatField, BODIES]
    react: Annotated[FloatField, BODIES]  # dry friction torque
    tied: Annotated[FloatField, BODIES - 1]  # torque of a coupling at the step's begin
    stiff: Annotated[FloatField, BODIES - 1]  # its change per rad/s of mean speed between its bodies
    alpha: Annotated[FloatField, BODIES]
    bears: Annotated[FloatField, BODIES]  # level of the bristles, or of all elements
    rate_Nm_s: Annotated[FloatField, BODIES]  # rate at which the speed winds stiff bristles
    kept: Annotated[FloatField, BODIES]  # deflection of the bristles after the step: constant part
    taken: Annotated[FloatField, BODIES]  # its change per rad/s of mean speed
    winds: Annotated[IntegerField, BODIES]  # 1: the motion of z cannot be predicted
    follows: Annotated[FloatField, BODIES]  # rate at which a slipping element follows its level [1/s]
    bristle_damping: Annotated[FloatField, BODIES]
    way: Annotated[FloatField, BODIES]  # predicted distance of z
    borne: Annotated[FloatField, BODIES]  # mean torque of the elements if z stands still
    rises: Annotated[FloatField, BODIES]  # its change per rad of z
    held: Annotated[FloatField, BODIES]  # torque of bristles or elements at rest
    given: Annotated[FloatField, BODIES]  # its change per rad/s of mean speed
    events: int  # number of events since power-on
    missed_events: int  # steps with more events than `chain.MOST_EVENTS`
    stored: float  # energy stored in springs and bristles


class PlantRecord(Record):
    """State of an axis's rig (`sim_bus.rig.plant`)."""

    # parameters
    step_ns: int  # the plant's step
    h: float  # the same step [s]
    inertia: float  # inertia of the device [kg m2]
    viscous: float  # viscous friction of the device [Nms/rad]
    coulomb: float  # Coulomb friction of the device [Nm]
    stribeck: float  # static friction minus Coulomb friction [Nm]
    stribeck_v: float  # Stribeck speed [rad/s]
    off_state: float  # torque of the brake without current [Nm]
    operator_inertia: float  # inertia of the hand [kg m2]
    operator_damping: float  # damping of the hand [Nms/rad]
    operator_stiffness: float  # stiffness of the hand [Nm/rad]
    motor_decay: float  # exp(-h / lag) of the motor
    motor_Nm_pm: float  # torque at the handle for one per mille, with the true polarity
    motor_peak_pm: float  # largest torque of the motor, per mille of its rated torque
    cogging: float  # amplitude of the cogging at the handle [Nm]
    cogging_rad: float  # periods per radian at the handle, times 2 pi
    coil_decay: float  # exp(-h / lag) of the coil
    fluid_decay: float  # exp(-h / lag) of the fluid
    brake_max: float  # largest torque of the brake [Nm]
    coil_A_Nm: float  # current per Nm
    counts_rad: float  # encoder counts per radian at the handle, with the true polarity
    eccentric: float  # amplitude of the encoder's eccentricity error at the handle
    eccentric_rad: float  # its phase in radians per radian at the handle
    noise: float  # noise of the transducer [Nm RMS]
    bias: float  # bias of the transducer [Nm]
    drift: float  # drift of the transducer [Nm/s]
    transducer_decay: float  # exp(-h / lag) of the transducer
    coil_step: float  # resolution of the coil's torque; 0: continuous
    transducer_polarity: float  # sign of the transducer, 1 or -1
    ambient: float  # temperature of the room [degC]
    K_A2: float  # steady temperature rise of the coil per square of its current
    thermal_s: float  # time constant of the coil
    remanence: float  # share of the torque that stays as remanence
    brake_gain: float  # true torque per Nm of command
    # state
    temperature: float  # temperature of the coil [degC]
    coil_fault: int  # COIL_INTACT, COIL_OPEN, COIL_SHORT
    obstacle_Nm: float  # largest torque of an obstacle that blocks the axis; 0: it is free
    motor_pm: float  # command of the drive, per mille of the motor's rated torque
    brake_Nm: float  # command of the brake's driver
    reverse_A: float  # current of the opposite sign from the driver
    remanent: float  # remanent brake torque
    remanent_before: float  # remanent brake torque before the current became negative
    t_ns: int  # time to which the plant was advanced
    x: float  # angle of the handle [rad]
    v: float  # speed of the handle [rad/s]
    motor: float  # motor torque at the handle
    coil: float  # brake torque that corresponds to the coil's present current
    fluid: float  # present torque capacity of the fluid, without the off-state part
    inherent: float  # own friction of the device at the present speed
    transduced: float  # hand's torque after the transducer's filter
    filtered: int  # 1: the transducer shows `transduced`, not the torque itself
    random: int  # state of the noise's generator
    # torques on the handle in the step that ended at t_ns
    f_operator: float  # torque of the hand
    f_motor: float  # torque of the motor
    f_brake: float  # torque of the brake
    f_friction: float  # own friction of the device
    # cumulative work of each torque on the handle, and the viscous loss
    w_operator: float  # work of the hand [J]
    w_motor: float  # work of the motor
    w_brake: float  # work of the brake
    w_friction: float  # work of the device's own friction
    w_viscous: float  # loss of the device's viscous friction
    detail: DetailRecord  # parts beyond one rigid body
    plane: PlanePlantRecord  # two coupled joints: that of the first axis is used


class ShownRecord(Record):
    """A quantity of the rig, shown in an object of a device."""

    row: int  # row of the device, and slot of the object in its values
    slot: int
    quantity: int
    gain: float  # counts per unit
    offset: float  # value of the quantity at the count 0
    low: int
    high: int


class Coupling(Record):
    """Coupling of an axis's rig to devices that are not this project's (`sim_bus.rig.coupling`)."""

    foreign: int  # 0: our own two devices; the fields below are unused
    shown_count: int
    shown: Annotated[RecordArray[ShownRecord], MOST_SHOWN]
    brake_output: int
    brake_channel: int  # channel of the module, or slot of the object
    brake_counts: float  # counts of the set-point for one per mille of a drive, or for one Nm of our driver
    brake_scale_Nm: float  # torque per count, without a table
    brake_points: int  # number of points of the table; 0: none
    brake_table_raw: Annotated[FloatField, TABLE_POINTS]  # ascending
    brake_table_Nm: Annotated[FloatField, TABLE_POINTS]


class RigAxis(Coupling):
    """An axis of the rig: its devices, and the operator's schedule."""

    motor: int  # row of the motor in the node records
    brake: int  # row of the brake
    operator_start_ns: int  # or `NOT_BEGUN`, `NO_HAND`
    force_step: int  # step of the plant at which the force block begins
    force_end_ns: int  # end time of the force block
    steps_per_knot: int  # steps of the plant per knot of the operator's force
    truth_on: int  # 1: the true course is stored


DETAIL = dtype_of(DetailRecord)
PLANT = dtype_of(PlantRecord)
AXIS = dtype_of(RigAxis)


FAR_rad = 0.1


@kernel
def wave(state: WaveRecord, angle: float) -> float:
    r"""Return the sine of `angle` [rad]; `state` is a record of `WaveRecord`.

    :math:`\sin(\varphi_0 + \delta) = \sin\varphi_0\cos\delta + \cos\varphi_0\sin\delta`, with the series of
    the small angle :math:`\delta` up to :math:`\delta^7`: accurate to :math:`\delta^8/8!`, which is 2.5e-13
    where :math:`\varphi_0` is recomputed (`FAR_rad`). The series costs less than a sine.
    """
    small = angle - state.at
    if abs(small) > FAR_rad or state.cosine == state.sine:
        state.at, state.sine, state.cosine = angle, math.sin(angle), math.cos(angle)
        return float(state.sine)
    square = small * small
    odd = small * (1.0 - square * (1.0 / 6.0 - square * (1.0 / 120.0 - square * (1.0 / 5040.0))))
    even = 1.0 - square * (0.5 - square * (1.0 / 24.0 - square * (1.0 / 720.0)))
    return float(state.sine * even + state.cosine * odd)
