"""Compiled node guarding (CiA 301, section 7.2.8.3.2.1): answer to the master's remote frame, and life time.

The answer carries the NMT state and a toggle bit, 0 in the first answer after a boot-up. If guard
time (100Ch) times life time factor (100Dh) passes without a remote frame, the master is lost: a
life guarding event. The check begins with the first remote frame. A node with a heartbeat (1017h)
is not guarded: only one of the two is active, and the heartbeat has priority.

In the kernels: `n` the node's record (`node.record`), `out` the queue of frames to send.
"""

from __future__ import annotations

from coulombus.eds.cia301 import CobId
from coulombus.eds.nmt import ALLOWED, Service
from coulombus.kernels.decorator import kernel
from coulombus.node import emcy
from coulombus.node.record import NodeRecord
from coulombus.wire.frame import Queue, push

__all__ = ["LOST", "answer", "late", "next_deadline", "restart"]

_WAITING, _ALIVE, LOST = 0, 1, 2


@kernel
def restart(n: NodeRecord) -> None:
    """Restart the check, which waits for a remote frame (boot-up, a changed 100Ch, 100Dh or 1017h)."""
    n.guard_toggle = 0
    n.guard_state = _WAITING


@kernel
def answer(n: NodeRecord, t_ns: int, out: Queue) -> None:
    """Answer a remote frame on 700h + node id."""
    if n.guard_on == 0 or not ALLOWED[n.nmt] & Service.ERROR_CONTROL:
        return
    push(out, n.station, t_ns + n.processing_ns, CobId.HEARTBEAT + n.node_id, 1, n.guard_toggle << 7 | n.nmt)
    n.guard_toggle ^= 1
    if n.guard_life_ns > 0:
        n.guard_last_ns = t_ns
        if n.guard_state != _ALIVE:
            n.next_ns = min(n.next_ns, t_ns + n.guard_life_ns)
        if n.guard_state == LOST:
            emcy.gone(n, t_ns, emcy.LIFE_GUARDING, out)
        n.guard_state = _ALIVE


@kernel
def late(n: NodeRecord, t_ns: int) -> bool:
    """Tell whether the life time is over now."""
    return bool(n.guard_state == _ALIVE and n.guard_life_ns > 0 and t_ns - n.guard_last_ns >= n.guard_life_ns)


@kernel
def next_deadline(n: NodeRecord, next_ns: int) -> int:
    """Return the earlier of `next_ns` and the end of the life time."""
    if n.guard_state == _ALIVE and n.guard_life_ns > 0:
        next_ns = min(next_ns, n.guard_last_ns + n.guard_life_ns)
    return next_ns
