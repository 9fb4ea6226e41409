"""State of an axis after a cycle, for a world outside (`host.world`)."""

from __future__ import annotations

from coulombus.host.cycle.records import AxisRecord
from coulombus.host.world.records import OFFERS, StateRecord
from coulombus.kernels.decorator import kernel

__all__ = ["describe"]


@kernel
def describe(axis: AxisRecord, number: int, now_ns: int, state: StateRecord) -> None:
    """Write the state of axis `number` after its cycle into `state`; `head` and `lost` stay."""
    h, w = axis.host, axis.world
    state.sequence = h.cycle
    state.t_ns = h.sync_ns
    state.axis = number
    state.phase = h.phase
    state.trip = h.trip
    state.x_rad = h.counts * axis.control.rad_count
    state.v_rad_s = axis.motion.v_rad_s
    state.handle_Nm = h.handle_Nm
    state.motor_Nm = h.torque_Nm
    state.brake_Nm = h.brake_Nm
    state.law_Nm = axis.state.psi_Nm
    state.world_Nm = 0.0 - h.world_Nm
    state.world_brake_Nm = h.gain * w.world_brake_Nm
    state.share = w.share
    state.model = w.offered[w.taken % OFFERS].sequence
    state.clipped = w.clipped
    state.sent_ns = now_ns
