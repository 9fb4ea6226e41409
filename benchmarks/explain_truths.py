"""Runs whose truth is known, and what `coulombus explain` tells of them (docs/explain.md).

Each `Scenario` does one thing to a `Machine`, and says what must come of it: which kinds may name
the first incident, of which node, in which state.
"""

from __future__ import annotations

import random
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

from benchmarks.explain_bus import CLEAR, HEARTBEAT_MS, MS, Machine, description
from coulombus.eds.cia301 import NmtCommand
from coulombus.explain.eds_files import EdsFiles
from coulombus.explain.explained import Explainer, Explanation
from coulombus.lab.simulate import simulate
from coulombus.recording.reading import read
from coulombus.rigs.rig import Rig
from coulombus.wire.frame import Records

REST_MS = 900
RIG_SHARE = 5
"""Each so many-th run is one of the bench rig."""


@dataclass(frozen=True)
class Truth:
    """What was done: the kinds that name it rightly, the node (None: the bus), the states."""

    kinds: frozenset[str]
    node: int | None
    states: frozenset[str]
    also: tuple[Truth, ...] = ()


Scenario = Callable[[Machine, int], Truth]


def _truth(kinds: str, node: int | None, states: str) -> Truth:
    return Truth(frozenset(kinds.split()), node, frozenset(states.split()))


def node_off(machine: Machine, node: int) -> Truth:
    """A node loses its supply for good."""
    machine.network.power_off(machine.row(node))
    machine.run(REST_MS)
    return _truth("node_lost", node, "unresolved")


def _again(machine: Machine, node: int) -> None:
    """Bring a node up again, as a master does."""
    machine.commanded.discard(node)
    machine.run(30)
    machine.configure(node)
    machine.words[node] = 0
    machine.order(NmtCommand.START, node)
    machine.commanded.add(node)
    for word in (CLEAR, 0x06, 0x07, 0x0F):
        machine.words[node] = word
        machine.run(40)


def node_off_and_back(machine: Machine, node: int) -> Truth:
    """A node loses its supply for some heartbeats, and is brought up again."""
    machine.network.power_off(machine.row(node))
    machine.run(machine.dice.randint(4, 8) * HEARTBEAT_MS)
    machine.network.power_on(machine.row(node))
    machine.run(40)
    _again(machine, node)
    machine.run(REST_MS / 2)
    return _truth("node_lost restarted", node, "recovered")


def brown_out(machine: Machine, node: int) -> Truth:
    """A short dip: the node restarts, and nobody brings it up."""
    machine.network.power_off(machine.row(node))
    machine.run(12)
    machine.network.power_on(machine.row(node))
    machine.run(REST_MS)
    return _truth("restarted", node, "unresolved")


def brown_out_and_back(machine: Machine, node: int) -> Truth:
    """A short dip, and the master brings the node up."""
    machine.network.power_off(machine.row(node))
    machine.run(12)
    machine.network.power_on(machine.row(node))
    machine.run(40)
    _again(machine, node)
    machine.run(REST_MS / 2)
    return _truth("restarted", node, "recovered")


def refused_write(machine: Machine, node: int) -> Truth:
    """The master writes what the node does not take."""
    index, subindex, value, size = machine.dice.choice(((0x1000, 0, 1, 4), (0x2FF0, 1, 5, 2), (0x1018, 1, 3, 4)))
    machine.write(node, index, subindex, value, size)
    machine.run(REST_MS / 2)
    return _truth("sdo_abort", node, "unresolved")


def absent_node(machine: Machine, node: int) -> Truth:
    """The master asks a node that is not there."""
    absent = machine.dice.choice([number for number in range(61, 120) if number not in machine.ids])
    for _ in range(3):
        machine.ask(absent, bytes((0x40, 0x00, 0x10, 0, 0, 0, 0, 0)), 10)
    machine.run(REST_MS)
    return _truth("node_missing", absent, "unresolved")


