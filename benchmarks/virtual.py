"""Figures in virtual time: the whole stack, its start, and the frame lengths."""

from __future__ import annotations

import itertools
import os
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from benchmarks.report import show
from benchmarks.size import size

if TYPE_CHECKING:
    from coulombus.host.run.result import RunResult
    from coulombus.sim_bus.network.virtual_rig import VirtualRig

__all__ = ["million_frames", "virtual"]


def timed(function: Callable[[], object]) -> float:
    """Processor time of one call, with its child processes, in s."""

    def spent() -> float:
        children = resource.getrusage(resource.RUSAGE_CHILDREN)
        return time.process_time() + children.ru_utime + children.ru_stime

    begin = spent()
    function()
    return spent() - begin


def turns(*functions: Callable[[], object], count: int = 5) -> list[list[float]]:
    """Return the times of each function; the functions take turns."""
    times: list[list[float]] = [[] for _ in functions]
    for _ in range(size(count, 1)):
        for row, function in zip(times, functions, strict=True):
            row.append(timed(function))
    return times


def rates(amount: float, times: list[float]) -> list[float]:
    """Return `amount` divided by each time."""
    return [amount / time_s for time_s in times]


def untripped(result: RunResult) -> RunResult:
    """Return a run's result.

    One that tripped has measured nothing, and ends the benchmark with exit status 7.
    """
    if result.trip is not None:
        print(f"benchmarks: the run tripped, so its figures mean nothing: {result.trip}", file=sys.stderr)
        sys.exit(7)
    return result


def simulation() -> None:
    """Virtual time against real time, on one core, and against the bare co-simulation."""
    from benchmarks.bare_kernel import bare_cycles
    from coulombus.lab.simulate import simulate

    seconds = size(60.0, 1.0)
    with tempfile.TemporaryDirectory() as directory:
        paths = (Path(directory, f"{number}.pcapng") for number in itertools.count())

        def plain() -> None:
            untripped(simulate("bench", "hybrid", seconds, measured=False))

        def recorded() -> None:
            untripped(simulate("bench", "hybrid", seconds, record=next(paths)))  # a new file, as a user's

        plain()
        recorded()
        without, with_recording = (rates(seconds, times) for times in turns(plain, recorded))
    what = "simulate: host, two nodes, exact bus, rig, heartbeats; no recording"
    show(what, f"{statistics.median(without):.0f} x", "at least 300 x real time", without)
    what = "simulate with recording, figures computed from it"
    show(what, f"{statistics.median(with_recording):.0f} x", "at least 400 x", with_recording)

    world = armed()
    bare = bare_cycles(world)
    bare(1)
    cyclic, least = turns(lambda: world.wait_ns(20_000_000_000), lambda: bare(20_000), count=5)
    speeds = rates(20.0, cyclic)
    what = "cyclic kernel alone: four PDOs, SYNC, heartbeats, law, plant at 50 us"
    show(what, f"{statistics.median(speeds):.0f} x", "at least 1,000 x", speeds)
    show("... CPU time of one cycle", f"{statistics.median(cyclic) / 20_000 * 1e9:.0f} ns")
    shares = [bare_s / cyclic_s for cyclic_s, bare_s in zip(cyclic, least, strict=True)]
    what = "... its speed, of the bare co-simulation's: plant, host and PDOs without a bus"
    show(what, f"{statistics.median(shares):.2f} x", "at least 0.8 x", shares)


def armed() -> VirtualRig:
    """Return a rig that displays."""
    from coulombus.lab.set_up import set_up
    from coulombus.rigs.rig import load_rig
    from coulombus.sim_bus.network.virtual_rig import VirtualRig

    world = VirtualRig(load_rig("bench"), "hybrid")
    set_up(world)
    world.start_host()
    world.wait_ns(2_000_000_000)
    if world.controllers.trip is not None:
        sys.exit(f"benchmarks: the run tripped: {world.controllers.trip}")
    return world


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
    ours, imports = (statistics.median(times) for times in turns(fresh, bare, count=3))
    show("start to first cycle, warm caches, and a safe end", f"{ours:.2f} s", "at most 3 s")
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
    fast, slow = (statistics.median(times) for times in turns(tables, bits))
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
        bits = frame_bits(can_id, data, extended=extended, remote=kind == 2)
        different += bits != len(classical(can_id, data, extended, kind == 2))
    show(f"frame lengths that differ from the oracle's, of {count:,}", f"{different}", "at most 0")


def virtual() -> None:
    """Run the benchmarks in virtual time."""
    for benchmark in (simulation, start_up, frame_lengths):
        benchmark()
