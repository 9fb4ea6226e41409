"""The records of the virtual CAN bus: the wire, the stations' controllers, faults.

Each part of `BusRecord` is written by the module that stands above it. What is not said is int64, and
a time is in ns.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np

from coulombus.kernels.records import IntegerField, Record, RecordArray
from coulombus.sim_bus.can_bus.bus_state import ErrorKind

__all__ = [
    "FRAME_BITS",
    "MAX_FAULTS",
    "MAX_FLIPS",
    "MAX_SENDERS",
    "MOST_TOLD",
    "ROOM",
    "STATIONS",
    "STATION_MASK",
    "BusRecord",
    "ControllerRecord",
    "FaultRecord",
    "StuckRecord",
]

STATIONS = 256
"""Rows: a station's is the low eight bits of its number, so the host's -1 is 255."""
ROOM = 1024
"""Frames that may wait at a time; more are dropped and counted in the queue's record."""
STATION_MASK = 0xFF
"""Stations are counted by the low eight bits of their number: the host's -1 is 255."""
MAX_SENDERS = 128
"""Stations that may take part in one arbitration; more wait."""
FRAME_BITS = 160
"""No classical frame has more, from the start of frame to the end of the inter-frame space."""
MAX_FAULTS = 62
MOST_TOLD = 512
"""Injections that are kept between two looks at them; more are only counted."""
MAX_FLIPS = 16


class ControllerRecord(Record):
    """The CAN controller of a station."""

    # set up
    attached: int  # 1: the station is on the bus
    listen_only: int  # 1: it never drives the wire
    one_shot: int  # 1: it sends each frame once
    loopback: int  # 1: it receives its own frames
    queue_limit: int  # frames that may wait; 0: any number
    restart_ns: int  # from bus-off to the beginning of recovery; MANUAL: never
    # fault confinement
    tec: int  # transmit error counter
    rec: int  # receive error counter
    state: int  # a `CanState`
    changed: int  # 1: the state has changed, which is to be told
    recovered: int  # 1: bus-off is over, which is to be told
    restart_at_ns: int  # when recovery begins
    runs_left: int  # of 11 recessive bits, until bus-off ends
    suspend_ns: int  # until then an error-passive sender waits
    # counters
    overloads: int  # overload frames
    retransmissions: int  # frames that were sent again
    arbitration_lost: int  # arbitrations that it lost
    dropped: int  # frames that found no place in its queue
    warnings: int  # times that it came to error warning
    passives: int  # times that it became error passive
    bus_offs: int  # times that it went bus-off
    restarts: int  # times that it recovered
    errors: Annotated[IntegerField, len(ErrorKind)]  # by kind
    # the frame on the wire
    half: int  # where it is while the cable is cut
    hears: int  # it receives what is on the wire
    confinement: int  # what its node is to know
    contends_ns: int  # when it took part in an arbitration
    owed: int  # 1: a scripted fault has struck the frame that is to be sent again ...
    again: int  # ... and it is sent once more ...
    lost_for: int  # ... and this station does not receive it
    # bit by bit (`sim_bus.can_bus.controller_bits`)
    mode: int  # a `ControllerMode`
    count: int  # bits in this mode
    level: int  # that it drives: 0 dominant, 1 recessive
    frame: int  # row of the frame that it sends; -1: it receives
    sent_bits: int  # of that frame
    transmitted: int  # 1: its own frame has just ended
    exempt: int  # 1: its error counts nothing, unless its passive flag sees something dominant (rule c)
    overload: int  # 1: the flag and delimiter are an overload frame's
    joins: int  # 1: it sends with the next start of frame
    passive_flag: int  # 1: its error flag is passive
    flag_last: int  # the last level within a passive flag ...
    flag_run: int  # ... and how often it stood in a row
    position: int  # of the bit within the frame, without stuff bits
    last: int  # the last level ...
    run: int  # ... and how often it stood in a row
    crc: int  # of what was received
    bit_12: int  # RTR or SRR
    extended: int  # 1: 29 bits of identifier
    header: int  # bits before the data field; NOT_YET
    dlc: int  # data length code
    crc_end: int  # bits up to the end of the CRC sequence; NOT_YET
    tail: int  # bits behind the CRC sequence


class SenderRecord(Record):
    """A station that sends, bit by bit."""

    state: int  # `Sent`
    order: int
    can_id: int
    length: int
    word: int
    source: int
    lost_bit: int  # in which it lost the arbitration; without stuff bits
    bits: int
    bit: Annotated[IntegerField, FRAME_BITS, np.int8]


class SeenRecord(Record):
    """What was seen of a frame that is sent bit by bit."""

    accepted_bit: int  # the last but one bit of the end of frame, in which receivers accept; -1: not yet
    gave_up: int  # 1: who sends once only has lost the arbitration, and that is not told yet
    told_bit: int  # in which the first error was detected; `NOT_TOLD`; `TOLD_BEFORE` this stretch
    tell: int  # 1: an error is to be told: class, type, place and who
    classes: int
    kind: int
    place: int
    source: int


class PlayRecord(Record):
    """Where the bits that are played have come to."""

    begin_ns: int  # when the first bit began
    bit: int  # bits played
    passed: int  # 1: what ends at the end of this bit is a frame that was received
    unsettled: int  # 1: not all stations were idle at the end of the last stretch


