"""Compiled end of a frame on the detailed path, or of a bit-level simulation.

It writes the reports, and sets the next state of the senders.

The reports are error frames in the format of Linux's CAN drivers (include/uapi/linux/can/error.h).
The identifier has the classes, the eight bytes have the details.

====== =======================================================================
byte   content
====== =======================================================================
0      bit in which the arbitration was lost: 0 is the start of frame, stuff bits do not count
1      controller's change of state: warning, passive, active again
2      type of a protocol error: bit, form, stuff, overload; 80h: on transmission
3      position in the frame
4      (transceiver: not used here)
5      number of the reported station, its low eight bits
6, 7   transmit and receive error counter of that station
====== =======================================================================

All classes for which Linux also sends counters carry CAN_ERR_CNT.

    c : the record of a controller
"""

from __future__ import annotations

from coulombus.kernels.decorator import inlined, kernel
from coulombus.sim_bus.can_bus.bit_level import run_bits
from coulombus.sim_bus.can_bus.controller_bits import FrameFate
from coulombus.sim_bus.can_bus.fault_confinement import (
    PASSIVE_LEVEL,
    CanState,
    begin_bus_off,
    count_received,
    count_sent,
)
from coulombus.sim_bus.can_bus.faults import NO_FRAME, FaultKind, fire, plan_alarm
from coulombus.sim_bus.can_bus.records import (
    MOST_ROWS,
    NOBODY,
    NS,
    STATION_MASK,
    SUSPEND_BITS,
    BusRecord,
    ControllerRecord,
    Delivered,
    Stage,
    is_meant,
)
from coulombus.sim_bus.can_bus.stations import number, refresh
from coulombus.sim_bus.can_bus.tx_queue import HELD_BACK, WITHDRAWN, first_order, hold, withdraw
from coulombus.wire.clock import NEVER_NS
from coulombus.wire.controller_state import Confinement
from coulombus.wire.error_frames import (
    ACTIVE_AGAIN,
    BUS_OFF,
    CONTROLLER,
    COUNTERS,
    LOST_ARBITRATION,
    RESTARTED,
    RX_PASSIVE,
    RX_WARNING,
    TX_PASSIVE,
    TX_WARNING,
)
from coulombus.wire.frame import CAN_ERR_FLAG, Queue

__all__ = ["end_attempt", "error_frame", "lose", "lost_frame", "state_frame", "with_counters"]


@inlined
def with_counters(word: int, c: ControllerRecord) -> int:
    """Return the eight bytes with a controller's counters in the last two."""
    counters = min(c.tec, 255) | min(c.rec, 255) << 8
    signed: int = (word & 0xFFFF_FFFF_FFFF) | ((counters ^ 0x8000) - 0x8000) << 48
    return signed


@kernel
def error_frame(c: ControllerRecord, station: int, classes: int, kind: int, place: int) -> tuple[int, int]:
    """Return identifier and bytes of the frame that reports an error on the bus."""
    word = kind << 16 | place << 24 | (station & 0xFF) << 40
    return CAN_ERR_FLAG | COUNTERS | classes, with_counters(word, c)


@kernel
def lost_frame(c: ControllerRecord, station: int, bit: int) -> tuple[int, int]:
    """Return identifier and bytes of the frame that reports a given-up frame to its station: the arbitration
    was lost in `bit`.
    """
    return CAN_ERR_FLAG | COUNTERS | LOST_ARBITRATION, with_counters(bit | (station & 0xFF) << 40, c)


@kernel
def state_frame(c: ControllerRecord, station: int) -> tuple[int, int]:
    """Return identifier and bytes of the frame that reports a controller's new state."""
    classes = COUNTERS
    how = 0
    if c.recovered:
        classes |= RESTARTED
    if c.state == CanState.BUS_OFF:
        classes |= BUS_OFF
    elif c.state == CanState.ERROR_ACTIVE:
        classes |= CONTROLLER
        how = ACTIVE_AGAIN
    else:
        classes |= CONTROLLER
        passive = c.state == CanState.ERROR_PASSIVE
        if c.tec >= c.rec:
            how |= TX_PASSIVE if passive else TX_WARNING
        if c.rec >= c.tec:
            how |= RX_PASSIVE if passive else RX_WARNING
    return CAN_ERR_FLAG | classes, with_counters(how << 8 | (station & 0xFF) << 40, c)


