"""Answers of a live run to other programs: its state, a marker, a change of parameters.

Errors are returned to the client; they never affect the run.
"""

from __future__ import annotations

import time
from typing import Any

from coulombus.host.realtime.data_plane import DataPlane
from coulombus.host.run.changes import Changes
from coulombus.host.run.last_word import wall_time
from coulombus.host.run.markers import marker_of
from coulombus.host.run.run import Outputs
from coulombus.host.run.run_sequence import Course
from coulombus.host.run.run_state import axis_state, plane_state
from coulombus.host.run.status_socket import StatusSocket, encoded
from coulombus.recording.wall_clock import utc
from coulombus.system.exit import say

__all__ = ["Answers"]


class Answers:
    """Answers for a run on the bus named `buses`, or on several.

    Raises
    ------
    coulombus.host.run.status_socket.StatusError
        the socket at ``outputs.status`` cannot be created
    """

    def __init__(self, run: Course, plane: DataPlane, changes: Changes, buses: str, outputs: Outputs) -> None:
        self._run, self._plane, self._changes = run, plane, changes
        self._buses, self._meta = buses, dict(outputs.meta)
        self._teller = None if outputs.status is None else StatusSocket(outputs.status, self.status)

    def status(self) -> dict[str, Any]:
        """Return the run's state for other programs, as plain values in SI units at the handle.

        The data plane writes meanwhile, so the values may come from two cycles.
        """
        run, rig = self._run, self._run.k.rig
        enabled = run.enabled_ns
        return {
            "rig": rig.name,
            "bus": self._buses,
            "mode": run.k.mode,
            "utc": utc(time.time_ns()),
            "display_s": None if enabled is None else (run.now_ns - enabled) * 1e-9,
            "trip": run.trip,
            "tripped": wall_time(run.k.trip_ns),
            **plane_state(self._plane, rig.bus.period_ns),
            "recording": None if run.path is None else str(run.path),
            "meta": self._meta,
            "arm_key": bool(self._changes.arm_key),
            "axes": [
                {**axis_state(controller), "parameters": rows}
                for controller, rows in zip(run.k, self._changes.rows(), strict=True)
            ],
        }

    def state(self) -> bytes:
        """Return the state as the answer for a client."""
        try:
            return encoded(self.status())
        except Exception as error:
            return encoded({"error": f"{type(error).__name__}: {error}"})

    def tell(self, now_ns: int) -> None:
        """Send the status to the readers of the status socket when due; an error closes that socket only."""
        if self._teller is None:
            return
        try:
            self._teller.serve(now_ns)
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
        if self._teller is not None:
            self._teller.close()
            self._teller = None
