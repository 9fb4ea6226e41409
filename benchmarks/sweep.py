"""A run of a sweep, set-up and figures included, on one core; and two processes against one, beside
two processes of nothing but cycles: what the machine's processors give.

The reference is the cyclic kernel alone over the same display, which runs in between. CPU time of
the thread is counted, so that what else the machine does counts little.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from benchmarks.size import size
from coulombus.lab.set_up import set_up
from coulombus.lab.sweep.one_run import Job, carry_out, run_request
from coulombus.lab.sweep.sweep_file import read_sweep
from coulombus.lab.sweep.workers import on_processes
from coulombus.rigs.rig import load_rig
from coulombus.sim_bus.network.virtual_rig import VirtualRig

__all__ = ["sweep"]

DISPLAY_S = size(13.0, 1.0)
ROUNDS = size(7, 1)
SCALED_RUNS = size(1000, 4)
CYCLED_S = size(1000.0, 2.0)
ROOT = Path(__file__).resolve().parents[1]
FILE = f"""
seconds = {DISPLAY_S}
design = "random"
runs = {SCALED_RUNS}
[vary]
operator.inertia_kg_m2 = {{ low = 1e-4, high = 0.02, scale = "log" }}
plant.coulomb_Nm = {{ low = 0.03, high = 0.09 }}
[rates]
still = "hold_counts_p2p <= 2"
"""


def sweep(show: Callable[..., None]) -> None:
    """Print the figures with `show`."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "sweep.toml"
        path.write_text(FILE)
        swept = read_sweep(path)
    job = Job.from_sweep(swept)
    requests = [run_request(swept, run) for run in range(swept.runs)]
    world = VirtualRig(load_rig("bench"), "hybrid")
    set_up(world)
    world.start_host()
    world.wait_ns(2_000_000_000)
    carry_out(job, requests[0])
    runs, cycles = [], []
    for k in range(ROUNDS):
        runs.append(carry_out(job, requests[k]).cpu_s)
        begin = time.thread_time()
        world.wait_ns(round(DISPLAY_S * 1e9))
        cycles.append(time.thread_time() - begin)
    run_s, cycles_s = statistics.median(runs), statistics.median(cycles)
    show(
        f"a run of {DISPLAY_S:g} s in a sweep, set-up and figures included",
        f"{DISPLAY_S / run_s:.0f} x",
        "at least 900 x",
        [DISPLAY_S / s for s in runs],
    )
    show("... as a multiple of its cycles alone", f"{run_s / cycles_s:.1f} x")
    alone, one, alone_two, two = _cycling(1), _lasting(job, requests, 1), _cycling(2), _lasting(job, requests, 2)
    show(f"{SCALED_RUNS} runs by two processes against one", f"{one / two:.2f} x", "at least 1.9 x on two idle cores")
    show("... the same cycles by each of two processes", f"{2 * alone / alone_two:.2f} x", "what the processors give")


def _cycles() -> None:
    """Wait for a line, run a display's cycles, and tell how long that took [s]."""
    world = VirtualRig(load_rig("bench"), "hybrid")
    set_up(world)
    world.start_host()
    world.wait_ns(2_000_000_000)
    print("ready", flush=True)
    sys.stdin.readline()
    begin = time.perf_counter()
    world.wait_ns(round(CYCLED_S * 1e9))
    print(time.perf_counter() - begin, flush=True)


def _cycling(count: int) -> float:
    """Return how long the slowest of `count` processes takes for the same cycles [s]."""
    words = [sys.executable, "-c", "from benchmarks.sweep import _cycles; _cycles()"]
    with ExitStack() as stack:
        processes = [
            stack.enter_context(
                subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=ROOT)
            )
            for _ in range(count)
        ]
        pipes = [(process.stdin, process.stdout) for process in processes]
        for _, out in pipes:
            assert out is not None
            out.readline()
        for into, _ in pipes:
            assert into is not None
            into.write("\n")
            into.flush()
        return max(float(out.readline()) for _, out in pipes if out is not None)


def _lasting(job: Job, requests: list, count: int) -> float:
    """Return how long the runs take once the processes have all begun [s]."""
    begin = None
    for done in on_processes(job, requests, count):
        begin = begin if begin is not None else time.perf_counter()
        assert done.row["error"] is None
    return time.perf_counter() - (begin or 0.0)
