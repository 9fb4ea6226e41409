"""Compiled half of a CANopen device: its reactions to a frame and to a time.

`on_frame` and `on_time` are functions of their arguments: the node's record, the time, a frame.
They push the node's answers to the queue and keep its next deadline in `next_ns`. Deadlines are
lazy: a reception only stores its time; `on_time`, called at `next_ns`, detects what is late and
computes the next deadline. A frame at the same time as a deadline is handled first, so it is in
time.

Python (`node.device`) serves SDO, LSS and resets, for which `on_frame` returns 1, and edits the same
record.

In the kernels: `n` the node's record (`node.record`), `k` a number
from 0, `out` the queue of frames to send.
"""

from __future__ import annotations

from coulombus.eds.cia301 import NmtCommand, NmtState
from coulombus.eds.cia305 import REQUESTS, UNCONFIGURED
from coulombus.eds.nmt import AFTER_COMMAND, AFTER_ERROR, ALLOWED, Service
from coulombus.kernels.decorator import inlined, kernel
from coulombus.node import deadlines, emcy, guarding, pdo_traffic
from coulombus.node.kinds import NO_KIND
from coulombus.node.profile import BY_COMMAND, BY_ITSELF, BY_RESET
from coulombus.node.reactions import (
    actuate,
    alarm,
    apply,
    connection_lost,
    inputs,
    measure,
    next_deadline,
    react,
    sample,
)
from coulombus.node.record import NodeRecord
from coulombus.node.sdo_kernels import answer_upload, collect_segment, send_segments
from coulombus.wire.clock import NEVER_NS
from coulombus.wire.controller_state import Confinement
from coulombus.wire.frame import CAN_RTR_FLAG, Queue, push

__all__ = [
    "ROUTE_CONSUMER",
    "ROUTE_GUARD",
    "ROUTE_LSS",
    "ROUTE_NMT",
    "ROUTE_NONE",
    "ROUTE_PDO",
    "ROUTE_SDO",
    "ROUTE_SYNC",
    "ROUTE_TIME",
    "confinement_changed",
    "forget_connections",
    "handle",
    "nmt_command",
    "on_frame",
    "on_time",
    "reads_inputs",
    "refresh_inputs",
    "set_nmt",
    "written",
]

ROUTE_NONE, ROUTE_NMT, ROUTE_SYNC, ROUTE_SDO, ROUTE_LSS, ROUTE_TIME, ROUTE_GUARD = 0, 1, 2, 3, 4, 5, 6
ROUTE_PDO = 8  # + number of the PDO: an RPDO in `route`, a TPDO in `rtr_route`
ROUTE_CONSUMER = 1024  # + number of the entry of 1016h

_ALL_NODES = 0
_IS_LSS_REQUEST = tuple(int(command in REQUESTS) for command in range(256))
"""Whether the first byte of an LSS frame is a request. Other LSS frames cost no more than frames for other nodes."""


@inlined
def on_frame(
    n: NodeRecord,
    t_ns: int,
    can_id: int,
    length: int,
    word: int,
    out: Queue,
) -> int:
    """Handle a frame whose end was at `t_ns`; return 1 if Python has to serve it (SDO, LSS, the end of NMT
    commands), else 0.
    """
    if can_id <= 0x7FF and n.route[can_id] == ROUTE_NONE:
        return 0
    return handle(n, t_ns, can_id, length, word, out)


