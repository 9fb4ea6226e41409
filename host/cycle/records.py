"""The host's compiled records: limits and scales (`CONTROL`), the process image, and what the cycle
keeps (`HOST`).

Everything here is SI at the handle, except where a name says counts, raw or pm (per mille of the
motor's rated torque).
"""

from __future__ import annotations

from enum import IntEnum
from typing import Annotated, TypeAlias

from coulombus.eds.codec import PdoRecord
from coulombus.host.laws.law import LawFunction, LawRecord, LawStateRecord, MotionRecord
from coulombus.kernels.records import FloatField, IntegerField, Record, RecordArray, dtype_of
from coulombus.rigs.devices import TABLE_POINTS
from coulombus.rigs.hysteresis import MOST_PLAYS
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
    "SignResult",
    "Slot",
    "Trip",
]


class Phase(IntEnum):
    """What the cycle is doing; each phase leads to the next one, and any failed check leads to SAFE."""

    OFF = 0  # outputs zero, controlword "disable voltage"
    STILL = 1  # drive switched on; the handle must be still before anything else
    ENABLE = 2  # controlword "enable operation" until the drive says so
    SIGN = 3  # a small torque ramp: do motor, encoder and transducer agree?
    SETTLE = 4  # torque back to zero, still again
    RUN = 5  # the law; its gain ramps in
    SAFE = 6  # motor torque 0 and controlword "disable voltage"; the brake is released
    DISABLE = 7  # brake off; until the drive says that it is disabled
    DONE = 8  # nothing more to do; outputs zero


class Trip(IntEnum):
    """Why the host went to its safe state, or refused to arm. 0: it did not."""

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
    NO_HAND = 2  # motor and encoder agree; nothing held the handle, so the transducer could not be judged


class Image(IntEnum):
    """Slots of the process image: raw values as they stand in the PDOs."""

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
    CONSTANT = 16  # here and behind: what RPDOs carry beside what the host commands


IMAGE_SLOTS = Image.CONSTANT + MOST_CONSTANTS
TRACK = WINDOW_CYCLES
"""Positions that the estimate of a slow velocity looks back at, at most."""
ASKED = MOST_DELAY_CYCLES - 1
"""Cycles for which what the law asks for is held back, at most."""
KINETIC_CYCLES = 4
"""Cycles of whose kinetic energies the observer takes the largest and the smallest."""
DRIVE_PDOS = MOST_PDOS
"""PDOs that the host's tables have room for, each way."""


