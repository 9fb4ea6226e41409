"""A stretch of bus time in slow motion: every station's controller, bit by bit (ISO 11898-1:2015, clauses 10 and 11).

The arbiter knows a frame's length and its winner without a look at the bits. Where something goes wrong that is not enough, and `run_bits`
plays the bits instead: each controller drives a level, dominant (0) wins, a disturbance turns the level around for all or for one, and each
controller makes of it what the standard says: bit, stuff, CRC, form and ACK errors, active and passive error flags that overlap, delimiters,
overload frames, intermission. It ends when nobody sends and somebody may begin to; failed frames then wait anew. Who is not idle by then, as an
error-passive receiver that alone has seen an error, is in the midst of what it does when the next stretch begins (`BUS.unsettled`).

It pauses at the end of each bit in which there is something to tell: a frame that was received or given up, an error, a change of state.
And it pauses now and then, so that a station that is switched off in the middle falls silent in the middle.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Any

import numpy as np

from coulombus.compiled.decorator import inlined, kernel
from coulombus.sim_bus.copper.controller import (
    PASSIVE_LEVEL,
    CanState,
    ErrorKind,
    count_received,
    count_sent,
    raise_rec,
    raise_tec,
)
from coulombus.sim_bus.copper.noise import disturber, next_noise
from coulombus.sim_bus.copper.stuffing import CRC_BITS, FRAME_BITS, crc_step, stuffed_bits
from coulombus.wire.frame import CAN_EFF_FLAG

__all__ = [
    "ALL",
    "CLIENTS",
    "CLIENT_ROWS",
    "MAX_FLIPS",
    "MAX_SENDERS",
    "SLOW_FIELDS",
    "Sent",
    "add_sender",
    "begin_bits",
    "is_meant",
    "may_start",
    "run_bits",
]

MAX_SENDERS = 128
"""Stations that may take part in one arbitration; more wait."""
MAX_FLIPS = 16
ALL = -1000
"""As the station of a disturbance: all see it."""
CLIENTS = -1001
"""As a station: each client of a bus in real time."""
CLIENT_ROWS = slice(128, 192)


class Mode(IntEnum):
    """What a controller is in the middle of."""

    IDLE = 0
    FRAME = 1
    FLAG = 2  # error flag, active or passive
    OVERLOAD = 3  # overload flag
    WAIT = 4  # for the first recessive bit after a flag
    DELIMITER = 5
    INTERMISSION = 6
    INTEGRATING = 7  # switched on: 11 recessive bits first


class Sent(IntEnum):
    """What became of a frame that was on the wire."""

    PENDING = 0
    DONE = 1
    FAILED = 2
    LOST = 3  # the arbitration
    GIVEN_UP = 4  # lost, by a station that sends once only: that is told


IDLE, FRAME, FLAG, OVERLOAD, WAIT, DELIMITER, INTERMISSION, INTEGRATING = map(int, Mode)
PENDING, DONE, FAILED, LOST, GIVEN_UP = map(int, Sent)
BIT, STUFF, CRC, FORM, ACK = map(int, ErrorKind)
CLIENTS_FROM, CLIENTS_TO = CLIENT_ROWS.start, CLIENT_ROWS.stop
NOT_YET = 1 << 30
CRC_DELIMITER, ACK_SLOT, ACK_DELIMITER, LAST_BUT_ONE, LAST = 0, 1, 2, 8, 9  # `tail`: bits behind the CRC sequence
FLAG_BITS, DELIMITER_BITS, INTERMISSION_BITS, SUSPEND_BITS, INTEGRATION_BITS = 6, 8, 3, 8, 11
LONGEST_STRETCH = 64  # bits without a pause
NOT_TOLD, TOLD_BEFORE = -1, -2
NS = 1_000_000_000

SLOW_FIELDS = [
    ("slow", np.int64),  # 1: the wire is in slow motion
    ("slow_ns", np.int64),  # when its first bit began
    ("slow_bit", np.int64),  # bits played
    ("accepted_bit", np.int64),  # the last but one bit of the end of frame, in which receivers accept
    ("passed", np.int64),  # 1: what ends at the end of this bit is a frame that was received
    ("told_bit", np.int64),  # in which the first error was detected; `NOT_TOLD`; `TOLD_BEFORE` this stretch
    ("unsettled", np.int64),  # 1: not all stations were idle at the end of the last stretch
    ("recessive_ns", np.int64),  # the wire has been recessive since
    ("gave_up", np.int64),  # 1: who sends once only has lost the arbitration, and that is not told yet
    ("tell", np.int64),  # 1: an error is to be told: class, type, place and who
    ("error_class", np.int64),
    ("error_type", np.int64),
    ("error_place", np.int64),
    ("error_source", np.int64),
    ("senders", np.int64),
    ("tx_state", np.int64, (MAX_SENDERS,)),
    ("tx_order", np.int64, (MAX_SENDERS,)),
    ("tx_can_id", np.int64, (MAX_SENDERS,)),
    ("tx_length", np.int64, (MAX_SENDERS,)),
    ("tx_word", np.int64, (MAX_SENDERS,)),
    ("tx_source", np.int64, (MAX_SENDERS,)),
    ("tx_lost_bit", np.int64, (MAX_SENDERS,)),  # in which it lost the arbitration; without stuff bits
    ("tx_bits", np.int64, (MAX_SENDERS,)),
    ("tx_bit", np.int8, (MAX_SENDERS, FRAME_BITS)),
    ("flips", np.int64),
    ("flip_bit", np.int64, (MAX_FLIPS,)),
    ("flip_station", np.int64, (MAX_FLIPS,)),
    ("stuck_from_ns", np.int64),  # the wire is dominant from ... to
    ("stuck_until_ns", np.int64),
    ("noise_rate", np.float64),  # of disturbed bits, by whichever fault; 0: none
    ("noise_hits", np.int64),  # not counted in the faults' table yet
    ("noise_ns", np.int64),  # when the next one begins
    ("noise_until_ns", np.int64),  # the first of the noises ends
    ("noise_state", np.int64),
]
"""The part of the bus's record (`sim_bus.copper.arbiter.BUS`) that slow motion works on."""

