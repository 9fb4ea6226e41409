"""Compiled start of frames on a bus with faults, counted errors, or a station that is alone.

`sim_bus.can_bus.arbiter.start_frame` leaves the start to this module if `BusRecord.alert` is set,
or if two stations send the same arbitration field. `attempt` starts the next frame: it applies the scripted faults,
and then either the frame passes undisturbed (`Stage.WATCHED`), or `sim_bus.can_bus.bit_level`
simulates its bits, with all stations whose frames are ready as senders.
`sim_bus.can_bus.frame_result` ends it.

All of this is one function, which the event loop calls by the address in `BusRecord.detailed`: a
run without errors compiles none of it.
"""

from __future__ import annotations

from coulombus.kernels.by_address import call_part, part_address
from coulombus.kernels.decorator import inlined, kernel
from coulombus.kernels.records import dtype_of
from coulombus.sim_bus.can_bus.bit_level import add_sender, begin_bits, run_bits
from coulombus.sim_bus.can_bus.controller_bits import may_start
from coulombus.sim_bus.can_bus.fault_confinement import CanState, recover
from coulombus.sim_bus.can_bus.faults import alarm, strike, strike_nothing
from coulombus.sim_bus.can_bus.frame_result import end_attempt, lose
from coulombus.sim_bus.can_bus.records import (
    INTER_FRAME_BITS,
    MAX_SENDERS,
    NS,
    RUN_BITS,
    STATION_MASK,
    BusRecord,
    Stage,
)
from coulombus.sim_bus.can_bus.stations import attach, refresh
from coulombus.sim_bus.can_bus.tx_queue import (
    HELD_BACK,
    SEQUENCE_BITS,
    SEQUENCE_MASK,
    first_order,
    hold,
    take_in,
    winner,
)
from coulombus.wire.bits import data_frame_bits
from coulombus.wire.frame import Queue

__all__ = ["attempt", "detailed_address", "detailed_end", "detailed_start"]

_START, _END = 0, 1


@inlined
def detailed_start(bus: BusRecord, out: Queue, now_ns: int) -> None:
    """Call `attempt` by its address."""
    call_part(bus.detailed, bus, out, _START, now_ns)


@inlined
def detailed_end(bus: BusRecord, out: Queue) -> int:
    """Call `sim_bus.can_bus.frame_result.end_attempt` by its address."""
    rows: int = call_part(bus.detailed, bus, out, _END, 0)
    return rows


def _detailed(bus: BusRecord, out: Queue, part: int, now_ns: int) -> int:
    if part == _END:
        return int(end_attempt(bus, out))
    attempt(bus, out, now_ns)
    return 0


def detailed_address() -> int:
    """Return the function's address, compiled or loaded from the cache."""
    return part_address(_detailed, dtype_of(BusRecord), dtype_of(Queue))


@inlined
def _recover(bus: BusRecord, now_ns: int) -> None:
    """Credit the stations in bus-off with the runs of 11 recessive bits since the last dominant bit."""
    for k in range(bus.on_count):
        c = bus.stations[bus.on[k]]
        if c.state != CanState.BUS_OFF or c.restart_at_ns > now_ns:
            continue
        begin_ns = max(bus.recessive_ns, c.restart_at_ns)
        runs = max(now_ns - begin_ns, 0) * bus.bit_rate // NS // RUN_BITS
        c.runs_left -= runs
        c.restart_at_ns = begin_ns + runs * RUN_BITS * NS // bus.bit_rate
        if c.runs_left <= 0:
            recover(c)