@kernel
def handle(
    n: NodeRecord,
    t_ns: int,
    can_id: int,
    length: int,
    word: int,
    out: Queue,
) -> int:
    """Do the same as `on_frame`, for callers that are not compiled."""
    if can_id > 0x7FF:  # remote, extended or error frame
        if can_id & ~0x7FF == CAN_RTR_FLAG and n.powered and t_ns >= n.silent_ns:
            route = int(n.rtr_route[can_id & 0x7FF])
            if route == ROUTE_GUARD:
                guarding.answer(n, t_ns, out)
            elif route >= ROUTE_PDO and ALLOWED[n.nmt] & Service.PDO:
                pdo_traffic.answer_rtr(n, route - ROUTE_PDO, t_ns, out)
        return 0
    route = int(n.route[can_id])
    if route == ROUTE_NONE or n.powered == 0 or t_ns < n.silent_ns:
        return 0
    if route == ROUTE_SYNC:
        _sync(n, t_ns, length, word, out)
        return 0
    if route >= ROUTE_CONSUMER:
        deadlines.heartbeat_received(n, route - ROUTE_CONSUMER, t_ns, length, word, out)
        return 0
    if route >= ROUTE_PDO:
        if not ALLOWED[n.nmt] & Service.PDO:
            n.dropped_unknown += 1
            return 0
        acted = 0
        k = route - ROUTE_PDO
        while k >= 0:
            acted |= pdo_traffic.receive(n, k, t_ns, length, word, out)
            k = n.rpdo_next[k]
        if acted and n.tpdo_events > 0:
            n.next_ns = min(n.next_ns, pdo_traffic.transmit_events(n, t_ns, n.next_ns, out))
        return 0
    if route == ROUTE_NMT:
        if length < 2:
            n.dropped_length += 1
            return 0
        addressed = word >> 8 & 0xFF
        if addressed == n.node_id or addressed == _ALL_NODES:
            return nmt_command(n, t_ns, word & 0xFF, out)
        return 0
    if route == ROUTE_LSS:
        if length != 8:
            n.dropped_length += 1
            return 0
        if not _IS_LSS_REQUEST[word & 0xFF]:
            n.dropped_unknown += 1
            return 0
        return 1
    if route == ROUTE_TIME:
        if not ALLOWED[n.nmt] & Service.TIME:
            n.dropped_unknown += 1
        elif length == 6:
            n.time_set_ns = t_ns
            n.time_word = word
        else:
            n.dropped_length += 1
        return 0
    if not ALLOWED[n.nmt] & Service.SDO:
        n.dropped_unknown += 1
        return 0
    if n.segments_open > 0 and collect_segment(n, t_ns, can_id, length, word):
        return 0
    return 0 if answer_upload(n, t_ns, can_id, length, word, out) else 1


@inlined
def reads_inputs(n: NodeRecord, can_id: int) -> bool:
    """Whether a frame other than SYNC may make the device use or show its inputs at once: an SDO request, an RPDO
    that does not wait for SYNC, a remote frame.
    """
    if can_id > 0x7FF:
        return can_id & ~0x7FF == CAN_RTR_FLAG
    route = n.route[can_id]
    if ROUTE_PDO <= route < ROUTE_CONSUMER:
        return pdo_traffic.acts_at_once(n, route - ROUTE_PDO)
    return route == ROUTE_SDO


@kernel
def nmt_command(n: NodeRecord, t_ns: int, command: int, out: Queue) -> int:
    """Execute an NMT command; return 1 if a part is left for Python: a reset, and the end of SDO with
    STOPPED.
    """
    if command == NmtCommand.RESET_NODE or command == NmtCommand.RESET_COMMUNICATION:
        return 1
    if n.node_id == UNCONFIGURED:
        return 0
    if command != NmtCommand.START and command != NmtCommand.STOP and command != NmtCommand.ENTER_PRE_OPERATIONAL:
        n.dropped_unknown += 1
        return 0
    set_nmt(n, t_ns, AFTER_COMMAND[n.nmt, command], BY_COMMAND, out)
    return 0 if ALLOWED[n.nmt] & Service.SDO else 1


