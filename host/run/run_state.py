"""The state of the data plane and of an axis for other programs."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any, TypeAlias

from coulombus.host.cycle.controller import Controller
from coulombus.host.realtime.data_plane import DataPlane
from coulombus.host.run.histogram import coarse_dict

__all__ = ["Progress", "axis_state", "plane_state", "with_states"]

Progress: TypeAlias = Callable[[float, list[dict[str, Any]]], None]
"""Callback with the display's time in s and the state of each axis (`axis_state`)."""


def plane_state(plane: DataPlane, period_ns: int) -> dict[str, Any]:
    """Return the state of the data plane as plain values; `period_ns` is the period of the cycle."""
    wakeup, latency = plane.wakeup(), plane.latency()
    return {
        "data_plane": plane.status.name.lower(),
        "cycles": plane.cycles,
        "wakeup_us": wakeup and wakeup.as_dict(),
        "sync_to_rpdo_us": latency and latency.as_dict(),
        "histograms_us": {
            "wakeup": coarse_dict(plane.shared.wakeup_bins),
            "sync_to_rpdo": coarse_dict(plane.shared.latency_bins),
            "deadline": period_ns / 1000,
        },
        "counters": plane.counters(),
    }


def axis_state(controller: Controller) -> dict[str, Any]:
    """Return the state of an axis as plain values in SI units at the handle."""
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


def with_states(progress: Progress | None, controllers: Iterable[Controller]) -> Callable[[float], None] | None:
    """Return a function of the time that calls `progress` with the time and each axis' state; None for None."""
    if progress is None:
        return None
    return lambda t_s: progress(t_s, [axis_state(controller) for controller in controllers])