# Linux's include/uapi/linux/can/error.h: error classes, types (data[2]) and places (data[3])
ERR_PROT, ERR_ACK, ERR_BUSERROR = 0x08, 0x20, 0x80
PROT_FORM, PROT_STUFF, PROT_BIT0, PROT_BIT1, PROT_OVERLOAD, PROT_TX = 0x02, 0x04, 0x08, 0x10, 0x20, 0x80
PLACE_DATA, PLACE_CRC, PLACE_INTERMISSION, PLACE_UNKNOWN = 0x0A, 0x08, 0x12, 0x00
_ID_PLACES = [0x03] + 8 * [0x02] + 3 * [0x06]
_BASE_HEAD = [*_ID_PLACES, 0x04, 0x05, 0x09, *(4 * [0x0B])]
_EXTENDED_HEAD = [*_ID_PLACES, 0x04, 0x05, *(5 * [0x07]), *(8 * [0x0F]), *(5 * [0x0E]), 0x0C, 0x0D, 0x09, *(4 * [0x0B])]
HEAD_PLACES = np.array([_BASE_HEAD + [0] * 20, _EXTENDED_HEAD], np.int64)
TAIL_PLACES = np.array([0x18, 0x19, 0x1B] + 7 * [0x1A], np.int64)


@kernel
def add_sender(bus: Any, order: int, can_id: int, length: int, word: int, source: int, wrong_crc: int) -> None:
    """Let a station send a frame in the slow motion that is to begin."""
    k = bus.senders
    bus.tx_state[k] = PENDING
    bus.tx_order[k] = order
    bus.tx_can_id[k] = can_id
    bus.tx_length[k] = length
    bus.tx_word[k] = word
    bus.tx_source[k] = source
    bus.tx_bits[k] = stuffed_bits(can_id, length, word, wrong_crc, bus.tx_bit[k])
    bus.senders = k + 1


