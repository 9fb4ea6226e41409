"""The records of the simulated rig: the plant of an axis, and how it meets devices of others."""

from __future__ import annotations

from typing import Annotated

from coulombus.kernels.records import FloatField, IntegerField, Record, RecordArray, dtype_of
from coulombus.rigs.devices import TABLE_POINTS
from coulombus.rigs.plant_detail import MOST_ELEMENTS

__all__ = [
    "AXIS",
    "BODIES",
    "DETAIL",
    "MOST_SHOWN",
    "PLANT",
    "Coupling",
    "DetailRecord",
    "PlantRecord",
    "RigAxis",
    "ShownRecord",
    "WaveRecord",
]

MOST_SHOWN = 6
BODIES = 3
PLAYS = 8


class WaveRecord(Record):
    """A sine of an angle that moves a little in each step. One of zeros is taken anew at once
    where the angle is not near 0."""

    at: float
    sine: float
    cosine: float


class DetailRecord(Record):
    """What the plant has beyond one rigid body (`sim_bus.rig.detail`)."""

    on: int  # 1: the plant needs `sim_bus.rig.plant_step.advance_detailed`
    count: int  # of bodies
    drum: int  # the body with the brake
    # bodies: parameters and state
    mass: Annotated[FloatField, BODIES]  # inertia of the device's bodies, without the hand
    total: Annotated[FloatField, BODIES]  # with the hand
    viscous: Annotated[FloatField, BODIES]
    share: Annotated[FloatField, BODIES]  # of the device's own friction
    q: Annotated[FloatField, BODIES]
    v: Annotated[FloatField, BODIES]
    # couplings
    k: Annotated[FloatField, BODIES - 1]
    d: Annotated[FloatField, BODIES - 1]
    gap: Annotated[FloatField, BODIES - 1]  # half of the backlash
    contact: Annotated[IntegerField, BODIES - 1]  # 1, -1: on one side, the other; 0: within the backlash
    # the device's own friction
    bristles: int  # `DRY`, `LUGRE`, `ELEMENTS`
    sigma_0: float
    sigma_1: float
    z: Annotated[FloatField, BODIES]
    elements: int
    element_k: Annotated[FloatField, MOST_ELEMENTS]
    element_w: Annotated[FloatField, MOST_ELEMENTS]  # together 1
    slip_rate: float  # C of the generalised Maxwell-slip friction; 0: Leuven's
    element_Nm: Annotated[FloatField, (BODIES, MOST_ELEMENTS)]
    element_slips: Annotated[FloatField, (BODIES, MOST_ELEMENTS)]  # 1, -1: it slips in this sense; 0: it winds
    waves: Annotated[RecordArray[WaveRecord], BODIES + 2]  # sines: of each body's friction, of ripple and cogging
    angle_share: float
    angle_rad: float  # periods in one revolution of the handle
    angle_phase: float
    friction_K: float  # share for one kelvin
    friction_s: float  # share for one second
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
    # a step's own
    weak: float  # what is left of the fluid's torque at its temperature
    wet: float  # the fluid's viscous friction at its temperature
    level: Annotated[FloatField, BODIES]
    dry: Annotated[FloatField, BODIES]  # the brake's part of the level
    side: Annotated[IntegerField, BODIES]  # direction of slip; 0: stuck
    u: Annotated[FloatField, BODIES]  # mean speed
    main: Annotated[FloatField, BODIES]  # the system's diagonal
    load: Annotated[FloatField, BODIES]
    react: Annotated[FloatField, BODIES]  # dry friction
    tied: Annotated[FloatField, BODIES - 1]  # a coupling's torque at the step's begin ...
    stiff: Annotated[FloatField, BODIES - 1]  # ... and for each rad/s of mean speed between its bodies
    alpha: Annotated[FloatField, BODIES]
    bears: Annotated[FloatField, BODIES]  # the level of the bristles, or of all elements
    rate_Nm_s: Annotated[FloatField, BODIES]  # how fast the speed winds stiff bristles
    kept: Annotated[FloatField, BODIES]  # of the bristles' deflection behind the step ...
    taken: Annotated[FloatField, BODIES]  # ... and for each rad/s of mean speed
    winds: Annotated[IntegerField, BODIES]  # 1: how z goes cannot be foretold
    follows: Annotated[FloatField, BODIES]  # how fast a slipping one follows it [1/s]
    bristle_damping: Annotated[FloatField, BODIES]
    way: Annotated[FloatField, BODIES]  # of z, as foretold
    borne: Annotated[FloatField, BODIES]  # what the elements bear on the mean if z stands still ...
    rises: Annotated[FloatField, BODIES]  # ... and for each rad of z
    held: Annotated[FloatField, BODIES]  # the torque of bristles or elements at rest ...
    given: Annotated[FloatField, BODIES]  # ... and for each rad/s of mean speed
    events: int  # since power-on
    missed_events: int  # steps with more of them than `chain.MOST_EVENTS`
    stored: float  # energy in springs and bristles


