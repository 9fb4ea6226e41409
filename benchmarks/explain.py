"""`python -m benchmarks.explain`: what `coulombus explain` tells of logs whose truth is known, and
how fast it is.

    .venv/bin/python -m benchmarks.explain truths --runs 2000     # minutes; the matrix of docs/explain.md
    .venv/bin/python -m benchmarks.explain speed
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.explain_bus import Machine
from benchmarks.explain_runs import main as truths
from coulombus.explain.explained import Explainer
from coulombus.explain.live_bus import Followed
from coulombus.kernels.records import Records
from coulombus.recording.pcapng_writer import PcapngWriter
from coulombus.wire.bits import frame_bits
from coulombus.wire.client import Received
from coulombus.wire.frame import data_bytes
from coulombus.wire.frame_batches import Block

CAUSE, NODE, STATE, INVENTED = 0.95, 0.98, 0.98, 1 / 200


def cyclic(frames: int) -> Records:
    """Return so many frames of a healthy machine: its bring-up, then its cycles again and again."""
    import random

    machine = Machine(random.Random(3))
    machine.bring_up()
    machine.run(2000)
    log = machine.frames
    sync = log["t_ns"][log["can_id"] == 0x080]
    begin, end = int(sync[-(1_600_000_000 // machine.period_ns)]), int(sync[-2])
    work, log = log[(log["t_ns"] >= begin) & (log["t_ns"] < end)], log[log["t_ns"] < end]
    span = end - begin
    copies = [log]
    for k in range(1, frames // len(work) + 1):
        again = work.copy()
        again["t_ns"] += k * span
        copies.append(again)
    return np.concatenate(copies)[:frames]


def speed(frames: int) -> None:
    """Print how long a recording of so many frames takes, and the peak memory, in a process of its own;
    then the share of a core at the full load of a live bus.
    """
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "long.pcapng"
        with PcapngWriter(path, attachments={}) as writer:
            writer.write(cyclic(frames))
        child = [sys.executable, "-c", EXPLAIN_A_FILE, str(path)]
        print(subprocess.run(child, check=True, capture_output=True, text=True).stdout, end="")
    live()


EXPLAIN_A_FILE = """
import sys, time
from coulombus.explain.explained import explain
begin, cpu = time.perf_counter(), time.process_time()
told = explain(sys.argv[1])
wall, used = time.perf_counter() - begin, time.process_time() - cpu
peak = next(line for line in open("/proc/self/status") if line.startswith("VmHWM")).split()[1]
print(f"{told.frames} frames of a file: {wall:.2f} s, {used:.2f} s of CPU; peak memory {int(peak) // 1024} MB; {told.verdict}")
"""
"""What the child runs: its peak memory is its own (getrusage has the parent's, too)."""


def live(seconds: float = 20.0) -> None:
    """Print the share of a core that a bus at the full load of 1 Mbit/s takes: its frames come as a
    client receives them, in batches of 0.1 s of virtual time.
    """
    frames = cyclic(400_000)
    bits = [frame_bits(int(f["can_id"]), data_bytes(int(f["word"]), int(f["length"]))) for f in frames[:1000]]
    every_ns = round(1000 * sum(bits) / len(bits))
    count = round(seconds * 1e9 / every_ns)
    received: list[Received] = [
        ((k + 1) * every_ns, can_id, length, word.to_bytes(8, "little", signed=True))
        for k, (_, can_id, length, word, _) in enumerate(frames[:count].tolist())
    ]
    explainer, followed = Explainer(), Followed(lambda explanation, incident: None)
    batch = max(round(1e8 / every_ns), 1)
    begin = time.process_time()
    for number, start in enumerate(range(0, count, batch), 1):
        explainer.add_frames(Block.from_frames(received[start : start + batch]).records)
        if number % 5 == 0:
            explainer.note_overdue()
            followed.report_changes(explainer.explanation())
    used = time.process_time() - begin
    print(f"live, {count / seconds:.0f} frames a second for {seconds:g} s: {100 * used / seconds:.1f} % of a core")


def run() -> None:
    """Do what the command line says; end with 1 where the targets are missed."""
    parser = argparse.ArgumentParser()
    parser.add_argument("what", choices=("truths", "speed"))
    parser.add_argument("--runs", type=int, default=2000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--frames", type=int, default=2_000_000)
    arguments = parser.parse_args()
    if arguments.what == "speed":
        speed(arguments.frames)
        return
    score = truths(arguments.runs, arguments.first)
    shares = (score.cause / score.runs, score.node / score.runs, score.state / score.runs, score.culprit / score.runs)
    missed = (
        shares[0] < CAUSE
        or shares[1] < NODE
        or shares[2] < STATE
        or shares[3] < STATE
        or score.invented > INVENTED * score.healthy
    )
    sys.exit(1 if missed else 0)


if __name__ == "__main__":
    run()