@kernel
def _sync(n: NodeRecord, t_ns: int, length: int, word: int, out: Queue) -> None:
    """Handle a SYNC: RPDOs act, inputs are sampled, synchronous TPDOs are sent."""
    if not ALLOWED[n.nmt] & Service.PDO:
        return  # SYNC matters to PDOs only
    if length != (1 if n.sync_overflow > 0 else 0):
        n.dropped_length += 1
        emcy.come(n, t_ns, emcy.SYNC_LENGTH, length, out)
        return
    n.sync_ns = t_ns
    if n.causes & (1 << emcy.SYNC_LENGTH | 1 << emcy.SYNC_LOST):
        emcy.gone(n, t_ns, emcy.SYNC_LENGTH, out)
        if n.causes >> emcy.SYNC_LOST & 1:
            emcy.gone(n, t_ns, emcy.SYNC_LOST, out)
            n.sync_armed = 0
    if n.sync_armed == 0:
        n.sync_armed = 1
        n.next_ns = min(n.next_ns, t_ns + 1)  # to schedule the check
    if n.kind != NO_KIND:
        inputs(n, t_ns, out)
    if n.rpdo_pending:
        pdo_traffic.act_pending(n, t_ns, out)
    actuate(n, t_ns)
    sample(n)
    pdo_traffic.transmit_sync(n, t_ns, word & 0xFF if length else -1, out)
    if n.tpdo_events > 0:
        n.next_ns = min(n.next_ns, pdo_traffic.transmit_events(n, t_ns, n.next_ns, out))


@kernel
def on_time(n: NodeRecord, t_ns: int, out: Queue) -> None:
    """Handle the deadlines due at `t_ns`, and set `next_ns`."""
    if n.powered == 0:
        n.next_ns = NEVER_NS
        return
    if n.kind != NO_KIND:
        inputs(n, t_ns, out)
    if deadlines.expire(n, t_ns, out):
        _react(n, t_ns, n.error_behaviour, out)
    if n.causes & emcy.DEVICE_MASK and n.device_error_behaviour != 1:
        _react(n, t_ns, n.device_error_behaviour, out)
    if n.outbox_count > 0 and t_ns >= n.outbox_next_ns:
        send_segments(n, t_ns, out)
    if n.sync_producer_ns > 0 and ALLOWED[n.nmt] & Service.SYNC and t_ns >= n.sync_next_ns:
        _produce_sync(n, t_ns, out)
    actuate(n, t_ns)
    _schedule(n, t_ns, out)


@kernel
def _react(n: NodeRecord, t_ns: int, behaviour: int, out: Queue) -> None:
    """Change the NMT state after an error as 1029h says (`eds.nmt.AUTOMATIC`); a value that CiA 301 does not
    define changes nothing.
    """
    following = AFTER_ERROR[behaviour, n.nmt] if 0 <= behaviour < AFTER_ERROR.shape[0] else n.nmt
    if following != n.nmt:
        set_nmt(n, t_ns, following, BY_ITSELF, out)


@kernel
def _produce_sync(n: NodeRecord, t_ns: int, out: Queue) -> None:
    length = 0
    if n.sync_overflow > 0:
        length = 1
        n.sync_counter = n.sync_counter % n.sync_overflow + 1
    push(out, n.station, t_ns, n.sync_id, length, n.sync_counter if length else 0)
    following_ns = n.sync_next_ns + n.sync_producer_ns
    n.sync_next_ns = following_ns if following_ns > t_ns else t_ns + n.sync_producer_ns  # called too late: no burst
    _sync(n, t_ns, length, n.sync_counter, out)


@kernel
def _schedule(n: NodeRecord, t_ns: int, out: Queue) -> None:
    next_ns = min(deadlines.next_deadline(n, NEVER_NS), n.outbox_next_ns)
    if n.sync_producer_ns > 0 and ALLOWED[n.nmt] & Service.SYNC:
        next_ns = min(next_ns, n.sync_next_ns)
    next_ns = next_deadline(n, t_ns, next_ns)
    if ALLOWED[n.nmt] & Service.PDO and n.tpdo_events > 0:
        next_ns = pdo_traffic.transmit_events(n, t_ns, next_ns, out)
    n.next_ns = max(next_ns, t_ns + 1)


