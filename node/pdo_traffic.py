"""Compiled PDOs of a node (CiA 301, section 7.2.2): reception, action on SYNC or at once, transmission.

Transmission types of a TPDO: 0 on the SYNC after a change; 1-240 every nth SYNC, from the SYNC
start value on; 252 sampled on SYNC, sent on RTR; 253 sent on RTR; 254 and 255 on an event: the
event timer, or a change of the bits in `tpdo_mask`, not before the inhibit time is over. RPDOs:
0-240 act on the next SYNC, 254 and 255 at once.

In the kernels: `n` the node's record (`node.record`), `p` one of its
PDOs, `k` a number from 0, `out` the queue of frames to send.
"""

from __future__ import annotations

from coulombus.eds.codec import PdoRecord, pack, unpack
from coulombus.kernels.decorator import kernel
from coulombus.node import deadlines, emcy
from coulombus.node.reactions import actuate, alarm, apply, sample
from coulombus.node.record import NodeRecord
from coulombus.wire.frame import Queue, push

__all__ = [
    "act_pending",
    "acts_at_once",
    "answer_rtr",
    "forget_pending",
    "receive",
    "start",
    "transmit_events",
    "transmit_sync",
]

_SYNC_MAX, _SYNC_RTR, _RTR, _EVENT = 240, 252, 253, 254


@kernel
def start(n: NodeRecord, t_ns: int) -> None:
    """Enter OPERATIONAL: nothing received, nothing sent; every event-driven TPDO is due once."""
    forget_pending(n)
    for k in range(n.rpdo_used):
        n.rpdo_armed[k] = 0
        n.rpdo_lost[k] = 0
    for k in range(n.tpdo_used):
        p = n.tpdo[k]
        n.tpdo_count[k] = -1 if p.sync_start > 0 and n.sync_overflow > 0 else 0
        n.tpdo_ns[k] = t_ns - p.inhibit_ns
        n.tpdo_due[k] = 1


@kernel
def forget_pending(n: NodeRecord) -> None:
    """Discard the RPDOs that wait for a SYNC."""
    n.rpdo_pending = 0
    for k in range(n.rpdo_used):
        n.rpdo_waits[k] = 0


@kernel
def acts_at_once(n: NodeRecord, k: int) -> bool:
    """Whether RPDO `k`, or another of its COB-ID, acts without a SYNC."""
    while k >= 0:
        if n.rpdo[k].transmission > _SYNC_MAX:
            return True
        k = n.rpdo_next[k]
    return False


@kernel
def receive(n: NodeRecord, k: int, t_ns: int, length: int, word: int, out: Queue) -> int:
    """Process the frame of RPDO `k`; return 1 if it acted at once."""
    p = n.rpdo[k]
    if length < p.length:
        n.dropped_length += 1
        alarm(n, t_ns, emcy.RPDO_SHORT, k + 1, out)
        return 0
    if length > p.length:
        n.excess_length += 1
        alarm(n, t_ns, emcy.RPDO_LONG, k + 1, out)
    elif n.causes & (1 << emcy.RPDO_SHORT | 1 << emcy.RPDO_LONG):
        emcy.gone(n, t_ns, emcy.RPDO_SHORT, out)
        emcy.gone(n, t_ns, emcy.RPDO_LONG, out)
    n.rpdo_ns[k] = t_ns
    if n.rpdo_armed[k] == 0:
        n.rpdo_armed[k] = 1
        if p.event_ns > 0:
            n.next_ns = min(n.next_ns, t_ns + p.event_ns)
    if n.rpdo_lost[k]:
        n.rpdo_lost[k] = 0
        deadlines.settle(n, t_ns, out)
    if p.transmission <= _SYNC_MAX:
        if n.sync_window_ns > 0 and t_ns - n.sync_ns > n.sync_window_ns:
            n.dropped_window += 1  # after the window it acts on no SYNC, but proves that its sender is alive
            return 0
        n.rpdo_word[k] = word
        n.rpdo_pending += 1 - n.rpdo_waits[k]
        n.rpdo_waits[k] = 1
        return 0
    unpack(p, word, n.values)
    _act(n, t_ns, k, out)
    actuate(n, t_ns)
    return 1


