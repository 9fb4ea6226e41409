"""Pending frames in two heaps: the next winner in O(log n).

Stations request with `wire.frame.push`, which only appends to the queue. A few pending frames stay
there, and each arbitration examines all of them. If there are more, as when 126 nodes answer one
SYNC, the bus moves them into two binary heaps of places: `later` by the time at which a frame is
ready, and `ready` by its arbitration field and then by the order of the requests. So a frame costs
O(log n).

The fields of the heaps are part of the bus's record (`sim_bus.can_bus.records.BusRecord`).
"""

from __future__ import annotations

from coulombus.kernels.decorator import inlined, kernel
from coulombus.kernels.records import Integers
from coulombus.sim_bus.can_bus.fault_confinement import CanState
from coulombus.sim_bus.can_bus.records import ROOM, STATION_MASK, BusRecord
from coulombus.wire.clock import NEVER_NS
from coulombus.wire.frame import Frame, Queue, arbitration_key

__all__ = [
    "HELD_BACK",
    "WITHDRAWN",
    "accept",
    "first_ns",
    "first_order",
    "hold",
    "rival",
    "take_in",
    "win",
    "winner",
    "withdraw",
]

FEW = 4
"""Up to this number of frames, a linear search is faster."""
SEQUENCE_BITS = 31
SEQUENCE_MASK = (1 << SEQUENCE_BITS) - 1
HELD_BACK = 2
"""Sequence of a frame that a scripted fault has struck already: it is delayed, or sent once more."""
WITHDRAWN = -1
"""`order` of a frame on the wire that is not sent again."""
FIRST_SEQUENCE = 3  # 0: a frame that was on the wire before; 1: a frame that was about to be


@inlined
def _insert(keys: Integers, places: Integers, n: int, key: int, place: int) -> None:
    """Insert `place` into the heap of `n`."""
    at = n
    while at > 0:
        up = (at - 1) >> 1
        if keys[up] <= key:
            break
        keys[at], places[at] = keys[up], places[up]
        at = up
    keys[at], places[at] = key, place


@inlined
def _remove_first(keys: Integers, places: Integers, n: int) -> None:
    """Remove the first element from the heap, in which `n` remain."""
    key, place = keys[n], places[n]
    at = 0
    while 2 * at + 1 < n:
        down = 2 * at + 1
        if down + 1 < n and keys[down + 1] < keys[down]:
            down += 1
        if keys[down] >= key:
            break
        keys[at], places[at] = keys[down], places[down]
        at = down
    keys[at], places[at] = key, place


@inlined
def first_order(can_id: int) -> int:
    """Return the lowest `order` of a frame: before all others of its arbitration field."""
    return arbitration_key(can_id) << SEQUENCE_BITS


@kernel
def hold(bus: BusRecord, order: int, can_id: int, length: int, word: int, source: int, ready_ns: int) -> bool:
    """Insert a frame that is ready from `ready_ns` on; `order` is its key among the ready frames. False: no
    room is left.
    """
    if bus.held >= ROOM:
        return False
    if bus.freed > 0:
        bus.freed -= 1
        place = bus.free_place[bus.freed]
    else:
        place = bus.fresh
        bus.fresh += 1
    bus.held_order[place] = order
    bus.held_can_id[place] = can_id
    bus.held_length[place] = length
    bus.held_word[place] = word
    bus.held_source[place] = source
    bus.held += 1
    bus.waiting_of[source & STATION_MASK] += 1
    _insert(bus.later_key, bus.later_place, bus.later, ready_ns, place)
    bus.later += 1
    return True


@inlined
def accept(bus: BusRecord, frame: Frame) -> bool:
    """Insert a requested frame, unless its station's queue is full; False: no room is left."""
    if bus.held == 0:
        bus.sequence = FIRST_SEQUENCE
    if bus.limited:  # a finite transmit queue, or a station in bus-off, accepts no more
        c = bus.stations[frame.source & STATION_MASK]
        if 0 < c.queue_limit <= bus.waiting_of[frame.source & STATION_MASK] or c.state == CanState.BUS_OFF:
            c.dropped += 1
            return True
    order = first_order(frame.can_id) | bus.sequence
    if not hold(bus, order, frame.can_id, frame.length, frame.word, frame.source, frame.t_ns):
        return False
    bus.sequence += 1
    return True


@kernel
def take_in(bus: BusRecord, out: Queue) -> None:
    """Move the frames requested since the last call into the heaps; the queue is empty then."""
    for i in range(out.count):
        if not accept(bus, out.frames[i]):
            out.dropped += 1
    out.count = 0
    out.waiting = bus.held


