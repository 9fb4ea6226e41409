"""The host's compiled records: limits and scales (CONTROL), and the cycle's state (HOST) with the process image.

All values are in SI units at the handle, except where a name says counts, raw or pm (per mille of the
motor's rated torque).
"""

from __future__ import annotations

from enum import IntEnum
from typing import Annotated, TypeAlias

from coulombus.eds.codec import PdoRecord
from coulombus.host.laws.law import LawFunction, LawRecord, LawStateRecord, MotionRecord
from coulombus.host.plane.plane_host_record import PlaneHostRecord
from coulombus.host.plane.plane_step import PlaneFunctions
from coulombus.host.world.records import LocalModelRecord
from coulombus.kernels.records import FloatField, IntegerField, Record, RecordArray, dtype_of
from coulombus.rigs.devices import MOST_PLAYS, TABLE_POINTS
from coulombus.rigs.model import MOST_DELAY_CYCLES, MOST_DEVICES, WINDOW_CYCLES, WORK_WINDOW_CYCLES
from coulombus.rigs.pdo_maps import MOST_CONSTANTS, MOST_PDOS

__all__ = [
    "ASKED",
    "AXIS",
    "DRIVE_PDOS",
    "HOST",
    "KINETIC_CYCLES",
    "SLOTS",
    "TRACK",
    "AxisRecord",
    "AxisRecords",
    "ControlRecord",
    "HostRecord",
    "Image",
    "LawFunction",
    "LiveRecord",
    "OrderRecord",
    "Phase",
    "PlaneFunctions",
    "SignResult",
    "Slot",
    "Trip",
]


class Phase(IntEnum):
    """Phase of the cycle: each phase leads to the next, and any failed check leads to SAFE."""

    OFF = 0  # outputs zero, controlword "disable voltage"
    STILL = 1  # drive switched on; the handle must be still before anything else
    ENABLE = 2  # controlword "enable operation" until the drive reports Operation Enabled
    SIGN = 3  # a small torque ramp checks that motor, encoder and transducer agree on the sign
    SETTLE = 4  # torque back to zero, still again
    RUN = 5  # the law is displayed; its gain ramps in
    SAFE = 6  # motor torque 0 and controlword "disable voltage"; the brake is released
    DISABLE = 7  # brake off; waits until the drive reports that it is disabled
    DONE = 8  # the run has ended; outputs zero


class Trip(IntEnum):
    """Reason for the safe state or for a refusal to arm; 0: none."""

    NONE = 0
    SPEED = 1
    ENCODER_JUMP = 2
    NET_WORK = 3
    HANDLE_TORQUE = 4
    TRAVEL = 5
    VOLTAGE = 6
    COIL_I2T = 7
    TPDO_LOST = 8
    EMCY_MOTOR = 9
    EMCY_BRAKE = 10
    HEARTBEAT_MOTOR = 11
    HEARTBEAT_BRAKE = 12
    DRIVE_STATE = 13
    NMT_STATE = 14
    TRANSMIT = 15
    RECORDING = 16
    BUS_LOST = 17
    SECOND_HOST = 18
    DEADMAN = 19
    DATA_PLANE = 20
    LAW = 21
    OTHER_AXIS = 22
    HOST = 23
    EMCY_SENSOR = 24
    HEARTBEAT_SENSOR = 25
    MOTOR_TORQUE = 26
    LAW_CLIPPED = 27
    WORKSPACE = 28
    SINGULAR = 29
    LAW_OSCILLATES = 30
    NOT_STILL = 32  # from here on: arming was refused
    HANDLE_LOADED = 33
    ENABLE_TIMEOUT = 34
    SIGN_NO_MOTION = 35
    SIGN_ENCODER = 36
    SIGN_TRANSDUCER = 37
    SIGN_TRAVEL = 38


class SignResult(IntEnum):
    """Outcome of the sign check."""

    NOT_RUN = 0
    AGREED = 1  # motor, encoder and transducer agree
    REFUSED = 3  # motor, encoder or transducer disagreed, or nothing moved
    NO_HAND = 2  # motor and encoder agree; no hand held the handle, so the transducer could not be checked