class ControlRecord(Record):
    """Limits and scales of an axis."""

    period_ns: int  # of SYNC
    window_ns: int  # SYNC to the last TPDO
    sync_cob_id: int  # SYNC's identifier; -1: another axis leads
    host_id: int  # the host's own node id
    nodes: int  # motor, brake, sensors
    node_id: Annotated[IntegerField, MOST_DEVICES]  # of each node
    emcy_id: Annotated[IntegerField, MOST_DEVICES]  # identifier of each node's EMCYs
    heartbeat_timeout_ns: Annotated[IntegerField, MOST_DEVICES]  # of each node; 0: not watched
    heartbeat_ns: int  # period of the host's heartbeat; 0: it has none
    guard_ns: int  # period of the remote frames by which the host guards; 0: it guards no node
    guarded: int  # a bit for each node that is guarded
    rpdos: int  # number of PDOs the host sends
    tpdos: int  # number of PDOs it waits for
    every_cycle: int  # bits of the TPDOs that come in each cycle
    awaited: int  # bits of those whose arrival ends the wait: these, or all where there are none
    by_timer: int  # bits of the others
    position_mask: int  # the bit of the TPDO that carries the position
    position_half: int  # half the counts after which it wraps
    motor_active: int  # 1: the motor displays the law (mode active)
    brake_active: int  # 1: the brake displays the law (modes passive, hybrid)
    is_hybrid: int  # 1: the motor displays the law's part for it (mode hybrid)
    brake_is_drive: int  # 1: the brake has power states of its own
    brake_ramps: int  # 1: its driver ramps it off by itself when set-points end
    # scales
    rad_count: float  # signed by the encoder's polarity
    motor_Nm_raw: float  # torque at the handle of one count of the set-point (6071h: per mille), signed
    torque_Nm_raw: float  # of the measured torque; 0: not measured
    torque_commanded: float  # 1: the command stands for it
    handle_Nm_raw: float  # of the handle's torque transducer, signed; 0: there is none
    handle_offset_Nm: float  # what the transducer shows without a load
    brake_Nm_raw: float  # with a table, of its last step
    brake_points: int  # of the table; 0: a factor
    brake_raw_at: Annotated[FloatField, TABLE_POINTS]  # the set-points of the table, ascending ...
    brake_Nm_at: Annotated[FloatField, TABLE_POINTS]  # ... and the torques that they give
    coil_A_raw: float  # 0: not measured
    coil_A_Nm: float  # the command stands for it; 0: it is measured
    # compensation of the inherent friction
    friction_Nm: float  # the device's own Coulomb friction, as believed
    compensation_Nm: float  # what the motor gives against it
    viscous: float  # Nms/rad, compensated, too
    velocity_band_counts: float  # Delta v, in encoder counts a cycle
    slide_band_counts: float  # the band of the estimate over `window_cycles`
    gain_step: float  # a cycle
    delay_cycles: int  # from sampling to actuation; beyond 1 the host holds back what the law asks for
    # what the hand feels (`host.cycle.slow_velocity`, `host.cycle.brake_model`, `host.cycle.passivity`)
    window_cycles: int  # of the estimate of a slow velocity; 1: a backward difference
    level_is_felt: int  # 1: the law says what the hand feels, and not what the brake bears
    inertia: float  # kg m2, of the handle with the motor
    coil_step: float  # share of the way that the coil goes in a cycle, as believed; 0: no lead
    fluid_step: float  # the same share for the fluid
    iron_plays: int  # play operators of the brake's iron, as believed; 0: it has no hysteresis
    iron_r: Annotated[FloatField, MOST_PLAYS]  # thresholds of the play operators [Nm] ...
    iron_w: Annotated[FloatField, MOST_PLAYS]  # ... and their weights
    iron_direct: float  # weight of the coil itself
    passivity_J: float  # inf: the motor's compensation is not observed
    # limits
    motor_limit_raw: int  # in counts of the set-point; of 6071h the same number as the drive's 6072h
    motor_rate_Nm: float  # a cycle
    brake_limit_Nm: float  # the rig file's limit or the device's, whichever is less
    brake_limit_raw: int  # what its object takes at most
    brake_fall_Nm: float  # by which the law's set-point may fall in a cycle
    clipped_cycles: int  # so many more clipped than unclipped cycles of the law trip
    speed_limit: float  # rad/s
    jump_counts: int  # more in a cycle is no motion
    net_work_J: float  # that the motor may give within the window
    net_work_cycles: int  # length of that window
    stores: int  # 1: the law gives back what the hand has put into it, as a spring does
    travel_rad: float  # inf: unlimited
    motor_mismatch_Nm: float  # measured torque beyond the command; inf: not measured
    motor_mismatch_cycles: int  # so many in a row trip
    motor_lag_decay: float  # a cycle, of the command's envelope
    mismatch_Nm: float  # transducer beyond what motor and brake explain
    mismatch_cycles: int  # so many in a row trip
    missed_cycles: int  # so many in a row without a TPDO trip
    coil_limit_A2: float  # mean square of the coil's current
    coil_decay: float  # a cycle
    brake_lag_decay: float  # a cycle, of the brake torque expected at the handle
    # arming
    still_cycles: int  # so many in a row without a count are standstill
    still_handle_Nm: float  # more torque on the handle is a load
    still_timeout_cycles: int  # arming is refused after so many
    enable_timeout_cycles: int  # arming is refused after so many
    sign_check: int  # 0: no motor in this mode, nothing to check
    sign_step_Nm: float  # a cycle
    sign_counts: int  # motion that is decisive
    sign_torque_Nm: float  # the ramp's end
    sign_travel_counts: int  # motion that is too much
    sign_hand_Nm: float  # change of the handle torque that is decisive
    sign_hand_cycles: int  # ... averaged over this many cycles
    settle_cycles: int  # without torque behind the sign check
    # dead man
    deadman_key: int  # 1: somebody outside keeps HOST.deadman_ok
    deadman_slot: int  # slot of the process image that holds the switch; -1: none
    deadman_mask: int  # bits that are all 1 while the switch is held; 0: any bit
    # safe state
    safe_longest_cycles: int  # the brake is off at the latest after so many
    release_Nm: float  # by which the brake's set-point falls in a cycle of the safe state
    unloaded_Nm: float  # ... where no load is on the handle
    release_counts: float  # a cycle; the release pauses while the handle is faster
    # what the host tells of itself (`host.cycle.telemetry`)
    law_keeps: int  # numbers, by its declaration


