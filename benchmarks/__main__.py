"""`make bench`: the project's figures of speed, each with what it is measured against.

``python -m benchmarks WHAT`` with one of `virtual`, `first`, `bus`, `nodes`, `eds`, `exports`,
`clients`, `network`, `page`, `detail`, `sweep`, `bits`, `loss`, `realtime`, `lost`, `disturbed`, `faulty`,
`coverage` (how often the intervals of commissioning hold the truth);
real time is `benchmarks.realtime`.

This machine's clock is not yours: every figure is a ratio (simulated to real time, or to a
reference that ran in between in the same process). Each is the median of several rounds; the
references are interleaved with what they are held against.
"""

from __future__ import annotations

import argparse
import os
import signal
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from benchmarks.size import SMALLEST, size

if TYPE_CHECKING:
    from coulombus.host.run.result import RunResult


def timed(function: Callable[[], object]) -> float:
    """CPU-bound wall time of one call, in s."""
    begin = time.perf_counter()
    function()
    return time.perf_counter() - begin


def rounds(*functions: Callable[[], object], count: int = 5) -> list[float]:
    """Median time of each function; the functions take turns."""
    times: list[list[float]] = [[] for _ in functions]
    for _ in range(size(count, 1)):
        for row, function in zip(times, functions, strict=True):
            row.append(timed(function))
    return [statistics.median(row) for row in times]


def show(what: str, figure: str, target: str = "") -> None:
    """Print one line."""
    print(f"{what:<78} {figure:>12}   {target}", flush=True)


def untripped(result: RunResult) -> RunResult:
    """Return a run's result.

    One that tripped has measured nothing, and ends the benchmark with exit status 7.
    """
    if result.trip is not None:
        print(f"benchmarks: the run tripped, so its figures mean nothing: {result.trip}", file=sys.stderr)
        sys.exit(7)
    return result


def simulation() -> None:
    """Virtual time against real time, on one core."""
    from coulombus.lab.simulate import simulate
    from coulombus.sim_bus.network.virtual_rig import VirtualRig

    seconds = size(60.0, 1.0)
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / "run.pcapng"

        def plain() -> None:
            untripped(simulate("bench", "hybrid", seconds, measured=False))

        def recorded() -> None:
            untripped(simulate("bench", "hybrid", seconds, record=path, force=True))

        plain()
        recorded()
        without, with_recording = rounds(plain, recorded)
    show(
        "simulate: host, two nodes, exact bus, rig, heartbeats; no recording",
        f"{seconds / without:.0f} x",
        "at least 300 x real time",
    )
    show("simulate with recording, figures computed from it", f"{seconds / with_recording:.0f} x", "at least 200 x")

    def armed() -> VirtualRig:
        from coulombus.lab.virtual_bringup import switch_on
        from coulombus.rigs.rig import load_rig

        world = VirtualRig(load_rig("bench"), "hybrid")
        switch_on(world)
        world.start_host()
        world.wait_ns(2_000_000_000)
        if world.controllers.trip is not None:
            sys.exit(f"benchmarks: the run tripped: {world.controllers.trip}")
        return world

    world = armed()
    (cyclic,) = rounds(lambda: world.wait_ns(20_000_000_000), count=3)
    show(
        "cyclic kernel alone: five PDOs, SYNC, heartbeats, law, plant at 50 us",
        f"{20 / cyclic:.0f} x",
        "at least 1,000 x",
    )
    show("... CPU time of one cycle", f"{cyclic / 20_000 * 1e9:.0f} ns")


def start_up() -> None:
    """A fresh process to its first cycle, with warm caches."""
    code = "from coulombus.lab.simulate import simulate; simulate('bench', 'hybrid', 0.001)"
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}

    def fresh() -> None:
        subprocess.run([sys.executable, "-c", code], check=True, env=environment)

    def bare() -> None:
        subprocess.run(
            [sys.executable, "-c", "import numba, scipy.signal, canopen, pydantic"], check=True, env=environment
        )

    fresh()
    ours, imports = rounds(fresh, bare, count=3)
    show("start to first cycle, warm caches, and a safe end", f"{ours:.2f} s", "under 3 s")
    show("... as a multiple of importing its libraries alone", f"{ours / imports:.1f} x")


def frame_lengths() -> None:
    """Exact frame lengths by tables against the same by single bits."""
    import numpy as np

    from coulombus.wire.bits import data_frame_bits, frame_bits

    random = np.random.default_rng(1)
    words = [int(w) for w in random.integers(-(2**63), 2**63, 2000)]
    payloads = [w.to_bytes(8, "little", signed=True) for w in words]

    def tables() -> None:
        for word in words:
            data_frame_bits(0x181, 8, word)

    def bits() -> None:
        for data in payloads:
            frame_bits(0x181, data)

    tables()
    fast, slow = rounds(tables, bits)
    show("frame length: compiled tables (call from Python included) against bit by bit", f"{slow / fast:.1f} x")


