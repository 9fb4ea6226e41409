"""Overrides of the rig file that more than one verb gives."""

from __future__ import annotations

__all__ = ["SHARED_MACHINE"]

SHARED_MACHINE = (
    "motor.setpoint_fault_s=0.05",
    "brake.setpoint_fault_s=0.05",
    "motor.sync_timeout_s=0.05",
    "brake.sync_timeout_s=0.05",
    "motor.heartbeat_timeout_s=0.5",
    "brake.heartbeat_timeout_s=0.5",
    "limits.missed_tpdo_cycles=50",
    "host.loss_limit=1.0",
)
"""Overrides for a machine that is shared with others and may stand still for tens of milliseconds.

The rig's PC needs none of them.
"""