class HostRecord(Record):
    """What the cycle of an axis keeps."""

    phase: int  # a `Phase`
    phase_cycle: int  # cycles since the phase began
    stop: int  # 1: somebody wants the safe state without a trip
    trip: int  # a `Trip`
    trip_ns: int  # when
    emcy_code: int  # error code of the EMCY that tripped
    sign_result: int  # a `SignResult`
    sign_direction: int  # sense that the sign check tries: 1, then -1
    sign_moved: int  # counts that its full torque moved the handle, at most
    deadman_ok: int  # 1: a hand is on the switch, or none is asked for
    # the cycle
    cycle: int  # number of this cycle
    next_ns: int  # when `on_time` wants to be called
    sync_ns: int  # when this cycle's SYNC was due
    waiting: int  # 1: SYNC is out, TPDOs are awaited
    arrived: int  # bit mask of this cycle's TPDOs
    enabled_ns: int  # when the drive entered Operation Enabled; -1 before
    armed_ns: int  # when the law began; -1 before
    full_gain_ns: int  # when its gain came to 1; -1 before
    heartbeat_due_ns: int  # the host's next heartbeat
    guard_due_ns: int  # its next round of guarding
    heard_ns: Annotated[IntegerField, MOST_DEVICES]  # of each node, its last heartbeat; -1 none
    nmt: Annotated[IntegerField, MOST_DEVICES]  # of each node, the state that its heartbeat told; -1 none
    suspect_node: int  # the node whose EMCY or heartbeat tripped
    law_Nm: float  # what the law returned that is not finite ...
    law_part: int  # ... 0: as its result, 1: for the brake, 2: for the motor
    # measured
    image: Annotated[IntegerField, IMAGE_SLOTS]  # the process image, by `Image`
    raw_position: int  # 6064h as it came last
    counts: int  # encoder counts since the start, without the wrap of 6064h
    position_age: int  # cycles since it was fresh
    has_position: int  # 1: a position has come since the start
    fresh: int  # 1: this cycle's position is fresh
    reference_counts: int  # of the phase: where the handle was still, where the sign check began
    moved_counts: int  # between the last two fresh positions, however many cycles apart
    v_counts: float  # the velocity, in counts a cycle
    slide_counts: float  # the estimate by which the law slides or is stuck
    track: Annotated[IntegerField, TRACK]  # the positions behind it
    track_row: int  # where the next one goes
    track_length: int  # how many are there
    handle_Nm: float  # the transducer's torque
    drive: int  # PowerState that the statusword tells; -1: none
    brake_drive: int  # the brake's; of one without power states the drive's
    # commanded
    gain: float  # of the law, 0 to 1
    torque_Nm: float  # the motor's
    brake_Nm: float  # the brake's
    brake_lagged_Nm: float  # the brake torque that is expected at the handle
    coil_Nm: float  # the lead's belief of what the coil's current stands for ...
    iron_Nm: float  # ... of what the fluid sees of it ...
    iron_y: Annotated[FloatField, MOST_PLAYS]  # of the play operators, as believed
    fluid_Nm: float  # ... and of what the fluid bears
    asked_sense: Annotated[FloatField, ASKED]  # by the law, and held back: of the compensation ...
    asked_psi_Nm: Annotated[FloatField, ASKED]  # ... of the motor ...
    asked_brake_Nm: Annotated[FloatField, ASKED]  # ... and of the brake
    asked_row: int  # where the next ones go
    share: float  # of its compensation that the motor may give
    port_J: float  # paid at the hand's port and still there
    port_kinetic_J: Annotated[FloatField, KINETIC_CYCLES]  # of the last fresh cycles
    port_row: int  # where the next energy goes
    port_brake_Nm: float  # the brake's expected torque on the way that the position ends
    port_handle_Nm: float  # a cycle ago: the hand ...
    port_pushed_Nm: float  # ... and the law's part for the motor
    port_way: float  # the last way that was not 0 [rad] ...
    port_slid_ns: int  # ... and for how long it has had its sign
    pushed_Nm: float  # the law's part that the motor was given last, as psi
    handle_before_Nm: float  # sums of the handle torque before and in the sign check
    handle_during_Nm: float  # ... and in it
    handle_samples: int  # how many are summed
    emcy: int  # a trip that an EMCY asks for
    foreign_id: int  # identifier of a host's frame that somebody else sent; -1: none
    # watches
    still: int  # cycles in a row without a count
    missed_in_a_row: int  # cycles in a row that lack a TPDO
    tpdo_age: Annotated[
        IntegerField, DRIVE_PDOS
    ]  # cycles since each TPDO by timer came: 1 in the cycle in which it came
    oldest_tpdo: int  # the largest of them
    voltage_low: int  # cycles in a row in which the drive lacked its voltage
    commanded_high_Nm: float  # envelope of the motor's commands, which decays to 0 ...
    commanded_low_Nm: float  # ... below and above
    motor_mismatch: int  # cycles in a row in which the measured torque is outside
    mismatch: int  # cycles in a row in which the transducer shows more than is explained
    coil_A2: float  # mean square of the coil's current
    work_sum: float  # of the window [J]
    work_row: int  # where the next one goes
    work: Annotated[FloatField, WORK_WINDOW_CYCLES]  # of the motor in each cycle of the window [J]
    contact_J: float  # work of a storing law's push since it began
    # counters
    clipped: int  # 1: a limit acts on what the law asks for in this cycle
    clipped_balance: int  # clipped cycles less unclipped ones, not below 0
    display_cycles: int  # cycles since Operation Enabled, until SAFE
    lost_pdos: int  # TPDOs that had not come by the next SYNC
    late_cycles: int  # whose RPDOs were handed over after the next SYNC was due
    stray_frames: int  # of nobody that the host knows
    malformed_pdos: int  # of a wrong length
    malformed_services: int  # EMCYs, heartbeats, SDO responses of another length than CiA 301's
    clipped_torque: int  # the motor's torque was more than its limit
    slowed_torque: int  # ... was held back by its rate, or near the speed limit, in phase RUN
    limited_by_drive: int  # the drive told of a limit of its own (statusword bit 11) in phase RUN
    clipped_setpoints: int  # the brake's set-point was more than its limit
    slowed_setpoints: int  # ... fell faster than its rate
    negative_setpoints: int  # of the brake, by the law
    withheld_compensation: int  # the observer let the motor give less than its compensation
    # what the host has told of itself (`host.cycle.telemetry`)
    told_cycle: int  # the last cycle of which it told
    last_counters: Annotated[IntegerField, 6]  # counters as they were then


