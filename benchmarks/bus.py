"""``python -m benchmarks bus``: the rig and its bus in virtual time against real time, without and
with errors on the wire, and for hours.

All contestants run in turns in this process, bring-up and safe end included; times are CPU time, so
a neighbour on the machine costs less. The noise hits each bit alike, so about as many bits of the
idle wire as bits of frames, and each of both is played with its error frame. How many frames it
destroyed is counted from what the controllers say, how many bits it hit from what the bus says, and
both are printed.
"""

from __future__ import annotations

import os
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

from benchmarks.size import size
from coulombus.host.run.result import RunResult
from coulombus.lab.simulate import simulate
from coulombus.sim_bus.network.virtual_rig import VirtualRig

__all__ = ["bus"]

SIMULATED_S = size(120.0, 2.0)
ROUNDS = size(5, 1)
NOISE = '[[fault]]\nkind = "noise"\nrate = 1.3e-4\n'
"""About 1 frame of 100 is destroyed.

As many strikes again hit the idle wire, and few an error frame or a bit that destroys nothing.
"""
PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")
HOUR_S = 3600.0


def resident_bytes() -> int:
    """Return the memory that this process has now."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * PAGE_BYTES


def cpu_s(function: Callable[[], RunResult]) -> tuple[float, RunResult]:
    """Return the CPU time of a call, and its result."""
    begin = time.process_time()
    result = function()
    return time.process_time() - begin, result


def retransmissions(result: RunResult) -> int:
    """Return how often a frame was destroyed and sent again."""
    return sum(int(one["retransmissions"]) for one in (result.controllers or {}).values())


def strikes(result: RunResult) -> int:
    """Return how many bits were disturbed, those of the idle wire too."""
    return sum(int(one["times"]) for one in result.faults or ())


def against_real_time(show: Callable[..., None], noise: Path, recording: Path) -> None:
    """Show how much faster than real time the rig runs."""
    worlds: list[VirtualRig] = []
    runs: dict[str, Callable[[], RunResult]] = {
        "plain": lambda: simulate("bench", "hybrid", SIMULATED_S, measured=False),
        "noisy": lambda: simulate("bench", "hybrid", SIMULATED_S, faults=noise, script=worlds.append, measured=False),
        "recorded": lambda: simulate("bench", "hybrid", SIMULATED_S, faults=noise, record=recording, force=True),
    }
    times: dict[str, list[float]] = {name: [] for name in runs}
    for function in runs.values():
        function()
    for _ in range(ROUNDS):
        for name, function in runs.items():
            taken, result = cpu_s(function)
            times[name].append(taken)
            del worlds[:-1]
            if result.trip is not None:
                show(f"{name}: the run tripped", result.trip)
    frames = int(worlds.pop().bus["frames"][0])
    speed = {name: f"{SIMULATED_S / statistics.median(each):.0f} x" for name, each in times.items()}
    destroyed = retransmissions(result)
    show("simulate: host, two nodes with all services, bus, rig", speed["plain"], "at least 500 x")
    share = f"{100 * destroyed / frames:.2f} %"
    show(f"... with noise that destroys {share} of the frames", speed["noisy"], "at least 200 x")
    show("... bits that it hit: one of a destroyed frame; besides", f"{destroyed} + {strikes(result) - destroyed}")
    speeds = [plain / noisy for plain, noisy in zip(times["plain"], times["noisy"], strict=True)]
    what = "... its speed, of the undisturbed run's"
    show(what, f"{statistics.median(speeds):.2f} x", "at least 0.95 x", speeds)
    show("... with noise, recorded, and the figures computed from the recording", speed["recorded"])


def long_run(show: Callable[..., None], hours: float) -> None:
    """Show the memory hour by hour of one run of so many hours of bus time."""
    sizes: list[int] = []

    def report(t_s: float) -> None:
        if t_s >= HOUR_S * (len(sizes) + 1):
            sizes.append(resident_bytes())
            cpu = time.process_time() - begin
            show(f"... hour {len(sizes)}: memory", f"{sizes[-1] / 2**20:.0f} MiB", f"{cpu:.0f} s of CPU so far")

    begin = time.process_time()
    result = simulate("bench", "hybrid", hours * HOUR_S, progress=report, measured=False)
    taken = time.process_time() - begin
    came_to = f"{result.trip or 'no trip'}, {result.lost_pdos} PDOs lost"
    show(f"{hours:g} hours of bus time in one run", f"{hours * HOUR_S / taken:.0f} x", came_to)
    if len(sizes) > 1:
        show("... memory from the first to the last hour", f"{(sizes[-1] - sizes[0]) / 2**20:+.1f} MiB", "flat")


def bus(show: Callable[..., None], hours: float = 0.0) -> None:
    """Print the figures with `show`."""
    with tempfile.TemporaryDirectory() as directory:
        noise = Path(directory) / "noise.toml"
        noise.write_text(NOISE)
        against_real_time(show, noise, Path(directory) / "run.pcapng")
    if hours > 0:
        long_run(show, hours)
