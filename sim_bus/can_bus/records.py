"""Records of the virtual CAN bus: the wire, the stations' controllers, faults; the states of the bus.

The module named above each part of `BusRecord` writes it. Fields are int64 unless declared
otherwise; times are in ns.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Annotated

import numpy as np

from coulombus.kernels.decorator import inlined
from coulombus.kernels.records import IntegerField, Record, RecordArray
from coulombus.wire.frame import Frame

__all__ = [
    "ALL",
    "CLIENTS",
    "CLIENT_ROWS",
    "FRAME_BITS",
    "INTER_FRAME_BITS",
    "MAX_FAULTS",
    "MAX_FLIPS",
    "MAX_SENDERS",
    "MOST_ROWS",
    "MOST_TOLD",
    "NOBODY",
    "NS",
    "ROOM",
    "RUN_BITS",
    "STATIONS",
    "STATION_MASK",
    "SUSPEND_BITS",
    "BusRecord",
    "ControllerRecord",
    "Delivered",
    "ErrorKind",
    "FaultRecord",
    "Stage",
    "StuckRecord",
    "is_meant",
]

INTER_FRAME_BITS = 3
"""Length of the intermission."""
SUSPEND_BITS = 8
"""Additional waiting time of an error-passive sender."""
RUN_BITS = 11
"""Recessive bits at the end of a frame or of an error frame, with the inter-frame space.

Bus-off ends after 128 such runs.
"""
NS = 1_000_000_000


class Stage(IntEnum):
    """State of the bus up to `end_ns`.

    ::

        FREE ---> FRAME ------------------------------> FREE     a frame: only its length matters
        FREE ---> WATCHED ----------------------------> FREE     an undisturbed frame; its end applies rules g and h
        FREE ---> TELLING ----------------------------> FREE     nobody sends; the recovery of a controller is reported
        FREE ---> PLAYED ---> TOLD ---> PLAYED ... OVER ---> FREE   bit-level simulation

    `BusRecord.stage` is written at each start (`arbiter.start_frame`, `error_path.attempt`), by
    `bit_level.run_bits`, and at each end (`BusRecord.end_ns`) by `arbiter.end_frame` or
    `frame_result.end_attempt`.
    """

    FREE = 0
    FRAME = 1
    WATCHED = 2
    TELLING = 3
    PLAYED = 4  # bits are simulated up to `end_ns`, where their events are reported
    TOLD = 5  # events are reported, the next bits are due
    OVER = 6  # as PLAYED; after the last bit a station may start to send


class Delivered(IntEnum):
    """Receivers of the frame that has just ended."""

    NOBODY = 0  # not a frame
    OTHERS = 1  # all except its sender
    HEARERS = 2  # stations whose controller has `hears`


class ErrorKind(IntEnum):
    """The five errors of the standard (10.11)."""

    BIT = 0
    STUFF = 1
    CRC = 2
    FORM = 3
    ACK = 4


STATIONS = 256
"""Number of rows: a station's row is the low eight bits of its number, so the host's -1 is row 255."""
ROOM = 1024
"""Largest number of pending frames; more are dropped and counted in the queue's record."""
STATION_MASK = 0xFF
"""Mask of a station's row: the low eight bits of its number; the host's -1 is row 255."""
ALL = -1000
"""Station number for all stations; for a disturbance, the wire."""
CLIENTS = -1001
"""Station number for every client of a bus in real time."""
NOBODY = -2000
CLIENT_ROWS = slice(128, 192)
_CLIENTS_FROM, _CLIENTS_TO = CLIENT_ROWS.start, CLIENT_ROWS.stop
MAX_SENDERS = 128
"""Largest number of stations in one arbitration; more wait."""
FRAME_BITS = 160
"""Largest length of a classical frame, from the start of frame to the end of the inter-frame space."""
MAX_FAULTS = 62
MOST_TOLD = 512
"""Injections stored between two reads; more are only counted."""
MAX_FLIPS = 16
MOST_ROWS = 16
"""Largest number of log rows for the end of a frame."""


@inlined
def is_meant(station: int, row: int) -> bool:
    """Tell whether a row of the stations is `station`, or a member of that group."""
    if station == ALL:
        return True
    if station == CLIENTS:
        return _CLIENTS_FROM <= row < _CLIENTS_TO
    return station != NOBODY and station & 0xFF == row


