"""A cable cut into two halves, or several buses, each with its own time, pending frames and acknowledgement.

A bus is an array of two records `sim_bus.can_bus.records.BusRecord`. The first is the whole cable,
or the first half of the cut cable; the second is in use only while the cable is cut. `half` of a
station's controller is its half; the controller is in the record of that half.

Several buses (`SEVERAL`) are parts of a cable that never were one: a record for each, and a station
is on one of them. Only the host is on all. What it sends goes to the bus of the identifier, and to
each bus if it is for all nodes. Such buses have no faults.

A cut and its repair act between two frames: a frame on the wire ends first. Before the repair, the
half that is idle first starts no new frame until the other half is idle too, so no frame is torn.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from coulombus.kernels.decorator import inlined, kernel
from coulombus.kernels.records import RecordArray, Records
from coulombus.sim_bus.can_bus.faults import FaultKind, plan_alarm
from coulombus.sim_bus.can_bus.noise import next_noise, seeded
from coulombus.sim_bus.can_bus.records import MOST_TOLD, STATION_MASK, STATIONS, BusRecord, FaultRecord, Stage
from coulombus.sim_bus.can_bus.stations import number, refresh
from coulombus.sim_bus.can_bus.tx_queue import accept, first_ns, hold, withdraw
from coulombus.wire.clock import NEVER_NS
from coulombus.wire.frame import Queue

__all__ = [
    "APART",
    "MENDING",
    "SEVERAL",
    "WHOLE",
    "assign",
    "choose",
    "divide",
    "join",
    "merged_faults",
    "on_its_bus",
    "split",
    "wire_of",
]

WHOLE, APART, MENDING, SEVERAL = 0, 1, 2, 3
"""`BusRecord.cut` of the first record; `SEVERAL` in all of them."""
HOST = STATION_MASK
"""Row of the host."""


@kernel
def divide(bus: RecordArray[BusRecord], out: Queue) -> None:
    """Move the frames requested since the last call to the queue of their sender's half or bus.

    The common queue is empty then.
    """
    near = bus[0]
    for i in range(out.count):
        frame = out.frames[i]
        row = frame.source & STATION_MASK
        first = last = near.stations[row].half
        if near.cut == SEVERAL and row == HOST:
            first = last = near.host_bus[frame.can_id & 0x7FF]
            if first < 0:
                first, last = 0, bus.shape[0] - 1
        for half in range(first, last + 1):
            if not accept(bus[half], frame):
                out.dropped += 1
    out.count = out.waiting = 0
    for half in range(bus.shape[0]):
        out.waiting += bus[half].held


@kernel
def _next_ns(bus: BusRecord, out: Queue) -> int:
    """Return when a half's frame ends, or the next frame starts."""
    if bus.stage != Stage.FREE:
        return int(bus.end_ns)
    return int(max(min(first_ns(bus, out), bus.alarm_ns), bus.free_ns))


@kernel
def _soonest(bus: RecordArray[BusRecord], out: Queue) -> int:
    """Return the bus with the next event, as `choose` does."""
    soonest, soonest_ns, starts = 0, NEVER_NS, 1
    for k in range(bus.shape[0]):
        t_ns, free = _next_ns(bus[k], out), 1 if bus[k].stage == Stage.FREE else 0
        if t_ns < soonest_ns or (t_ns == soonest_ns and free < starts):
            soonest, soonest_ns, starts = k, t_ns, free
    return soonest


@inlined
def on_its_bus(bus: BusRecord, station: int) -> bool:
    """Tell whether the bus of the frame that has just ended is a station's bus, where there are several."""
    return bool(bus.cut != SEVERAL or bus.stations[station].half == bus.half)


@kernel
def choose(bus: RecordArray[BusRecord], out: Queue) -> int:
    """Return the half or the bus with the next event.

    At equal times an end goes before a start, then the first half.
    """
    near, far = bus[0], bus[1]
    if out.count > 0:
        divide(bus, out)
    if near.cut == SEVERAL:
        return _soonest(bus, out)
    near.fault_calls |= far.fault_calls
    far.fault_calls = 0
    if near.cut == MENDING:
        if far.stage != Stage.FREE:
            return 1
        near.fault_calls |= 1 << near.cut_row
        return 0
    t_near, t_far = _next_ns(near, out), _next_ns(far, out)
    ends_sooner = near.stage == Stage.FREE and far.stage != Stage.FREE
    return 1 if t_far < t_near or (t_far == t_near and ends_sooner) else 0