def second_master(machine: Machine, node: int) -> Truth:
    """Another master sends set-points to one node, too."""
    other = machine.network.station(())

    def send(at: int) -> None:
        data = (0x0F).to_bytes(2, "little") + (300 + machine.cycle % 3).to_bytes(2, "little")
        other.send(0x200 + node, data, at_ns=at + machine.period_ns // 4)

    machine.extra.append(send)
    machine.run(REST_MS)
    return _truth("second_master", node, "unresolved")


def second_sync(machine: Machine, node: int) -> Truth:
    """Another node produces SYNC, too."""
    other = machine.network.station(())
    machine.extra.append(lambda at: other.send(0x080, at_ns=at + int(0.3 * machine.period_ns)))
    machine.run(REST_MS)
    return _truth("two_sync", None, "unresolved")


def duplicate_node(machine: Machine, node: int) -> Truth:
    """A second device with the node id of another sends heartbeats and TPDOs."""
    other = machine.network.station(())
    beat = [machine.network.t_ns + 17 * MS]

    def send(at: int) -> None:
        other.send(0x180 + node, machine.cycle.to_bytes(8, "little"), at_ns=at + machine.period_ns // 8)
        if at > beat[0]:
            other.send(0x700 + node, b"\x05", at_ns=at)
            beat[0] = at + HEARTBEAT_MS * MS

    machine.extra.append(send)
    machine.run(REST_MS)
    return _truth("duplicate_node", node, "unresolved")


def master_gone(machine: Machine, node: int) -> Truth:
    """The master's program ends: no SYNC, no set-points, no heartbeat."""
    machine.syncing = machine.beating = False
    machine.commanded = set()
    machine.run(REST_MS)
    return _truth("sync_lost host_lost", None, "unresolved")


def sync_pause(machine: Machine, node: int) -> Truth:
    """The master stands still for some time."""
    commanded, machine.commanded = machine.commanded, set()
    machine.syncing = machine.beating = False
    pause_ms = max(15 * machine.period_ns / MS, 90)
    machine.run(pause_ms)
    machine.syncing = machine.beating = True
    machine.commanded = commanded
    machine.run(REST_MS)
    watched = machine.watches and (machine.drives or pause_ms > 2 * HEARTBEAT_MS + 30)
    return _truth("sync_lost host_lost", None, "unresolved" if watched else "recovered")


def set_points_stop(machine: Machine, node: int) -> Truth:
    """The master stops commanding one node."""
    machine.commanded.discard(node)
    machine.run(REST_MS)
    return _truth("rpdo_missing", node, "unresolved")


def set_points_pause(machine: Machine, node: int) -> Truth:
    """The master leaves out some set-points of one node, fewer than its watch allows."""
    machine.commanded.discard(node)
    machine.run(3 * machine.period_ns / MS)
    machine.commanded.add(node)
    machine.run(REST_MS / 2)
    return _truth("rpdo_missing", node, "recovered")


def babble(machine: Machine, node: int) -> Truth:
    """A station floods the bus with a low identifier for some time."""
    other = machine.network.station(())
    identifier = machine.dice.choice((0x005, 0x010, 0x07F))
    for k in range(machine.dice.randint(500, 900)):
        other.send(identifier, b"\x55" * 8, at_ns=machine.network.t_ns + k * 160_000)
        if k % 200 == 199:
            machine.run(200 * 0.16)
    machine.run(REST_MS / 2)
    return _truth("babble", None, "warning recovered unresolved")


def short_rpdo(machine: Machine, node: int) -> Truth:
    """The master sends an RPDO that is shorter than the node's map."""
    machine.commanded.discard(node)

    def send(at: int) -> None:
        machine.master.send(0x200 + node, machine.words[node].to_bytes(2, "little"), at_ns=at + machine.period_ns // 2)

    machine.extra.append(send)
    machine.run(REST_MS)
    return _truth("pdo_length emcy", node, "unresolved")


def heartbeat_off(machine: Machine, node: int) -> Truth:
    """Somebody writes 0 to 1017h: the heartbeat ends, the PDOs go on."""
    machine.write(node, 0x1017, 0, 0, 2)
    machine.run(REST_MS)
    return _truth("heartbeat_lost", node, "unresolved")


def drive_fault(machine: Machine, node: int) -> Truth:
    """A drive sees a fault that stays."""
    machine.inject(node, machine.dice.choice(("over_current", "over_temperature")), True)
    machine.run(REST_MS)
    return _truth("emcy drive_fault", node, "unresolved")


def drive_fault_and_reset(machine: Machine, node: int) -> Truth:
    """A drive sees a fault that goes, and is reset and enabled again."""
    fault = machine.dice.choice(("over_current", "over_temperature"))
    machine.inject(node, fault, True)
    machine.run(60)
    machine.inject(node, fault, False)
    machine.run(30)
    for word in (0x00, CLEAR, 0x06, 0x07, 0x0F):
        machine.words[node] = word
        machine.run(max(40, 3 * machine.period_ns / MS))
    machine.run(REST_MS / 2)
    return _truth("emcy drive_fault", node, "recovered")


def left_alone(machine: Machine, node: int) -> Truth:
    """A node goes to PRE-OPERATIONAL without an order that the bus saw."""
    machine.network.nmt_command(machine.row(node), NmtCommand.ENTER_PRE_OPERATIONAL)
    machine.run(REST_MS)
    return _truth("left_operational", node, "unresolved")


def refused_then_fault(machine: Machine, node: int) -> Truth:
    """Two things: a write that a node refuses, and later another node falls silent."""
    first = refused_write(machine, node)
    others = [number for number in machine.ids if number != node]
    if not others:
        return first
    second = node_off(machine, machine.dice.choice(others))
    return Truth(first.kinds, first.node, first.states, (second,))


def fault_then_off(machine: Machine, node: int) -> Truth:
    """Two things: a node restarts, and later another falls silent."""
    first = brown_out(machine, node)
    others = [number for number in machine.ids if number != node]
    if not others:
        return first
    second = node_off(machine, machine.dice.choice(others))
    return Truth(first.kinds, first.node, first.states, (second,))


SCENARIOS: dict[str, tuple[Scenario, bool]] = {
    function.__name__: (function, drives)
    for function, drives in (
        (node_off, False), (node_off_and_back, False), (brown_out, False), (brown_out_and_back, False),
        (refused_write, False), (absent_node, False), (second_master, False), (second_sync, False),
        (duplicate_node, False), (master_gone, False), (sync_pause, False), (set_points_stop, False),
        (set_points_pause, False), (babble, False), (short_rpdo, False), (heartbeat_off, False),
        (drive_fault, True), (drive_fault_and_reset, True), (left_alone, False),
        (refused_then_fault, False), (fault_then_off, False),
    )
}  # fmt: skip
"""What may be done, and whether it needs drives."""


def healthy(machine: Machine) -> None:
    """Run, and now and then look into a node as a person does."""
    for _ in range(3):
        machine.run(REST_MS / 3)
        machine.read(machine.dice.choice(machine.ids), 0x1001, 0)


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
    def right(self) -> tuple[bool, bool, bool]:
        """Whether cause, node and state are right."""
        if self.truth is None:
            ok = not self.told.incidents
            return ok, ok, ok
        if not self.told.incidents:
            return False, False, False
        pairs = [(self.truth, self.told.incidents[0])]
        for truth in self.truth.also:  # what was done besides is an incident of its own
            others = [incident for incident in self.told.incidents[1:] if incident.root.kind in truth.kinds]
            if not others:
                return False, False, False
            pairs.append((truth, others[0]))
        host = self.told.bus.host
        return (
            all(incident.root.kind in truth.kinds for truth, incident in pairs),
            all((None if incident.node == host else incident.node) == truth.node for truth, incident in pairs),
            all(incident.status in truth.states for truth, incident in pairs),
        )


@dataclass
class Score:
    """Outcomes counted."""

    runs: int = 0
    cause: int = 0
    node: int = 0
    state: int = 0
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

    def lines(self) -> Iterator[str]:
        """Yield the matrix as a table in Markdown."""
        yield "| done to the machine | runs | told first |"
        yield "|---|---|---|"
        listed = set[str]()
        for name in ("healthy", "healthy_rig", *SCENARIOS, *RIG_FAULTS):
            row = {told: count for (done, told), count in self.matrix.items() if done == name}
            if row and name not in listed:
                listed.add(name)
                told = ", ".join(f"`{kind}` {count}" for kind, count in sorted(row.items(), key=lambda item: -item[1]))
                yield f"| `{name}` | {sum(row.values())} | {told} |"


def outcome(seed: int, name: str | None = None) -> Outcome:
    """Run a machine, do something to it or nothing, and explain what the bus carried.

    `name` is one of SCENARIOS, "healthy", or None: drawn.
    """
    dice = random.Random(seed)
    machine = Machine(dice)
    possible = [key for key, (_, drives) in SCENARIOS.items() if machine.drives or not drives]
    drawn = dice.choice([*possible, "healthy", "healthy"])
    name = drawn if name is None or name not in (*possible, "healthy") else name
    machine.bring_up()
    truth = None
    if name == "healthy":
        healthy(machine)
    else:
        truth = SCENARIOS[name][0](machine, dice.choice(machine.ids))
    if name == "healthy" or dice.random() < 0.5:
        machine.stop()
    files = EdsFiles() if machine.maps_by_sdo else EdsFiles(dict.fromkeys(machine.ids, description("motor")))
    frames = machine.frames
    return Outcome(name, truth, explained(frames, None, files), frames, machine)


def explained(frames: Records, rig: Rig | None = None, files: EdsFiles | None = None) -> Explanation:
    """Explain frames as a recording would bring them, some thousands at a time."""
    explainer = Explainer(rig, files)
    for start in range(0, len(frames), 5000):
        explainer.take(frames[start : start + 5000])
    explainer.end()
    return explainer.explanation()


RIG_FAULTS: dict[str, tuple[str, Truth | None]] = {
    "healthy_rig": ('kind = "noise"\nrate = 1e-6', None),
    "noise": (
        'kind = "noise"\nrate = 1e-4\nafter = "enabled"\nat_s = 0.3\nduration_s = 0.4',
        _truth("error_frames", None, "warning recovered unresolved"),
    ),
    "reset_motor": (
        'kind = "reset"\nnode = "motor"\nafter = "enabled"\nat_s = AT',
        _truth("restarted", 1, "unresolved"),
    ),
    "reset_brake": (
        'kind = "reset"\nnode = "brake"\nafter = "enabled"\nat_s = AT',
        _truth("restarted", 2, "unresolved"),
    ),
    "cut": (
        'kind = "cut"\nhalves = [["host", "brake"], ["motor"]]\nafter = "enabled"\nat_s = AT\nduration_s = 0.3',
        _truth("node_lost no_ack", 1, "unresolved"),
    ),
    "babbling_node": (
        'kind = "babble"\nnode = "brake"\ncan_id = 16\ndata = "55"\nperiod_us = 100\nafter = "enabled"\nat_s = AT\nduration_s = 0.3',
        _truth("babble", None, "unresolved warning recovered"),
    ),
    "stuck_dominant": (
        'kind = "stuck_dominant"\nafter = "enabled"\nat_s = AT\nduration_s = 0.06',
        _truth("bus_silent bus_off", None, "unresolved"),
    ),
    "delayed_tpdo": (
        'kind = "delay"\ndelay_us = 500\non = { frame = "TPDO1", node = "motor", every = 3 }\nafter = "enabled"\nat_s = AT\nduration_s = 0.3',
        _truth("tpdo_late", 1, "warning unresolved recovered"),
    ),
    "doubled_tpdo": (
        'kind = "duplicate"\non = { frame = "TPDO1", node = "brake", every = 7 }\nafter = "enabled"\nat_s = AT\nduration_s = 0.3',
        _truth("repeated", 2, "warning"),
    ),
    "unheard_sync": (
        'kind = "drop"\non = { frame = "SYNC", every = 9 }\nafter = "enabled"\nat_s = AT\nduration_s = 0.2',
        _truth("tpdo_missing", None, "recovered"),
    ),
}
"""Faults of docs/bus.md in the bench rig under the real host, with what must come of them."""


def rig_outcome(seed: int, name: str | None = None) -> Outcome:
    """Simulate the bench rig with a fault file, and explain the frames; the markers are left out."""
    dice = random.Random(seed)
    name = dice.choice(sorted(RIG_FAULTS)) if name is None else name
    text, truth = RIG_FAULTS[name]
    with tempfile.TemporaryDirectory() as folder:
        faults, record = Path(folder) / "faults.toml", Path(folder) / "run.pcapng"
        faults.write_text(
            f"seed = {seed + 1}\n[[fault]]\n" + text.replace("AT", f"{dice.uniform(0.2, 0.6):.3f}") + "\n"
        )
        mode = dice.choice(("active", "hybrid"))
        simulate("bench", mode, 1.5, record=record, seed=seed, faults=faults)
        recording = read(record)
    return Outcome(name, truth, explained(recording.frames, recording.rig), recording.frames, None)


def main(runs: int, first: int = 0) -> Score:
    """Explain so many runs, print the matrix, and return the score."""
    score = Score()
    for seed in range(first, first + runs):
        score.add(rig_outcome(seed) if seed % RIG_SHARE == 0 else outcome(seed))
    for line in score.lines():
        print(line)
    print(
        f"{score.runs} runs with a fault: cause {score.cause}, node {score.node}, state {score.state} right; "
        f"{score.healthy} healthy runs, in {score.invented} of them something was invented"
    )
    return score


__all__ = ["RIG_FAULTS", "SCENARIOS", "Outcome", "Score", "Truth", "main", "outcome", "rig_outcome"]