class ControllerRecord(Record):
    """CAN controller of a station."""

    # settings
    attached: int  # 1: the station is on the bus
    listen_only: int  # 1: it never drives the wire
    one_shot: int  # 1: it sends each frame only once
    loopback: int  # 1: it receives its own frames
    queue_limit: int  # largest number of pending frames; 0: no limit
    restart_ns: int  # time from bus-off to the beginning of recovery; MANUAL: never
    # fault confinement
    tec: int  # transmit error counter
    rec: int  # receive error counter
    state: int  # a `CanState`
    changed: int  # 1: the state has changed, which is to be reported
    recovered: int  # 1: bus-off is over, which is to be reported
    restart_at_ns: int  # time at which recovery begins
    runs_left: int  # runs of 11 recessive bits until bus-off ends
    suspend_ns: int  # time until which an error-passive sender waits
    # counters
    overloads: int  # overload frames
    retransmissions: int  # frames sent again
    arbitration_lost: int  # arbitrations lost
    dropped: int  # frames that found no room in its queue
    warnings: int  # transitions to error warning
    passives: int  # transitions to error passive
    bus_offs: int  # transitions to bus-off
    restarts: int  # recoveries
    errors: Annotated[IntegerField, len(ErrorKind)]  # by kind
    # the frame on the wire
    half: int  # its half of the cut cable, or the number of its bus
    hears: int  # 1: it receives the frame on the wire
    confinement: int  # event for its node, a `Confinement`
    contends_ns: int  # time of its last arbitration
    owed: int  # 1: a scripted fault has struck its frame, which is to be sent again
    again: int  # 1: that frame is sent once more
    lost_for: int  # station that does not receive that frame
    # bit level (`sim_bus.can_bus.controller_bits`)
    mode: int  # a `ControllerMode`
    count: int  # bits in this mode
    level: int  # driven level: 0 dominant, 1 recessive
    frame: int  # row of its own frame; -1: it receives
    sent_bits: int  # sent bits of that frame
    transmitted: int  # 1: its own frame has just ended
    exempt: int  # 1: its error is not counted, unless its passive flag sees a dominant bit (rule c)
    overload: int  # 1: flag and delimiter belong to an overload frame
    joins: int  # 1: it sends with the next start of frame
    passive_flag: int  # 1: its error flag is passive
    flag_last: int  # last level within a passive flag
    flag_run: int  # length of the run of that level
    position: int  # position of the bit within the frame, without stuff bits
    last: int  # last level
    run: int  # length of the run of that level
    crc: int  # CRC of the received bits
    bit_12: int  # RTR or SRR
    extended: int  # 1: 29 bits of identifier
    header: int  # bits before the data field, or NOT_YET
    dlc: int  # data length code
    crc_end: int  # bits up to the end of the CRC sequence, or NOT_YET
    tail: int  # bits after the CRC sequence


class SenderRecord(Record):
    """A sending station in the bit-level simulation."""

    state: int  # `Sent`
    order: int
    can_id: int
    length: int
    word: int
    source: int
    lost_bit: int  # bit in which it lost the arbitration, without stuff bits
    bits: int
    bit: Annotated[IntegerField, FRAME_BITS, np.int8]


class SeenRecord(Record):
    """Observations of a frame in the bit-level simulation."""

    accepted_bit: int  # the last but one bit of the end of frame, in which receivers accept; -1: not yet
    gave_up: int  # 1: a one-shot sender has lost the arbitration, which is to be reported
    told_bit: int  # bit in which the first error was detected; `NOT_TOLD`; `TOLD_BEFORE` this simulation
    tell: int  # 1: an error is to be reported: class, type, place and station
    classes: int
    kind: int
    place: int
    source: int


class PlayRecord(Record):
    """Progress of the bit-level simulation."""

    begin_ns: int  # time at which the first bit began
    bit: int  # simulated bits
    passed: int  # 1: a received frame ends at the end of this bit
    unsettled: int  # 1: not all stations were idle at the end of the last simulation


class FaultRecord(Record):
    """A planned fault."""

    kind: int  # a `FaultKind`
    from_ns: int  # begin of the active time
    until_ns: int  # end of the active time
    framed: int  # 1: it waits for a frame
    match_id: int  # identifier of the frame, with Linux's flags: equal under the mask
    match_mask: int  # bits that are compared
    match_source: int  # sender of the frame, or `ALL`
    nth: int  # first matching frame, counted from 1
    every: int  # then every n-th frame; 0: only the first
    most: int  # largest number of strikes; 0: no limit
    station: int  # station that it hits, or `ALL`
    bit: int  # inverted bit
    delay_ns: int  # delay of the frame
    can_id: int  # identifier of a babbler's frame
    length: int  # length of a babbler's frame
    word: int  # data of a babbler's frame
    period_ns: int  # period of a babbler
    next_ns: int  # time of its next action
    seen: int  # number of matching frames
    fired: int  # number of strikes
    first_ns: int  # time of the first strike
    last_ns: int  # time of the last strike
    active: int  # 1: a noise is active
    hits: int  # disturbed bits not yet counted in `fired`
    lasts_ns: int  # duration of a cut
    far: Annotated[IntegerField, STATIONS, np.int8]  # by row of a station: 1: in the second half of the cut cable
    rate: float  # error rate of a noise: disturbed bits per bit


class StruckRecord(Record):
    """Effects of scripted faults on the starting frame."""

    flips: int  # number of its inverted bits
    flip_bit: Annotated[IntegerField, MAX_FLIPS]
    flip_station: Annotated[IntegerField, MAX_FLIPS]
    wrong_crc: int  # bits inverted in its CRC sequence
    again: int  # 1: it is sent once more
    lost_for: int  # station that does not receive it, or `ALL`; `NOBODY`