@kernel
def _act(n: NodeRecord, t_ns: int, k: int, out: Queue) -> None:
    carries = n.rpdo_carries[k]
    if carries == 0:
        return
    apply(n, t_ns, n.rpdo_ns[k], carries, out)


@kernel
def act_pending(n: NodeRecord, t_ns: int, out: Queue) -> None:
    """Let the RPDOs that waited for this SYNC act, in order."""
    for k in range(n.rpdo_used):
        if n.rpdo_waits[k]:
            n.rpdo_waits[k] = 0
            unpack(n.rpdo[k], n.rpdo_word[k], n.values)
            _act(n, t_ns, k, out)
    n.rpdo_pending = 0


@kernel
def _send(n: NodeRecord, p: PdoRecord, k: int, t_ns: int, word: int, out: Queue) -> None:
    n.tpdo_word[k] = word
    n.tpdo_ns[k] = t_ns
    n.tpdo_due[k] = 0
    push(out, n.station, t_ns + n.processing_ns, p.cob_id, p.length, word)


@kernel
def transmit_sync(n: NodeRecord, t_ns: int, counter: int, out: Queue) -> None:
    """Send the synchronous TPDOs; `counter` is the SYNC's, or -1."""
    if n.sync_window_ns > 0 and n.processing_ns > n.sync_window_ns:
        return  # they would be sent after the window
    for k in range(n.tpdo_used):
        p = n.tpdo[k]
        kind = p.transmission
        if p.cob_id < 0 or kind > _SYNC_RTR:
            continue
        if kind == 0:
            word = pack(p, n.values)
            if n.tpdo_due[k] or word != n.tpdo_word[k]:
                _send(n, p, k, t_ns, word, out)
        elif kind == _SYNC_RTR:
            n.tpdo_word[k] = pack(p, n.values)
            n.tpdo_due[k] = 0
        else:
            count = n.tpdo_count[k]
            if count < 0:
                if counter != p.sync_start:
                    continue
                count = kind - 1  # the SYNC with the start value is the first to count
            count += 1
            if count >= kind:
                count = 0
                _send(n, p, k, t_ns, pack(p, n.values), out)
            n.tpdo_count[k] = count


@kernel
def transmit_events(n: NodeRecord, t_ns: int, next_ns: int, out: Queue) -> int:
    """Send the event-driven TPDOs that are due; return the earlier of `next_ns` and their next deadline."""
    sample(n)
    for k in range(n.tpdo_used):
        p = n.tpdo[k]
        if p.cob_id < 0 or p.transmission < _EVENT:
            continue
        word = pack(p, n.values)
        if (word ^ n.tpdo_word[k]) & n.tpdo_mask[k] or (p.event_ns > 0 and t_ns - n.tpdo_ns[k] >= p.event_ns):
            n.tpdo_due[k] = 1
        if n.tpdo_due[k]:
            if t_ns - n.tpdo_ns[k] >= p.inhibit_ns:
                _send(n, p, k, t_ns, word, out)
            else:
                next_ns = min(next_ns, n.tpdo_ns[k] + p.inhibit_ns)
        if p.event_ns > 0:
            next_ns = min(next_ns, n.tpdo_ns[k] + max(p.event_ns, p.inhibit_ns))
    return next_ns


@kernel
def answer_rtr(n: NodeRecord, k: int, t_ns: int, out: Queue) -> None:
    """Answer a remote frame for TPDO `k` if its COB-ID allows it; a synchronous TPDO repeats its last sample."""
    p = n.tpdo[k]
    if p.rtr_allowed == 0:
        return
    word = n.tpdo_word[k]
    if p.transmission >= _RTR or n.tpdo_due[k]:
        sample(n)
        word = pack(p, n.values)
    push(out, n.station, t_ns + n.processing_ns, p.cob_id, p.length, word)
