"""A node as the frames of a log show it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TypeAlias

__all__ = ["Objects", "SeenNode"]

Objects: TypeAlias = dict[tuple[int, int], int]
"""Values of a node's objects by (index, sub-index), as SDO transfers showed them."""


@dataclass
class SeenNode:
    """A node as its frames show it; stamps are ns, -1 where there is none."""

    number: int
    first_ns: int
    last_ns: int
    state: int = -1  # of the last heartbeat; -1: not known
    was_operational: bool = False
    heartbeat_ns: int = -1  # the last one; -1: none since it booted
    heartbeat_row: int = -1
    period_ns: int = 0  # of heartbeats; 0: not known
    last_gap_ns: int = 0
    gaps: list[int] = field(default_factory=list)
    boots: int = 0
    booted_ns: int = -1
    objects: Objects = field(default_factory=dict)
    device_type: int = 0