@kernel
def set_nmt(n: NodeRecord, t_ns: int, state: int, why: int, out: Queue) -> None:
    """Change the NMT state; leaving OPERATIONAL, STOPPED and any reset make the output safe
    (`why`: node.profile).
    """
    before = n.nmt
    n.nmt = state
    if before == NmtState.OPERATIONAL and state != NmtState.OPERATIONAL:
        pdo_traffic.forget_pending(n)
        deadlines.stop(n, t_ns, out)
    if why == BY_RESET or (before != state and (before == NmtState.OPERATIONAL or state == NmtState.STOPPED)):
        connection_lost(n, t_ns, why, out)
    if before != NmtState.OPERATIONAL and state == NmtState.OPERATIONAL:
        n.sync_armed = 0
        pdo_traffic.start(n, t_ns)
    if not ALLOWED[state] & Service.EMCY:
        n.emcy_waiting = 0
    if state == NmtState.INITIALISING:
        n.emcy_ready_ns = t_ns
    if n.sync_producer_ns > 0 and ALLOWED[state] & ~ALLOWED[before] & Service.SYNC:  # the producer restarts
        n.sync_counter = 0
        n.sync_next_ns = t_ns + n.sync_producer_ns
    actuate(n, t_ns)
    _schedule(n, t_ns, out)


@kernel
def written(n: NodeRecord, t_ns: int, carries: int, out: Queue) -> None:
    """Let the device act on `values` or records that Python wrote (an SDO download)."""
    deadlines.settle(n, t_ns, out)
    apply(n, t_ns, t_ns, carries, out)
    actuate(n, t_ns)
    _schedule(n, t_ns, out)


@kernel
def forget_connections(n: NodeRecord, t_ns: int, out: Queue) -> None:
    """Clear the connection losses after a reset, because no connection is checked yet."""
    deadlines.settle(n, t_ns, out)
    emcy.gone(n, t_ns, emcy.RPDO_SHORT, out)
    emcy.gone(n, t_ns, emcy.RPDO_LONG, out)
    emcy.gone(n, t_ns, emcy.SYNC_LENGTH, out)
    emcy.update_register(n)


@kernel
def confinement_changed(n: NodeRecord, t_ns: int, confinement: int, out: Queue) -> None:
    """React to the state of the node's CAN controller (`wire.controller_state.Confinement`).

    Bus-off is a communication error: the fault reaction follows, and 1029h:01 applies, as with lost
    heartbeats. Its EMCY (8140h) can be sent only when the controller is back; the error is gone then,
    so "error reset" follows unless a drive holds its fault.
    """
    if n.powered == 0:
        return
    if confinement == Confinement.PASSIVE:
        emcy.come(n, t_ns, emcy.ERROR_PASSIVE, emcy.NO_INFO, out)
    elif confinement == Confinement.ACTIVE:
        emcy.gone(n, t_ns, emcy.ERROR_PASSIVE, out)
    elif confinement == Confinement.BUS_OFF:
        n.emcy_waiting = 0
        n.causes = n.causes & ~(1 << emcy.ERROR_PASSIVE) | 1 << emcy.BUS_OFF
        n.latched &= ~(1 << emcy.ERROR_PASSIVE | 1 << emcy.BUS_OFF)
        react(n, t_ns, emcy.BUS_OFF)
        _react(n, t_ns, n.error_behaviour, out)
    elif confinement == Confinement.RECOVERED:
        alarm(n, t_ns, emcy.BUS_OFF, emcy.NO_INFO, out)
        emcy.gone(n, t_ns, emcy.BUS_OFF, out)
    actuate(n, t_ns)
    _schedule(n, t_ns, out)


@kernel
def refresh_inputs(n: NodeRecord, t_ns: int) -> None:
    """Update the values that the device measures (before an SDO upload)."""
    if n.powered:
        measure(n, t_ns)