@kernel
def _open_frame(c: Any, frame: int) -> None:
    """Begin to follow a frame at its start of frame."""
    c.mode = FRAME
    c.frame = frame
    c.sent_bits = c.position = c.run = c.crc = c.bit_12 = c.extended = c.dlc = c.joins = 0
    c.last = c.tail = -1
    c.header = c.crc_end = NOT_YET
    c.transmitted = 1 if frame >= 0 else 0


@kernel
def may_start(c: Any) -> bool:
    """Tell whether a controller may begin to send: it is idle, or the third bit of its intermission was dominant, which is a start of frame."""
    return bool(c.mode == IDLE or c.joins != 0)


@kernel
def begin_bits(bus: Any, now_ns: int) -> None:
    """Begin slow motion at `now_ns` with the senders that were added; the other stations are idle, or in the midst of what they do."""
    bus.slow = 1
    bus.slow_ns = now_ns
    bus.slow_bit = 0
    bus.accepted_bit = -1
    if bus.senders > 0 or not bus.unsettled:
        bus.told_bit = NOT_TOLD
    elif bus.told_bit != NOT_TOLD:
        bus.told_bit = TOLD_BEFORE
    for k in range(bus.on_count):
        c = bus.stations[bus.on[k]]
        c.hears = 0
        c.frame = -1
    for k in range(bus.senders):
        c = bus.stations[bus.tx_source[k] & 0xFF]
        joins = c.joins
        _open_frame(c, k)
        if joins:  # its start of frame is the bit that has just been
            c.sent_bits = c.position = c.run = 1
            c.last = 0
            if k == 0:
                bus.slow_ns -= NS // bus.bit_rate
                bus.slow_bit = 1


@kernel
def _place(c: Any) -> int:
    """Return where in the frame a controller is, in Linux's numbers."""
    if c.mode != FRAME:
        return PLACE_INTERMISSION if c.mode == INTERMISSION else PLACE_UNKNOWN
    if c.tail >= 0:
        return int(TAIL_PLACES[min(c.tail, LAST)])
    if c.position >= c.header:
        return PLACE_CRC if c.position >= c.crc_end - CRC_BITS else PLACE_DATA
    return int(HEAD_PLACES[c.extended, min(c.position, 38)])


@kernel
def _tell(bus: Any, c: Any, station: int, classes: int, kind: int) -> None:
    """Note the first error of this slow motion for the clients; of several in one bit the transmitter's."""
    transmitter = c.transmitted != 0
    if bus.told_bit != NOT_TOLD and not (transmitter and bus.told_bit == bus.slow_bit):
        return
    bus.tell = 1
    bus.told_bit = bus.slow_bit
    bus.error_class = classes
    bus.error_type = kind | (PROT_TX if transmitter else 0)
    bus.error_place = _place(c)
    bus.error_source = station


@kernel
def _raise(c: Any, receiver_by: int) -> None:
    """Count an error in the counter of the station's role: 8 for a transmitter, `receiver_by` for a receiver."""
    if c.transmitted:
        raise_tec(c)
    else:
        raise_rec(c, receiver_by)


@kernel
def _error(bus: Any, c: Any, station: int, kind: int, exempt: int) -> None:
    """Detect an error: count it (rules a, c) and send an error flag from the next bit on."""
    passive = 1 if c.tec >= PASSIVE_LEVEL or c.rec >= PASSIVE_LEVEL else 0
    c.errors[kind] += 1
    bits = (PROT_BIT1 if c.level else PROT_BIT0) if kind == BIT else PROT_STUFF if kind == STUFF else PROT_FORM
    if kind in (ACK, CRC):
        bits = 0
    _tell(bus, c, station, ERR_BUSERROR | (ERR_ACK if kind == ACK else ERR_PROT), bits)
    if c.frame >= 0:
        bus.tx_state[c.frame] = FAILED
        c.frame = -1
    c.exempt = 0
    if kind == ACK and passive:
        c.exempt = 1  # rule c1, unless something dominant is seen in the passive flag
    elif not exempt:
        _raise(c, 1)
    c.mode = FLAG
    c.count = c.flag_run = 0
    c.overload = 0
    c.passive_flag = 1 if passive or c.listen_only else 0


