"""Error frames in the format of Linux's CAN drivers (include/uapi/linux/can/error.h).

The identifier has the classes, the eight bytes have the details.

====== =======================================================================
byte   content
====== =======================================================================
0      bit in which the arbitration was lost: 0 is the start of frame, stuff bits do not count
1      controller's change of state: warning, passive, active again
2      type of a protocol error: bit, form, stuff, overload; 80h: on transmission
3      position in the frame
4      (transceiver: not used here)
5      number of the reported station, its low eight bits
6, 7   transmit and receive error counter of that station
====== =======================================================================

All classes for which Linux also sends counters carry CAN_ERR_CNT.

    c : the record of a controller
"""

from __future__ import annotations

from coulombus.kernels.decorator import inlined, kernel
from coulombus.sim_bus.can_bus.fault_confinement import CanState
from coulombus.sim_bus.can_bus.records import ControllerRecord
from coulombus.wire.error_frames import (
    ACTIVE_AGAIN,
    BUS_OFF,
    CONTROLLER,
    COUNTERS,
    LOST_ARBITRATION,
    RESTARTED,
    RX_PASSIVE,
    RX_WARNING,
    TX_PASSIVE,
    TX_WARNING,
)
from coulombus.wire.frame import CAN_ERR_FLAG

__all__ = ["error_frame", "lost_frame", "state_frame", "with_counters"]


@inlined
def with_counters(word: int, c: ControllerRecord) -> int:
    """Return the eight bytes with a controller's counters in the last two."""
    counters = min(c.tec, 255) | min(c.rec, 255) << 8
    signed: int = (word & 0xFFFF_FFFF_FFFF) | ((counters ^ 0x8000) - 0x8000) << 48
    return signed


@kernel
def error_frame(c: ControllerRecord, station: int, classes: int, kind: int, place: int) -> tuple[int, int]:
    """Return identifier and bytes of the frame that reports an error on the bus."""
    word = kind << 16 | place << 24 | (station & 0xFF) << 40
    return CAN_ERR_FLAG | COUNTERS | classes, with_counters(word, c)


@kernel
def lost_frame(c: ControllerRecord, station: int, bit: int) -> tuple[int, int]:
    """Return identifier and bytes of the frame that reports a given-up frame to its station: the arbitration
    was lost in `bit`.
    """
    return CAN_ERR_FLAG | COUNTERS | LOST_ARBITRATION, with_counters(bit | (station & 0xFF) << 40, c)


@kernel
def state_frame(c: ControllerRecord, station: int) -> tuple[int, int]:
    """Return identifier and bytes of the frame that reports a controller's new state."""
    classes = COUNTERS
    how = 0
    if c.recovered:
        classes |= RESTARTED
    if c.state == CanState.BUS_OFF:
        classes |= BUS_OFF
    elif c.state == CanState.ERROR_ACTIVE:
        classes |= CONTROLLER
        how = ACTIVE_AGAIN
    else:
        classes |= CONTROLLER
        passive = c.state == CanState.ERROR_PASSIVE
        if c.tec >= c.rec:
            how |= TX_PASSIVE if passive else TX_WARNING
        if c.rec >= c.tec:
            how |= RX_PASSIVE if passive else RX_WARNING
    return CAN_ERR_FLAG | classes, with_counters(how << 8 | (station & 0xFF) << 40, c)
