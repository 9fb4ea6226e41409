"""State of a node from the frames of a log."""

from __future__ import annotations

from dataclasses import dataclass, field

from coulombus.recording.maps.seen_maps import MappedNode

__all__ = ["SeenNode"]


@dataclass
class SeenNode(MappedNode):
    """State of a node from its frames; stamps are ns, -1 if none."""

    first_ns: int
    last_ns: int
    state: int = -1  # of the last heartbeat; -1: unknown
    was_operational: bool = False
    heartbeat_ns: int = -1  # the last one; -1: none since it booted
    heartbeat_row: int = -1
    period_ns: int = 0  # of heartbeats; 0: unknown
    last_gap_ns: int = 0
    gaps: list[int] = field(default_factory=list)
    boots: int = 0
    booted_ns: int = -1
