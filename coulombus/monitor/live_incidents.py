"""Incidents of a live bus, as in ``coulombus explain``: each when detected, with its state.

Taking frames only stores them. A thread processes them twice a second, so that neither reader nor
display waits for it. Its errors never end the view.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass

from coulombus.explain.explained import Explainer, Explanation
from coulombus.explain.explanation_text import cause, checks, course, title
from coulombus.explain.incidents import Incident
from coulombus.explain.live_bus import LATE_NS, same_incident
from coulombus.monitor.view_thread import ViewThread
from coulombus.recording.maps.known_bus import KnownBus
from coulombus.wire.client import Received
from coulombus.wire.frame_batches import Block

__all__ = ["IncidentReader", "IncidentRow", "LiveIncidents", "incident_rows"]

LOOK_S = 0.5
COURSE = 12
"""Lines of an incident's course."""
WAITING = 1 << 20
"""Maximum pending frames: some minutes of a full bus while the machine is busy."""


@dataclass(frozen=True)
class IncidentRow:
    """An incident for a view; times are ns since 1970."""

    number: int
    key: str
    """Constant while number and state change."""
    status: str
    """"unresolved", "recovered" or "warning"."""
    title: str
    begin_ns: int
    end_ns: int | None
    cause: str
    sure: str
    checks: tuple[str, ...]
    course: tuple[tuple[int, str, str], ...]
    """Time, role and text of its events."""


class LiveIncidents:
    """Processes frames once; `update` returns the incidents.

    Parameters
    ----------
    known
        Names and PDO maps of a rig, and EDS files.
    """

    def __init__(self, bus: KnownBus) -> None:
        self._explainer = Explainer(bus)

    def add_frames(self, block: Block) -> None:
        """Process frames."""
        if len(block):
            self._explainer.add_frames(block.records)

    def update(self, now_ns: int) -> tuple[IncidentRow, ...]:
        """Return the incidents at a time [ns since 1970], the most important first."""
        self._explainer.note_overdue(now_ns - LATE_NS)
        return incident_rows(self._explainer.explanation())


def incident_rows(explanation: Explanation) -> tuple[IncidentRow, ...]:
    """Return the incidents of an explanation, the most important first."""
    return tuple(_row(explanation, incident) for incident in explanation.incidents)


def _row(explanation: Explanation, incident: Incident) -> IncidentRow:
    kind, node, begin_ns = same_incident(incident)
    return IncidentRow(
        number=incident.number,
        key=f"{kind}-{'bus' if node is None else node}-{begin_ns}",
        status=incident.status,
        title=title(explanation, incident),
        begin_ns=incident.begin_ns,
        end_ns=incident.end_ns,
        cause=cause(incident),
        sure=incident.sure,
        checks=checks(incident),
        course=tuple(course(explanation, incident)[:COURSE]),
    )


class IncidentReader(ViewThread):
    """Detects incidents in a separate thread, within a ``with`` block.

    Attributes
    ----------
    rows : the incidents at the last update
    """

    def __init__(self, bus: KnownBus) -> None:
        super().__init__("incident reader")
        self.rows: tuple[IncidentRow, ...] = ()
        self.failure = ""
        """Reason why it stopped; empty while it runs."""
        self._incidents = LiveIncidents(bus)
        self._lock = threading.Lock()
        self._waiting: list[Block] = []
        self._frames = 0

    def add_frames(self, received: Block | Sequence[Received]) -> None:
        """Store frames for the next update."""
        block = received if isinstance(received, Block) else Block.from_frames(received)
        with self._lock:
            if self._frames < WAITING and not self.failure:
                self._waiting.append(block)
                self._frames += len(block)

    def update(self, now_ns: int) -> None:
        """Process pending frames, and update the incidents."""
        with self._lock:
            blocks, self._waiting, self._frames = self._waiting, [], 0
        self._incidents.add_frames(Block.joined(blocks))
        self.rows = self._incidents.update(now_ns)

    def _run(self) -> None:
        while not self.stop.wait(LOOK_S):
            try:
                self.update(time.time_ns())
            except Exception as error:  # an unknown bus may have unforeseen content: the view goes on
                self.failure = f"the search for incidents has ended: {type(error).__name__}: {error}"
                return
