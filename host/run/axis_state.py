"""The state of an axis for other programs."""

from __future__ import annotations

from typing import Any

from coulombus.host.cycle.controller import Controller

__all__ = ["axis_state"]


def axis_state(controller: Controller) -> dict[str, Any]:
    """Return the state of an axis as plain values, SI at the handle."""
    h, c = controller.host[0], controller.control[0]
    count_rad = float(c["rad_count"])
    return {
        "axis": controller.axis.name,
        "phase": controller.phase.name.lower(),
        "trip": controller.trip,
        "position_rad": int(h["counts"]) * count_rad,
        "velocity_rad_s": float(h["v_counts"]) * count_rad / (int(c["period_ns"]) * 1e-9),
        "handle_torque_Nm": float(h["handle_Nm"]),
        "motor_torque_Nm": float(h["torque_Nm"]),
        "brake_torque_Nm": float(h["brake_Nm"]),
        "gain": float(h["gain"]),
        "deadman_held": bool(h["deadman_ok"]),
        "lost_pdos": int(h["lost_pdos"]),
    }