class PlantRecord(Record):
    """The rig of an axis (`sim_bus.rig.plant`)."""

    # parameters
    step_ns: int  # the plant's step
    h: float  # the same [s]
    inertia: float  # of the device [kg m2]
    viscous: float  # of the device [Nms/rad]
    coulomb: float  # its Coulomb friction [Nm]
    stribeck: float  # what the static friction is more than that
    stribeck_v: float  # Stribeck speed [rad/s]
    off_state: float  # the brake's torque without current [Nm]
    operator_inertia: float  # of the hand [kg m2]
    operator_damping: float  # of the hand [Nms/rad]
    operator_stiffness: float  # of the hand [Nm/rad]
    motor_decay: float  # exp(-h / lag)
    motor_Nm_pm: float  # torque at the handle for one per mille, with the true polarity
    motor_peak_pm: float  # what the motor gives at most
    cogging: float  # amplitude at the handle
    cogging_rad: float  # periods for one radian at the handle, times 2 pi
    coil_decay: float  # exp(-h / lag) of the coil
    fluid_decay: float  # exp(-h / lag) of the fluid
    brake_max: float  # what the brake gives at most [Nm]
    coil_A_Nm: float  # current for one Nm
    counts_rad: float  # encoder counts for one radian at the handle, with the true polarity
    eccentric: float  # amplitude of the encoder's error at the handle
    eccentric_rad: float  # its radians for one radian at the handle
    noise: float  # of the transducer [Nm RMS]
    bias: float  # of the transducer [Nm]
    drift: float  # of the transducer [Nm/s]
    transducer_decay: float  # exp(-h / lag) of the transducer
    coil_step: float  # resolution of the coil's torque; 0: continuous
    transducer_polarity: float  # 1 or -1
    ambient: float  # temperature of the room [degC]
    K_A2: float  # steady rise of the coil's temperature for the square of its current
    thermal_s: float  # time constant of the coil
    remanence: float  # share of the torque that the iron keeps
    brake_gain: float  # true torque for each Nm that the command stands for
    # state
    temperature: float  # of the coil [degC]
    coil_fault: int  # COIL_INTACT, COIL_OPEN, COIL_SHORT
    motor_pm: float  # what the drive commands, per mille of the motor's rated torque
    brake_Nm: float  # what the brake's driver commands
    reverse_A: float  # the driver's current of the opposite sign
    remanent: float  # brake torque that the iron remembers
    remanent_before: float  # ... before the current became negative
    t_ns: int  # up to which it was advanced
    x: float  # angle of the handle [rad]
    v: float  # speed of the handle [rad/s]
    motor: float  # motor torque at the handle
    coil: float  # brake torque that the coil's present current stands for
    fluid: float  # brake torque that the fluid can bear now, without the off-state part
    inherent: float  # the device's own friction at the present speed
    transduced: float  # what the transducer's filter has of the hand's torque
    filtered: int  # 1: the transducer shows that, and not the torque itself
    random: int  # state of the noise's generator
    # torques on the handle in the step that ended at t_ns
    f_operator: float  # the hand's
    f_motor: float  # the motor's
    f_brake: float  # the brake's
    f_friction: float  # the device's own
    # cumulative work of each on the handle, and the viscous loss
    w_operator: float  # the hand's [J]
    w_motor: float  # the motor's
    w_brake: float  # the brake's
    w_friction: float  # the device's own friction's
    w_viscous: float  # what its viscous friction took
    detail: DetailRecord  # what it has beyond one rigid body


class ShownRecord(Record):
    """A quantity of the rig that an object of a device shows."""

    row: int  # the device, and where the object stands in its values
    slot: int
    quantity: int
    gain: float  # counts for one unit
    offset: float  # the quantity at the count 0
    low: int
    high: int


class Coupling(Record):
    """How the rig of an axis meets devices that are not this project's (`sim_bus.rig.coupling`)."""

    foreign: int  # 0: our own two devices, and nothing below is used
    shown_count: int
    shown: Annotated[RecordArray[ShownRecord], MOST_SHOWN]
    brake_output: int
    brake_channel: int  # of the module, or the object's slot
    brake_counts: float  # counts of the set-point for one per mille of a drive, or one Nm of our driver
    brake_scale_Nm: float  # for one count, where there is no table
    brake_points: int  # of the table; 0: none
    brake_table_raw: Annotated[FloatField, TABLE_POINTS]  # ascending
    brake_table_Nm: Annotated[FloatField, TABLE_POINTS]


class RigAxis(Coupling):
    """An axis of the rig: its devices, and the operator's schedule."""

    motor: int  # rows of the node records
    brake: int  # row of the brake
    operator_start_ns: int  # -1: the schedule has not begun
    force_step: int  # the plant's step at which the force block begins
    force_end_ns: int  # the time at which it ends
    steps_per_knot: int  # of the operator's force
    truth_on: int  # 1: the true course is kept


DETAIL = dtype_of(DetailRecord)
PLANT = dtype_of(PlantRecord)
AXIS = dtype_of(RigAxis)
