"""Compiled emergencies of a node: causes, latches, EMCY frame, 1001h and 1003h (CiA 301, section 7.2.7).

A cause is one bit of the record's `causes` while it is present. When it appears, its bit in
`latched` is set, the error register and the history follow, and the EMCY frame is sent at once,
only once until the release. A cause in the record's `held` stays latched until the reset of its
kind (a drive's faults); every other cause is released when it is gone. A release sends the EMCY
"error reset" (0000h) with the register of what remains.

In the kernels: `n` the node's record (`node.record`), `k` a number
from 0, `out` the queue of frames to send.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from coulombus.eds.nmt import ALLOWED, Service
from coulombus.kernels.decorator import constant, kernel
from coulombus.node import slots
from coulombus.node.record import EMCY_WAITING, MAX_HISTORY, NodeRecord
from coulombus.wire.frame import Queue, push

__all__ = [
    "AT_ONCE_MASK",
    "CAUSES",
    "DEVICE_FAULTS",
    "DEVICE_MASK",
    "FAULT_MASK",
    "NO_INFO",
    "Cause",
    "clear_latches",
    "come",
    "drain",
    "gone",
    "update_register",
]


class Cause(NamedTuple):
    """A row of the table of causes."""

    name: str
    code: int  # EMCY error code
    register: int  # bits of 1001h, without bit 0 (generic), which all causes set
    fault: bool  # a drive enters the state FAULT


RPDO_SHORT, RPDO_LONG, SYNC_LENGTH, HEARTBEAT, RPDO_DEADLINE, SYNC_LOST, SUPPLY, CONNECTION = range(8)
FIRST_DEVICE_CAUSE, DEVICE_CAUSES_END = 8, 17
NO_INFO = constant(0)
"""Info of a cause without further data."""
_NO_ERROR = constant(0x0000)
OVER_CURRENT, OVER_TEMPERATURE, ENCODER, COIL_OPEN, COIL_SHORT, SUPPLY_LOW, HARDWARE, FOLLOWING, BLOCKED = range(8, 17)
LIFE_GUARDING, ERROR_PASSIVE, BUS_OFF = 17, 18, 19

_CURRENT, _VOLTAGE, _TEMPERATURE, _COMMUNICATION, _PROFILE = 0x02, 0x04, 0x08, 0x10, 0x20

CAUSES: tuple[Cause, ...] = (
    Cause("RPDO too short, not processed", 0x8210, _COMMUNICATION, False),
    Cause("RPDO longer than mapped", 0x8220, _COMMUNICATION, False),
    Cause("SYNC of an unexpected length", 0x8240, _COMMUNICATION, False),
    Cause("heartbeat lost", 0x8130, _COMMUNICATION, True),
    Cause("RPDO deadline", 0x8250, _COMMUNICATION, True),
    Cause("SYNC lost", 0x8700, _COMMUNICATION, True),
    Cause("supply lost while switched on", 0x3220, _VOLTAGE, True),
    Cause("connection aborted by an NMT command, with 6007h = 1", 0x8100, _COMMUNICATION, True),
    Cause("over-current", 0x2310, _CURRENT, True),
    Cause("over-temperature", 0x4210, _TEMPERATURE, True),
    Cause("encoder lost", 0x7305, _PROFILE, True),
    Cause("coil open", 0x5410, _PROFILE, True),
    Cause("coil short circuit", 0x2320, _CURRENT, True),
    Cause("supply low", 0x3120, _VOLTAGE, True),
    Cause("input or output hardware failed", 0x5000, 0, True),
    Cause("following error", 0x8611, _PROFILE, True),
    Cause("motor blocked", 0x7121, _PROFILE, True),
    Cause("life guarding: no remote frame", 0x8130, _COMMUNICATION, True),
    Cause("CAN in error passive mode", 0x8120, _COMMUNICATION, False),
    Cause("recovered from bus-off", 0x8140, _COMMUNICATION, True),
)
"""Causes by bit; bits 8 to 16 are device faults, bits 0-8 of the record's `in_faults`."""

DEVICE_FAULTS = {
    "over_current": OVER_CURRENT,
    "over_temperature": OVER_TEMPERATURE,
    "encoder_lost": ENCODER,
    "supply_low": SUPPLY_LOW,
    "coil_open": COIL_OPEN,
    "coil_short": COIL_SHORT,
}
"""Device faults by the names used in scripts."""