@inlined
def first_ns(bus: BusRecord, out: Queue) -> int:
    """Return the time from which a pending frame is ready: any time up to `free_ns` if one is ready by then,
    `NEVER_NS` if none is pending.
    """
    t = NEVER_NS
    count = out.count
    if bus.held == 0 and count <= FEW and bus.alert == 0:
        for i in range(count):
            t = min(t, out.frames[i].t_ns)
            if t <= bus.free_ns:  # also prevents a slow vectorisation of the values just written
                break
    else:
        if count > 0:
            take_in(bus, out)
        if bus.ready > 0:
            t = 0
        elif bus.later > 0:
            t = bus.later_key[0]
    return t


@inlined
def win(bus: BusRecord, out: Queue, now_ns: int) -> bool:
    """Make the winner of the arbitration among the frames ready at `now_ns` (there must be one) the bus's
    frame.

    Return whether another station's frame with the same arbitration field is ready too.
    """
    count = out.count
    tie = False
    if bus.held == 0 and count <= FEW:
        best, best_key = 0, NEVER_NS
        for i in range(count):
            if out.frames[i].t_ns <= now_ns:
                key = arbitration_key(out.frames[i].can_id)
                if key < best_key:
                    best, best_key = i, key
                    tie = False
                elif key == best_key and out.frames[i].source != out.frames[best].source:
                    tie = True
        frame = out.frames[best]
        bus.can_id = frame.can_id
        bus.length = frame.length
        bus.word = frame.word
        bus.source = frame.source
        for i in range(best, count - 1):  # keep the order: first come first served among equals
            into, later = out.frames[i], out.frames[i + 1]
            into.t_ns = later.t_ns
            into.can_id = later.can_id
            into.length = later.length
            into.word = later.word
            into.source = later.source
        out.count = count - 1
    else:
        if count > 0:
            take_in(bus, out)
        place = winner(bus, now_ns)
        out.waiting = bus.held
        tie = rival(bus, bus.held_order[place])
        bus.can_id = bus.held_can_id[place]
        bus.length = bus.held_length[place]
        bus.word = bus.held_word[place]
        bus.source = bus.held_source[place]
    return tie


@kernel
def winner(bus: BusRecord, now_ns: int) -> int:
    """Remove the winner among the heap frames ready at `now_ns`, and return its place; -1 if none is ready.

    The frame stays at its place, in the fields `held_...`, until another frame is inserted.
    """
    while bus.later > 0 and bus.later_key[0] <= now_ns:
        waits = bus.later_place[0]
        bus.later -= 1
        _remove_first(bus.later_key, bus.later_place, bus.later)
        _insert(bus.ready_key, bus.ready_place, bus.ready, bus.held_order[waits], waits)
        bus.ready += 1
    place = -1
    if bus.ready > 0:
        place = bus.ready_place[0]
        bus.ready -= 1
        _remove_first(bus.ready_key, bus.ready_place, bus.ready)
        _leave(bus, place)
    return place


@inlined
def rival(bus: BusRecord, order: int) -> bool:
    """Tell whether the heap has a ready frame with the winner's arbitration field."""
    return bool(bus.ready > 0 and bus.ready_key[0] >> SEQUENCE_BITS == order >> SEQUENCE_BITS)


@inlined
def _leave(bus: BusRecord, place: int) -> None:
    bus.free_place[bus.freed] = place
    bus.freed += 1
    bus.held -= 1
    bus.waiting_of[bus.held_source[place] & STATION_MASK] -= 1


@kernel
def withdraw(bus: BusRecord, out: Queue, source: int) -> None:
    """Remove the pending frames of a station that was switched off; its frame on the wire is not sent again
    if it fails.
    """
    take_in(bus, out)
    for k in range(bus.senders):
        if bus.tx[k].source == source:
            bus.tx[k].order = WITHDRAWN
    n, bus.later = bus.later, 0
    for i in range(n):
        key, place = bus.later_key[i], bus.later_place[i]
        if bus.held_source[place] == source:
            _leave(bus, place)
        else:  # the write position stays behind the read position
            _insert(bus.later_key, bus.later_place, bus.later, key, place)
            bus.later += 1
    n, bus.ready = bus.ready, 0
    for i in range(n):
        key, place = bus.ready_key[i], bus.ready_place[i]
        if bus.held_source[place] == source:
            _leave(bus, place)
        else:
            _insert(bus.ready_key, bus.ready_place, bus.ready, key, place)
            bus.ready += 1
