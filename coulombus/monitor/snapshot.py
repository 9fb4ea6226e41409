"""State of a bus at one time, from `monitor.live`: PDOs, nodes, events."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = ["Event", "HostLine", "NodeRow", "PdoRow", "Snapshot", "Value"]


@dataclass(frozen=True)
class Event:
    """An event: its time [ns since 1970] and text; `grave` if a run cannot continue."""

    t_ns: int
    text: str
    grave: bool = False


@dataclass(frozen=True)
class HostLine:
    """State of the bus' host, or end of the last one, in a line.

    `state` is "runs", "tripped" or "ended" (by order, or as its time was over).
    """

    text: str
    state: str = "runs"


@dataclass(frozen=True)
class Value:
    """A signal's last value in `unit`; None: never received."""

    name: str
    value: int | float | None
    unit: str


@dataclass(frozen=True)
class PdoRow:
    """One PDO: number and rate of frames, age of the last [s] (None: never received), values."""

    name: str
    can_id: int
    count: int
    rate_per_s: float
    age_s: float | None
    malformed: int
    values: tuple[Value, ...]
    least_s: float | None = None
    most_s: float | None = None
    """Shortest and longest interval since the last snapshot [s]; None with fewer than two frames."""
    data: bytes = b""
    """Its last bytes; empty before the first frame."""
    changed: frozenset[int] = frozenset()
    """Positions of bytes changed since the last snapshot."""


@dataclass(frozen=True)
class NodeRow:
    """One node: NMT state (None: never heard), age of its heartbeat [s], power state and last
    emergency, if any.

    `frames` counts its sent frames: PDOs, SDO responses, emergencies, heartbeats, the host's SYNC.
    A node outside the rig (not `known`) is named by its number.
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
    """State of the bus at one time."""

    t_ns: int
    frames: int
    frames_per_s: float
    sync_per_s: float
    error_frames: int
    unknown: int
    bits_per_s: float
    """Upper bound of bits on the wire [1/s]: with the worst stuffing, without error frames."""
    pdos: tuple[PdoRow, ...]
    nodes: tuple[NodeRow, ...]
    events: tuple[Event, ...]
    """Events since the last snapshot."""