@inlined
def _next(bus: BusRecord, now_ns: int) -> int:
    """Return the place of the next frame whose sender may send now, -1 if there is none."""
    place = winner(bus, now_ns)
    while place >= 0:
        row = bus.held_source[place] & STATION_MASK
        c = bus.stations[row]
        if c.attached == 0:
            attach(bus, row)
        if c.state == CanState.BUS_OFF or c.listen_only:
            c.dropped += 1
        elif c.suspend_ns > now_ns:
            _wait_again(bus, place, bus.held_order[place], c.suspend_ns)
        elif not may_start(c):
            _wait_again(bus, place, bus.held_order[place], now_ns + NS // bus.bit_rate)
        else:
            return place
        place = winner(bus, now_ns)
    return -1


@kernel
def _wait_again(bus: BusRecord, place: int, order: int, ready_ns: int) -> None:
    can_id, length, word, source = (
        bus.held_can_id[place],
        bus.held_length[place],
        bus.held_word[place],
        bus.held_source[place],
    )
    hold(bus, order, can_id, length, word, source, ready_ns)


@kernel
def attempt(bus: BusRecord, out: Queue, now_ns: int) -> None:
    """Start the next frame or event at `now_ns`, if any."""
    if out.count > 0:
        take_in(bus, out)
    _recover(bus, now_ns)
    if bus.alarm_ns <= now_ns:
        alarm(bus, now_ns)
        refresh(bus)
        if bus.fault_calls != 0:  # cut or repair the cable before anything is sent
            out.waiting = bus.held
            return
    stuck = bus.stuck.from_ns <= now_ns < bus.stuck.until_ns
    bus.senders = 0
    strike_nothing(bus)
    while True:
        place = _next(bus, now_ns)
        if place < 0:
            break
        can_id, source = bus.held_can_id[place], bus.held_source[place]
        length, word = bus.held_length[place], bus.held_word[place]
        sequence = bus.held_order[place] & SEQUENCE_MASK
        if sequence == 0:  # it was on the wire before, and the fault that struck it then is still to come
            c = bus.stations[source & STATION_MASK]
            bus.retransmissions += 1
            c.retransmissions += 1
            if c.owed:
                bus.struck.again, bus.struck.lost_for = c.again, c.lost_for
                c.owed = 0
        if sequence == 0 or sequence == HELD_BACK:
            break
        delay_ns = strike(bus, now_ns, can_id, length, word, source)
        if delay_ns == 0:
            break
        _wait_again(bus, place, first_order(can_id) | HELD_BACK, now_ns + delay_ns)
    out.waiting = bus.held
    if place >= 0:
        _send(bus, place, now_ns)
    elif stuck or bus.play.unsettled or bus.noise.next_ns <= now_ns:
        _begin_slow(bus, now_ns)
    else:
        _only_report(bus, now_ns)


@kernel
def _only_report(bus: BusRecord, now_ns: int) -> None:
    """Start a state without a sender, to report a controller that has recovered."""
    for k in range(bus.on_count):
        if bus.stations[bus.on[k]].changed:
            bus.stage = Stage.TELLING
            bus.end_ns = now_ns
            return


@kernel
def _begin_slow(bus: BusRecord, now_ns: int) -> None:
    begin_bits(bus, now_ns)
    bus.t_ns = now_ns
    bus.end_ns = run_bits(bus)


@inlined
def _send(bus: BusRecord, place: int, now_ns: int) -> None:
    """Start the frame at `place`, which has won the arbitration."""
    bus.can_id = bus.held_can_id[place]
    bus.length = bus.held_length[place]
    bus.word = bus.held_word[place]
    bus.source = bus.held_source[place]
    order = bus.held_order[place]
    bits = data_frame_bits(bus.can_id, bus.length, bus.word)
    end_ns = now_ns + bits * NS // bus.bit_rate
    acknowledged = False
    row = bus.source & STATION_MASK
    for k in range(bus.on_count):
        c = bus.stations[bus.on[k]]
        is_sender = bus.on[k] == row
        c.hears = 1 if c.state != CanState.BUS_OFF and (not is_sender or c.loopback) else 0
        if c.state != CanState.BUS_OFF and ((not is_sender and not c.listen_only) or (is_sender and c.loopback)):
            acknowledged = True
    disturbed = (
        bus.struck.flips > 0 or bus.struck.wrong_crc != 0 or bus.stuck.from_ns < end_ns or bus.noise.next_ns < end_ns
    )
    if disturbed or bus.play.unsettled or not acknowledged or _contested(bus, order):
        add_sender(bus, order, bus.can_id, bus.length, bus.word, bus.source, bus.struck.wrong_crc)
        _contend(bus, now_ns)
        _begin_slow(bus, now_ns)
        return
    _count_lost(bus, now_ns)
    lose(bus)
    bus.t_ns = now_ns
    bus.end_ns = now_ns + (bits - INTER_FRAME_BITS) * NS // bus.bit_rate
    bus.free_ns = end_ns
    bus.recessive_ns = end_ns - RUN_BITS * NS // bus.bit_rate
    bus.stage = Stage.WATCHED
    bus.frames += 1
    bus.bits += bits


@inlined
def _contested(bus: BusRecord, order: int) -> bool:
    """Tell whether the winner's bits matter to another station: its frame has the same arbitration field, or
    it is in one-shot mode.
    """
    for n in range(bus.ready):
        source = bus.held_source[bus.ready_place[n]]
        if source == bus.source:
            continue
        if bus.ready_key[n] >> SEQUENCE_BITS == order >> SEQUENCE_BITS or bus.stations[source & STATION_MASK].one_shot:
            return True
    return False


@kernel
def _contends(bus: BusRecord, source: int, now_ns: int) -> bool:
    """Tell, once for each station with a ready frame, whether it takes part in the present arbitration."""
    c = bus.stations[source & STATION_MASK]
    if (
        c.contends_ns == now_ns
        or c.state == CanState.BUS_OFF
        or c.listen_only
        or c.suspend_ns > now_ns
        or not may_start(c)
    ):
        return False
    c.contends_ns = now_ns
    return True


@inlined
def _count_lost(bus: BusRecord, now_ns: int) -> None:
    """Count the stations that lose the arbitration to the bus's frame, without simulating the bits."""
    bus.stations[bus.source & STATION_MASK].contends_ns = now_ns
    for n in range(bus.ready):
        source = bus.held_source[bus.ready_place[n]]
        if _contends(bus, source, now_ns):
            bus.stations[source & STATION_MASK].arbitration_lost += 1


@kernel
def _contend(bus: BusRecord, now_ns: int) -> None:
    """Let the other stations with a ready frame send their first frames too: the bits decide."""
    bus.stations[bus.source & STATION_MASK].contends_ns = now_ns
    while bus.senders < MAX_SENDERS:
        place = winner(bus, now_ns)
        if place < 0:
            return
        order, source = bus.held_order[place], bus.held_source[place]
        if bus.stations[source & STATION_MASK].attached == 0:  # never switched on explicitly, but present
            attach(bus, source)
        if _contends(bus, source, now_ns):
            add_sender(bus, order, bus.held_can_id[place], bus.held_length[place], bus.held_word[place], source, 0)
        else:
            _wait_again(bus, place, order, now_ns + 1)
