"""What happens to a frame on a bus that wants a closer look than its length: faults, errors that were counted, a station that is alone (compiled).

`sim_bus.copper.arbiter` comes here when `BUS.alert` is set, or when two stations send one arbitration field. `attempt` starts the next frame: it
lets the scripted faults strike, and either the frame will pass, with the counters' rules at its end, or `sim_bus.copper.slow_motion` plays its bits,
with all whose frames are ready as senders.
`end_attempt` is the end of a frame, or a pause of the slow motion: it writes to the log what there is to tell.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from coulombus.compiled.decorator import inlined, kernel
from coulombus.sim_bus.copper.controller import (
    PASSIVE_LEVEL,
    STATIONS,
    CanState,
    begin_bus_off,
    count_received,
    count_sent,
    recover,
)
from coulombus.sim_bus.copper.error_frames import error_frame, lost_frame, state_frame
from coulombus.sim_bus.copper.faults import NO_FRAME, NOBODY, RUN_BITS, STUCK_DOMINANT, alarm, fire, plan_alarm, strike
from coulombus.sim_bus.copper.slow_motion import (
    DONE,
    FAILED,
    GIVEN_UP,
    INTEGRATING,
    LOST,
    MAX_SENDERS,
    NS,
    add_sender,
    begin_bits,
    is_meant,
    may_start,
    run_bits,
)
from coulombus.sim_bus.copper.waiting import (
    FAR_NS,
    HELD_BACK,
    SEQUENCE_BITS,
    SEQUENCE_MASK,
    STATION_MASK,
    WITHDRAWN,
    first_order,
    hold,
    take_in,
    winner,
    withdraw,
)
from coulombus.wire.bits import data_frame_bits
from coulombus.wire.link import LINK_ACTIVE, LINK_OFF, LINK_PASSIVE, LINK_RECOVERED

__all__ = [
    "ATTEMPT_FIELDS",
    "INTER_FRAME_BITS",
    "MOST_ROWS",
    "attach",
    "attempt",
    "detach",
    "end_attempt",
    "refresh",
    "restart",
]

INTER_FRAME_BITS = 3
SUSPEND_BITS = 8
MOST_ROWS = 16
"""Rows of the log that the end of a frame may need."""

_LINKS = (LINK_ACTIVE, LINK_ACTIVE, LINK_PASSIVE, LINK_OFF)  # by CanState

ATTEMPT_FIELDS = [
    ("alert", np.int64),  # 1: look closely
    ("closely", np.int64),  # 1: the frame on the wire is looked at closely
    ("slowly", np.int64),  # 1: it is played in slow motion
    ("delivered", np.int64),  # 1: what has just ended is a frame, which its receivers have now
    ("partial", np.int64),  # 1: who receives it stands in `hears`
    ("partial_row", np.int64),  # the log's row of the last such frame
    ("resume", np.int64),  # 1: slow motion goes on at `end_ns`
    ("on_count", np.int64),
    ("on", np.int64, (STATIONS,)),  # rows of the stations that are switched on
    ("errors", np.int64),  # errors that were told, all stations together
    ("retransmissions", np.int64),
    ("links", np.int64),  # 1: a controller's `link` is to be told to its node
]


@kernel
def refresh(bus: Any) -> None:
    """Find out whether the bus wants a close look, after something has changed."""
    bus.alert = bus.limited = 0
    if bus.bit_rate <= 0:
        return
    acknowledging = 0
    for k in range(bus.on_count):
        c = bus.stations[bus.on[k]]
        if c.tec | c.rec | c.state | c.changed | c.listen_only | c.one_shot | c.loopback | c.queue_limit:
            bus.alert = 1
            if c.queue_limit or c.state == CanState.BUS_OFF:
                bus.limited = 1
        if c.state != CanState.BUS_OFF and c.listen_only == 0:
            acknowledging += 1
    if bus.fault_count > 0 or bus.alarm_ns < FAR_NS or (bus.on_count > 0 and acknowledging < 2):
        bus.alert = 1


@kernel
def attach(bus: Any, station: int) -> None:
    """Switch a station's controller on."""
    row = station & STATION_MASK
    c = bus.stations[row]
    if c.attached == 0:
        c.attached = 1
        c.tec = c.rec = c.state = c.changed = c.recovered = c.suspend_ns = 0
        c.mode = INTEGRATING if bus.slow or bus.unsettled else 0
        c.count = c.transmitted = c.joins = 0
        c.frame = c.contends_ns = -1
        bus.on[bus.on_count] = row
        bus.on_count += 1
    refresh(bus)


