"""Arbitration: one frame at a time, the lowest identifier first, for exactly the duration of its bits.

`BusRecord` is the state of the bus. A pending frame (`sim_bus.can_bus.tx_queue`) starts when it is
ready and the bus is free; of all frames ready at that instant the lowest arbitration field wins
(ISO 11898-1, 10.4.2.5: base before extended, data before remote, first come first served among
equals). Receivers have the frame at its end of frame, `end_ns`; the bus is free again three bits of
inter-frame space later, at `free_ns`. If errors are possible, `start_frame` reports it, and
`sim_bus.can_bus.error_path` handles the frame in detail.
"""

from __future__ import annotations

from coulombus.kernels.decorator import inlined
from coulombus.kernels.records import RecordArray, Records, new_records
from coulombus.sim_bus.can_bus.cable_cut import SEVERAL
from coulombus.sim_bus.can_bus.records import INTER_FRAME_BITS, NS, STATION_MASK, BusRecord, Delivered, Stage
from coulombus.sim_bus.can_bus.tx_queue import first_ns, first_order, hold, win
from coulombus.wire.bits import data_frame_bits
from coulombus.wire.clock import NEVER_NS
from coulombus.wire.frame import Queue

__all__ = ["INTER_FRAME_BITS", "end_frame", "new_bus", "receives", "start_frame", "start_ns"]


def new_bus(*bitrates_bit_s: int) -> RecordArray[BusRecord]:
    """Return an idle bus: its record, and the record of the second half for a cut cable; for several
    rates, the records of several buses (`sim_bus.can_bus.cable_cut`).
    """
    bus = new_records(BusRecord, max(2, len(bitrates_bit_s)))
    bus["bit_rate"] = bitrates_bit_s
    if len(bitrates_bit_s) > 1:
        bus["half"], bus["cut"] = range(len(bitrates_bit_s)), SEVERAL
    bus["alarm_ns"] = bus["stuck"]["from_ns"] = bus["stuck"]["until_ns"] = NEVER_NS
    bus["noise"]["next_ns"], bus["partial_row"] = NEVER_NS, -1
    bus["stations"]["restart_at_ns"] = NEVER_NS
    return bus


@inlined
def start_ns(bus: BusRecord, out: Queue) -> int:
    """Return when the next pending frame can start, or when a scripted fault needs the bus; `NEVER_NS` if
    neither is pending.
    """
    return max(min(first_ns(bus, out), bus.alarm_ns), bus.free_ns)


@inlined
def start_frame(bus: BusRecord, out: Queue, now_ns: int) -> bool:
    """Arbitrate among the frames that are ready at `now_ns`, and start the winner.

    False: nothing was started, because the bus needs the detailed path
    (`sim_bus.can_bus.error_path.attempt`): faults, counted errors, a station that is alone
    (`alert`), or two stations with the same arbitration field.
    """
    if bus.alert:
        return False
    if win(bus, out, now_ns) and bus.on_count > 0 and bus.bit_rate > 0:
        hold(bus, first_order(bus.can_id) | 1, bus.can_id, bus.length, bus.word, bus.source, now_ns)
        return False
    bits = data_frame_bits(bus.can_id, bus.length, bus.word)
    bus.t_ns = now_ns
    bus.end_ns = bus.free_ns = now_ns
    if bus.bit_rate > 0:
        bus.end_ns = now_ns + (bits - INTER_FRAME_BITS) * NS // bus.bit_rate
        bus.free_ns = now_ns + bits * NS // bus.bit_rate
    bus.stage = Stage.FRAME
    bus.frames += 1
    bus.bits += bits
    return True


@inlined
def end_frame(bus: BusRecord, log: Records, row: int) -> None:
    """End a frame that did not need the detailed path, and write it to `log[row]`, stamped with its end of
    frame.
    """
    bus.stage = Stage.FREE
    bus.delivered = Delivered.OTHERS
    frame = log[row]
    frame.t_ns = bus.end_ns
    frame.can_id = bus.can_id
    frame.length = bus.length
    frame.word = bus.word
    frame.source = bus.source


@inlined
def receives(bus: BusRecord, station: int) -> bool:
    """Tell whether a station receives the frame that has just ended."""
    if bus.delivered == Delivered.OTHERS:
        return bus.source != station
    return bus.stations[station & STATION_MASK].hears != 0
