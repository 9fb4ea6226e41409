"""Join clues into incidents: an incident contains its consequences."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from coulombus.explain.clues import Clue
from coulombus.explain.incident_words import KINDS, OF_AXES, WHO

__all__ = ["Incident", "join"]

S = 1_000_000_000
AFTER_NS = S
"""Time after the end of an incident within which a clue may still be its consequence."""
TRIP_NS = 3 * S
"""The same after a trip, while the machine comes to rest."""
ROOT_NS = S // 2
"""Time from the first clue within which the clue that names an incident begins."""
PROMPT_NS = 5_000_000
PROMPT = frozenset({"rpdo_missing", "pdo_length"})
"""Kinds that are consequences unless they come first."""
AT_ONCE_NS = 2_000_000
"""Time within which equal losses of two nodes have one cause."""
FEW = 3
OFTEN = frozenset({"repeated", "sdo_stray", "event_timer", "inhibit_time"})
"""Kinds that are reported from a minimum count."""
TOLERANCE_NS = 60_000_000
"""Maximum delay of an observed cause after its first consequence."""

BUS_WIDE = frozenset(kind for kind, words in KINDS.items() if words.group == "bus")
SDO = frozenset(kind for kind, words in KINDS.items() if words.group == "sdo")
CLIENT = frozenset(
    {"sdo_late", "sdo_not_taken", "sdo_repeated", "sdo_overlap", "sdo_wrong_object", "sdo_stray", "sdo_client_abort"}
)
"""Kinds about how client and server wait for each other."""
FOR_ALL = frozenset({"bus_silent", "bus_off", "babble", "host_lost", "sync_lost", "two_sync", "bus_load"})
"""Kinds with consequences at every node."""
PROOFS, PROOF_NS = frozenset({"duplicate_node", "second_master", "not_hearing"}), 5 * S
"""Kinds that explain an incident though its first sign comes earlier, by this time at most."""
AWAY = frozenset({"node_lost", "restarted", "not_hearing"})
"""Kinds after which a command out of OPERATIONAL changes nothing."""
APART = frozenset({"time_lost", "lss_refused"})
"""Kinds that neither cause nor follow from others."""
ABSENCES = frozenset(
    {"node_lost", "host_lost", "sync_lost", "bus_silent", "tpdo_missing", "rpdo_missing", "pdo_stopped"}
)
CAUSES: tuple[tuple[frozenset[str], frozenset[str], bool, int], ...] = (
    (frozenset({"ordered_away"}), AWAY, True, 0),  # a node that was gone before is not ordered away
    (frozenset({"bus_off"}), frozenset({"babble"}), False, 0),  # what floods the bus drives controllers off
    (ABSENCES, frozenset({"error_frames"}), False, 0),  # what destroys frames silences nodes
    (frozenset({"pdo_stopped", "tpdo_missing", "heartbeat_lost"}), frozenset({"restarted"}), True, PROOF_NS),
    (frozenset({"sync_gap", "tpdo_missing", "tpdo_late"}), frozenset({"overrun"}), False, TOLERANCE_NS),
)
"""Kinds that would name an incident, kinds that name it in their place, whether of the same node, and how long after
the first sign [ns].
"""
SILENCE = frozenset({"node_lost", "heartbeat_lost", "host_lost"})
SILENCE_NS = 300_000_000
"""Maximum lead of a silence, which begins at the last received frame, before its cause."""
MINOR = frozenset(
    {
        *("repeated", "sync_gap", "sync_jitter", "rpdo_late", "tpdo_late", "heartbeat_late", "overrun", "starved"),
        *("sdo_refused_read", "sdo_repeated", "sdo_overlap", "sdo_stray", "sdo_client_abort", "service_length"),
        *("error_history", "guard_toggle", "limit_active", "event_timer", "inhibit_time"),
    }
)
"""Kinds that do not stop a machine by themselves."""
REMARKS = frozenset({"limit_active", "error_history"})
"""Kinds that name an incident only if it has no other clue."""
GONE = frozenset(
    {"node_lost", "not_hearing", "restarted", "node_missing", "duplicate_node", "left_operational", "ordered_away"}
)
"""Kinds after which a node does not answer as before."""
TOLD_BY_NODE = OF_AXES | {"emcy", "left_operational"}
"""Kinds whose cause a node may report by EMCY or 603Fh."""
REPORTED = frozenset(
    {"emcy", "error_code", "host_trip", "sdo_abort", "error_history", "following_error", "limit_active"}
)
"""Kinds reported by a node or the host itself."""


@dataclass
class Incident:
    """One event: its clues in time order; the highest rank names it.

    `status` is "unresolved", "recovered" or "warning"; `sure` is the certainty of the cause.
    """

    clues: list[Clue] = field(default_factory=list)
    number: int = 0

    @property
    def root(self) -> Clue:
        """The clue that names it."""
        telling = [clue for clue in self.clues if clue.kind not in REMARKS] or self.clues
        trips = [clue.begin_ns for clue in telling if clue.kind == "host_trip"]
        if trips:  # what comes behind the trip is no cause of it
            telling = [clue for clue in telling if clue.begin_ns <= min(trips) + PROMPT_NS]
        grave = [clue for clue in telling if clue.kind not in MINOR] or telling
        due_ns = min(clue.due_ns for clue in grave)
        early = [clue for clue in grave if clue.begin_ns <= due_ns + (PROMPT_NS if clue.kind in PROMPT else ROOT_NS)]
        early += [clue for clue in grave if clue.kind in PROOFS and clue.begin_ns <= due_ns + PROOF_NS]
        # jitter behind it is no cause
        early += [clue for clue in telling if due_ns - ROOT_NS <= clue.begin_ns < due_ns]
        root = max(early, key=lambda clue: (KINDS[clue.kind].rank, -clue.begin_ns))
        for kinds, causes, of_node, within_ns in CAUSES:
            if root.kind in kinds:
                some = [c for c in telling if c.kind in causes and c.begin_ns <= root.due_ns + within_ns]
                root = next((c for c in some if c.node == root.node or not of_node), root)
        return root

    @property
    def begin_ns(self) -> int:
        """Time of its beginning."""
        return min(clue.begin_ns for clue in self.clues)

    @property
    def end_ns(self) -> int | None:
        """Time of its end; None while it is open."""
        ends = [clue.end_ns for clue in self.clues]
        return None if None in ends else max(end for end in ends if end is not None)

    @property
    def node(self) -> int | None:
        """The node concerned; None: the bus, or the host."""
        root = self.root
        alike = {
            clue.node
            for clue in self.clues
            if clue.kind == root.kind and abs(clue.begin_ns - root.begin_ns) < AT_ONCE_NS
        }
        return root.node if len(alike) == 1 else None

    @property
    def status(self) -> str:
        """Its status: open or over, or only a warning."""
        if any(clue.end_ns is None for clue in self.clues):
            return "unresolved"
        lasted = any(clue.end_text or clue.kind not in MOMENTARY for clue in self.clues)
        return "recovered" if lasted else "warning"

    @property
    def diagnosis(self) -> Clue:
        """The clue with the node's own diagnosis, else the root."""
        if self.root.kind not in TOLD_BY_NODE:
            return self.root
        return next((c for c in self.clues if c.kind in ("emcy", "error_code") and c.node == self.node), self.root)

    @property
    def is_danger(self) -> bool:
        """Whether somebody may be hurt now."""
        return self.root.kind == "runs_on" and self.status == "unresolved"

    @property
    def count(self) -> int:
        """Number of observations of its kind."""
        return sum(clue.count for clue in self.clues if clue.kind == self.root.kind)

    @property
    def who(self) -> str:
        """Culprit: node, host, client, wire, configuration or unknown."""
        return self.root.who or WHO.get(self.root.kind, "node")

    @property
    def axes(self) -> tuple[int, ...]:
        """The drive's axes concerned, from 1; empty for a whole node."""
        kinds = {clue.axis + 1 for clue in self.clues if clue.kind in OF_AXES and clue.node == self.node}
        return tuple(sorted(kinds)) if self.root.kind in TOLD_BY_NODE else ()

    @property
    def sure(self) -> str:
        """Certainty of the cause."""
        if self.diagnosis.kind in REPORTED:
            return "reported"
        return "at the same moment" if len(self.clues) > 1 else "likely"