class Image(IntEnum):
    """Slots of the process image: raw values of the PDOs."""

    CONTROLWORD = 0
    TARGET_TORQUE = 1
    BRAKE_SETPOINT = 2
    STATUSWORD = 3
    POSITION = 4
    TORQUE = 5
    VELOCITY = 6
    HANDLE_TORQUE = 7
    COIL_CURRENT = 8
    COIL_TEMPERATURE = 9
    DEADMAN = 10
    BRAKE_STATUSWORD = 11
    BRAKE_CONTROLWORD = 12
    CONSTANT = 16  # from here on: constants that the RPDOs carry besides the host's commands


IMAGE_SLOTS = Image.CONSTANT + MOST_CONSTANTS
TRACK = WINDOW_CYCLES
"""Largest number of positions in the window of the slow-velocity estimate."""
ASKED = MOST_DELAY_CYCLES - 1  # largest number of cycles for which the law's output is held back
KINETIC_CYCLES = 4
"""Number of cycles over which the passivity observer takes the largest and the smallest kinetic energy."""
DRIVE_PDOS = MOST_PDOS  # size of the host's PDO tables, for each direction


class ControlRecord(Record):
    """Limits and scales of an axis."""

    period_ns: int  # period of SYNC
    window_ns: int  # time from SYNC to the end of the wait for TPDOs
    sync_cob_id: int  # identifier of SYNC; -1: another axis sends SYNC
    host_id: int  # node id of the host
    nodes: int  # number of nodes: motor, brake, sensors
    node_id: Annotated[IntegerField, MOST_DEVICES]  # node id of each node
    emcy_id: Annotated[IntegerField, MOST_DEVICES]  # identifier of each node's EMCY
    heartbeat_timeout_ns: Annotated[IntegerField, MOST_DEVICES]  # heartbeat time-out of each node; 0: not monitored
    heartbeat_ns: int  # period of the host's heartbeat; 0: no heartbeat
    guard_ns: int  # period of node guarding by remote frames; 0: no node is guarded
    guarded: int  # one bit for each guarded node
    rpdos: int  # number of RPDOs that the host sends
    tpdos: int  # number of TPDOs that the host receives
    every_cycle: int  # bits of the TPDOs sent in each cycle
    awaited: int  # bits of the TPDOs that end the wait: those of each cycle, or all if there are none
    by_timer: int  # bits of the TPDOs sent on an event timer
    position_mask: int  # bit of the TPDO that carries the position
    position_half: int  # half the number of counts after which the position wraps
    motor_active: int  # 1: the motor displays the law (mode active)
    brake_active: int  # 1: the brake displays the law (modes passive, hybrid)
    is_hybrid: int  # 1: the motor displays `LawStateRecord.motor_Nm` (mode hybrid)
    brake_is_drive: int  # 1: the brake is a CiA 402 drive with power states
    brake_ramps: int  # 1: the brake's driver ramps the brake off when set-points end
    # scales
    rad_count: float  # signed by the encoder's polarity
    motor_Nm_raw: float  # torque at the handle of one count of the motor's set-point (6071h: per mille), signed
    torque_Nm_raw: float  # torque of one count of the measured torque; 0: not measured
    torque_commanded: float  # 1: the commanded torque replaces the measured torque
    handle_Nm_raw: float  # torque of one count of the handle's transducer, signed; 0: no transducer
    handle_offset_Nm: float  # transducer torque at raw value 0
    brake_Nm_raw: float  # torque of one count of the brake's set-point; with a table: in its last segment
    brake_points: int  # number of points of the brake's table; 0: a factor
    brake_raw_at: Annotated[FloatField, TABLE_POINTS]  # set-points of the table, ascending
    brake_Nm_at: Annotated[FloatField, TABLE_POINTS]  # torques of the table
    coil_A_raw: float  # current of one count; 0: not measured
    coil_A_Nm: float  # coil current per commanded torque, where it is not measured; 0: it is measured
    # compensation of the inherent friction
    friction_Nm: float  # modelled Coulomb friction of the device
    compensation_Nm: float  # motor torque that compensates the Coulomb friction
    viscous: float  # viscous friction [Nms/rad]
    velocity_band_counts: float  # Delta v, in encoder counts a cycle
    slide_band_counts: float  # velocity band of the estimate over `window_cycles`, in counts a cycle
    gain_step: float  # increase of the gain in a cycle
    delay_cycles: int  # cycles from sampling to actuation; above 1 the host holds back the law's output
    # corrections between law and brake (`host.cycle.slow_velocity`, `host.cycle.brake_model`, `host.cycle.passivity`)
    window_cycles: int  # longest window of the slow-velocity estimate; 1: backward difference
    level_is_felt: int  # 1: the law gives the level at the hand; 0: the level of the brake
    inertia: float  # inertia of handle and motor [kg m2]
    coil_step: float  # modelled step of the coil's lag in a cycle, as a share of the remaining error; 0: no lag
    fluid_step: float  # modelled step of the fluid's lag in a cycle, as a share of the remaining error; 0: no lag
    iron_plays: int  # number of play operators in the model of the brake's iron; 0: no hysteresis
    iron_r: Annotated[FloatField, MOST_PLAYS]  # thresholds of the play operators [Nm]
    iron_w: Annotated[FloatField, MOST_PLAYS]  # weights of the play operators
    iron_direct: float  # weight of the coil's torque itself
    passivity_J: float  # energy at which the passivity observer begins to reduce the compensation; inf: no observer
    # limits
    motor_limit_raw: int  # in counts of the set-point; for 6071h the same number as the drive's 6072h
    motor_rate_Nm: float  # largest change of the motor's torque in a cycle
    brake_limit_Nm: float  # the rig file's limit or the device's, whichever is less
    brake_limit_raw: int  # largest value of the brake's set-point object
    brake_fall_Nm: float  # largest fall of the law's set-point in a cycle
    brake_rise_Nm: float  # largest rise of the law's set-point in a cycle
    most_reversals: float  # counted reversals above which the host trips
    reversal_decay: float  # decay of their count in a cycle
    clipped_cycles: int  # excess of clipped over unclipped cycles above which the host trips
    speed_limit: float  # rad/s
    jump_counts: int  # largest plausible motion in a cycle
    net_work_J: float  # largest net work of the motor within the window
    net_work_cycles: int  # length of the window of the net work
    is_joint: int  # 1: the axis is a joint of an arm
    stores: int  # 1: the law returns energy to the hand, as a spring does
    travel_rad: float  # largest travel from the start; inf: unlimited
    motor_mismatch_Nm: float  # largest measured torque beyond the command; inf: not measured
    motor_mismatch_cycles: int  # cycles in a row above motor_mismatch_Nm after which the host trips
    motor_lag_decay: float  # decay of the command's envelope in a cycle
    mismatch_Nm: float  # largest transducer torque that motor and brake do not explain
    mismatch_cycles: int  # cycles in a row above mismatch_Nm after which the host trips
    mismatch_share: float  # largest mean error of the felt torque, as a share of the displayed torque
    smooth_step: float  # step of the smoothed error of the felt torque in a cycle (`host.cycle.plausibility`)
    mean_step: float  # step of its mean
    missed_cycles: int  # cycles in a row without a TPDO after which the host trips
    coil_limit_A2: float  # largest mean square of the coil's current
    coil_decay: float  # decay of the mean square of the coil's current in a cycle
    brake_lag_decay: float  # decay of the error of the expected brake torque in a cycle
    # arming
    still_counts: int  # motion of a handle that stands still
    still_cycles: int  # cycles in a row that count as standstill
    still_handle_Nm: float  # torque on the handle above which it counts as loaded
    still_timeout_cycles: int  # longest wait for standstill; then arming is refused
    enable_timeout_cycles: int  # longest wait for Operation Enabled; then arming is refused
    sign_check: int  # 0: no motor in this mode, so no sign check
    sign_step_Nm: float  # increase of the sign check's torque in a cycle
    sign_counts: int  # motion that decides the encoder's sign
    sign_torque_Nm: float  # end of the torque ramp
    sign_travel_counts: int  # largest motion in the sign check
    sign_hand_Nm: float  # change of the handle torque that decides the transducer's sign
    sign_hand_cycles: int  # cycles over which the handle torque is averaged in the sign check
    settle_cycles: int  # cycles of standstill without torque after the sign check
    deadman_key: int  # dead man's switch; 1: HOST.deadman_ok is written from outside the cycle
    deadman_slot: int  # slot of the process image that holds the switch; -1: none
    deadman_mask: int  # bits that are all 1 while the switch is held; 0: any bit
    # orderly end
    hands_over: (
        int  # 1: the motor displays torque on which a hand may lean; the brake takes it over before the motor ends
    )
    rise_cycles: int  # time for the brake to rise
    fade_cycles: int  # time for the motor's torque to fall after that
    ends_by_nmt: int  # 1: the drive ends its torque when NMT takes it out of OPERATIONAL
    # safe state
    safe_longest_cycles: int  # longest time to brake off
    release_Nm: float  # fall of the brake's set-point in a cycle of the safe state
    unloaded_Nm: float  # fall of the brake's set-point in a cycle of the safe state, with an unloaded handle
    release_counts: float  # speed in counts a cycle above which the release pauses
    # telemetry (`host.cycle.telemetry`)
    law_keeps: int  # number of state variables that the law declares