@kernel
def detach(bus: Any, station: int) -> None:
    """Switch a station's controller off; the frame that it is sending breaks off where slow motion can show it."""
    row = station & STATION_MASK
    c = bus.stations[row]
    if c.attached:
        c.attached = c.hears = 0
        kept = 0
        for k in range(bus.on_count):
            if bus.on[k] != row:
                bus.on[kept] = bus.on[k]
                kept += 1
        bus.on_count = kept
    plan_alarm(bus, 0 if bus.slow == 0 else bus.slow_ns)
    refresh(bus)


@kernel
def restart(bus: Any, station: int, now_ns: int) -> None:
    """Begin the recovery of a station in bus-off, as ``ip link set can0 type can restart``."""
    c = bus.stations[station & STATION_MASK]
    if c.state == CanState.BUS_OFF:
        c.restart_at_ns = now_ns
        plan_alarm(bus, now_ns)
        refresh(bus)


@inlined
def _recover(bus: Any, now_ns: int) -> None:
    """Credit the stations in bus-off with the runs of 11 recessive bits since the last dominant one."""
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
def _next(bus: Any, now_ns: int) -> int:
    """Return the place of the next frame whose sender may send now, -1 when there is none."""
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
def _wait_again(bus: Any, place: int, order: int, ready_ns: int) -> None:
    can_id, length, word, source = (
        bus.held_can_id[place],
        bus.held_length[place],
        bus.held_word[place],
        bus.held_source[place],
    )
    hold(bus, order, can_id, length, word, source, ready_ns)


@kernel
def attempt(bus: Any, out: Any, now_ns: int) -> None:
    """Start what is to start at `now_ns`, if anything."""
    if out.count > 0:
        take_in(bus, out)
    _recover(bus, now_ns)
    if bus.alarm_ns <= now_ns:
        alarm(bus, now_ns)
        refresh(bus)
        if bus.fault_calls != 0:  # the cable is cut, or mended, before anything is sent
            out.waiting = bus.held
            return
    stuck = bus.stuck_from_ns <= now_ns < bus.stuck_until_ns
    bus.senders = bus.flips = bus.wrong_crc = bus.again = 0
    bus.lost_for = NOBODY
    while True:
        place = _next(bus, now_ns)
        if place < 0:
            break
        can_id, source = bus.held_can_id[place], bus.held_source[place]
        length, word = bus.held_length[place], bus.held_word[place]
        sequence = bus.held_order[place] & SEQUENCE_MASK
        if sequence == 0:  # it was on the wire before, and what has struck it then is still to come
            c = bus.stations[source & STATION_MASK]
            bus.retransmissions += 1
            c.retransmissions += 1
            if c.owed:
                bus.again, bus.lost_for = c.again, c.lost_for
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
    elif stuck or bus.unsettled or bus.noise_ns <= now_ns:
        _begin_slow(bus, now_ns)
    else:
        _only_tell(bus, now_ns)


@kernel
def _only_tell(bus: Any, now_ns: int) -> None:
    """Nobody sends; a controller that has recovered is to be told all the same."""
    for k in range(bus.on_count):
        if bus.stations[bus.on[k]].changed:
            bus.busy = bus.closely = 1
            bus.passed = bus.tell = bus.slow = bus.slowly = bus.resume = 0
            bus.end_ns = now_ns
            return


@kernel
def _begin_slow(bus: Any, now_ns: int) -> None:
    begin_bits(bus, now_ns)
    bus.gave_up = 0
    bus.t_ns = now_ns
    bus.end_ns = run_bits(bus)
    bus.busy = bus.closely = bus.partial = bus.slowly = 1
    bus.resume = 0


@inlined
def _lose(bus: Any) -> None:
    """Let those not hear the frame for whom a scripted fault has dropped it."""
    if bus.lost_for == NOBODY:
        return
    for k in range(bus.on_count):
        if is_meant(bus.lost_for, bus.on[k]):
            bus.stations[bus.on[k]].hears = 0


@inlined
def _once_more(bus: Any) -> None:
    """Let the frame that has passed wait again, where a scripted fault duplicates it."""
    if bus.again:
        order = first_order(bus.can_id) | HELD_BACK
        hold(bus, order, bus.can_id, bus.length, bus.word, bus.source, bus.free_ns)
        bus.again = 0