class StuckRecord(Record):
    """Times of the next dominant fault of the wire."""

    from_ns: int
    until_ns: int


class NoiseRecord(Record):
    """Random bit errors."""

    rate: float  # rate of disturbed bits by all faults; 0: none
    hits: int  # disturbed bits not yet counted in the faults' table
    next_ns: int  # begin of the next disturbed bit
    until_ns: int  # end of the first noise to end
    state: int


class BusRecord(Record):
    """State of the bus."""

    bit_rate: int  # bit/s; 0: a frame takes no time here (another bus carries it)
    stage: int  # state, a `sim_bus.can_bus.records.Stage`
    delivered: int  # receivers of the last frame, a `sim_bus.can_bus.records.Delivered`
    end_ns: int  # end of the frame on the wire
    free_ns: int  # time from which the bus is free
    t_ns: int  # time of the frame on the wire; fields as in FRAME
    can_id: int  # identifier with Linux's flags
    length: int  # data bytes
    word: int  # data
    source: int  # number of the sending station
    frames: int  # frames sent
    bits: int  # bits sent, stuff bits included
    # the cable in two halves, or several buses (`cable_cut`)
    half: int  # half of the cut cable of this record, 0 or 1; or number of the bus
    cut: int  # WHOLE, APART or MENDING, in the first record; or SEVERAL
    host_bus: Annotated[IntegerField, 0x800, np.int8]  # first of several: bus of the host's identifiers; -1: all
    cut_row: int  # row of the cut in the faults
    mend_ns: int  # time of the repair
    # pending frames (`tx_queue`)
    limited: int  # 1: a station has a queue limit
    held: int  # number of pending frames here
    sequence: int  # sequence of the next frame; restarts whenever none is pending
    later: int  # frames not known to be ready yet
    ready: int  # frames in the next arbitration
    fresh: int  # first place that was never used
    freed: int  # number of freed places
    waiting_of: Annotated[IntegerField, STATION_MASK + 1]  # pending frames here, by station
    later_key: Annotated[IntegerField, ROOM]  # heap: ready time
    later_place: Annotated[IntegerField, ROOM]  # heap: place
    ready_key: Annotated[IntegerField, ROOM]  # heap: arbitration field, sequence
    ready_place: Annotated[IntegerField, ROOM]  # heap: place
    free_place: Annotated[IntegerField, ROOM]  # stack
    held_order: Annotated[IntegerField, ROOM]  # by place: key in the heap `ready`
    held_can_id: Annotated[IntegerField, ROOM]  # by place: identifier
    held_length: Annotated[IntegerField, ROOM]  # by place: data bytes
    held_word: Annotated[IntegerField, ROOM]  # by place: data
    held_source: Annotated[IntegerField, ROOM]  # by place: station
    # present stations (`stations`)
    alert: int  # 1: the detailed path is necessary
    detailed: int  # address of the detailed path (`error_path`); 0: it is not compiled yet
    on_count: int  # number of switched-on stations
    on: Annotated[IntegerField, STATIONS]  # rows of the switched-on stations
    # ends of frames (`frame_result`)
    report: Annotated[RecordArray[Frame], MOST_ROWS]  # log rows of the last end on the detailed path
    partial_row: int  # log row of the last frame delivered to `Delivered.HEARERS`
    errors: int  # reported errors of all stations
    retransmissions: int  # frames sent again
    confinements: int  # 1: a controller's `confinement` is to be reported to its node
    # bit level (`bit_level`, `controller_bits`)
    play: PlayRecord  # progress of the simulation
    recessive_ns: int  # start of the recessive level, as far as observed
    seen: SeenRecord  # observations of the frame
    senders: int  # rows of `tx` in use
    tx: Annotated[RecordArray[SenderRecord], MAX_SENDERS]  # sending stations
    # faults (`faults`, `noise`)
    faults: Annotated[RecordArray[FaultRecord], MAX_FAULTS]  # rows of the fault file
    fault_count: int  # number of rows
    fault_due: int  # bit i: row i waits for the end of its triggering frame
    fault_calls: int  # bit i: row i waits for Python (a reset, a cut)
    alarm_ns: int  # time of the bus's next own deadline, without a frame
    told: int  # injections since the last read
    told_ns: Annotated[IntegerField, MOST_TOLD]  # time of each injection
    told_row: Annotated[IntegerField, MOST_TOLD]  # fault row of each injection
    told_id: Annotated[IntegerField, MOST_TOLD]  # frame identifier of each injection
    struck: StruckRecord  # effects on the starting frame
    stuck: StuckRecord  # times of a dominant wire
    noise: NoiseRecord  # random bit errors
    # all controllers
    stations: Annotated[RecordArray[ControllerRecord], STATIONS]  # by the low eight bits of a station's number
