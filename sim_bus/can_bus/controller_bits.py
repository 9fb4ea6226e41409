"""Compiled bit-level model of a controller (ISO 11898-1:2015, clauses 10 and 11).

It gives the bit that a controller drives, and the reaction to the bit that it samples.

Bit, stuff, CRC, form and ACK errors, active and passive error flags, delimiters, overload frames,
intermission: `follow` processes one bit of them. `BusRecord.seen` holds what the stations together
have detected in this simulation, and only this module writes it; `BusRecord.tx` holds the fates of
their frames.

    c : the record of a controller
"""

from __future__ import annotations

from enum import IntEnum

import numpy as np

from coulombus.kernels.decorator import inlined, kernel
from coulombus.sim_bus.can_bus.fault_confinement import PASSIVE_LEVEL, count_received, count_sent, raise_rec, raise_tec
from coulombus.sim_bus.can_bus.records import INTER_FRAME_BITS, NS, SUSPEND_BITS, BusRecord, ControllerRecord, ErrorKind
from coulombus.sim_bus.can_bus.stuffing import CRC_BITS, crc_step
from coulombus.wire.frame import CAN_EFF_FLAG

__all__ = ["ControllerMode", "FrameFate", "drive", "follow", "look_anew", "may_start", "open_frame"]


class ControllerMode(IntEnum):
    """Mode of a controller."""

    IDLE = 0
    FRAME = 1
    FLAG = 2  # error flag, active or passive
    OVERLOAD = 3  # overload flag
    WAIT = 4  # for the first recessive bit after a flag
    DELIMITER = 5
    INTERMISSION = 6
    INTEGRATING = 7  # after switch-on: waits for 11 recessive bits


class FrameFate(IntEnum):
    """Fate of a frame that was on the wire."""

    PENDING = 0
    DONE = 1
    FAILED = 2
    LOST = 3  # lost the arbitration
    GIVEN_UP = 4  # lost the arbitration in one-shot mode, which is to be reported


NOT_YET = 1 << 30
CRC_DELIMITER, ACK_SLOT, ACK_DELIMITER, LAST_BUT_ONE, LAST = 0, 1, 2, 8, 9  # `tail`: bits after the CRC sequence
FLAG_BITS, DELIMITER_BITS, INTEGRATION_BITS = 6, 8, 11
NOT_TOLD, TOLD_BEFORE = -1, -2


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
def open_frame(c: ControllerRecord, frame: int) -> None:
    """Start following a frame at its start of frame."""
    c.mode = ControllerMode.FRAME
    c.frame = frame
    c.sent_bits = c.position = c.run = c.crc = c.bit_12 = c.extended = c.dlc = c.joins = 0
    c.last = c.tail = -1
    c.header = c.crc_end = NOT_YET
    c.transmitted = 1 if frame >= 0 else 0


@kernel
def may_start(c: ControllerRecord) -> bool:
    """Tell whether a controller may start to send: it is idle, or the third bit of its intermission was
    dominant, which is a start of frame.
    """
    return bool(c.mode == ControllerMode.IDLE or c.joins != 0)


@kernel
def look_anew(bus: BusRecord) -> None:
    """Clear `seen`, except for an error of a simulation that continues."""
    bus.seen.accepted_bit = -1
    bus.seen.gave_up = 0
    if bus.senders > 0 or not bus.play.unsettled:
        bus.seen.told_bit = NOT_TOLD
    elif bus.seen.told_bit != NOT_TOLD:
        bus.seen.told_bit = TOLD_BEFORE


@kernel
def _place(c: ControllerRecord) -> int:
    """Return a controller's position in the frame, in Linux's numbers."""
    if c.mode != ControllerMode.FRAME:
        return PLACE_INTERMISSION if c.mode == ControllerMode.INTERMISSION else PLACE_UNKNOWN
    if c.tail >= 0:
        return int(TAIL_PLACES[min(c.tail, LAST)])
    if c.position >= c.header:
        return PLACE_CRC if c.position >= c.crc_end - CRC_BITS else PLACE_DATA
    return int(HEAD_PLACES[c.extended, min(c.position, 38)])


@kernel
def _record_first_error(bus: BusRecord, c: ControllerRecord, station: int, classes: int, kind: int) -> None:
    """Record the first error of this simulation for the clients.

    Of several errors in one bit, the transmitter's counts.
    """
    transmitter = c.transmitted != 0
    if bus.seen.told_bit != NOT_TOLD and not (transmitter and bus.seen.told_bit == bus.play.bit):
        return
    bus.seen.tell = 1
    bus.seen.told_bit = bus.play.bit
    bus.seen.classes = classes
    bus.seen.kind = kind | (PROT_TX if transmitter else 0)
    bus.seen.place = _place(c)
    bus.seen.source = station