class FaultRecord(Record):
    """A fault that is planned."""

    kind: int  # a `FaultKind`
    from_ns: int  # active from ... to
    until_ns: int  # ... to
    framed: int  # 1: it waits for a frame
    match_id: int  # of the frame, with Linux's flags: equal under the mask
    match_mask: int  # bits that count
    match_source: int  # and sent by this station, or by `ALL`
    nth: int  # the first frame that is meant, counted from 1
    every: int  # and then every so many; 0: that one only
    most: int  # how often it may strike; 0: no limit
    station: int  # whom it hits, or `ALL`
    bit: int  # which one is turned
    delay_ns: int  # by which a frame is put off
    can_id: int  # what a babbler says
    length: int  # of a babbler's frame
    word: int  # of a babbler's frame
    period_ns: int  # of a babbler
    next_ns: int  # when it acts next
    seen: int  # frames that matched
    fired: int  # how often it struck
    first_ns: int  # when it struck first
    last_ns: int  # when it struck last
    active: int  # a noise: 1: at work
    hits: int  # bits that it has disturbed, not counted in `fired` yet
    lasts_ns: int  # a cut
    far: Annotated[IntegerField, STATIONS, np.int8]  # by row of a station: 1: in the second half of the cut cable
    rate: float  # of a noise: disturbed bits among all


class StruckRecord(Record):
    """What a scripted fault does to the frame that starts."""

    flips: int  # for the frame that starts: so many of its bits are turned around,
    flip_bit: Annotated[IntegerField, MAX_FLIPS]
    flip_station: Annotated[IntegerField, MAX_FLIPS]
    wrong_crc: int  # its CRC sequence is sent with these bits turned,
    again: int  # it is sent once more,
    lost_for: int  # it is not received by this station, or by `ALL`; `NOBODY`


class StuckRecord(Record):
    """When the wire is dominant next."""

    from_ns: int
    until_ns: int


class NoiseRecord(Record):
    """Random bit errors."""

    rate: float  # of disturbed bits, by whichever fault; 0: none
    hits: int  # not counted in the faults' table yet
    next_ns: int  # when the next one begins
    until_ns: int  # the first of the noises ends
    state: int


class BusRecord(Record):
    """The wire with all that hangs on it."""

    bit_rate: int  # bit/s; 0: a frame takes no time here (another bus carries it)
    stage: int  # `sim_bus.can_bus.bus_state.Stage`: what the wire is in the midst of
    delivered: int  # `sim_bus.can_bus.bus_state.Delivered`: who has what has ended last
    end_ns: int  # of the frame on the wire
    free_ns: int  # the bus is free from then on
    t_ns: int  # the frame on the wire, fields as in FRAME
    can_id: int  # with Linux's flags
    length: int  # data bytes
    word: int  # data
    source: int  # number of the sending station
    frames: int  # counters
    bits: int  # all that were on the wire, stuff bits included
    # the cable in two halves (`cable_cut`)
    half: int  # of the cut cable, 0 or 1, that this record is (sim_bus.can_bus.cable_cut)
    cut: int  # in the first record: is the cable cut?
    cut_row: int  # by which row of the faults
    mend_ns: int  # when it is whole again
    # frames that wait (`tx_queue`)
    limited: int  # 1: some station takes no more than so many
    held: int  # frames that wait here
    sequence: int  # of the next one; begins anew whenever nobody waits
    later: int  # how many are not known to be ready yet
    ready: int  # how many take part in the next arbitration
    fresh: int  # places from here on were never used
    freed: int  # places that may be used again
    waiting_of: Annotated[IntegerField, STATION_MASK + 1]  # frames that wait here, by station
    later_key: Annotated[IntegerField, ROOM]  # heap: ready time
    later_place: Annotated[IntegerField, ROOM]  # ... and place
    ready_key: Annotated[IntegerField, ROOM]  # heap: arbitration field, sequence
    ready_place: Annotated[IntegerField, ROOM]  # ... and place
    free_place: Annotated[IntegerField, ROOM]  # stack
    held_order: Annotated[IntegerField, ROOM]  # by place: its key in the heap `ready`
    held_can_id: Annotated[IntegerField, ROOM]  # by place: the frame
    held_length: Annotated[IntegerField, ROOM]  # data bytes
    held_word: Annotated[IntegerField, ROOM]  # data
    held_source: Annotated[IntegerField, ROOM]  # station
    # who is there (`stations`)
    alert: int  # 1: look closely
    on_count: int  # how many are switched on
    on: Annotated[IntegerField, STATIONS]  # rows of the stations that are switched on
    # ends of frames (`frame_result`)
    partial_row: int  # the log's row of the last frame that was delivered to `Delivered.HEARERS`
    errors: int  # errors that were told, all stations together
    retransmissions: int  # frames that were sent again
    confinements: int  # 1: a controller's `confinement` is to be told to its node
    # bits (`bit_level`, `controller_bits`)
    play: PlayRecord  # where the bits have come to
    recessive_ns: int  # the wire has been recessive since, as far as somebody looked
    seen: SeenRecord  # what was seen of the frame
    senders: int  # rows of `tx` in use
    tx: Annotated[RecordArray[SenderRecord], MAX_SENDERS]  # the stations that send
    # faults (`faults`, `noise`)
    faults: Annotated[RecordArray[FaultRecord], MAX_FAULTS]  # rows of the faults' file
    fault_count: int  # how many
    fault_due: int  # bit i: row i waits for the end of the frame that has triggered it
    fault_calls: int  # bit i: row i waits for Python (a reset, a cut)
    alarm_ns: int  # when the bus itself has something to do, though nobody sends
    told: int  # injections since the last look: time, row, identifier
    told_ns: Annotated[IntegerField, MOST_TOLD]  # of each, when
    told_row: Annotated[IntegerField, MOST_TOLD]  # ... which fault
    told_id: Annotated[IntegerField, MOST_TOLD]  # ... identifier of the frame
    struck: StruckRecord  # what strikes the frame that starts
    stuck: StuckRecord  # when the wire is dominant
    noise: NoiseRecord  # random bit errors
    # all controllers
    stations: Annotated[RecordArray[ControllerRecord], STATIONS]  # by the low eight bits of a station's number
