"""Answers of a live run to other programs: its state, a marker, a change of parameters.

Errors are returned to the client; they never affect the run.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import Any, TypeAlias

from coulombus.host.cycle.controller import Controller
from coulombus.host.realtime.data_plane import DataPlane
from coulombus.host.run.changes import Changes
from coulombus.host.run.histogram import coarse_dict
from coulombus.host.run.last_word import wall_time
from coulombus.host.run.markers import marker_of
from coulombus.host.run.run import Outputs
from coulombus.host.run.run_sequence import Course
from coulombus.host.run.status_socket import StatusSocket, encoded
from coulombus.recording.wall_clock import utc
from coulombus.system.exit import say

__all__ = ["ClientAnswers", "Progress", "axis_state", "plane_state", "with_states"]

Progress: TypeAlias = Callable[[float, list[dict[str, Any]]], None]
"""Callback with the display's time in s and the state of each axis (`axis_state`)."""


class ClientAnswers:
    """Answers for a run on the bus named `buses`, or on several.

    Raises
    ------
    coulombus.host.run.status_socket.StatusError
        the socket at ``outputs.status`` cannot be created
    """

    def __init__(self, run: Course, plane: DataPlane, changes: Changes, buses: str, outputs: Outputs) -> None:
        self._run, self._plane, self._changes = run, plane, changes
        self._buses, self._meta = buses, dict(outputs.meta)
        self._status_socket = None if outputs.status is None else StatusSocket(outputs.status, self.status)

    def status(self) -> dict[str, Any]:
        """Return the run's state for other programs, as plain values in SI units at the handle.

        The data plane writes meanwhile, so the values may come from two cycles.
        """
        run, rig = self._run, self._run.controllers.rig
        enabled = run.enabled_ns
        return {
            "rig": rig.name,
            "bus": self._buses,
            "mode": run.controllers.mode,
            "utc": utc(time.time_ns()),
            "display_s": None if enabled is None else (run.now_ns - enabled) * 1e-9,
            "trip": run.trip,
            "tripped": wall_time(run.controllers.trip_ns),
            **plane_state(self._plane, rig.bus.period_ns),
            "recording": None if run.path is None else str(run.path),
            "meta": self._meta,
            "arm_key": bool(self._changes.arm_key),
            "axes": [
                {**axis_state(controller), "parameters": rows}
                for controller, rows in zip(run.controllers, self._changes.rows(), strict=True)
            ],
        }

    def state(self) -> bytes:
        """Return the state as the answer for a client."""
        try:
            return encoded(self.status())
        except Exception as error:
            return encoded({"error": f"{type(error).__name__}: {error}"})

    def serve_status(self, now_ns: int) -> None:
        """Send the status to the readers of the status socket when due; an error closes that socket only."""
        if self._status_socket is None:
            return
        try:
            self._status_socket.serve(now_ns)
        except Exception as error:
            self.close()
            say(f"coulombus: the status socket is closed: {type(error).__name__}: {error}")

    def mark(self, text: str) -> bytes:
        """Set a marker with a client's text in the recording, and return the answer."""
        run = self._run
        if run.recorder is None or run.failure is not None:
            return encoded({"error": "it does not record; start it with --record"})
        try:
            marker = marker_of(text)
        except ValueError as error:
            return encoded({"error": str(error)})
        run.mark(run.now_ns, marker)
        return encoded({"marker": marker, "recording": str(run.path)})

    def change(self, text: str) -> bytes:
        """Change parameters as a client requests, and return the answer."""
        try:
            return encoded(self._changes.answer(text, self._run.now_ns))
        except Exception as error:
            return encoded({"error": f"{type(error).__name__}: {error}"})

    def close(self) -> None:
        """Close the status socket."""
        if self._status_socket is not None:
            self._status_socket.close()
            self._status_socket = None


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
