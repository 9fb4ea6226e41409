"""Compiled deadlines of a node: heartbeats both ways, RPDO deadline, SYNC time-out, stalled SDO transfer.

Each check begins with the first reception (heartbeat, RPDO, SYNC) and is lazy: `expire` detects
what is late at `t_ns`, `next_deadline` returns the time of the next check.

In the kernels: `n` the node's record (`node.record`), `p` one of its
PDOs, `k` a number from 0, `out` the queue of frames to send.
"""

from __future__ import annotations

from coulombus.eds.cia301 import CobId
from coulombus.eds.nmt import ALLOWED, Service
from coulombus.kernels.decorator import kernel
from coulombus.node import emcy, guarding, slots
from coulombus.node.reactions import alarm
from coulombus.node.record import NodeRecord
from coulombus.wire.clock import NEVER_NS
from coulombus.wire.frame import Queue, push

__all__ = ["expire", "heartbeat_received", "next_deadline", "settle", "stop"]

_WAITING, _ALIVE, _LOST = 0, 1, 2


@kernel
def heartbeat_received(n: NodeRecord, k: int, t_ns: int, length: int, word: int, out: Queue) -> None:
    """Process a heartbeat of consumer entry `k`; a boot-up does not count, because the producer has just
    lost its connections.
    """
    if length < 1:
        n.dropped_length += 1
        return
    if word & 0x7F == 0:
        return
    n.consumer_last_ns[k] = t_ns
    before = n.consumer_state[k]
    if before == _ALIVE:
        return
    n.consumer_state[k] = _ALIVE
    n.next_ns = min(n.next_ns, t_ns + n.consumer_ns[k])
    if before == _LOST:
        settle(n, t_ns, out)


@kernel
def settle(n: NodeRecord, t_ns: int, out: Queue) -> None:
    """Release the losses that are over: nothing lost any more, or no longer checked."""
    heartbeats, rpdos = 0, 0
    for k in range(n.consumers_used):
        heartbeats += n.consumer_state[k] == _LOST
    for k in range(n.rpdo_used):
        rpdos += n.rpdo_lost[k]
    if heartbeats == 0 and n.causes >> emcy.HEARTBEAT & 1:
        emcy.gone(n, t_ns, emcy.HEARTBEAT, out)
    if n.guard_state != guarding.LOST and n.causes >> emcy.LIFE_GUARDING & 1:
        emcy.gone(n, t_ns, emcy.LIFE_GUARDING, out)
    if rpdos == 0 and n.causes >> emcy.RPDO_DEADLINE & 1:
        emcy.gone(n, t_ns, emcy.RPDO_DEADLINE, out)
    if n.sync_armed == 0 and n.causes >> emcy.SYNC_LOST & 1:
        emcy.gone(n, t_ns, emcy.SYNC_LOST, out)


@kernel
def stop(n: NodeRecord, t_ns: int, out: Queue) -> None:
    """Stop the checks of SYNC and RPDOs after NMT left OPERATIONAL: they are not expected any more, so
    their loss is over.
    """
    n.sync_armed = 0
    for k in range(n.rpdo_used):
        n.rpdo_armed[k] = 0
        n.rpdo_lost[k] = 0
    settle(n, t_ns, out)


@kernel
def expire(n: NodeRecord, t_ns: int, out: Queue) -> int:
    """Detect what is late at `t_ns`; return 1 if a heartbeat or the guarding was lost now (1029h determines
    the NMT state).
    """
    lost_now = 0
    if n.heartbeat_ns > 0 and t_ns >= n.heartbeat_next_ns:
        push(out, n.station, t_ns, CobId.HEARTBEAT + n.node_id, 1, n.nmt)
        following_ns = n.heartbeat_next_ns + n.heartbeat_ns
        n.heartbeat_next_ns = (
            following_ns if following_ns > t_ns else t_ns + n.heartbeat_ns
        )  # called too late: no burst
    if n.emcy_waiting > 0:
        emcy.drain(n, t_ns, out)
    for k in range(n.consumers_used):
        if n.consumer_state[k] == _ALIVE and t_ns - n.consumer_last_ns[k] >= n.consumer_ns[k]:
            n.consumer_state[k] = _LOST
            n.latched &= ~(1 << emcy.HEARTBEAT)  # each lost producer gets its own EMCY
            alarm(n, t_ns, emcy.HEARTBEAT, n.consumer_id[k], out)
            lost_now = 1
    if guarding.late(n, t_ns):
        n.guard_state = guarding.LOST
        alarm(n, t_ns, emcy.LIFE_GUARDING, emcy.NO_INFO, out)
        lost_now = 1
    if ALLOWED[n.nmt] & Service.PDO:
        for k in range(n.rpdo_used):
            p = n.rpdo[k]
            late = p.cob_id >= 0 and p.event_ns > 0 and t_ns - n.rpdo_ns[k] >= p.event_ns
            if late and n.rpdo_armed[k] and n.rpdo_lost[k] == 0:
                n.rpdo_lost[k] = 1
                alarm(n, t_ns, emcy.RPDO_DEADLINE, k + 1, out)
        timeout_ns = n.values[slots.SYNC_TIMEOUT_US] * 1000
        if n.sync_armed and timeout_ns > 0 and t_ns - n.sync_ns >= timeout_ns and not n.causes >> emcy.SYNC_LOST & 1:
            alarm(n, t_ns, emcy.SYNC_LOST, emcy.NO_INFO, out)
    for k in range(n.sdo_used):
        if t_ns >= n.sdo_deadline_ns[k]:
            if ALLOWED[n.nmt] & Service.SDO:
                push(out, n.station, t_ns + n.processing_ns, n.sdo_abort_id[k], 8, n.sdo_abort_word[k])
            n.sdo_deadline_ns[k] = NEVER_NS
    return lost_now


@kernel
def next_deadline(n: NodeRecord, next_ns: int) -> int:
    """Return the earlier of `next_ns` and the next of these deadlines."""
    for k in range(n.sdo_used):
        next_ns = min(next_ns, n.sdo_deadline_ns[k])
    next_ns = guarding.next_deadline(n, next_ns)
    if n.emcy_waiting > 0:
        next_ns = min(next_ns, n.emcy_ready_ns)
    if n.heartbeat_ns > 0:
        next_ns = min(next_ns, n.heartbeat_next_ns)
    for k in range(n.consumers_used):
        if n.consumer_state[k] == _ALIVE:
            next_ns = min(next_ns, n.consumer_last_ns[k] + n.consumer_ns[k])
    if ALLOWED[n.nmt] & Service.PDO:
        for k in range(n.rpdo_used):
            p = n.rpdo[k]
            if p.cob_id >= 0 and p.event_ns > 0 and n.rpdo_armed[k] and n.rpdo_lost[k] == 0:
                next_ns = min(next_ns, n.rpdo_ns[k] + p.event_ns)
        timeout_ns = n.values[slots.SYNC_TIMEOUT_US] * 1000
        if n.sync_armed and timeout_ns > 0 and not n.causes >> emcy.SYNC_LOST & 1:
            next_ns = min(next_ns, n.sync_ns + timeout_ns)
    return next_ns