def million_frames(count: int = 1_000_000) -> None:
    """Frame lengths against the oracle that sends bit by bit: standard, extended and remote frames, a
    third each.
    """
    import random

    from benchmarks.bit_oracle import classical
    from coulombus.wire.bits import frame_bits

    rng = random.Random(1)
    different = 0
    for i in range(count):
        kind = i % 3
        extended = kind == 1 or (kind == 2 and rng.random() < 0.5)
        can_id = rng.getrandbits(29 if extended else 11)
        length = rng.randrange(9)
        data = rng.randbytes(length) if rng.random() < 0.5 else bytes(rng.choices((0, 0xFF, 0xF8, 0x1F), k=length))
        found = frame_bits(can_id, data, extended=extended, remote=kind == 2)
        different += found != len(classical(can_id, data, extended, kind == 2))
    show(f"frame lengths that differ from the oracle's, of {count:,}", f"{different}", "0")


def observers_of(options: argparse.Namespace) -> None:
    """Run the simulated observers that the options name."""
    from benchmarks.observer_displays import observer_displays
    from benchmarks.observer_groups import observer_groups
    from benchmarks.observers import observers

    if options.displays:
        observer_displays(show, 1 if options.smallest else options.observers, options.document)
    elif options.groups:
        observer_groups(show, 2 if options.smallest else options.groups, options.document)
    else:
        observers(show, 8 if options.smallest else options.observers, options.document)


def virtual() -> None:
    """Run the benchmarks in virtual time."""
    for benchmark in (simulation, start_up, frame_lengths):
        benchmark()


def main() -> None:
    """Run what the arguments ask for."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description="Figures of speed, as ratios.")
    parser.add_argument(
        "what",
        nargs="?",
        choices=(
            "all",
            "virtual",
            "first",
            "bus",
            "nodes",
            "eds",
            "exports",
            "network",
            "page",
            "detail",
            "sweep",
            "clients",
            "bits",
            "loss",
            "realtime",
            "lost",
            "disturbed",
            "faulty",
            "observers",
            "coverage",
        ),
        default="all",
    )
    parser.add_argument("--seconds", type=float, default=5.0, help="of each contestant in each round, in real time")
    parser.add_argument("--rounds", type=int, default=3, help="in real time")
    parser.add_argument("--minutes", type=float, default=0.5, help="of the runs that look for what is lost")
    parser.add_argument("--hours", type=float, default=0.0, help="of bus time in one run, in virtual time")
    parser.add_argument("--observers", type=int, default=200, help="of each method and kind")
    parser.add_argument("--displays", action="store_true", help="observers judge what they feel of simulated displays")
    parser.add_argument("--groups", type=int, default=0, help="of observers, for the hierarchical fit")
    parser.add_argument("--document", type=Path, help="write the table of the observers there, between its marks")
    parser.add_argument("--rigs", type=int, default=10, help="random rigs that are commissioned")
    parser.add_argument("--seed", type=int, default=1, help="of the random rigs")
    parser.add_argument("--figure", type=Path, help="draw the histograms of the wake-ups there")
    parser.add_argument("--smallest", action="store_true", help="as little as shows that it runs; no figure means much")
    options = parser.parse_args()
    if options.smallest:
        os.environ[SMALLEST] = "1"
        options.seconds, options.rounds, options.minutes = 0.3, 1, 0.01
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # by way of the context managers that end the bus
    if options.what in ("all", "virtual"):
        virtual()
    if options.what in ("all", "first"):
        from benchmarks.first_minute import first_minute

        first_minute(show)
    if options.what in ("all", "bus"):
        from benchmarks.bus import bus

        bus(show, options.hours)
    if options.what in ("all", "nodes"):
        from benchmarks.nodes import nodes

        nodes(show)
    if options.what in ("all", "eds"):
        from benchmarks.eds_files import eds_files

        eds_files(show)
    if options.what in ("all", "exports"):
        from benchmarks.exports import exports

        exports(show)
    if options.what in ("all", "clients"):
        from benchmarks.clients import clients

        clients(show)
    if options.what == "bits":
        million_frames()
    if options.what in ("all", "coverage"):
        from benchmarks.coverage import coverage

        coverage(options.rigs, options.seed)
    if options.what == "loss":
        from benchmarks.loss import loss

        loss(show, options.minutes)
    if options.what in ("all", "network"):
        from benchmarks.network import network

        network(show)
    if options.what in ("all", "page"):
        from benchmarks.page import page

        page(show)
    if options.what in ("all", "detail"):
        from benchmarks.detail import detail

        detail(show)
    if options.what in ("all", "sweep"):
        from benchmarks.sweep import sweep

        sweep(show)
    if options.what == "observers":
        observers_of(options)
    if options.what == "lost":
        from benchmarks.realtime import lost

        lost(options.minutes)
    if options.what == "disturbed":
        from benchmarks.realtime import disturbed

        disturbed(options.seconds, options.rounds)
    if options.what in ("all", "faulty"):
        from benchmarks.faulty import faulty

        faulty(options.seconds, options.rounds)
    if options.what in ("all", "realtime"):
        from benchmarks.realtime import realtime

        realtime(seconds=options.seconds, rounds=options.rounds, minutes=options.minutes, figure=options.figure)


if __name__ == "__main__":
    main()
