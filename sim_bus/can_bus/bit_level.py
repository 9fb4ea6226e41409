"""Compiled bit-level simulation of every station's controller (ISO 11898-1:2015, clauses 10 and 11).

The arbiter knows a frame's length and the winner without the bits. With errors that is not enough,
and `run_bits` simulates the bits instead: each controller drives a level, dominant (0) wins, a
disturbance inverts the level for all stations or for one, and each controller follows the standard
(`sim_bus.can_bus.controller_bits`). The simulation ends when no station sends and at least one may
start; failed frames then return to the queue. A controller that is not idle by then, such as an
error-passive receiver that alone has seen an error, continues in its present mode when the next
simulation begins (`unsettled`).

It pauses at the end of each bit with an event: a frame received or given up, an error, a change of
state. It also pauses regularly, so that a station that is switched off in mid-frame falls silent in
mid-frame.
"""

from __future__ import annotations

from coulombus.kernels.decorator import kernel
from coulombus.sim_bus.can_bus.controller_bits import (
    ControllerMode,
    FrameFate,
    drive,
    follow,
    look_anew,
    may_start,
    open_frame,
)
from coulombus.sim_bus.can_bus.fault_confinement import CanState
from coulombus.sim_bus.can_bus.noise import noisy_bit
from coulombus.sim_bus.can_bus.records import ALL, NOBODY, NS, BusRecord, Stage, is_meant
from coulombus.sim_bus.can_bus.stuffing import stuffed_bits

__all__ = ["add_sender", "begin_bits", "run_bits"]

LONGEST_STRETCH = 64  # bits without a pause


@kernel
def add_sender(bus: BusRecord, order: int, can_id: int, length: int, word: int, source: int, wrong_crc: int) -> None:
    """Add a station's frame to the bit-level simulation that is about to begin."""
    k = bus.senders
    sender = bus.tx[k]
    sender.state = FrameFate.PENDING
    sender.order = order
    sender.can_id = can_id
    sender.length = length
    sender.word = word
    sender.source = source
    sender.bits = stuffed_bits(can_id, length, word, wrong_crc, sender.bit)
    bus.senders = k + 1


@kernel
def begin_bits(bus: BusRecord, now_ns: int) -> None:
    """Begin the bit-level simulation at `now_ns` with the senders that were added.

    The other stations are idle, or continue in their present modes.
    """
    bus.play.begin_ns = now_ns
    bus.play.bit = 0
    look_anew(bus)
    for k in range(bus.on_count):
        c = bus.stations[bus.on[k]]
        c.hears = 0
        c.frame = -1
    for k in range(bus.senders):
        c = bus.stations[bus.tx[k].source & 0xFF]
        joins = c.joins
        open_frame(c, k)
        if joins:  # its start of frame is the bit that has just ended
            c.sent_bits = c.position = c.run = 1
            c.last = 0
            if k == 0:
                bus.play.begin_ns -= NS // bus.bit_rate
                bus.play.bit = 1


@kernel
def _disturbed(bus: BusRecord, row: int, level: int) -> int:
    """Return `level` after the scripted disturbances of the station in a row, or those of the wire for
    `ALL`.
    """
    for k in range(bus.struck.flips):
        station = bus.struck.flip_station[k]
        if bus.struck.flip_bit[k] == bus.play.bit and (station == ALL) == (row == ALL) and is_meant(station, row):
            level = 1 - level
    return level


@kernel
def _wire_level(bus: BusRecord, stuck: bool) -> int:
    """Return the level of the wire in this bit: dominant if a controller or a fault drives it; a disturbance
    of all stations inverts it.
    """
    level = 1
    for k in range(bus.on_count):
        c = bus.stations[bus.on[k]]
        c.level = 1 if c.state == CanState.BUS_OFF else drive(bus, c)
        level &= c.level
    if stuck:
        level = 0
    return _disturbed(bus, ALL, level)


@kernel
def _see(bus: BusRecord, level: int, hit: int, end_ns: int) -> bool:
    """Let each controller sample the bit, inverted for the stations of `hit`.

    Tell whether a controller has changed its state.
    """
    changed = False
    for k in range(bus.on_count):
        station = bus.on[k]
        c = bus.stations[station]
        if c.state == CanState.BUS_OFF:
            continue
        bit = _disturbed(bus, station, level)
        if is_meant(hit, station):
            bit = 1 - bit
        follow(bus, c, station, bit, end_ns)
        if c.changed:
            changed = True
            if c.state == CanState.BUS_OFF and c.frame >= 0:
                bus.tx[c.frame].state = FrameFate.FAILED
                c.frame = -1
    return changed


@kernel
def _somebody_may_start(bus: BusRecord) -> bool:
    """Tell whether the bit-level simulation is over: no station sends, and one may start or none is left.
    Controllers need not be idle.
    """
    alive = idle = ready = sending = 0
    for k in range(bus.on_count):
        c = bus.stations[bus.on[k]]
        if c.state != CanState.BUS_OFF:
            alive += 1
            idle += c.mode == ControllerMode.IDLE
            ready += may_start(c)
            sending += c.frame >= 0
    over = sending == 0 and (ready > 0 or alive == 0)
    if over:
        bus.play.unsettled = 1 if idle < alive else 0
    return over


@kernel
def run_bits(bus: BusRecord) -> int:
    """Simulate bits until an event, or until a station may send (`Stage.OVER`).

    Return the end of the last bit.
    """
    bus.stage = Stage.PLAYED
    bus.play.passed = bus.seen.tell = 0
    last_bit = bus.play.bit + LONGEST_STRETCH
    end_ns: int = bus.play.begin_ns + bus.play.bit * NS // bus.bit_rate
    while True:
        begin_ns = end_ns
        end_ns = bus.play.begin_ns + (bus.play.bit + 1) * NS // bus.bit_rate
        stuck = bus.stuck.from_ns <= begin_ns < bus.stuck.until_ns
        level = _wire_level(bus, stuck)
        hit = noisy_bit(bus, end_ns)
        if hit == ALL:
            level = 1 - level
            hit = NOBODY
        if level == 0:
            bus.recessive_ns = end_ns
        changed = _see(bus, level, hit, end_ns)
        if bus.seen.accepted_bit >= 0 and bus.play.bit == bus.seen.accepted_bit + 1:
            bus.play.passed = 1
        bus.play.bit += 1
        if not stuck and _somebody_may_start(bus):
            bus.stage = Stage.OVER
            return end_ns
        if bus.seen.tell or changed or bus.play.passed or bus.seen.gave_up:
            return end_ns
        if bus.play.bit >= last_bit or end_ns >= bus.stuck.until_ns:
            return end_ns
