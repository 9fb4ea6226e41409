"""The host's compiled records: limits and scales (`CONTROL`), the process image, and what the cycle
keeps (`HOST`).

Everything here is SI at the handle, except where a name says counts, raw or pm (per mille of the
motor's rated torque).
"""

from __future__ import annotations

from enum import IntEnum
from typing import Any, TypeAlias

import numpy as np

from coulombus.host.laws.law import LawFunction
from coulombus.rigs.devices import TABLE_POINTS
from coulombus.rigs.hysteresis import MOST_PLAYS
from coulombus.rigs.model import MOST_DELAY_CYCLES, MOST_DEVICES, WINDOW_CYCLES, WORK_WINDOW_CYCLES
from coulombus.rigs.pdo_maps import MOST_CONSTANTS, MOST_PDOS

__all__ = [
    "ASKED",
    "CONTROL",
    "DRIVE_PDOS",
    "HOST",
    "KINETIC_CYCLES",
    "TRACK",
    "AxisRecord",
    "AxisRecords",
    "ControlRecord",
    "HostRecord",
    "Image",
    "LawFunction",
    "Phase",
    "SignResult",
    "Trip",
]

ControlRecord: TypeAlias = Any
"""Limits and scales of an axis: a record of `CONTROL`; mypy knows none of its fields."""
HostRecord: TypeAlias = Any
"""What the cycle of an axis keeps: a record of `HOST`."""
AxisRecord: TypeAlias = Any
"""All of an axis: a record of `host.cycle.controller.AXIS`."""
AxisRecords: TypeAlias = Any
"""The axes of a bus, the one that sends SYNC first."""


class Phase(IntEnum):
    """What the cycle is doing; each phase leads to the next one, and any doubt leads to SAFE."""

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

CONTROL = np.dtype(
    [
        ("period_ns", np.int64),
        ("window_ns", np.int64),  # SYNC to the last TPDO
        ("sync_cob_id", np.int64),
        ("host_id", np.int64),
        ("nodes", np.int64),  # motor, brake, sensors
        ("node_id", np.int64, (MOST_DEVICES,)),
        ("emcy_id", np.int64, (MOST_DEVICES,)),  # identifier of each node's EMCYs
        ("heartbeat_timeout_ns", np.int64, (MOST_DEVICES,)),  # of each node; 0: not watched
        ("heartbeat_ns", np.int64),
        ("guard_ns", np.int64),  # period of the remote frames by which the host guards; 0: it guards no node
        ("guarded", np.int64),  # a bit for each node that is guarded
        ("rpdos", np.int64),  # number of PDOs the host sends
        ("tpdos", np.int64),  # number of PDOs it waits for
        ("every_cycle", np.int64),  # bits of the TPDOs that come in each cycle
        ("awaited", np.int64),  # bits of those whose arrival ends the wait: these, or all where there are none
        ("by_timer", np.int64),  # bits of the others
        ("position_mask", np.int64),  # the bit of the TPDO that carries the position
        ("position_half", np.int64),  # half the counts after which it wraps
        ("motor_active", np.int64),  # 1: the motor displays the law (mode active)
        ("brake_active", np.int64),  # 1: the brake displays the law (modes passive, hybrid)
        ("motor_helps", np.int64),  # 1: the motor displays the law's part for it (mode hybrid)
        ("brake_is_drive", np.int64),  # 1: the brake has power states of its own
        ("brake_ramps", np.int64),  # 1: its driver ramps it off by itself when set-points end
        # scales
        ("rad_count", np.float64),  # signed by the encoder's polarity
        ("motor_Nm_raw", np.float64),  # torque at the handle of one count of the set-point (6071h: per mille), signed
        ("torque_Nm_raw", np.float64),  # of the measured torque; 0: not measured
        ("torque_commanded", np.float64),  # 1: the command stands for it
        ("handle_Nm_raw", np.float64),
        ("handle_offset_Nm", np.float64),
        ("brake_Nm_raw", np.float64),  # with a table, of its last step
        ("brake_points", np.int64),  # of the table; 0: a factor
        ("brake_raw_at", np.float64, (TABLE_POINTS,)),
        ("brake_Nm_at", np.float64, (TABLE_POINTS,)),
        ("coil_A_raw", np.float64),  # 0: not measured
        ("coil_A_Nm", np.float64),  # the command stands for it; 0: it is measured
        # compensation of the inherent friction
        ("friction_Nm", np.float64),
        ("compensation_Nm", np.float64),
        ("viscous", np.float64),
        ("velocity_band_counts", np.float64),
        ("slide_band_counts", np.float64),  # the band of the estimate over `window_cycles`
        ("gain_step", np.float64),  # a cycle
        ("late_cycles", np.int64),  # for which what the law asks for is held back (`host.cycle.study_delay`)
        # what the hand feels (`host.cycle.felt`)
        ("window_cycles", np.int64),  # of the estimate of a slow velocity; 1: a backward difference
        ("felt", np.int64),  # 1: the law says what the hand feels, and not what the brake bears
        ("inertia", np.float64),
        ("coil_step", np.float64),  # share of the way that the coil goes in a cycle, as believed; 0: no lead
        ("fluid_step", np.float64),
        ("iron_plays", np.int64),  # play operators of the brake's iron, as believed; 0: it has no hysteresis
        ("iron_r", np.float64, (MOST_PLAYS,)),
        ("iron_w", np.float64, (MOST_PLAYS,)),
        ("iron_direct", np.float64),
        ("passivity_J", np.float64),  # inf: the motor's compensation is not observed
        # limits
        ("motor_limit_raw", np.int64),  # in counts of the set-point; of 6071h the same number as the drive's 6072h
        ("motor_rate_Nm", np.float64),  # a cycle
        ("brake_limit_Nm", np.float64),  # the rig file's limit or the device's, whichever is less
        ("brake_limit_raw", np.int64),  # what its object takes at most
        ("brake_fall_Nm", np.float64),  # by which the law's set-point may fall in a cycle
        ("clipped_cycles", np.int64),  # so many more clipped than unclipped cycles of the law trip
        ("speed_limit", np.float64),
        ("jump_counts", np.int64),
        ("net_work_J", np.float64),
        ("net_work_cycles", np.int64),
        ("travel_rad", np.float64),  # inf: unlimited
        ("motor_mismatch_Nm", np.float64),  # measured torque beyond the command; inf: not measured
        ("motor_mismatch_cycles", np.int64),
        ("motor_lag_decay", np.float64),  # a cycle, of the command's envelope
        ("mismatch_Nm", np.float64),
        ("mismatch_cycles", np.int64),
        ("missed_cycles", np.int64),
        ("coil_limit_A2", np.float64),
        ("coil_decay", np.float64),  # a cycle
        ("brake_lag_decay", np.float64),  # a cycle, of the brake torque expected at the handle
        # arming
        ("still_cycles", np.int64),
        ("still_handle_Nm", np.float64),
        ("still_timeout_cycles", np.int64),
        ("enable_timeout_cycles", np.int64),
        ("sign_check", np.int64),  # 0: no motor in this mode, nothing to check
        ("sign_step_Nm", np.float64),  # a cycle
        ("sign_counts", np.int64),
        ("sign_torque_Nm", np.float64),
        ("sign_travel_counts", np.int64),
        ("sign_hand_Nm", np.float64),  # change of the handle torque that is decisive
        ("sign_hand_cycles", np.int64),  # ... averaged over this many cycles
        ("settle_cycles", np.int64),
        # dead man
        ("deadman_key", np.int64),  # 1: somebody outside keeps HOST.deadman_ok
        ("deadman_slot", np.int64),  # slot of the process image that holds the switch; -1: none
        ("deadman_mask", np.int64),  # bits that are all 1 while the switch is held; 0: any bit
        # safe state
        ("safe_longest_cycles", np.int64),  # the brake is off at the latest after so many
        ("release_Nm", np.float64),  # by which the brake's set-point falls in a cycle of the safe state
        ("unloaded_Nm", np.float64),  # ... where no load is on the handle
        ("release_counts", np.float64),  # a cycle; the release pauses while the handle is faster
        # what the host tells of itself (`host.cycle.telemetry`)
        ("law_keeps", np.int64),  # numbers, by its declaration
    ],
    align=True,
)