FAULT_MASK = sum(1 << i for i, cause in enumerate(CAUSES) if cause.fault)
DEVICE_MASK = sum(1 << i for i in range(FIRST_DEVICE_CAUSE, DEVICE_CAUSES_END))
AT_ONCE_MASK = 1 << SUPPLY | DEVICE_MASK & ~(1 << OVER_TEMPERATURE | 1 << FOLLOWING | 1 << BLOCKED)
"""Faults that prevent a ramp to torque 0: of supply, power stage or encoder."""

_CODE = np.array([cause.code for cause in CAUSES], np.int64)
_REGISTER = np.array([cause.register | 0x01 for cause in CAUSES], np.int64)


@kernel
def update_register(n: NodeRecord) -> None:
    """Update 1001h from the latches."""
    register = 0
    for cause in range(_REGISTER.shape[0]):
        if (n.latched >> cause) & 1:
            register |= _REGISTER[cause]
    n.values[slots.ERROR_REGISTER] = register


@kernel
def _send(n: NodeRecord, t_ns: int, code: int, info: int, out: Queue) -> None:
    """Push the EMCY frame, or queue it until the end of the inhibit time; STOPPED and INITIALISING allow
    none.

    The queue is short, so that its content is never outdated; its last entry is always the newest.
    """
    if code or n.latched == 0:
        n.values[slots.ERROR_CODE] = code
    if n.emcy_id < 0 or not ALLOWED[n.nmt] & Service.EMCY:
        return
    word, ready = code | n.values[slots.ERROR_REGISTER] << 16 | info << 24, t_ns + n.processing_ns
    n.emcy_count += 1
    if n.emcy_waiting > 0 or ready < n.emcy_ready_ns:
        k = min(n.emcy_waiting, EMCY_WAITING - 1)
        n.emcy_word[k] = word
        n.emcy_waiting = k + 1
        n.next_ns = min(n.next_ns, max(n.emcy_ready_ns, t_ns + 1))
        return
    n.emcy_ready_ns = ready + n.emcy_inhibit_ns
    push(out, n.station, ready, n.emcy_id, 8, word)


@kernel
def drain(n: NodeRecord, t_ns: int, out: Queue) -> None:
    """Push the queued EMCYs that are due; drop them if EMCY was disabled meanwhile."""
    if n.emcy_id < 0:
        n.emcy_waiting = 0
    while n.emcy_waiting > 0 and t_ns >= n.emcy_ready_ns:
        push(out, n.station, t_ns, n.emcy_id, 8, n.emcy_word[0])
        n.emcy_ready_ns = t_ns + n.emcy_inhibit_ns
        waiting = n.emcy_waiting - 1
        for k in range(waiting):
            n.emcy_word[k] = n.emcy_word[k + 1]
        n.emcy_waiting = waiting


@kernel
def come(n: NodeRecord, t_ns: int, cause: int, info: int, out: Queue) -> None:
    """Report a `cause` (bit number) that is present, once; `info` (16 bits) goes to bytes 3-4 and into
    1003h.
    """
    bit = 1 << cause
    n.causes |= bit
    if n.latched & bit:
        return
    n.latched |= bit
    update_register(n)
    for k in range(MAX_HISTORY - 1, 0, -1):
        n.history[k] = n.history[k - 1]
    n.history[0] = _CODE[cause] | info << 16
    n.history_count = min(n.history_count + 1, MAX_HISTORY)
    _send(n, t_ns, _CODE[cause], info, out)


@kernel
def gone(n: NodeRecord, t_ns: int, cause: int, out: Queue) -> None:
    """Release a `cause` that is no longer present, unless it is held until the reset of its kind."""
    bit = 1 << cause
    n.causes &= ~bit
    if not n.latched & bit or n.held & bit:
        return
    clear_latches(n, t_ns, bit, out)


@kernel
def clear_latches(n: NodeRecord, t_ns: int, mask: int, out: Queue) -> None:
    """Reset the latches of `mask` and send "error reset" with the register of what remains."""
    n.latched &= ~mask
    update_register(n)
    _send(n, t_ns, _NO_ERROR, NO_INFO, out)