@kernel
def _raise(c: ControllerRecord, receiver_by: int) -> None:
    """Count an error by the station's role: 8 for a transmitter, `receiver_by` for a receiver."""
    if c.transmitted:
        raise_tec(c)
    else:
        raise_rec(c, receiver_by)


@kernel
def _error(bus: BusRecord, c: ControllerRecord, station: int, kind: int, exempt: int) -> None:
    """Detect an error: count it (rules a, c) and send an error flag from the next bit on."""
    passive = 1 if c.tec >= PASSIVE_LEVEL or c.rec >= PASSIVE_LEVEL else 0
    c.errors[kind] += 1
    bits = (
        (PROT_BIT1 if c.level else PROT_BIT0)
        if kind == ErrorKind.BIT
        else PROT_STUFF
        if kind == ErrorKind.STUFF
        else PROT_FORM
    )
    if kind in (ErrorKind.ACK, ErrorKind.CRC):
        bits = 0
    _record_first_error(bus, c, station, ERR_BUSERROR | (ERR_ACK if kind == ErrorKind.ACK else ERR_PROT), bits)
    if c.frame >= 0:
        bus.tx[c.frame].state = FrameFate.FAILED
        c.frame = -1
    c.exempt = 0
    if kind == ErrorKind.ACK and passive:
        c.exempt = 1  # rule c1, unless a dominant bit is seen in the passive flag
    elif not exempt:
        _raise(c, 1)
    c.mode = ControllerMode.FLAG
    c.count = c.flag_run = 0
    c.overload = 0
    c.passive_flag = 1 if passive or c.listen_only else 0


@kernel
def _bit_error_in_flag(bus: BusRecord, c: ControllerRecord, station: int) -> None:
    """Apply rules d and e: a dominant bit was driven and a recessive bit seen; another error flag begins."""
    c.errors[ErrorKind.BIT] += 1
    _record_first_error(bus, c, station, ERR_BUSERROR | ERR_PROT, PROT_BIT0)
    passive = 1 if c.tec >= PASSIVE_LEVEL or c.rec >= PASSIVE_LEVEL else 0
    _raise(c, 8)
    c.mode = ControllerMode.FLAG
    c.count = c.flag_run = 0
    c.overload = 0
    c.passive_flag = passive


@kernel
def _overload(bus: BusRecord, c: ControllerRecord, station: int) -> None:
    c.overloads += 1
    _record_first_error(bus, c, station, ERR_BUSERROR | ERR_PROT, PROT_OVERLOAD)
    c.mode = ControllerMode.OVERLOAD
    c.count = 0
    c.overload = 1


@kernel
def _take_bit(c: ControllerRecord, bit: int) -> None:
    """Process one bit of the frame, stuff bits removed: header, data, CRC."""
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
def _tail_bit(bus: BusRecord, c: ControllerRecord, station: int, bit: int) -> None:
    """Process a bit after the CRC sequence."""
    at = c.tail
    sender = c.frame >= 0
    if at == ACK_SLOT:
        if sender:
            if bit == 1:
                _error(bus, c, station, ErrorKind.ACK, 0)
                return
        elif c.crc == 0:
            count_received(c)
    elif at == LAST:
        if bit == 0:  # a sender's bit error was detected before; a receiver has the frame
            _overload(bus, c, station)
            return
        if sender:
            bus.tx[c.frame].state = FrameFate.DONE
            count_sent(c)
            if c.loopback:
                c.hears = 1
            if bus.seen.accepted_bit < 0:
                bus.seen.accepted_bit = bus.play.bit - 1
            c.frame = -1
        c.mode = ControllerMode.INTERMISSION
        c.count = 0
    elif bit == 0:
        _error(bus, c, station, ErrorKind.FORM, 0)
        return
    elif at == ACK_DELIMITER and c.crc != 0 and not sender:
        _error(bus, c, station, ErrorKind.CRC, 0)
        return
    elif at == LAST_BUT_ONE and not sender:
        c.hears = 1
        bus.seen.accepted_bit = bus.play.bit
    c.tail = at + 1


