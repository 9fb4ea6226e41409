"""The figures of a node in a log."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

from coulombus.explain.bus import PDOS, Bus
from coulombus.explain.nodes import STATES
from coulombus.explain.seen_node import SeenNode

__all__ = ["NodeSummary", "summary_of"]


@dataclass(frozen=True)
class NodeSummary:
    """Summary of a node in a line."""

    number: int
    name: str
    state: str
    frames: int
    boots: int
    heartbeat_ns: tuple[int, float, int] | None
    """Minimum, median and maximum of the intervals of its heartbeats [ns]; None without one."""
    sdo_response_ns: tuple[int, float, int] | None
    """The same of the times from an SDO request to its response."""
    sdo_transfers: int
    emergencies: int
    pdos_per_s: float
    states: dict[str, float]
    """Share of the log that it spent in each NMT state."""
    identity: tuple[int, int] | None
    """Vendor id and product code (1018h) if the log has them."""
    profile: int
    """Number of its device profile, as 402 (1000h); 0: unknown, or none."""
    eds: str
    """Path of its EDS file, "" without one."""
    maps: str
    """Source of its PDO maps: "rig", "SDO seen in the log", "EDS", "assumed", or ""."""
    well: bool


def summary_of(bus: Bus, number: int, well: bool) -> NodeSummary:
    """Return the figures of a node."""
    node, duration_ns = bus.nodes[number], max(bus.last_ns - max(bus.first_ns, 0), 1)
    sent = {key: count for key, count in bus.counts.items() if bus.sender(key) == number}
    maps = {
        pdo_map.source
        for pdo_map in bus.maps.values()
        if pdo_map.node == number and pdo_map.fields and pdo_map.can_id in bus.counts
    }
    return NodeSummary(
        number=number,
        name=bus.names.get(number, ""),
        state=_state_text(node.state) if node.state >= 0 else "",
        frames=sum(sent.values()),
        boots=node.boots,
        heartbeat_ns=node.intervals.figures,
        sdo_response_ns=node.sdo_response.figures,
        sdo_transfers=node.transfers,
        emergencies=node.emergencies,
        pdos_per_s=sum(count for key, count in sent.items() if key in PDOS) / (duration_ns / 1e9),
        states=_shares(node, bus.last_ns, duration_ns),
        identity=node.identity if any(node.identity) else None,
        profile=node.device_type & 0xFFFF,
        eds=str(description.path) if (description := bus.describe(number)) is not None else "",
        maps=", ".join(sorted(maps)),
        well=well,
    )


def _shares(node: SeenNode, end_ns: int, duration_ns: int) -> dict[str, float]:
    """Return the share of the log in each NMT state."""
    shares: dict[str, float] = {}
    for (since_ns, state), (until_ns, _) in pairwise([*node.states, (end_ns, -1)]):
        name = _state_text(state)
        shares[name] = shares.get(name, 0.0) + (until_ns - since_ns) / duration_ns
    return shares


def _state_text(state: int) -> str:
    return "booting" if state == 0 else STATES.get(state, "")  # type: ignore[call-overload]