class HostRecord(Record):
    """State of an axis' cycle."""

    phase: int  # a `Phase`
    phase_cycle: int  # cycles since the phase began
    doubt: int  # the `Trip` of this cycle's monitors (joints of an arm)
    held: int  # 1: another joint of the arm is not ready for this joint's next phase
    ready: int  # 1: the phase is over but for the other joints
    safe_from_Nm: float  # brake torque at the begin of the safe state (joints of an arm); negative before
    stop: int  # 1: safe stop requested; above: the `Trip` to stop for
    trip: int  # a `Trip`
    trip_ns: int  # time of the trip, or of the entry into SAFE without one
    emcy_code: int  # error code of the EMCY that tripped
    sign_result: int  # a `SignResult`
    sign_direction: int  # direction of the sign check's torque: 1, then -1
    sign_moved: int  # largest motion of the handle under the sign check's full torque, in counts
    deadman_ok: int  # 1: the switch is held, or the rig has none
    # the cycle
    cycle: int  # number of this cycle
    next_ns: int  # time at which `on_time` is due
    sync_ns: int  # time at which this cycle's SYNC was due
    waiting: int  # 1: SYNC is sent, TPDOs are awaited
    arrived: int  # bits of the TPDOs that have arrived in this cycle
    enabled_ns: int  # time at which the drive entered Operation Enabled; -1 before
    armed_ns: int  # time at which the law began; -1 before
    full_gain_ns: int  # time at which the law's gain reached 1; -1 before
    heartbeat_due_ns: int  # time of the host's next heartbeat
    guard_due_ns: int  # time of the next guarding requests
    heard_ns: Annotated[IntegerField, MOST_DEVICES]  # time of each node's last heartbeat; -1: none
    nmt: Annotated[IntegerField, MOST_DEVICES]  # NMT state in each node's last heartbeat; -1: none
    suspect_node: int  # the node whose EMCY or heartbeat tripped
    law_Nm: float  # output of the law that is not finite
    law_part: int  # the law's output that is not finite: 0: the result, 1: the brake's, 2: the motor's
    # measured
    image: Annotated[IntegerField, IMAGE_SLOTS]  # the process image, by `Image`
    raw_position: int  # last received 6064h
    counts: int  # encoder counts since the start, unwrapped
    position_age: int  # cycles since the last fresh position
    has_position: int  # 1: a position has arrived since the start
    fresh: int  # 1: this cycle's position is fresh
    reference_counts: int  # reference of the phase: where the handle was still, where the sign check began
    moved_counts: int  # between the last two fresh positions, however many cycles apart
    v_counts: float  # velocity (backward difference), in counts a cycle
    slide_counts: float  # slow-velocity estimate, which decides between stick and slip, in counts a cycle
    track: Annotated[IntegerField, TRACK]  # ring of the positions for the slow-velocity estimate
    track_row: int  # next row of the ring of positions
    track_length: int  # number of positions in the ring of positions
    handle_Nm: float  # the transducer's torque
    drive: int  # `PowerState` of the motor's drive; -1: none
    brake_drive: int  # `PowerState` of the brake; of a brake without power states, that of the motor's drive
    # commanded
    gain: float  # gain of the law, 0 to 1
    end_cycles: int  # cycles since the brake began to take over from the motor, at an orderly end; 0 before
    displayed_Nm: float  # largest recent torque on the motor that a hand may lean on; it decays to 0
    level_Nm: float  # torque that the brake bears, from the begin of the hand-over or of the safe state on
    takes_over: int  # 1: the brake rises to that level
    torque_Nm: float  # torque of the motor
    brake_Nm: float  # torque of the brake
    brake_lagged_Nm: float  # brake torque that is expected at the handle
    coil_Nm: float  # modelled torque of the coil's current
    iron_Nm: float  # modelled torque behind the iron, at the fluid's input
    iron_y: Annotated[FloatField, MOST_PLAYS]  # modelled state of the play operators
    fluid_Nm: float  # modelled torque of the fluid
    asked_sense: Annotated[FloatField, ASKED]  # held back outputs of the law: direction of the compensation
    asked_psi_Nm: Annotated[FloatField, ASKED]  # held back outputs of the law: the motor's torque
    asked_brake_Nm: Annotated[FloatField, ASKED]  # held back outputs of the law: the brake's level
    asked_row: int  # next row of the rings of held back outputs
    share: float  # share of its compensation that the motor may give
    port_J: float  # energy balance at the hand's port
    port_kinetic_J: Annotated[FloatField, KINETIC_CYCLES]  # kinetic energies of the last fresh cycles
    port_row: int  # next row of the ring of kinetic energies
    port_brake_Nm: float  # expected brake torque during the motion to the newest position
    port_handle_Nm: float  # handle torque a cycle ago
    port_pushed_Nm: float  # the law's part for the motor a cycle ago
    port_way: float  # last motion that was not 0 [rad]
    port_slid_ns: int  # time since the motion last changed its sign
    pushed_Nm: float  # the law's part for the motor in the last command, with the sign of psi
    handle_before_Nm: float  # sum of the handle torque before the sign check, then its mean
    handle_during_Nm: float  # sum of the handle torque in the sign check
    handle_samples: int  # number of summed samples
    emcy: int  # `Trip` of a received EMCY
    foreign_id: int  # identifier of a host's frame that another station sent; -1: none
    drive_taken: int  # 1: NMT has taken the drive out of OPERATIONAL, because another station commands it
    # monitors
    still: int  # cycles in a row without motion
    missed_in_a_row: int  # cycles in a row that lack a TPDO
    tpdo_age: Annotated[IntegerField, DRIVE_PDOS]  # cycles since each TPDO by timer arrived: 1 in that cycle
    oldest_tpdo: int  # largest of the ages of the TPDOs by timer
    voltage_low: int  # cycles in a row in which the drive lacked its supply
    commanded_high_Nm: float  # upper envelope of the motor's commands, which decays to 0
    commanded_low_Nm: float  # lower envelope of the motor's commands, which decays to 0
    motor_mismatch: int  # cycles in a row in which the measured torque is outside the envelopes
    mismatch: int  # cycles in a row in which the transducer torque is not explained
    felt_v_counts: float  # speed with a short lag, in counts a cycle (`host.cycle.plausibility`)
    mean_v_counts: float  # smoothed speed, in counts a cycle
    felt_error_Nm: float  # smoothed difference of the felt from the displayed torque
    mean_error_Nm: float  # its mean along the motion
    mean_size_Nm: float  # mean of the displayed torque
    felt_wrong: int  # cycles in a row in which the mean error is too large
    coil_A2: float  # mean square of the coil's current
    work_sum: float  # net work of the motor within the window [J]
    work_row: int  # next row of the window of the net work
    work: Annotated[FloatField, WORK_WINDOW_CYCLES]  # work of the motor in each cycle of the window [J]
    contact_J: float  # work of a storing law's push since the contact began
    world_Nm: float  # the world's part of pushed_Nm (`host.world.local_model`)
    world_elastic_Nm: float  # what of that the world's wall, spring and field exert
    world_J: float  # energy that the hand has stored in them
    world_most_J: float  # largest energy that they can return
    unpaid_J: float  # energy that they gave at an arm's tip in the last cycle, and the hand had not stored
    # counters
    clipped: int  # 1: a limit changes the law's output in this cycle
    clipped_balance: int  # clipped minus unclipped cycles, at least 0
    side: Annotated[
        IntegerField, 2
    ]  # sign of the motor's last torque near its limit, and of the brake's last fast move
    reversals: Annotated[FloatField, 2]  # their changes within the window
    moved_from_Nm: float  # brake's set-point of the last cycle
    display_cycles: int  # cycles since Operation Enabled, until SAFE
    lost_pdos: int  # cycles that lacked a TPDO at the next SYNC
    late_cycles: int  # cycles whose RPDOs were sent after the next SYNC was due
    stray_frames: int  # frames of unknown senders or with unknown identifiers
    malformed_pdos: int  # TPDOs of a wrong length
    malformed_services: int  # EMCYs, heartbeats, SDO responses whose length is not that of CiA 301
    clipped_torque: int  # the motor's torque exceeded its limit
    slowed_torque: int  # the motor's torque was limited by its rate, or near the speed limit, in phase RUN
    limited_by_drive: int  # the drive reported an internal limit (statusword bit 11) in phase RUN
    clipped_setpoints: int  # the brake's set-point exceeded its limit
    slowed_setpoints: int  # the brake's set-point fell faster than its rate
    negative_setpoints: int  # the law gave a negative set-point for the brake
    withheld_compensation: int  # the passivity observer reduced the motor's compensation
    implausible_torque: int  # the hand felt another torque than the displayed one
    # telemetry (`host.cycle.telemetry`)
    told_cycle: int  # last reported cycle
    last_counters: Annotated[IntegerField, 7]  # counters in the last report


