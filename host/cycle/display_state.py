"""State of an axis after a cycle, for a world outside (`host.world`)."""

from __future__ import annotations

from coulombus.host.cycle.records import AxisRecords
from coulombus.host.world.records import OFFERS, StateRecord
from coulombus.kernels.decorator import kernel

__all__ = ["describe"]


@kernel
def describe(axes: AxisRecords, number: int, now_ns: int, state: StateRecord) -> None:
    """Write the state of axis `number` after its cycle into `state`; `head` and `lost` stay."""
    axis = axes[number]
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
    if axis.control.is_joint:  # the model is the tip's, with the first joint
        tip, w = axes[0].plane.motion, axes[0].world
        state.model = w.offered[w.taken % OFFERS].sequence
        state.tip_x_m, state.tip_y_m = tip.x_m[0], tip.x_m[1]
        state.tip_vx_m_s, state.tip_vy_m_s = tip.v_m_s[0], tip.v_m_s[1]
        state.hand_x_N, state.hand_y_N = tip.hand_N[0], tip.hand_N[1]
        state.world_x_N, state.world_y_N = 0.0 - w.psi_N[0], 0.0 - w.psi_N[1]
    state.clipped = w.clipped
    state.softened = w.softened
    state.sent_ns = now_ns
