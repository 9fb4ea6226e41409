"""Compiled scripted faults: a table of rows, each with its trigger and its effect.

`sim_bus.faults.fault_file` creates the rows from a file. The table is part of the bus's record, so
a kernel needs no Python to inject: `strike` evaluates the rows at the start of each frame, `alarm`
those that wait for a time.

    f : a row of the table
"""

from __future__ import annotations

from enum import IntEnum

from coulombus.kernels.decorator import inlined, kernel
from coulombus.sim_bus.can_bus.fault_confinement import CanState
from coulombus.sim_bus.can_bus.noise import renew
from coulombus.sim_bus.can_bus.records import (
    INTER_FRAME_BITS,
    MAX_FLIPS,
    MOST_TOLD,
    NOBODY,
    NS,
    RUN_BITS,
    STATION_MASK,
    BusRecord,
    FaultRecord,
    is_meant,
)
from coulombus.sim_bus.can_bus.stuffing import TAIL_BITS
from coulombus.sim_bus.can_bus.tx_queue import first_order, hold
from coulombus.wire.bits import data_frame_bits
from coulombus.wire.clock import NEVER_NS

__all__ = ["NO_FRAME", "FaultKind", "alarm", "fire", "plan_alarm", "strike", "strike_nothing"]

NO_FRAME = -1
"""Identifier of a fault that struck an idle wire, or a station."""
BABBLE_LIMIT = 4  # pending frames of a babbler: more would only fill the queue
TAIL_BIT = 1000
"""`bit` values from here on count after the CRC sequence: 1000 is the CRC delimiter."""


class FaultKind(IntEnum):
    """Effect of a fault."""

    FLIP = 0
    CORRUPT_CRC = 1
    DROP = 2
    DELAY = 3
    DUPLICATE = 4
    RESET = 5
    CUT = 6
    DRIFT = 7  # and each other fault of a node, which Python performs
    BABBLE = 8
    STUCK_DOMINANT = 9
    NOISE = 10


@inlined
def strike_nothing(bus: BusRecord) -> None:
    """Clear the effects on the last frame."""
    struck = bus.struck
    struck.flips = struck.wrong_crc = struck.again = 0
    struck.lost_for = NOBODY


@kernel
def fire(bus: BusRecord, row: int, t_ns: int, can_id: int) -> None:
    """Count a fault and record it, with the identifier of its frame, or `NO_FRAME`."""
    f = bus.faults[row]
    if f.fired == 0:
        f.first_ns = t_ns
    f.fired += 1
    f.last_ns = t_ns
    if bus.told < MOST_TOLD:
        bus.told_ns[bus.told] = t_ns
        bus.told_row[bus.told] = row
        bus.told_id[bus.told] = can_id
        bus.told += 1


@kernel
def _meant(f: FaultRecord, now_ns: int, can_id: int, source: int) -> bool:
    """Tell whether a row applies to this frame, and count the matching frames."""
    if not f.from_ns <= now_ns < f.until_ns:
        return False
    if f.kind > FaultKind.CUT or (f.kind >= FaultKind.RESET and not f.framed):
        return False
    if f.framed and (
        (can_id & f.match_mask) != (f.match_id & f.match_mask) or not is_meant(f.match_source, source & STATION_MASK)
    ):
        return False
    f.seen += 1
    if f.seen < f.nth or (0 < f.most <= f.fired):
        return False
    return bool(f.seen == f.nth if f.every == 0 else (f.seen - f.nth) % f.every == 0)