MOMENTARY = MINOR | {"babble", "error_frames", "no_ack", "pdo_length", "sdo_abort", "reset_failed"}
"""Momentary kinds."""


def join(clues: Iterable[Clue]) -> list[Incident]:
    """Return the incidents, the most important first, numbered from 1."""
    incidents: list[Incident] = []
    relevant = [clue for clue in clues if clue.kind not in OFTEN or clue.count >= FEW]
    for clue in sorted(relevant, key=_sort_key):
        parents = [incident for incident in incidents if _explains(incident, clue)]
        if parents:
            max(parents, key=lambda incident: _nearness(incident, clue)).clues.append(clue)
        else:
            incidents.append(Incident([clue]))
    ranks = {"unresolved": 0, "recovered": 1, "warning": 2}
    incidents = list(_merged(incidents))
    incidents.sort(
        key=lambda incident: (ranks[incident.status], _minor(incident), not incident.is_danger, incident.begin_ns)
    )
    for number, incident in enumerate(incidents, 1):
        incident.number = number
        incident.clues.sort(key=lambda clue: (clue.begin_ns, *_sort_key(clue)))
    return incidents


def _merged(incidents: list[Incident]) -> Iterator[Incident]:
    """Yield incidents; equal warnings are one."""
    first: dict[tuple[str, int | None, str], Incident] = {}
    for incident in incidents:
        root = incident.root
        key = root.kind, root.node, root.text if root.kind in SDO else ""
        if incident.status != "warning" or any(clue.kind != root.kind for clue in incident.clues):
            yield incident
        elif key in first:
            first[key].clues += incident.clues
        else:
            first[key] = incident
            yield incident