HOST = dtype_of(HostRecord)


class Slot(IntEnum):
    """Places of an order's values."""

    K_P = 0  # Nm/rad
    F_S = 1  # Nm
    F_D = 2  # Nm
    COMPENSATION = 3  # Nm
    USER = 4  # here and behind: `law.user`, where a law's named parameters lie


SLOTS = Slot.USER + 16


class OrderRecord(Record):
    """The parameters that somebody wants."""

    value: Annotated[FloatField, SLOTS]  # by `Slot`
    cycles: int  # in which the axis goes there


class LiveRecord(Record):
    """The live parameters of an axis."""

    offered: Annotated[RecordArray[OrderRecord], 2]  # order n is in n & 1
    wanted: int  # number of the newest order; 0: there was none
    taken: int  # number of the order that the step follows
    cycle: int  # of the way there
    cycles: int  # that the way takes
    first: Annotated[FloatField, SLOTS]  # where it began
    last: Annotated[FloatField, SLOTS]  # where it ends


class AxisRecord(Record):
    """One axis as the kernels take it."""

    control: ControlRecord  # limits and scales
    host: HostRecord  # what the cycle keeps
    rpdos: Annotated[RecordArray[PdoRecord], DRIVE_PDOS]  # what the host sends
    tpdos: Annotated[RecordArray[PdoRecord], DRIVE_PDOS]  # what it waits for
    motion: MotionRecord  # what the law is told
    law: LawRecord  # its parameters
    state: LawStateRecord  # what it keeps
    live: LiveRecord  # the changes of its parameters


AXIS = dtype_of(AxisRecord)

AxisRecords: TypeAlias = RecordArray[AxisRecord]
"""The axes of a bus, the one that sends SYNC first."""