@kernel
def _bit_error_in_flag(bus: Any, c: Any, station: int) -> None:
    """Rules d and e: what was driven dominant was seen recessive; another error flag begins."""
    c.errors[BIT] += 1
    _tell(bus, c, station, ERR_BUSERROR | ERR_PROT, PROT_BIT0)
    passive = 1 if c.tec >= PASSIVE_LEVEL or c.rec >= PASSIVE_LEVEL else 0
    _raise(c, 8)
    c.mode = FLAG
    c.count = c.flag_run = 0
    c.overload = 0
    c.passive_flag = passive


@kernel
def _overload(bus: Any, c: Any, station: int) -> None:
    c.overloads += 1
    _tell(bus, c, station, ERR_BUSERROR | ERR_PROT, PROT_OVERLOAD)
    c.mode = OVERLOAD
    c.count = 0
    c.overload = 1


@kernel
def _take_bit(c: Any, bit: int) -> None:
    """Take one bit of the frame, stuff bits removed: header, data, CRC."""
    at = c.position
    c.crc = crc_step(c.crc, bit)
    if at == 12:
        c.bit_12 = bit  # RTR, or SRR
    elif at == 13:
        c.extended = bit
        c.header = 39 if bit else 19
    elif at == 32 and c.extended:
        c.bit_12 = bit
    if at >= 14 and c.header - 4 <= at < c.header:
        c.dlc = c.dlc << 1 | bit
        if at == c.header - 1:
            c.crc_end = c.header + (0 if c.bit_12 else 8 * min(c.dlc, 8)) + CRC_BITS
    c.position = at + 1


@kernel
def _tail_bit(bus: Any, c: Any, station: int, bit: int) -> None:
    """Take a bit behind the CRC sequence."""
    at = c.tail
    sender = c.frame >= 0
    if at == ACK_SLOT:
        if sender:
            if bit == 1:
                _error(bus, c, station, ACK, 0)
                return
        elif c.crc == 0:
            count_received(c)
    elif at == LAST:
        if bit == 0:  # a sender's bit error was seen before; a receiver has the frame
            _overload(bus, c, station)
            return
        if sender:
            bus.tx_state[c.frame] = DONE
            count_sent(c)
            if c.loopback:
                c.hears = 1
            if bus.accepted_bit < 0:
                bus.accepted_bit = bus.slow_bit - 1
            c.frame = -1
        c.mode = INTERMISSION
        c.count = 0
    elif bit == 0:
        _error(bus, c, station, FORM, 0)
        return
    elif at == ACK_DELIMITER and c.crc != 0 and not sender:
        _error(bus, c, station, CRC, 0)
        return
    elif at == LAST_BUT_ONE and not sender:
        c.hears = 1
        bus.accepted_bit = bus.slow_bit
    c.tail = at + 1


