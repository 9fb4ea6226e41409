"""`python -m benchmarks.explain`: what `coulombus explain` tells of logs whose truth is known, and
how fast it is.

    .venv/bin/python -m benchmarks.explain truths --runs 2000     # minutes; the matrix of docs/explain.md
    .venv/bin/python -m benchmarks.explain speed
"""

from __future__ import annotations

import argparse
import resource
import sys
import time

import numpy as np

from benchmarks.explain_bus import Machine
from benchmarks.explain_runs import main as truths
from coulombus.explain.explained import Explainer
from coulombus.wire.frame import Records

CAUSE, NODE, STATE, INVENTED = 0.95, 0.98, 0.98, 1 / 200
STRETCH = 22_000
"""Frames that a reader of a recording hands over at a time."""


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
    """Print how long so many frames take, and what memory."""
    log = cyclic(frames)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    begin, cpu = time.perf_counter(), time.process_time()
    explainer = Explainer()
    for start in range(0, len(log), STRETCH):
        explainer.take(log[start : start + STRETCH])
    explainer.end()
    told = explainer.explanation()
    wall, used = time.perf_counter() - begin, time.process_time() - cpu
    more = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) / 1024
    print(f"{len(log)} frames: {wall:.2f} s, {used:.2f} s of CPU, {more:.0f} MB more; verdict {told.verdict}")


def run() -> None:
    """Do what the command line says; end with 1 where the targets are missed."""
    parser = argparse.ArgumentParser()
    parser.add_argument("what", choices=("truths", "speed"))
    parser.add_argument("--runs", type=int, default=2000)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--frames", type=int, default=2_000_000)
    given = parser.parse_args()
    if given.what == "speed":
        speed(given.frames)
        return
    score = truths(given.runs, given.first)
    shares = (score.cause / score.runs, score.node / score.runs, score.state / score.runs)
    missed = shares[0] < CAUSE or shares[1] < NODE or shares[2] < STATE or score.invented > INVENTED * score.healthy
    sys.exit(1 if missed else 0)


if __name__ == "__main__":
    run()