_LAST = MOST_ROWS - 2
"""First row of the reports that is reserved for an error and the frame."""

_TOLD = tuple(
    map(int, (Confinement.ACTIVE, Confinement.ACTIVE, Confinement.PASSIVE, Confinement.BUS_OFF))
)  # by CanState


@inlined
def lose(bus: BusRecord) -> None:
    """Mark the stations for which a scripted fault drops this frame."""
    if bus.struck.lost_for == NOBODY:
        return
    for k in range(bus.on_count):
        if is_meant(bus.struck.lost_for, bus.on[k]):
            bus.stations[bus.on[k]].hears = 0


@inlined
def _once_more(bus: BusRecord) -> None:
    """Queue the frame that has passed again if a scripted fault duplicates it."""
    if bus.struck.again:
        order = first_order(bus.can_id) | HELD_BACK
        hold(bus, order, bus.can_id, bus.length, bus.word, bus.source, bus.free_ns)
        bus.struck.again = 0


@kernel
def _write(bus: BusRecord, row: int, can_id: int, word: int, source: int) -> None:
    frame = bus.report[row]
    frame.t_ns = bus.end_ns
    frame.can_id = can_id
    frame.length = 8
    frame.word = word
    frame.source = source


@kernel
def _report_given_up(bus: BusRecord, row: int) -> int:
    """Write the bit in which each one-shot sender lost the arbitration.

    Return the next row.
    """
    bus.seen.gave_up = 0
    for k in range(bus.senders):
        source = bus.tx[k].source
        c = bus.stations[source & STATION_MASK]
        if bus.tx[k].state != FrameFate.LOST or not c.one_shot:
            continue
        if row == _LAST:
            bus.seen.gave_up = 1
        else:
            can_id, word = lost_frame(c, source, bus.tx[k].lost_bit)
            _write(bus, row, can_id, word, source)
            row += 1
            bus.tx[k].state = FrameFate.GIVEN_UP
            c.dropped += 1
    return row


@inlined
def _report_states(bus: BusRecord, out: Queue, row: int) -> int:
    """Write the controllers' changes of state; return the next row."""
    for k in range(bus.on_count):
        station = bus.on[k]
        c = bus.stations[station]
        if c.changed == 0 or row >= _LAST:
            continue
        can_id, word = state_frame(c, station)
        _write(bus, row, can_id, word, number(station))
        row += 1
        if c.recovered:
            c.confinement = Confinement.RECOVERED
        else:
            c.confinement = _TOLD[c.state]
        bus.confinements = 1
        c.changed = c.recovered = 0
        if c.state == CanState.BUS_OFF:
            begin_bus_off(c, bus.end_ns, NEVER_NS)
            withdraw(bus, out, number(station))
    return row


@inlined
def _settle(bus: BusRecord) -> None:
    """Apply rules g and h after a frame, and the suspension of an error-passive sender."""
    row = bus.source & STATION_MASK
    for k in range(bus.on_count):
        c = bus.stations[bus.on[k]]
        if bus.on[k] == row:
            count_sent(c)
            if c.tec >= PASSIVE_LEVEL or c.rec >= PASSIVE_LEVEL:
                c.suspend_ns = bus.free_ns + SUSPEND_BITS * NS // bus.bit_rate
        elif c.state != CanState.BUS_OFF:
            count_received(c)
    _once_more(bus)


@kernel
def _end_slow(bus: BusRecord) -> None:
    """Queue the failed frames again when the wire is free, except those of one-shot or switched-off
    senders.
    """
    bus.free_ns = bus.end_ns
    bus.bits += bus.play.bit
    if bus.noise.hits > 0:
        bus.noise.hits = 0
        for row in range(bus.fault_count):
            for _ in range(bus.faults[row].hits):
                fire(bus, row, bus.play.begin_ns, bus.can_id if bus.senders > 0 else NO_FRAME)
            bus.faults[row].hits = 0
    for k in range(bus.senders):
        c = bus.stations[bus.tx[k].source & STATION_MASK]
        state = bus.tx[k].state
        if state != FrameFate.FAILED and state != FrameFate.LOST:
            continue
        if c.attached == 0 or c.state == CanState.BUS_OFF or c.one_shot:
            c.dropped += 1
            continue
        can_id, order = bus.tx[k].can_id, bus.tx[k].order
        if order == WITHDRAWN:
            continue
        if k == 0:  # the winner is sent again; the other senders have not reached their bits
            order = first_order(can_id)
            if bus.struck.again or bus.struck.lost_for != NOBODY:
                c.owed, c.again, c.lost_for = 1, bus.struck.again, bus.struck.lost_for
        ready_ns = max(bus.free_ns, c.suspend_ns)
        hold(bus, order, can_id, bus.tx[k].length, bus.tx[k].word, bus.tx[k].source, ready_ns)