@inlined
def _send(bus: Any, place: int, now_ns: int) -> None:
    """Put the frame at `place`, which has won the arbitration, on the wire."""
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
        own = bus.on[k] == row
        c.hears = 1 if c.state != CanState.BUS_OFF and (not own or c.loopback) else 0
        if c.state != CanState.BUS_OFF and ((not own and not c.listen_only) or (own and c.loopback)):
            acknowledged = True
    disturbed = bus.flips > 0 or bus.wrong_crc != 0 or bus.stuck_from_ns < end_ns or bus.noise_ns < end_ns
    if disturbed or bus.unsettled or not acknowledged or _contested(bus, order):
        add_sender(bus, order, bus.can_id, bus.length, bus.word, bus.source, bus.wrong_crc)
        _contend(bus, now_ns)
        _begin_slow(bus, now_ns)
        return
    _count_lost(bus, now_ns)
    _lose(bus)
    bus.t_ns = now_ns
    bus.end_ns = now_ns + (bits - INTER_FRAME_BITS) * NS // bus.bit_rate
    bus.free_ns = end_ns
    bus.recessive_ns = end_ns - RUN_BITS * NS // bus.bit_rate
    bus.busy = bus.closely = bus.partial = bus.passed = 1
    bus.slow = bus.slowly = bus.tell = bus.resume = 0
    bus.frames += 1
    bus.bits += bits


@inlined
def _contested(bus: Any, order: int) -> bool:
    """Tell whether the winner's bits matter to another station: its frame has the same arbitration field, or it sends once only."""
    for n in range(bus.ready):
        source = bus.held_source[bus.ready_place[n]]
        if source == bus.source:
            continue
        if bus.ready_key[n] >> SEQUENCE_BITS == order >> SEQUENCE_BITS or bus.stations[source & STATION_MASK].one_shot:
            return True
    return False


@kernel
def _contends(bus: Any, source: int, now_ns: int) -> bool:
    """Tell, once for each station with a frame ready, whether it takes part in the arbitration that begins now."""
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
def _count_lost(bus: Any, now_ns: int) -> None:
    """Count who loses the arbitration to the bus's frame, without a look at the bits."""
    bus.stations[bus.source & STATION_MASK].contends_ns = now_ns
    for n in range(bus.ready):
        source = bus.held_source[bus.ready_place[n]]
        if _contends(bus, source, now_ns):
            bus.stations[source & STATION_MASK].arbitration_lost += 1


@kernel
def _contend(bus: Any, now_ns: int) -> None:
    """Let the other stations with a frame ready send it too, each its first one: the bits decide."""
    bus.stations[bus.source & STATION_MASK].contends_ns = now_ns
    while bus.senders < MAX_SENDERS:
        place = winner(bus, now_ns)
        if place < 0:
            return
        order, source = bus.held_order[place], bus.held_source[place]
        if bus.stations[source & STATION_MASK].attached == 0:  # nobody has switched it on: it is there all the same
            attach(bus, source)
        if _contends(bus, source, now_ns):
            add_sender(bus, order, bus.held_can_id[place], bus.held_length[place], bus.held_word[place], source, 0)
        else:
            _wait_again(bus, place, order, now_ns + 1)


@kernel
def _write(log: Any, row: int, t_ns: int, can_id: int, word: int, source: int) -> None:
    frame = log[row]
    frame.t_ns = t_ns
    frame.can_id = can_id
    frame.length = 8
    frame.word = word
    frame.source = source


@inlined
def _number(row: int) -> int:
    """Return the number of the station in a row: the host's is -1."""
    return -1 if row == STATION_MASK else row


@kernel
def _tell_given_up(bus: Any, log: Any, row: int, last: int) -> int:
    """Write, for those that send once only, in which bit they lost the arbitration; return the next row."""
    bus.gave_up = 0
    for k in range(bus.senders):
        source = bus.tx_source[k]
        c = bus.stations[source & STATION_MASK]
        if bus.tx_state[k] != LOST or not c.one_shot:
            continue
        if row == last:
            bus.gave_up = 1
        else:
            can_id, word = lost_frame(c, source, bus.tx_lost_bit[k])
            _write(log, row, bus.end_ns, can_id, word, source)
            row += 1
            bus.tx_state[k] = GIVEN_UP
            c.dropped += 1
    return row


@inlined
def _tell_states(bus: Any, out: Any, log: Any, row: int, last: int) -> int:
    """Write the controllers' changes of state; return the next row."""
    for k in range(bus.on_count):
        station = bus.on[k]
        c = bus.stations[station]
        if c.changed == 0 or row >= last:
            continue
        can_id, word = state_frame(c, station)
        _write(log, row, bus.end_ns, can_id, word, _number(station))
        row += 1
        c.link = LINK_RECOVERED if c.recovered else _LINKS[c.state]
        bus.links = 1
        c.changed = c.recovered = 0
        if c.state == CanState.BUS_OFF:
            begin_bus_off(c, bus.end_ns, FAR_NS)
            withdraw(bus, out, _number(station))
    return row