@kernel
def _frame_bit(bus: BusRecord, c: ControllerRecord, station: int, bit: int) -> None:
    """Process one bit of a frame, as its transmitter or as a receiver."""
    c.joins = 0
    if c.frame >= 0:
        c.sent_bits += 1
        if bit != c.level and not (c.tail == ACK_SLOT and bit == 0):
            arbitration_end = 32 if bus.tx[c.frame].can_id & CAN_EFF_FLAG else 12
            if c.level == 0 or c.tail >= 0 or not 1 <= c.position <= arbitration_end:
                _error(bus, c, station, ErrorKind.BIT, 0)
                return
            if c.run == 5:
                _error(bus, c, station, ErrorKind.STUFF, 1)  # rule c2
                return
            bus.tx[c.frame].state = FrameFate.LOST
            bus.tx[c.frame].lost_bit = c.position
            bus.seen.gave_up |= c.one_shot
            c.arbitration_lost += 1
            c.frame = -1
            c.transmitted = 0
    elif c.level == 0 and bit == 1:
        _error(bus, c, station, ErrorKind.BIT, 0)  # its ACK was not received
        return
    if c.tail >= 0:
        _tail_bit(bus, c, station, bit)
        return
    if c.run == 5:  # a stuff bit
        if bit == c.last:
            _error(bus, c, station, ErrorKind.STUFF, 0)
            return
        c.run = 1
    else:
        c.run = c.run + 1 if bit == c.last else 1
        _take_bit(c, bit)
    c.last = bit
    if c.position == c.crc_end and c.run < 5:
        c.tail = 0


@kernel
def _flag_bit(bus: BusRecord, c: ControllerRecord, station: int, bit: int) -> None:
    """Process one bit of the station's own error flag or overload flag."""
    if c.mode == ControllerMode.OVERLOAD or not c.passive_flag:
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
        c.mode = ControllerMode.WAIT
        c.count = c.exempt = 0


@kernel
def _after_flag(bus: BusRecord, c: ControllerRecord, station: int, bit: int) -> None:
    """Wait for recessive, then count the delimiter."""
    if c.mode == ControllerMode.WAIT:
        if bit == 1:
            c.mode = ControllerMode.DELIMITER
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
            _error(bus, c, station, ErrorKind.FORM, 0)
        return
    c.count += 1
    if c.count == DELIMITER_BITS:
        c.mode = ControllerMode.INTERMISSION
        c.count = 0


@inlined
def _suspends(c: ControllerRecord) -> bool:
    """Tell whether a controller waits eight more bits before it sends again: it is error passive, and has
    sent the last frame.
    """
    return bool(c.transmitted and (c.tec >= PASSIVE_LEVEL or c.rec >= PASSIVE_LEVEL))


@kernel
def _between_frames(bus: BusRecord, c: ControllerRecord, station: int, bit: int, end_ns: int) -> None:
    """Process one bit of the intermission, of the idle bus, or of the first bits after switch-on."""
    joins = 0
    if c.mode == ControllerMode.INTEGRATING:
        c.count = c.count + 1 if bit else 0
        if c.count == INTEGRATION_BITS:
            c.mode = ControllerMode.IDLE
    elif c.mode == ControllerMode.INTERMISSION:
        if bit == 0:
            if c.count < INTER_FRAME_BITS - 1:
                _overload(bus, c, station)
                return
            joins = 0 if _suspends(c) else 1
        else:
            c.count += 1
            if c.count < INTER_FRAME_BITS:
                return
            c.mode = ControllerMode.IDLE
            if _suspends(c):
                c.suspend_ns = end_ns + SUSPEND_BITS * NS // bus.bit_rate
            return
    if bit == 0 and c.mode != ControllerMode.INTEGRATING:  # a start of frame
        open_frame(c, -1)
        _frame_bit(bus, c, station, bit)
        c.joins = joins


@kernel
def drive(bus: BusRecord, c: ControllerRecord) -> int:
    """Return the level that a controller drives in this bit."""
    if c.mode == ControllerMode.FRAME:
        if c.frame >= 0:
            if c.tail == ACK_SLOT and c.loopback:
                return 0
            return int(bus.tx[c.frame].bit[c.sent_bits]) if c.sent_bits < bus.tx[c.frame].bits else 1
        return 0 if c.tail == ACK_SLOT and c.crc == 0 and not c.listen_only else 1
    if c.mode == ControllerMode.OVERLOAD or (c.mode == ControllerMode.FLAG and not c.passive_flag):
        return 1 if c.listen_only else 0
    return 1


@kernel
def follow(bus: BusRecord, c: ControllerRecord, station: int, bit: int, end_ns: int) -> None:
    """Process one sampled bit in the controller's current mode."""
    if c.mode == ControllerMode.FRAME:
        _frame_bit(bus, c, station, bit)
    elif c.mode == ControllerMode.FLAG or c.mode == ControllerMode.OVERLOAD:
        _flag_bit(bus, c, station, bit)
    elif c.mode == ControllerMode.WAIT or c.mode == ControllerMode.DELIMITER:
        _after_flag(bus, c, station, bit)
    else:
        _between_frames(bus, c, station, bit, end_ns)