@kernel
def _frame_bit(bus: Any, c: Any, station: int, bit: int) -> None:
    """Follow a frame by one bit, as its transmitter or as a receiver."""
    c.joins = 0
    if c.frame >= 0:
        c.sent_bits += 1
        if bit != c.level and not (c.tail == ACK_SLOT and bit == 0):
            arbitration_end = 32 if bus.tx_can_id[c.frame] & CAN_EFF_FLAG else 12
            if c.level == 0 or c.tail >= 0 or not 1 <= c.position <= arbitration_end:
                _error(bus, c, station, BIT, 0)
                return
            if c.run == 5:
                _error(bus, c, station, STUFF, 1)  # rule c2
                return
            bus.tx_state[c.frame] = LOST
            bus.tx_lost_bit[c.frame] = c.position
            bus.gave_up |= c.one_shot
            c.arbitration_lost += 1
            c.frame = -1
            c.transmitted = 0
    elif c.level == 0 and bit == 1:
        _error(bus, c, station, BIT, 0)  # its ACK was not seen
        return
    if c.tail >= 0:
        _tail_bit(bus, c, station, bit)
        return
    if c.run == 5:  # a stuff bit
        if bit == c.last:
            _error(bus, c, station, STUFF, 0)
            return
        c.run = 1
    else:
        c.run = c.run + 1 if bit == c.last else 1
        _take_bit(c, bit)
    c.last = bit
    if c.position == c.crc_end and c.run < 5:
        c.tail = 0


@kernel
def _flag_bit(bus: Any, c: Any, station: int, bit: int) -> None:
    """Follow the station's own error flag or overload flag."""
    if c.mode == OVERLOAD or not c.passive_flag:
        if bit == 1 and not c.listen_only:
            _bit_error_in_flag(bus, c, station)
            return
        c.count += 1
    else:
        if bit == 0 and c.exempt:
            c.exempt = 0
            raise_tec(c)
        c.flag_run = c.flag_run + 1 if c.flag_run > 0 and bit == c.flag_last else 1
        c.flag_last = bit
        c.count = c.flag_run
    if c.count == FLAG_BITS:
        c.mode = WAIT
        c.count = c.exempt = 0


@kernel
def _after_flag(bus: Any, c: Any, station: int, bit: int) -> None:
    """Wait for recessive, then count the delimiter."""
    if c.mode == WAIT:
        if bit == 1:
            c.mode = DELIMITER
            c.count = 1
            return
        c.count += 1
        if c.count == 1 and not c.overload and not c.transmitted:
            raise_rec(c, 8)  # rule b
        if c.count % 8 == 0:
            _raise(c, 8)  # rule f
        return
    if bit == 0:
        if c.count == DELIMITER_BITS - 1:
            _overload(bus, c, station)
        else:
            _error(bus, c, station, FORM, 0)
        return
    c.count += 1
    if c.count == DELIMITER_BITS:
        c.mode = INTERMISSION
        c.count = 0


@inlined
def _suspends(c: Any) -> bool:
    """Tell whether a controller lets eight bits more pass before it sends again: error passive, it has sent the last frame."""
    return bool(c.transmitted and (c.tec >= PASSIVE_LEVEL or c.rec >= PASSIVE_LEVEL))


@kernel
def _between_frames(bus: Any, c: Any, station: int, bit: int, end_ns: int) -> None:
    """Intermission, idle, or the first bits after switch-on."""
    joins = 0
    if c.mode == INTEGRATING:
        c.count = c.count + 1 if bit else 0
        if c.count == INTEGRATION_BITS:
            c.mode = IDLE
    elif c.mode == INTERMISSION:
        if bit == 0:
            if c.count < INTERMISSION_BITS - 1:
                _overload(bus, c, station)
                return
            joins = 0 if _suspends(c) else 1
        else:
            c.count += 1
            if c.count < INTERMISSION_BITS:
                return
            c.mode = IDLE
            if _suspends(c):
                c.suspend_ns = end_ns + SUSPEND_BITS * NS // bus.bit_rate
            return
    if bit == 0 and c.mode != INTEGRATING:  # a start of frame
        _open_frame(c, -1)
        _frame_bit(bus, c, station, bit)
        c.joins = joins


@kernel
def _drive(bus: Any, c: Any) -> int:
    """Return the level that a controller drives in this bit."""
    if c.mode == FRAME:
        if c.frame >= 0:
            if c.tail == ACK_SLOT and c.loopback:
                return 0
            return int(bus.tx_bit[c.frame, c.sent_bits]) if c.sent_bits < bus.tx_bits[c.frame] else 1
        return 0 if c.tail == ACK_SLOT and c.crc == 0 and not c.listen_only else 1
    if c.mode == OVERLOAD or (c.mode == FLAG and not c.passive_flag):
        return 1 if c.listen_only else 0
    return 1


