"""Explain a live bus: report each incident and the changes of its state."""

from __future__ import annotations

import time
from collections.abc import Callable

from coulombus.explain.explained import Explainer, Explanation
from coulombus.explain.incidents import Incident
from coulombus.recording.maps.known_bus import KnownBus
from coulombus.system.stop_signals import StopSignals
from coulombus.wire.adapter import open_bus
from coulombus.wire.address import BusAddress
from coulombus.wire.frame_batches import Block
from coulombus.wire.handshake import Flags, Hello

__all__ = ["LATE_NS", "Followed", "explain_bus", "same_incident"]

WAIT_S = 0.1
LOOK_S = 0.5
LATE_NS = 1_000_000_000
"""Maximum delay of a frame after its stamp: earlier, nothing counts as missing."""


def same_incident(incident: Incident) -> tuple[str, int | None, int]:
    """Return the identity of an incident, independent of its number, state and text."""
    first = incident.clues[0]
    return first.kind, first.node, first.begin_ns


class Followed:
    """Detects new incidents and changes of state."""

    def __init__(self, report: Callable[[Explanation, Incident], None]) -> None:
        self._report = report
        self._known: dict[tuple[str, int | None, int], str] = {}

    def report_changes(self, explanation: Explanation) -> None:
        """Report the changes."""
        for incident in explanation.incidents:
            key = same_incident(incident)
            if self._known.get(key) != incident.status:
                self._known[key] = incident.status
                self._report(explanation, incident)


def explain_bus(
    address: BusAddress,
    report: Callable[[Explanation, Incident], None],
    *,
    known: KnownBus,
    seconds: float | None = None,
) -> Explanation:
    """Listen to a bus, and report each incident; nothing is sent.

    Parameters
    ----------
    address
        The bus.
    report
        Called with each new incident, and when its state changes.
    known
        Names and PDO maps of a rig, and EDS files.
    seconds
        Duration [s]; None: until a signal.

    Raises
    ------
    coulombus.wire.address.BusUnavailable
        There is no bus, or it closed meanwhile.
    """
    explainer, followed = Explainer(known), Followed(report)
    end = None if seconds is None else time.monotonic() + seconds
    reported = 0.0
    with open_bus(address, Hello(Flags.LISTEN_ONLY)) as client, StopSignals() as stop:
        while not stop.wait(0) and (end is None or time.monotonic() < end):
            client.wait(WAIT_S)
            while received := client.receive():
                explainer.add_frames(Block.from_frames(received).records)
            now = time.monotonic()
            if now - reported > LOOK_S:
                reported = now
                explainer.note_overdue(time.time_ns() - LATE_NS)
                followed.report_changes(explainer.explanation())
    explainer.end()
    explanation = explainer.explanation()
    followed.report_changes(explanation)
    return explanation