@kernel
def _show_sent(bus: BusRecord) -> bool:
    """Make the frame received in the bit-level simulation the bus's frame; False: there is none."""
    if bus.senders == 0:  # nobody sent: a disturbance that looks like a frame does not count
        return False
    k = 0
    for j in range(bus.senders):
        if bus.tx[j].state == FrameFate.DONE:
            k = j
            break
        if bus.tx[j].state == FrameFate.FAILED:  # an error in the last bit: the receivers have the frame
            k = j
    bus.can_id = bus.tx[k].can_id
    bus.length = bus.tx[k].length
    bus.word = bus.tx[k].word
    bus.source = bus.tx[k].source
    bus.frames += 1
    if k == 0:
        lose(bus)
        _once_more(bus)
    return True


@kernel
def _report_stuck(bus: BusRecord) -> None:
    """Count the dominant wire from its begin on, also if it begins in a frame and the bus does not become
    free for `alarm`.
    """
    for row in range(bus.fault_count):
        f = bus.faults[row]
        if f.kind == FaultKind.STUCK_DOMINANT and f.next_ns < min(bus.end_ns, f.until_ns):
            fire(bus, row, f.next_ns, NO_FRAME)
            f.next_ns = f.until_ns


@inlined
def _report_error(bus: BusRecord, row: int) -> None:
    """Write the first error of this simulation."""
    seen = bus.seen
    can_id, word = error_frame(bus.stations[seen.source], seen.source, seen.classes, seen.kind, seen.place)
    _write(bus, row, can_id, word, number(seen.source))
    bus.errors += 1


@inlined
def _deliver(bus: BusRecord, row: int) -> None:
    """Write the bus's frame for its receivers; the faults that it has triggered are due."""
    _write(bus, row, bus.can_id, bus.word, bus.source)
    bus.report[row].length = bus.length
    bus.delivered = Delivered.HEARERS
    bus.fault_calls |= bus.fault_due
    bus.fault_due = 0


@kernel
def _play_on(bus: BusRecord) -> None:
    """Continue the bit-level simulation."""
    if bus.stuck.until_ns <= bus.end_ns:
        plan_alarm(bus, bus.end_ns)
    bus.end_ns = run_bits(bus)


@kernel
def end_attempt(bus: BusRecord, out: Queue) -> int:
    """End a frame, or a bit-level simulation, at `end_ns`.

    Return the number of rows of `BusRecord.report` written; the last is the frame's.
    """
    bus.delivered = Delivered.NOBODY
    if bus.stage == Stage.TOLD:
        _play_on(bus)
        return 0
    if bus.stuck.from_ns < bus.end_ns:
        _report_stuck(bus)
    row = 0
    slowly = bus.stage >= Stage.PLAYED
    if bus.stage == Stage.WATCHED:
        _settle(bus)
    if slowly and bus.seen.gave_up:
        row = _report_given_up(bus, row)
    row = _report_states(bus, out, row)
    if slowly and bus.seen.tell:
        _report_error(bus, row)
        row += 1
    if bus.stage == Stage.WATCHED or (slowly and bus.play.passed and _show_sent(bus)):
        _deliver(bus, row)
        row += 1
    if slowly and bus.seen.gave_up:  # the last bit has more events: the next end, at the same time, reports them
        bus.play.passed = bus.seen.tell = 0
        return row
    if bus.stage == Stage.PLAYED:
        bus.stage = Stage.TOLD
        return row
    bus.stage = Stage.FREE
    if slowly:
        _end_slow(bus)
    if slowly or row > 1:
        plan_alarm(bus, bus.end_ns)
    if bus.fault_count == 0 or bus.limited:
        refresh(bus)
    return row