def assign(bus: RecordArray[BusRecord], host_bus: npt.ArrayLike, devices: Sequence[int]) -> None:
    """Put each device, by its row, on one of several buses; `host_bus` is that of the host's identifiers."""
    bus[0].host_bus[:] = host_bus
    bus["stations"]["half"][:, : len(devices)] = devices


def wire_of(bus: RecordArray[BusRecord], station: int) -> BusRecord:
    """Return the record of a station's half or bus."""
    return bus[int(bus[0].stations[station & STATION_MASK].half)]


def split(bus: RecordArray[BusRecord], out: Queue, row: int, t_ns: int) -> RecordArray[FaultRecord]:
    """Cut the idle cable as row `row` of the faults says, at `t_ns`.

    Return the previous faults, for `join`.
    """
    divide(bus, out)
    bus[1:2] = bus[0:1]
    near, far = bus[0], bus[1]
    before: RecordArray[FaultRecord] = near.faults.copy()
    halves = near.faults[row].far.astype(np.int64)
    switched_on = [int(station) for station in near.on[: near.on_count]]
    waits = [station for station in range(STATIONS) if near.waiting_of[station]]
    for half, wire in enumerate((near, far)):
        wire.half = half
        wire.stations["half"] = halves
        stay = [station for station in switched_on if halves[station] == half]
        wire.on_count = len(stay)
        wire.on[: len(stay)] = stay
        for station in range(STATIONS):
            if halves[station] != half:
                wire.stations[station].attached = wire.stations[station].hears = 0
                if station in waits:
                    withdraw(wire, out, number(station))
    for name in ("frames", "bits", "errors", "retransmissions", "told", "fault_due", "fault_calls"):
        far[name] = 0
    far.noise.hits = 0
    far.partial_row = -1
    far.noise.state = seeded(int(near.noise.state))
    next_noise(far, t_ns)
    for fault in far.faults:
        if fault.kind == FaultKind.CUT:
            fault.next_ns = NEVER_NS
    fault = near.faults[row]
    near.cut, near.cut_row = APART, row
    near.mend_ns = fault.next_ns = min(t_ns + int(fault.lasts_ns), NEVER_NS)
    for wire in (near, far):
        plan_alarm(wire, t_ns)
        refresh(wire)
    return before


def merged_faults(bus: RecordArray[BusRecord], before: RecordArray[FaultRecord]) -> Records:
    """Return the faults with the counts of both halves since `before`."""
    near, far = bus[0], bus[1]
    out: Records = near.faults.copy()
    for n in range(int(near.fault_count)):
        row, other, base = out[n], far.faults[n], before[n]
        if row.kind == FaultKind.BABBLE and near.stations[int(row.station) & STATION_MASK].half:
            out[n] = other
            continue
        firsts = [int(fault.first_ns) for fault in (row, other) if fault.fired]
        row.first_ns = min(firsts, default=0)
        row.last_ns = max(int(row.last_ns), int(other.last_ns))
        row.fired += other.fired - base.fired
        row.seen += other.seen - base.seen
    return out


def join(bus: RecordArray[BusRecord], out: Queue, before: RecordArray[FaultRecord], t_ns: int) -> None:
    """Repair the cable at `t_ns`; both halves are idle."""
    near, far = bus[0], bus[1]
    near.faults[:] = merged_faults(bus, before)
    for station in range(STATIONS):
        if near.stations[station].half:
            near.stations[station] = far.stations[station]
    for station in far.on[: far.on_count]:
        near.on[int(near.on_count)] = station
        near.on_count += 1
    near.stations["half"] = 0
    near.sequence = max(int(near.sequence), int(far.sequence))
    ready = [(0, int(place)) for place in far.ready_place[: far.ready]]
    later = [(int(t), int(place)) for t, place in zip(far.later_key, far.later_place[: far.later], strict=False)]
    for ready_ns, place in ready + later:
        order, can_id = far.held_order[place], far.held_can_id[place]
        length, word, source = far.held_length[place], far.held_word[place], far.held_source[place]
        if not hold(near, order, can_id, length, word, source, ready_ns):
            out["dropped"] += 1
    for name in ("frames", "bits", "errors", "retransmissions"):
        near[name] += far[name]
    for k in range(min(int(far.told), MOST_TOLD - int(near.told))):
        for name in ("told_ns", "told_row", "told_id"):
            near[name][near.told] = far[name][k]
        near.told += 1
    far.told = far.on_count = far.held = 0
    for name in ("free_ns", "recessive_ns"):
        near[name] = max(int(near[name]), int(far[name]))
    near.play.unsettled |= far.play.unsettled
    near.cut = WHOLE
    plan_alarm(near, t_ns)
    refresh(near)
