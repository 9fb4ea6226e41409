"""Threads of the page's server besides `monitor.bus_reader`: they query the host and the faults, and compute the law's curve."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping
from typing import Any

from coulombus.monitor.view_thread import ViewThread
from coulombus.monitor.web.capture import Curve
from coulombus.monitor.web.page_state import FaultDoor, HostDoor, HostView
from coulombus.rigs.axis import Axis
from coulombus.rigs.rig import Rig

__all__ = ["CurveReader", "FaultReader", "HostReader"]

HOST_S = 0.2
FAULTS_S = 0.2


class HostReader(ViewThread):
    """Queries the host's status five times a second, and passes it to `view`."""

    def __init__(self, door: HostDoor, view: HostView, lock: threading.Lock) -> None:
        super().__init__("host reader")
        self._door, self._view, self._lock = door, view, lock

    def _run(self) -> None:
        while not self.stop.wait(HOST_S):
            try:
                status, word = self._door.status(), None
            except Exception:  # no host, or no answer: must not end the page
                status, word = None, self._word()
            with self._lock:
                self._view.update(status, word)

    def _word(self) -> Mapping[str, Any] | None:
        try:
            return self._door.last()
        except Exception:  # must not end the page
            return None


class FaultReader(ViewThread):
    """Queries the faults of a simulated bus five times a second while `looked_at`.

    Attributes
    ----------
    state : of a `FaultDoor`; None if no simulated node is on the bus
    """

    def __init__(self, door: FaultDoor | None, looked_at: Callable[[], bool]) -> None:
        super().__init__("fault reader")
        self._door, self._looked_at = door, looked_at
        self.state: Mapping[str, Any] | None = None

    def _run(self) -> None:
        while self._door is not None and not self.stop.wait(FAULTS_S):
            if self._looked_at():
                self.read(self._door)

    def read(self, door: FaultDoor) -> None:
        """Query once."""
        try:
            self.state = door.state()
        except Exception:  # no simulated node, or no answer: must not end the page
            self.state = None


class CurveReader(ViewThread):
    """Recomputes the curve of each axis' law when the mode or a parameter changes.

    The curves are in `curves`, by the axis' name; None for a law without a curve or a failing law.
    """

    def __init__(self, door: HostDoor, view: HostView, rig: Rig, lock: threading.Lock) -> None:
        super().__init__("curve reader")
        self.curves: dict[str, Curve | None] = {}
        self.ring: tuple[tuple[float, ...], tuple[float, ...]] | None = None
        """Force of an arm's law over the directions: x and y [N]; None without such a law."""
        self._made: dict[str, object] = {}
        self._door, self._view, self._rig, self._lock = door, view, rig, lock

    def _run(self) -> None:
        while not self.stop.wait(HOST_S):
            for axis in self._rig.axes:
                with self._lock:
                    mode, live = self._view.mode, self._view.live(axis.name)
                self.make(axis, mode, live)

    def make(self, axis: Axis, mode: str, live: dict[str, float]) -> None:
        """Recompute a curve if its inputs changed."""
        key = (mode, tuple(live.items()))
        if self._made.get(axis.name) == key or mode not in axis.mode:
            return
        self._made[axis.name] = key
        try:
            curve = self._door.curve(axis, mode, live)
        except Exception:  # a user-defined law: the host reports its errors
            curve = None
        self.curves[axis.name] = None if curve is None else Curve(*curve)
        if self._rig.in_plane is not None and axis is self._rig.axes[0]:
            self._make_ring(mode, live)

    def _make_ring(self, mode: str, live: dict[str, float]) -> None:
        """Recompute the force of an arm's law over the directions."""
        try:
            self.ring = self._door.ring(self._rig, mode, live)
        except Exception:  # a user-defined law: the host reports its errors
            self.ring = None
