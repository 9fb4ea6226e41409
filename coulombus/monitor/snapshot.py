"""What is on a bus at one time, as `monitor.live` tells it: PDOs, nodes, events."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Event", "HostLine", "NodeRow", "PdoRow", "Snapshot", "Value"]


@dataclass(frozen=True)
class Event:
    """Something that happened: when [ns since 1970], and what; `grave` where a run cannot go on."""

    t_ns: int
    text: str
    grave: bool = False


@dataclass(frozen=True)
class HostLine:
    """What the bus' host does, or how the last one ended, in a line.

    `state` is "runs", "tripped" or "ended" (by order, or as its time was over).
    """

    text: str
    state: str = "runs"


@dataclass(frozen=True)
class Value:
    """A signal's last value in `unit`; None: it never came."""

    name: str
    value: int | float | None
    unit: str


@dataclass(frozen=True)
class PdoRow:
    """One PDO: frames so far and each second, age of the last one [s] (None: none came), values."""

    name: str
    can_id: int
    count: int
    rate_per_s: float
    age_s: float | None
    malformed: int
    values: tuple[Value, ...]
    least_s: float | None = None
    most_s: float | None = None
    """Shortest and longest time between two of them since the last snapshot [s]; None of fewer."""
    data: bytes = b""
    """Its last bytes; none as long as none came."""
    changed: frozenset[int] = frozenset()
    """Places of the bytes that are others than at the last snapshot."""


@dataclass(frozen=True)
class NodeRow:
    """One node: NMT state (None: never heard), age of its heartbeat [s], power state and last
    emergency, if any.

    `frames` are those that it sent: PDOs, SDO responses, emergencies, heartbeats, the host's SYNC.
    A node that the rig does not have (not `known`) is called by its number.
    """

    name: str
    node_id: int
    state: str | None
    age_s: float | None
    silent: bool
    power_state: str | None
    emergency: str | None
    known: bool
    frames: int
    rate_per_s: float


@dataclass(frozen=True)
class Snapshot:
    """All of it at one time."""

    t_ns: int
    frames: int
    frames_per_s: float
    sync_per_s: float
    error_frames: int
    unknown: int
    bits_per_s: float
    """Bits on the wire [1/s], at most: with the worst stuffing, error frames not counted."""
    pdos: tuple[PdoRow, ...]
    nodes: tuple[NodeRow, ...]
    events: tuple[Event, ...]
    """Those since the last snapshot."""