@kernel
def strike(bus: BusRecord, now_ns: int, can_id: int, length: int, word: int, source: int) -> int:
    """Apply the rows to the frame that is about to start.

    Return the delay [ns] by which they postpone it. `BusRecord.struck` holds their other effects.
    """
    delay_ns = meant = 0
    for row in range(bus.fault_count):
        f = bus.faults[row]
        second_cut = f.kind == FaultKind.CUT and bus.cut | bus.half  # only one cut at a time
        if _meant(f, now_ns, can_id, source) and not second_cut:
            meant |= 1 << row
            if f.kind == FaultKind.DELAY:
                delay_ns = max(delay_ns, f.delay_ns)
    for row in range(bus.fault_count):
        f = bus.faults[row]
        put_off = f.kind != FaultKind.DELAY and delay_ns > 0  # a delayed frame has no other fault
        if meant >> row & 1 == 0 or put_off:
            continue
        if f.kind == FaultKind.FLIP:
            stuffed = data_frame_bits(can_id, length, word) - INTER_FRAME_BITS - TAIL_BITS  # up to the CRC sequence
            bit = f.bit if f.bit < TAIL_BIT else stuffed + f.bit - TAIL_BIT
            if (
                bit >= stuffed + TAIL_BITS + INTER_FRAME_BITS or bus.struck.flips >= MAX_FLIPS
            ):  # this frame does not have such a bit
                continue
            bus.struck.flip_bit[bus.struck.flips] = bit
            bus.struck.flip_station[bus.struck.flips] = f.station
            bus.struck.flips += 1
        elif f.kind == FaultKind.CORRUPT_CRC:
            bus.struck.wrong_crc = 1
        elif f.kind == FaultKind.DROP:
            bus.struck.lost_for = f.station
        elif f.kind == FaultKind.DUPLICATE:
            bus.struck.again = 1
        elif f.kind == FaultKind.RESET or f.kind == FaultKind.CUT:
            bus.fault_due |= 1 << row
        fire(bus, row, now_ns, can_id)
    return delay_ns


@inlined
def _elsewhere(bus: BusRecord, f: FaultRecord) -> bool:
    """Tell whether a babbler is in the other half of a cut cable."""
    return bool(f.kind == FaultKind.BABBLE and bus.stations[f.station & STATION_MASK].half != bus.half)


@kernel
def _babble(bus: BusRecord, f: FaultRecord, row: int, now_ns: int) -> None:
    """Queue a babbler's frames that are due."""
    while f.next_ns <= now_ns and f.next_ns < f.until_ns:
        c = bus.stations[f.station & STATION_MASK]
        if c.state != CanState.BUS_OFF and bus.waiting_of[f.station & STATION_MASK] < BABBLE_LIMIT:
            fire(bus, row, f.next_ns, f.can_id)
            hold(bus, first_order(f.can_id) | 1, f.can_id, f.length, f.word, f.station, f.next_ns)
        f.next_ns += f.period_ns


@kernel
def alarm(bus: BusRecord, now_ns: int) -> None:
    """Handle the deadlines at `now_ns`: begin or end the faults that last for a time."""
    noise = False
    for row in range(bus.fault_count):
        f = bus.faults[row]
        if f.kind == FaultKind.BABBLE:
            if not _elsewhere(bus, f):
                _babble(bus, f, row, now_ns)
        elif f.kind == FaultKind.CUT and f.next_ns <= now_ns:
            f.next_ns = NEVER_NS
            bus.fault_calls |= 1 << row
        elif (f.kind == FaultKind.NOISE or f.kind == FaultKind.STUCK_DOMINANT) and f.next_ns <= now_ns:
            begins = f.next_ns < f.until_ns
            f.next_ns = f.until_ns if begins else NEVER_NS
            if f.kind == FaultKind.NOISE:
                f.active = 1 if begins else 0
                noise = True
            elif begins:
                fire(bus, row, now_ns, NO_FRAME)
    if noise:
        renew(bus, now_ns)
    plan_alarm(bus, now_ns)


@kernel
def plan_alarm(bus: BusRecord, now_ns: int) -> None:
    """Set `alarm_ns`, and the time of the wire's next dominant fault."""
    next_ns = bus.free_ns if bus.play.unsettled else bus.noise.next_ns
    bus.stuck.from_ns = bus.stuck.until_ns = NEVER_NS
    for row in range(bus.fault_count):
        f = bus.faults[row]
        if f.kind == FaultKind.STUCK_DOMINANT and f.until_ns > now_ns and f.from_ns < bus.stuck.from_ns:
            bus.stuck.from_ns = f.from_ns
            bus.stuck.until_ns = f.until_ns
        if (f.kind == FaultKind.CUT or f.kind > FaultKind.DRIFT) and (
            f.kind != FaultKind.BABBLE or (f.next_ns < f.until_ns and not _elsewhere(bus, f))
        ):
            next_ns = min(next_ns, f.next_ns)
    for k in range(bus.on_count):
        c = bus.stations[bus.on[k]]
        if c.state == CanState.BUS_OFF and c.restart_at_ns < NEVER_NS:
            begin_ns = max(bus.recessive_ns, c.restart_at_ns)
            next_ns = min(next_ns, begin_ns + -(-c.runs_left * RUN_BITS * NS // bus.bit_rate))
    bus.alarm_ns = next_ns
