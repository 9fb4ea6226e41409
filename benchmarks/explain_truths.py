"""What was done to a bus, what `coulombus explain` tells of it, and how the two are counted."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from benchmarks.explain_bus import Machine
from coulombus.eds.eds_folder import EdsFiles
from coulombus.explain.bus import Bus
from coulombus.explain.explained import Explainer, Explanation
from coulombus.explain.incidents import Incident
from coulombus.kernels.records import Records
from coulombus.recording.maps.known_bus import KnownBus
from coulombus.rigs.rig import Rig

__all__ = ["Outcome", "Score", "Truth", "explained", "truth_of"]


NOTHING = (False, False, False, False)


@dataclass(frozen=True)
class Truth:
    """What was done: the kinds that name it rightly, the node (None: the bus), the states."""

    kinds: frozenset[str]
    node: int | None
    states: frozenset[str]
    culprits: frozenset[str] = frozenset()
    """Who may be named; empty: not judged."""
    also: tuple[Truth, ...] = ()


def truth_of(kinds: str, node: int | None, states: str, culprits: str = "") -> Truth:
    """Return a truth of words: its kinds, its states and its culprits."""
    return Truth(frozenset(kinds.split()), node, frozenset(states.split()), frozenset(culprits.split()))


@dataclass
class Outcome:
    """A run, what was done, and what was told."""

    name: str
    truth: Truth | None
    told: Explanation
    frames: Records
    machine: Machine | None

    @property
    def first(self) -> str:
        """The kind of the first incident, "ok" where there is none."""
        return self.told.incidents[0].root.kind if self.told.incidents else "ok"

    @property
    def right(self) -> tuple[bool, bool, bool, bool]:
        """Whether cause, node, state and culprit are right."""
        if self.truth is None:
            ok = not self.told.incidents
            return ok, ok, ok, ok
        if not self.told.incidents:
            return NOTHING
        bus = self.told.bus
        pairs: list[tuple[Truth, Incident]] = []
        for truth in (self.truth, *self.truth.also):  # each is an incident of its own
            free = [incident for incident in self.told.incidents if all(incident is not other for _, other in pairs)]
            alike = [incident for incident in free if incident.root.kind in truth.kinds]
            if not alike:
                return NOTHING
            of_node = [incident for incident in alike if incident.node == truth.node]
            pairs.append((truth, (of_node or alike)[0]))
        if all(incident is not self.told.incidents[0] for _, incident in pairs):
            return NOTHING
        return (
            True,
            all((None if _is_host(bus, incident) else incident.node) == truth.node for truth, incident in pairs),
            all(incident.status in truth.states for truth, incident in pairs),
            all(incident.who in truth.culprits or not truth.culprits for truth, incident in pairs),
        )


def _is_host(bus: Bus, incident: Incident) -> bool:
    """Return whether an incident is about the host."""
    is_lost = incident.root.kind == "host_lost"
    return is_lost or (incident.node is not None and bus.is_host(incident.node, incident.begin_ns))


@dataclass
class Score:
    """Outcomes counted."""

    runs: int = 0
    cause: int = 0
    node: int = 0
    state: int = 0
    culprit: int = 0
    healthy: int = 0
    invented: int = 0
    matrix: Counter[tuple[str, str]] = field(default_factory=Counter)

    def add(self, outcome: Outcome) -> None:
        """Count an outcome."""
        self.matrix[outcome.name, outcome.first] += 1
        right = outcome.right
        if outcome.truth is None:
            self.healthy += 1
            self.invented += not right[0]
            return
        self.runs += 1
        self.cause += right[0]
        self.node += right[1]
        self.state += right[2]
        self.culprit += right[3]

    def lines(self, names: Iterable[str]) -> Iterator[str]:
        """Yield the matrix as a table in Markdown, in the order of these names."""
        yield "| done to the machine | runs | told first |"
        yield "|---|---|---|"
        for name in dict.fromkeys(names):
            row = {kind: count for (done, kind), count in self.matrix.items() if done == name}
            if row:
                kinds = ", ".join(f"`{kind}` {count}" for kind, count in sorted(row.items(), key=lambda item: -item[1]))
                yield f"| `{name}` | {sum(row.values())} | {kinds} |"


def explained(frames: Records, rig: Rig | None = None, files: EdsFiles | None = None) -> Explanation:
    """Explain frames as a recording would bring them, some thousands at a time."""
    explainer = Explainer(KnownBus(rig, files or EdsFiles()))
    for start in range(0, len(frames), 5000):
        explainer.add_frames(frames[start : start + 5000])
    explainer.end()
    return explainer.explanation()
