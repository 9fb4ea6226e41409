"""Compiled state and fault confinement of a CAN controller (ISO 11898-1:2015, 10.11 to 10.14).

The letters are those of the standard's list of rules.

Each station of a bus has a controller, a row of `BusRecord.stations` by the low eight bits of its
number. The transmit and receive error counters follow the standard's twelve rules; `state` results
from them, numbered as in Linux's ``enum can_state``:

==== ==================================================================== =========================
rule when                                                                 effect
==== ==================================================================== =========================
a    a receiver detects an error, but no bit error in its own active flag REC + 1
b    a receiver sees dominant in the first bit after its error flag       REC + 8
c    a transmitter sends an error flag, except c1 and c2                  TEC + 8
c1   ... error passive, no ACK, and nothing dominant in its passive flag  unchanged
c2   ... stuff error at a recessive stuff bit of the arbitration field    unchanged
d    a transmitter's bit error in its active error or overload flag       TEC + 8
e    a receiver's bit error in its active error or overload flag          REC + 8
f    each eighth consecutive dominant bit after a flag                    + 8, by its role
g    a frame was sent                                                     TEC - 1, if above 0
h    a frame was received                                                 REC - 1; 119 if above 127
i    TEC or REC above 127                                                 error passive
j    TEC above 255                                                        bus-off
k    TEC and REC below 128 again                                          error active
l    bus-off, and 128 times 11 consecutive recessive bits                 error active, counters 0
==== ==================================================================== =========================

    c : the record of a controller
"""

from __future__ import annotations

from enum import IntEnum

from coulombus.kernels.decorator import kernel
from coulombus.sim_bus.can_bus.records import ControllerRecord
from coulombus.wire.controller_state import ControllerState

__all__ = [
    "MANUAL",
    "RECOVERY_RUNS",
    "CanState",
    "begin_bus_off",
    "count_received",
    "count_sent",
    "raise_rec",
    "raise_tec",
    "recover",
    "state_of",
]

RECOVERY_RUNS = 128
"""Number of runs of 11 recessive bits that end bus-off."""
MANUAL = -1
"""Value of `restart_ns`: bus-off lasts until the controller is restarted (``restart-ms 0`` of Linux)."""
COUNTER_LIMIT = 255  # REC is a register of eight bits; TEC beyond 255 is bus-off
WARNING_LEVEL, PASSIVE_LEVEL, BUS_OFF_LEVEL = 96, 128, 256
REC_AFTER_PASSIVE = 119  # rule h leaves the choice between 119 and 127


class CanState(IntEnum):
    """State of a controller, numbered as in Linux's ``enum can_state``."""

    ERROR_ACTIVE = 0
    ERROR_WARNING = 1
    ERROR_PASSIVE = 2
    BUS_OFF = 3
    STOPPED = 4


@kernel
def _follow(c: ControllerRecord) -> None:
    """Update `state` from the counters (rules i, j, k); `changed` is set until the change is reported."""
    if c.state == CanState.BUS_OFF:
        return
    worst = max(c.tec, c.rec)
    state = CanState.ERROR_ACTIVE
    if c.tec >= BUS_OFF_LEVEL:
        state = CanState.BUS_OFF
    elif worst >= PASSIVE_LEVEL:
        state = CanState.ERROR_PASSIVE
    elif worst >= WARNING_LEVEL:
        state = CanState.ERROR_WARNING
    if state == c.state:
        return
    if state > c.state:
        if c.state < CanState.ERROR_WARNING:
            c.warnings += 1
        if c.state < CanState.ERROR_PASSIVE <= state:
            c.passives += 1
        if state == CanState.BUS_OFF:
            c.bus_offs += 1
            c.runs_left = RECOVERY_RUNS
    c.state = state
    c.changed = 1


@kernel
def raise_tec(c: ControllerRecord) -> None:
    """Apply rules c, d, f: TEC + 8."""
    c.tec += 8
    _follow(c)


@kernel
def raise_rec(c: ControllerRecord, by: int) -> None:
    """Apply rules a, b, e, f: REC + 1 or + 8.

    A listen-only controller takes no part in fault confinement.
    """
    if c.listen_only == 0:
        c.rec = min(c.rec + by, COUNTER_LIMIT)
        _follow(c)


@kernel
def count_sent(c: ControllerRecord) -> None:
    """Apply rule g: a frame was sent."""
    if c.tec > 0:
        c.tec -= 1
        _follow(c)


@kernel
def count_received(c: ControllerRecord) -> None:
    """Apply rule h: a frame was received, up to the ACK slot."""
    if c.rec > 0 and c.listen_only == 0:
        c.rec = REC_AFTER_PASSIVE if c.rec >= PASSIVE_LEVEL else c.rec - 1
        _follow(c)


@kernel
def begin_bus_off(c: ControllerRecord, t_ns: int, far_ns: int) -> None:
    """Schedule the recovery of a controller that went bus-off at `t_ns`; `far_ns` means never."""
    c.restart_at_ns = far_ns if c.restart_ns == MANUAL else t_ns + c.restart_ns


@kernel
def recover(c: ControllerRecord) -> None:
    """Apply rule l: error active again, with both counters 0."""
    c.tec = c.rec = 0
    c.state = CanState.ERROR_ACTIVE
    c.changed = c.recovered = 1
    c.restarts += 1
    c.suspend_ns = c.mode = c.joins = 0


def state_of(c: ControllerRecord) -> ControllerState:
    """Return a controller's state and counters; ``str`` gives the text of
    ``ip -details -statistics link show``.
    """
    modes = (c["loopback"], c["listen_only"], c["one_shot"])
    return ControllerState(
        state=int(c["state"]) if c["attached"] else int(CanState.STOPPED),
        modes=sum(1 << n for n, on in enumerate(modes) if on),
        tec=int(c["tec"]),
        rec=int(c["rec"]),
        restart_ms=0 if c["restart_ns"] == MANUAL else max(1, -(-int(c["restart_ns"]) // 1_000_000)),
        restarts=int(c["restarts"]),
        bus_errors=int(c["errors"].sum()),
        arbitration_lost=int(c["arbitration_lost"]),
        warnings=int(c["warnings"]),
        passives=int(c["passives"]),
        bus_offs=int(c["bus_offs"]),
    )