HOST = np.dtype(
    [
        ("phase", np.int64),
        ("phase_cycle", np.int64),  # cycles since the phase began
        ("stop", np.int64),  # 1: somebody wants the safe state without a trip
        ("trip", np.int64),
        ("trip_ns", np.int64),
        ("emcy_code", np.int64),  # error code of the EMCY that tripped
        ("sign_result", np.int64),
        ("sign_direction", np.int64),  # sense that the sign check tries: 1, then -1
        ("sign_moved", np.int64),  # counts that its full torque moved the handle, at most
        ("deadman_ok", np.int64),  # 1: a hand is on the switch, or none is asked for
        # the cycle
        ("cycle", np.int64),
        ("next_ns", np.int64),  # when `on_time` wants to be called
        ("sync_ns", np.int64),  # when this cycle's SYNC was due
        ("waiting", np.int64),  # 1: SYNC is out, TPDOs are awaited
        ("arrived", np.int64),  # bit mask of this cycle's TPDOs
        ("enabled_ns", np.int64),  # when the drive entered Operation Enabled; -1 before
        ("armed_ns", np.int64),  # when the law began; -1 before
        ("full_gain_ns", np.int64),  # when its gain came to 1; -1 before
        ("heartbeat_due_ns", np.int64),
        ("guard_due_ns", np.int64),
        ("heard_ns", np.int64, (MOST_DEVICES,)),  # of each node, its last heartbeat; -1 none
        ("nmt", np.int64, (MOST_DEVICES,)),
        ("doubtful", np.int64),  # the node whose EMCY or heartbeat tripped
        ("law_Nm", np.float64),  # what the law returned that is not finite ...
        ("law_part", np.int64),  # ... 0: as its result, 1: for the brake, 2: for the motor
        # measured
        ("image", np.int64, (IMAGE_SLOTS,)),
        ("raw_position", np.int64),  # 6064h as it came last
        ("counts", np.int64),  # encoder counts since the start, without the wrap of 6064h
        ("position_age", np.int64),  # cycles since it was fresh
        ("has_position", np.int64),
        ("fresh", np.int64),  # 1: this cycle's position is fresh
        ("reference_counts", np.int64),  # of the phase: where the handle was still, where the sign check began
        ("moved_counts", np.int64),  # between the last two fresh positions, however many cycles apart
        ("v_counts", np.float64),
        ("slide_counts", np.float64),  # the estimate by which the law slides or is stuck
        ("track", np.int64, (TRACK,)),  # the positions behind it
        ("track_row", np.int64),
        ("track_length", np.int64),
        ("handle_Nm", np.float64),
        ("drive", np.int64),  # PowerState that the statusword tells; -1: none
        ("brake_drive", np.int64),  # the brake's; of one without power states the drive's
        # commanded
        ("gain", np.float64),
        ("torque_Nm", np.float64),  # the motor's
        ("brake_Nm", np.float64),
        ("brake_lagged_Nm", np.float64),
        ("coil_Nm", np.float64),  # the lead's belief of what the coil's current stands for ...
        ("iron_Nm", np.float64),  # ... of what the fluid sees of it ...
        ("iron_y", np.float64, (MOST_PLAYS,)),
        ("fluid_Nm", np.float64),  # ... and of what the fluid bears
        ("asked_sense", np.float64, (ASKED,)),  # by the law, and held back: of the compensation ...
        ("asked_psi_Nm", np.float64, (ASKED,)),  # ... of the motor ...
        ("asked_brake_Nm", np.float64, (ASKED,)),  # ... and of the brake
        ("asked_row", np.int64),
        ("share", np.float64),  # of its compensation that the motor may give
        ("port_J", np.float64),  # paid at the hand's port and still there
        ("port_kinetic_J", np.float64, (KINETIC_CYCLES,)),  # of the last fresh cycles
        ("port_row", np.int64),
        ("port_brake_Nm", np.float64),  # the brake's expected torque on the way that the position ends
        ("port_handle_Nm", np.float64),  # a cycle ago: the hand ...
        ("port_pushed_Nm", np.float64),  # ... and the law's part for the motor
        ("port_way", np.float64),  # the last way that was not 0 [rad] ...
        ("port_slid_ns", np.int64),  # ... and for how long it has had its sign
        ("pushed_Nm", np.float64),  # the law's part that the motor was given last, as psi
        ("handle_before_Nm", np.float64),  # sums of the handle torque before and in the sign check
        ("handle_during_Nm", np.float64),
        ("handle_samples", np.int64),
        ("emcy", np.int64),  # a trip that an EMCY asks for
        ("foreign_id", np.int64),  # identifier of a host's frame that somebody else sent; -1: none
        # watches
        ("still", np.int64),
        ("missed_in_a_row", np.int64),
        (
            "tpdo_age",
            np.int64,
            (DRIVE_PDOS,),
        ),  # closed since each of the TPDOs by timer came: 1 in the cycle in which it came
        ("oldest_tpdo", np.int64),  # the largest of them
        ("voltage_low", np.int64),
        ("commanded_high_Nm", np.float64),  # envelope of the motor's commands, which decays to 0 ...
        ("commanded_low_Nm", np.float64),
        ("motor_mismatch", np.int64),  # cycles in a row in which the measured torque is outside
        ("mismatch", np.int64),
        ("coil_A2", np.float64),
        ("work_sum", np.float64),
        ("work_row", np.int64),
        ("work", np.float64, (WORK_WINDOW_CYCLES,)),
        # counters
        ("clipped", np.int64),  # 1: a limit acts on what the law asks for in this cycle
        ("clipped_balance", np.int64),  # clipped cycles less unclipped ones, not below 0
        ("display_cycles", np.int64),  # cycles since Operation Enabled, until SAFE
        ("lost_pdos", np.int64),
        ("missed_deadlines", np.int64),
        ("stray_frames", np.int64),
        ("malformed_pdos", np.int64),
        ("malformed_services", np.int64),  # EMCYs, heartbeats, SDO responses of another length than CiA 301's
        ("clipped_torque", np.int64),  # the motor's torque was more than its limit
        ("slowed_torque", np.int64),  # ... was held back by its rate, or near the speed limit, in phase RUN
        ("limited_by_drive", np.int64),  # the drive told of a limit of its own (statusword bit 11) in phase RUN
        ("clipped_setpoints", np.int64),  # the brake's set-point was more than its limit
        ("slowed_setpoints", np.int64),  # ... fell faster than its rate
        ("negative_setpoints", np.int64),
        ("withheld_compensation", np.int64),  # the observer let the motor give less than its compensation
        # what the host has told of itself (`host.cycle.telemetry`)
        ("told_cycle", np.int64),  # the last cycle of which it told
        ("told", np.int64, (6,)),  # counters as they were then
    ],
    align=True,
)