@inlined
def _settle(bus: Any) -> None:
    """A frame has passed: rules g and h, and the pause of an error-passive sender."""
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
def _end_slow(bus: Any) -> None:
    """The wire is free again: what failed waits anew, unless its sender sends once only, or is off."""
    bus.free_ns = bus.end_ns
    bus.bits += bus.slow_bit
    if bus.noise_hits > 0:
        bus.noise_hits = 0
        for row in range(bus.fault_count):
            for _ in range(bus.faults[row].hits):
                fire(bus, row, bus.slow_ns, bus.can_id if bus.senders > 0 else NO_FRAME)
            bus.faults[row].hits = 0
    for k in range(bus.senders):
        c = bus.stations[bus.tx_source[k] & STATION_MASK]
        state = bus.tx_state[k]
        if state != FAILED and state != LOST:
            continue
        if c.attached == 0 or c.state == CanState.BUS_OFF or c.one_shot:
            c.dropped += 1
            continue
        can_id, order = bus.tx_can_id[k], bus.tx_order[k]
        if order == WITHDRAWN:
            continue
        if k == 0:  # the winner, which was struck: it is sent again; the others only have not come to it
            order = first_order(can_id)
            if bus.again or bus.lost_for != NOBODY:
                c.owed, c.again, c.lost_for = 1, bus.again, bus.lost_for
        ready_ns = max(bus.free_ns, c.suspend_ns)
        hold(bus, order, can_id, bus.tx_length[k], bus.tx_word[k], bus.tx_source[k], ready_ns)


@kernel
def _show_sent(bus: Any) -> None:
    """Let the frame that was received in slow motion be the bus's frame."""
    if bus.senders == 0:  # nobody sent: a disturbance that looks like a frame is none
        bus.passed = 0
        return
    k = 0
    for j in range(bus.senders):
        if bus.tx_state[j] == DONE:
            k = j
            break
        if bus.tx_state[j] == FAILED:  # in the last bit: its receivers have it
            k = j
    bus.can_id = bus.tx_can_id[k]
    bus.length = bus.tx_length[k]
    bus.word = bus.tx_word[k]
    bus.source = bus.tx_source[k]
    bus.frames += 1
    if k == 0:
        _lose(bus)
        _once_more(bus)


@kernel
def _tell_stuck(bus: Any) -> None:
    """Count the wire's being dominant from its begin on, also where that is in a frame and the bus does not become free for `alarm`."""
    for row in range(bus.fault_count):
        f = bus.faults[row]
        if f.kind == STUCK_DOMINANT and f.next_ns < min(bus.end_ns, f.until_ns):
            fire(bus, row, f.next_ns, NO_FRAME)
            f.next_ns = f.until_ns


@kernel
def end_attempt(bus: Any, out: Any, log: Any, row: int) -> int:
    """End a frame, or a stretch of slow motion, at `end_ns`; return how many rows of the log were written, the frame's last."""
    bus.busy = bus.delivered = 0
    if bus.resume:
        bus.resume = 0
        bus.busy = 1
        if bus.gave_up:  # there is more to tell of the last bit
            bus.passed = bus.tell = 0
            return 0
        if bus.stuck_until_ns <= bus.end_ns:
            plan_alarm(bus, bus.end_ns)
        bus.end_ns = run_bits(bus)
        return 0
    if bus.stuck_from_ns < bus.end_ns:
        _tell_stuck(bus)
    if bus.passed and not bus.slowly:
        _settle(bus)
    first = row
    last = min(row + MOST_ROWS, log.shape[0]) - 2
    if bus.slowly and bus.gave_up:
        row = _tell_given_up(bus, log, row, last)
    row = _tell_states(bus, out, log, row, last)
    if bus.tell:
        bus.errors += 1
        source = bus.error_source
        c = bus.stations[source]
        can_id, word = error_frame(c, source, bus.error_class, bus.error_type, bus.error_place)
        _write(log, row, bus.end_ns, can_id, word, _number(source))
        row += 1
    if bus.passed and bus.slowly:
        _show_sent(bus)
    if bus.passed:
        _write(log, row, bus.end_ns, bus.can_id, bus.word, bus.source)
        log[row].length = bus.length
        bus.partial_row = row
        bus.delivered = 1
        bus.fault_calls |= bus.fault_due
        bus.fault_due = 0
        row += 1
    if bus.slowly and (bus.slow or bus.gave_up):
        bus.busy = bus.resume = 1
        return row - first
    if bus.slowly:
        _end_slow(bus)
    if bus.slowly or row - first > 1:
        plan_alarm(bus, bus.end_ns)
    if bus.fault_count == 0 or bus.limited:
        refresh(bus)
    return row - first
