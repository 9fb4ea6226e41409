"""The incidents of a live bus, as ``coulombus explain`` tells them: each when it is one, its state
followed.

Frames are only kept when they are taken. A thread goes through them twice a second, so that neither
reader nor picture waits for it. Nothing that it does ends the view.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from coulombus.explain.explained import Explainer, Explanation
from coulombus.explain.explanation_text import cause, checks, course, title
from coulombus.explain.incidents import Incident
from coulombus.explain.live_bus import LATE_NS, same_incident
from coulombus.recording.maps.eds_files import EdsFiles
from coulombus.rigs.rig import Rig
from coulombus.wire.client import Received
from coulombus.wire.frame import FRAME, Records
from coulombus.wire.frame_batches import Block

__all__ = ["IncidentReader", "IncidentRow", "LiveIncidents", "incident_rows", "records_of"]

LOOK_S = 0.5
COURSE = 12
"""Lines of an incident's course."""
WAITING = 1 << 20
"""Frames that wait at most: some minutes of a full bus, while the machine does other work."""


@dataclass(frozen=True)
class IncidentRow:
    """An incident as a view shows it; times are ns since 1970."""

    number: int
    key: str
    """Stays while number and state change."""
    status: str
    """"unresolved", "recovered" or "warning"."""
    title: str
    begin_ns: int
    end_ns: int | None
    cause: str
    sure: str
    checks: tuple[str, ...]
    course: tuple[tuple[int, str, str], ...]
    """Time, role and words of what happened."""


def records_of(block: Block) -> Records:
    """Return the frames of a block as records."""
    frames = np.zeros(len(block), FRAME)
    for name, column in (("t_ns", block.t_ns), ("can_id", block.can_ids), ("length", block.lengths)):
        frames[name] = column
    frames["word"] = block.words
    return frames


class LiveIncidents:
    """Goes through frames once; `look` at the incidents.

    Parameters
    ----------
    rig
        Gives names and PDO maps of the nodes that are its own.
    eds
        EDS files of nodes that are no rig's.
    """

    def __init__(self, rig: Rig | None, eds: EdsFiles | None = None) -> None:
        self._explainer = Explainer(rig, eds)

    def take(self, block: Block) -> None:
        """Go through frames."""
        if len(block):
            self._explainer.take(records_of(block))

    def look(self, now_ns: int) -> tuple[IncidentRow, ...]:
        """Return the incidents at a time [ns since 1970], the most important first."""
        self._explainer.look(now_ns - LATE_NS)
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


class IncidentReader:
    """Looks for incidents in a thread of its own, within a ``with`` block.

    Attributes
    ----------
    rows : the incidents at the last look
    """

    def __init__(self, rig: Rig | None, eds: EdsFiles | None = None) -> None:
        self.rows: tuple[IncidentRow, ...] = ()
        self.failure = ""
        """Why it looks no more; empty while it does."""
        self._incidents = LiveIncidents(rig, eds)
        self._lock = threading.Lock()
        self._waiting: list[Block] = []
        self._frames = 0
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="incident reader", daemon=True)

    def __enter__(self) -> IncidentReader:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join(timeout=5)

    def take(self, received: Block | Sequence[Received]) -> None:
        """Keep frames for the next look."""
        block = received if isinstance(received, Block) else Block.of(received)
        with self._lock:
            if self._frames < WAITING and not self.failure:
                self._waiting.append(block)
                self._frames += len(block)

    def look(self, now_ns: int) -> None:
        """Go through what waits, and look."""
        with self._lock:
            blocks, self._waiting, self._frames = self._waiting, [], 0
        self._incidents.take(Block.joined(blocks))
        self.rows = self._incidents.look(now_ns)

    def _run(self) -> None:
        while not self._stop.wait(LOOK_S):
            try:
                self.look(time.time_ns())
            except Exception as error:  # a bus of strangers may show what nobody thought of: the view goes on
                self.failure = f"incidents are no longer looked for: {type(error).__name__}: {error}"
                return