HOST = dtype_of(HostRecord)


class Slot(IntEnum):
    """Slots of an order's values."""

    K_P = 0  # Nm/rad
    F_S = 1  # Nm
    F_D = 2  # Nm
    COMPENSATION = 3  # Nm
    USER = 4  # from here on: `law.user`, which holds a law's named parameters


SLOTS = Slot.USER + 16


class OrderRecord(Record):
    """Target values of the live parameters."""

    value: Annotated[FloatField, SLOTS]  # by `Slot`
    cycles: int  # duration of the transition


class LiveRecord(Record):
    """The live parameters of an axis."""

    offered: Annotated[RecordArray[OrderRecord], 2]  # double buffer; order n is in row n & 1
    wanted: int  # number of the newest order; 0: none
    taken: int  # number of the order that the step follows
    cycle: int  # cycles since the transition began
    cycles: int  # duration of the transition
    first: Annotated[FloatField, SLOTS]  # values at the beginning of the transition
    last: Annotated[FloatField, SLOTS]  # values at the end of the transition


class AxisRecord(Record):
    """Record of one axis for the kernels."""

    control: ControlRecord  # limits and scales
    host: HostRecord  # state of the cycle
    rpdos: Annotated[RecordArray[PdoRecord], DRIVE_PDOS]  # PDOs that the host sends
    tpdos: Annotated[RecordArray[PdoRecord], DRIVE_PDOS]  # PDOs that the host receives
    motion: MotionRecord  # the law's input
    law: LawRecord  # the law's parameters
    state: LawStateRecord  # the law's state and output
    live: LiveRecord  # changes of the law's parameters
    plane: PlaneHostRecord  # two joints of one arm: that of the first axis is used
    world: LocalModelRecord  # the model that another program says


AXIS = dtype_of(AxisRecord)

AxisRecords: TypeAlias = RecordArray[AxisRecord]
"""The axes of a bus; the first axis sends SYNC."""
