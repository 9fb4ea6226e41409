"""Runs whose truth is known (docs/explain.md): a drawn machine and what is done to it, or the bench rig
under the real host with a fault file.
"""

from __future__ import annotations

import random
import tempfile
from pathlib import Path

from benchmarks.explain_bus import Machine
from benchmarks.explain_scenarios import PAIR, SCENARIOS, healthy, pair
from benchmarks.explain_truths import Outcome, Score, Truth, explained, truth_of
from coulombus.lab.simulate import simulate
from coulombus.recording.reading import read

__all__ = ["RIG_FAULTS", "main", "outcome", "rig_outcome"]

RIG_SHARE = 5
"""Each so many-th run is one of the bench rig."""
MID_TRAFFIC_SHARE = 6
"""Each so many-th run of a machine has a log that begins in mid-traffic."""


def outcome(seed: int, name: str | None = None) -> Outcome:
    """Run a machine, do something to it or nothing, and explain what the bus carried.

    `name` is one of SCENARIOS, "pair", "healthy", or None: drawn.
    """
    dice = random.Random(seed)
    machine = Machine(dice)
    possible = [key for key, (_, drives) in SCENARIOS.items() if machine.drives or not drives]
    drawn = dice.choice([*possible, *[PAIR] * 6, "healthy", "healthy"])
    name = drawn if name is None or name not in (*possible, PAIR, "healthy") else name
    if name == PAIR and len(machine.ids) < 2:
        name = "node_off"
    machine.bring_up()
    if seed % MID_TRAFFIC_SHARE == 1:
        machine.begin_log()
    truth = None
    if name == "healthy":
        healthy(machine)
    elif name == PAIR:
        truth = pair(machine)
    else:
        truth = SCENARIOS[name][0](machine, dice.choice(machine.ids))
    if name == "healthy" or dice.random() < 0.5:
        machine.stop()
    frames = machine.frames
    return Outcome(name, truth, explained(frames, None, machine.files), frames, machine)


RIG_FAULTS: dict[str, tuple[str, Truth | None]] = {
    "healthy_rig": ('kind = "noise"\nrate = 1e-6', None),
    "noise": (
        'kind = "noise"\nrate = 1e-4\nafter = "enabled"\nat_s = 0.3\nduration_s = 0.4',
        truth_of("error_frames", None, "warning recovered unresolved"),
    ),
    "reset_motor": (
        'kind = "reset"\nnode = "motor"\nafter = "enabled"\nat_s = AT',
        truth_of("restarted", 1, "unresolved"),
    ),
    "reset_brake": (
        'kind = "reset"\nnode = "brake"\nafter = "enabled"\nat_s = AT',
        truth_of("restarted", 2, "unresolved"),
    ),
    "cut": (
        'kind = "cut"\nhalves = [["host", "brake"], ["motor"]]\nafter = "enabled"\nat_s = AT\nduration_s = 0.3',
        truth_of("node_lost no_ack", 1, "unresolved"),
    ),
    "babbling_node": (
        'kind = "babble"\nnode = "brake"\ncan_id = 16\ndata = "55"\nperiod_us = 100\nafter = "enabled"\nat_s = AT\nduration_s = 0.3',
        truth_of("babble", None, "unresolved warning recovered"),
    ),
    "stuck_dominant": (
        'kind = "stuck_dominant"\nafter = "enabled"\nat_s = AT\nduration_s = 0.06',
        truth_of("bus_silent bus_off", None, "unresolved"),
    ),
    "delayed_tpdo": (
        'kind = "delay"\ndelay_us = 500\non = { frame = "TPDO1", node = "motor", every = 3 }\nafter = "enabled"\nat_s = AT\nduration_s = 0.3',
        truth_of("tpdo_late", 1, "warning unresolved recovered"),
    ),
    "doubled_tpdo": (
        'kind = "duplicate"\non = { frame = "TPDO1", node = "brake", every = 7 }\nafter = "enabled"\nat_s = AT\nduration_s = 0.3',
        truth_of("repeated", 2, "warning"),
    ),
    "unheard_sync": (
        'kind = "drop"\non = { frame = "SYNC", every = 9 }\nafter = "enabled"\nat_s = AT\nduration_s = 0.2',
        truth_of("tpdo_missing", None, "recovered"),
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
    for line in score.lines(("healthy", "healthy_rig", *SCENARIOS, PAIR, *RIG_FAULTS)):
        print(line)
    print(
        f"{score.runs} runs with a fault: cause {score.cause}, node {score.node}, state {score.state}, "
        f"culprit {score.culprit} right; "
        f"{score.healthy} healthy runs, in {score.invented} of them something was invented"
    )
    return score