@inlined
def is_meant(station: int, row: int) -> bool:
    """Tell whether a row of the stations is `station`, or one of those that it stands for."""
    return station == ALL or station & 0xFF == row if station != CLIENTS else CLIENTS_FROM <= row < CLIENTS_TO


@kernel
def _disturbed(bus: Any, row: int, level: int) -> int:
    """Return `level` as the scripted disturbances of the station in a row leave it, or those of the wire for `ALL`."""
    for k in range(bus.flips):
        one = bus.flip_station[k]
        if bus.flip_bit[k] == bus.slow_bit and (one == ALL) == (row == ALL) and is_meant(one, row):
            level = 1 - level
    return level


@kernel
def _step(bus: Any, c: Any, station: int, bit: int, end_ns: int) -> None:
    """Let a controller make of a bit what it is in the midst of."""
    if c.mode == FRAME:
        _frame_bit(bus, c, station, bit)
    elif c.mode == FLAG or c.mode == OVERLOAD:
        _flag_bit(bus, c, station, bit)
    elif c.mode == WAIT or c.mode == DELIMITER:
        _after_flag(bus, c, station, bit)
    else:
        _between_frames(bus, c, station, bit, end_ns)


@kernel
def run_bits(bus: Any) -> int:
    """Play bits until there is something to tell, or until somebody may send (`bus.slow` is 0 then); return the end of the last bit."""
    bus.passed = bus.tell = 0
    last_bit = bus.slow_bit + LONGEST_STRETCH
    end_ns: int = bus.slow_ns + bus.slow_bit * NS // bus.bit_rate
    while True:
        begin_ns = end_ns
        end_ns = bus.slow_ns + (bus.slow_bit + 1) * NS // bus.bit_rate
        level = 1
        for k in range(bus.on_count):
            c = bus.stations[bus.on[k]]
            c.level = 1 if c.state == CanState.BUS_OFF else _drive(bus, c)
            level &= c.level
        stuck = bus.stuck_from_ns <= begin_ns < bus.stuck_until_ns
        if stuck:
            level = 0
        level = _disturbed(bus, ALL, level)
        hit = bus.noise_ns < end_ns
        hits = ALL
        if hit:
            bus.noise_hits += 1
            noise = bus.faults[disturber(bus)]
            noise.hits += 1
            hits = noise.station
            next_noise(bus, end_ns)
            if hits == ALL:
                level = 1 - level
        if level == 0:
            bus.recessive_ns = end_ns
        alive = idle = ready = sending = 0
        changed = False
        for k in range(bus.on_count):
            station = bus.on[k]
            c = bus.stations[station]
            if c.state == CanState.BUS_OFF:
                continue
            bit = _disturbed(bus, station, level)
            if hit and hits != ALL and is_meant(hits, station):
                bit = 1 - bit
            _step(bus, c, station, bit, end_ns)
            if c.changed:
                changed = True
                if c.state == CanState.BUS_OFF:
                    if c.frame >= 0:
                        bus.tx_state[c.frame] = FAILED
                        c.frame = -1
                    continue
            alive += 1
            idle += c.mode == IDLE
            ready += may_start(c)
            sending += c.frame >= 0
        if bus.accepted_bit >= 0 and bus.slow_bit == bus.accepted_bit + 1:
            bus.passed = 1
        bus.slow_bit += 1
        if not stuck and sending == 0 and (ready > 0 or alive == 0):
            bus.slow = 0
            bus.unsettled = 1 if idle < alive else 0
        if bus.tell or changed or bus.passed or bus.gave_up or bus.slow == 0:
            return end_ns
        if bus.slow_bit >= last_bit or end_ns >= bus.stuck_until_ns:
            return end_ns