def _sort_key(clue: Clue) -> tuple[bool, int, int, str, int, str]:
    """Sort key: clues about all nodes first, then by time, because a cause may be seen after its consequence."""
    lead = TOLERANCE_NS if clue.kind in BUS_WIDE or clue.kind in GONE else 0
    lead = PROMPT_NS if clue.kind == "host_trip" else lead
    who = clue.kind, -1 if clue.node is None else clue.node, clue.text  # the same order in whichever blocks it is read
    return (clue.kind not in FOR_ALL, clue.begin_ns - lead, -KINDS[clue.kind].rank, *who)


def _minor(incident: Incident) -> bool:
    return all(clue.kind in MINOR for clue in incident.clues)


def _nearness(incident: Incident, clue: Clue) -> tuple[bool, int, int]:
    return (incident.node == clue.node, KINDS[incident.root.kind].rank, incident.begin_ns)


def _explains(incident: Incident, clue: Clue) -> bool:
    """Return whether a clue is a consequence of an incident."""
    end = incident.end_ns
    trip = next((c for c in incident.clues if c.kind == "host_trip"), None)
    at = clue.begin_ns
    if clue.kind in APART or (incident.root.kind in APART and clue.kind != incident.root.kind):
        return clue.kind == "time_lost" and incident.root.kind in ("host_lost", "sync_lost", "bus_silent")
    if "runs_on" in (clue.kind, incident.root.kind):
        return (
            clue.kind == incident.root.kind and at < incident.begin_ns + AFTER_NS
        )  # a danger is an incident of its own
    if (
        trip is not None
        and trip.begin_ns - PROMPT_NS <= at <= trip.begin_ns + TRIP_NS
        and clue.kind not in ("host_trip", "sdo_refused_read")
    ):
        return True
    if clue.kind not in MINOR and _minor(incident) and at > incident.begin_ns + AFTER_NS:
        return False  # jitter that has lasted is not what stops a machine now
    tolerance = SILENCE_NS if clue.kind in SILENCE else TOLERANCE_NS
    if at < incident.begin_ns - tolerance or (end is not None and at > end + AFTER_NS):
        return False
    root = incident.root
    if clue.kind in SILENCE and clue.kind == root.kind and clue.node == root.node and root.end_ns is not None:
        return False  # it came back, and was lost again
    if clue.kind in SDO or root.kind in SDO:
        return _sdo(incident, root, clue)
    if clue.kind == "host_trip":
        return not _minor(incident) or root.kind in ("sync_gap", "tpdo_late")
    if clue.kind == "repeated":
        return root.kind in BUS_WIDE or (root.kind == clue.kind and root.node == clue.node)
    if clue.kind == root.kind in ("tpdo_missing", "rpdo_missing") and abs(at - root.begin_ns) < AT_ONCE_NS:
        return True
    if root.kind in BUS_WIDE:
        return not _minor(incident) or clue.kind in MINOR
    if clue.kind in BUS_WIDE:
        return root.kind in ("node_lost", "restarted", "duplicate_node") and clue.kind in (
            "no_ack",
            "error_passive",
            "error_frames",
        )
    if root.node == clue.node:
        return True
    if root.kind in ("node_lost", "host_lost") and clue.kind == "rpdo_missing":
        return clue.begin_ns <= root.due_ns  # their sender fell silent
    if clue.kind == "rpdo_late":  # the host waits for the missing TPDO
        return any(other.kind in ("tpdo_missing", "tpdo_late") for other in incident.clues)
    return clue.kind == "emcy" and root.kind in GONE and "0x81" in clue.text


def _sdo(incident: Incident, root: Clue, clue: Clue) -> bool:
    if root.node != clue.node:
        return root.kind in ("bus_silent", "bus_off", "no_ack", "error_frames", "babble") and clue.kind == "sdo_timeout"
    if clue.kind == "not_hearing":
        return root.kind == "sdo_timeout"
    if root.kind in SDO:
        return root.kind == clue.kind or root.kind in CLIENT or clue.kind in (*CLIENT, "sdo_timeout", "not_applied")
    return root.kind in GONE or root.kind == "mode_refused"
