"""Overrides of the rig file shared by several verbs."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from coulombus.rigs.rig import Rig

__all__ = ["SHARED_MACHINE", "shared_machine"]

STANDSTILL_S = 0.05
MISSED = "limits.missed_tpdo_cycles"

SHARED_MACHINE = (
    "motor.setpoint_fault_s=0.05",
    "brake.setpoint_fault_s=0.05",
    "motor.sync_timeout_s=0.05",
    "brake.sync_timeout_s=0.05",
    "motor.heartbeat_timeout_s=0.5",
    "brake.heartbeat_timeout_s=0.5",
    f"{MISSED}=50",
    "host.loss_limit=1.0",
)
"""Overrides for a shared machine, which may stall for tens of milliseconds.

The rig's PC needs none of them. The missed cycles assume a cycle of 1 ms.
"""


def shared_machine(rig: Rig) -> tuple[str, ...]:
    """Return `SHARED_MACHINE` for a rig: a TPDO may be missing for 50 ms at any cycle, or as long as the rig allows if
    that is longer; at most 50 cycles.
    """
    longest_s = max(axis.bus.period_s for axis in rig.axes)
    cycles_of_rig = max(axis.limits.missed_tpdo_cycles for axis in rig.axes)
    cycles = max(cycles_of_rig, min(50, math.ceil(STANDSTILL_S / longest_s - 1e-9)))
    return tuple(f"{MISSED}={cycles}" if text.startswith(MISSED) else text for text in SHARED_MACHINE)
