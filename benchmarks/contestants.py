"""Who runs in the real-time benchmarks, each for so many seconds on the same bus and CPU, and
returns a `Run`.
"""

from __future__ import annotations

import json
import os
import select
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.loaded_plane import LoadedPlane
from coulombus.host.cycle.controllers import Controllers
from coulombus.host.errors import NodeMissing
from coulombus.host.realtime.data_plane import DataPlane, rig_filters
from coulombus.host.realtime.shared_memory import PlaneStatus
from coulombus.host.setup.bringup import bring_up
from coulombus.host.setup.control_plane import RealControlPlane
from coulombus.rigs.rig import Rig, load_rig
from coulombus.wire.address import BusAddress
from coulombus.wire.ancillary import SO_TIMESTAMPNS
from coulombus.wire.client import Client
from coulombus.wire.handshake import SEND_BUFFER, Flags, Hello

ROOT = Path(__file__).resolve().parent.parent
BINS = 20_000
HOST_PRIORITY, BUS_PRIORITY = 80, 79
CPUS = sorted(os.sched_getaffinity(0))
BUS_CPU, HOST_CPU = CPUS[0], CPUS[-1]
LEAD_NS = 20_000_000
MODE = "hybrid"

PATIENT = (
    "motor.setpoint_fault_s=2.0",
    "brake.setpoint_fault_s=2.0",
    "motor.sync_timeout_s=2.0",
    "brake.sync_timeout_s=2.0",
    "motor.heartbeat_timeout_s=5.0",
    "brake.heartbeat_timeout_s=5.0",
    "limits.missed_tpdo_cycles=1000",
    "limits.encoder_jump_counts=100000",
)
"""What times is not what trips: a shared machine's standstills end no run here."""


def no_bins() -> np.ndarray[Any, Any]:
    return np.zeros(BINS, np.int64)


@dataclass
class Run:
    """Figures of one contestant, of one round or of several together."""

    wakeup: np.ndarray[Any, Any] = field(default_factory=no_bins)
    """Histogram in us of how late it woke."""
    latency: np.ndarray[Any, Any] = field(default_factory=no_bins)
    cycles: int = 0
    missed: int = 0
    """Periods at whose end the cycle was not done: a long standstill is many."""
    late_cycles: int = 0
    """Cycles that were not done at their period's end, or woke after it: a standstill is one."""
    incomplete: int = 0
    """Cycles in whose window not all TPDOs came."""
    never: int = 0
    """TPDOs that never came."""
    cpu_us: float | None = None
    refused: tuple[str, ...] = ()
    trip: str | None = None

    @property
    def late(self) -> float:
        """Late cycles as a share of all cycles."""
        return self.late_cycles / max(1, self.cycles)

    @property
    def gone(self) -> float:
        """Missed periods as a share of all periods."""
        return self.missed / max(1, self.cycles + self.missed)

    def p(self, share: float) -> float:
        """Quantile of the wake-up [us], within its bin evenly spread."""
        return quantile(self.wakeup, share)


def quantile(bins: np.ndarray[Any, Any], share: float) -> float:
    total = np.cumsum(bins)
    if not total[-1]:
        return float("nan")
    row = int(np.searchsorted(total, share * total[-1]))
    below = total[row] - bins[row]
    return float(row + (share * total[-1] - below) / bins[row])


def dense(pairs: Sequence[tuple[int, int]]) -> np.ndarray[Any, Any]:
    bins = no_bins()
    for at, count in pairs:
        bins[at] = count
    return bins


def together(runs: Sequence[Run]) -> Run:
    """All rounds as one."""
    cpu = [run.cpu_us for run in runs if run.cpu_us is not None]
    return Run(
        sum((r.wakeup for r in runs), no_bins()),
        sum((r.latency for r in runs), no_bins()),
        sum(r.cycles for r in runs),
        sum(r.missed for r in runs),
        sum(r.late_cycles for r in runs),
        sum(r.incomplete for r in runs),
        sum(r.never for r in runs),
        float(np.median(cpu)) if cpu else None,
        runs[0].refused,
        next((r.trip for r in runs if r.trip), None),
    )


# the bus


class Bus:
    """A ``coulombus emulate`` of its own on the first CPU."""

    def __init__(self, overrides: Sequence[str] = (), *, unpaced: bool = False, faults: Path | None = None) -> None:
        self.overrides = [*PATIENT, *overrides]
        self.rig: Rig = load_rig("bench", self.overrides)
        self.address = BusAddress("coulombus", f"bench-{os.getpid()}-{time.monotonic_ns() % 1_000_000}")
        sets = [part for override in self.overrides for part in ("--set", override)]
        options = ["--cpu", str(BUS_CPU), "--priority", "0" if unpaced else str(BUS_PRIORITY), *sets]
        self.process = subprocess.Popen(
            [
                sys.executable,
                "-m",
                "coulombus",
                "emulate",
                "--bus",
                str(self.address),
                "--mode",
                MODE,
                "--json",
                *options,
            ]
            + ["--unpaced"] * unpaced
            + (["--faults", str(faults)] if faults is not None else []),
            cwd=ROOT,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            start_new_session=True,
        )

    def __enter__(self) -> Bus:
        assert self.process.stdout is not None
        if json.loads(self.process.stdout.readline() or "{}").get("event") != "ready":
            raise RuntimeError(f"coulombus emulate ended with status {self.process.wait()}")
        return self

    def __exit__(self, *_: object) -> None:
        if self.process.poll() is None:
            self.end()

    def end(self) -> dict[str, Any]:
        """End it and return its figures."""
        self.process.terminate()
        out = self.process.communicate(timeout=30)[0]
        figures: dict[str, Any] = json.loads(out.strip().splitlines()[-1])
        return figures


def bring_up_patiently(rig: Rig, control: RealControlPlane) -> None:
    """Bring the nodes up.

    On a busy machine a heartbeat may come too late, and is waited for once more.
    """
    controllers = Controllers(rig, MODE)
    for left in (4, 3, 2, 1, 0):
        try:
            bring_up(controllers, control)
            return
        except NodeMissing:
            if left == 0:
                raise


@contextmanager
def nodes_up(bus: Bus) -> Iterator[None]:
    """Both nodes OPERATIONAL, and PRE-OPERATIONAL afterwards."""
    control = RealControlPlane(bus.rig, bus.address)
    try:
        control.check_alone(time.monotonic())
        bring_up_patiently(bus.rig, control)
        yield
        control.send(0x000, b"\x80\0")
    finally:
        control.close()


# contestants of the cycle


def data_plane(bus: Bus, seconds: float, *, loaded: bool = False) -> Run:
    """The project's loop, as `coulombus run` starts it; `loaded`: with busy threads in its
    process.
    """
    k = Controllers(bus.rig, MODE)
    plane = (LoadedPlane if loaded else DataPlane)(k, bus.address, priority=HOST_PRIORITY, cpu=HOST_CPU)
    try:
        plane.wait_ready()
        if isinstance(plane, LoadedPlane):
            plane.wait_loaded()
        with nodes_up(bus):
            plane.take_frames()
            period = int(k.control["period_ns"][0])
            plane.start_cycle((time.monotonic_ns() + LEAD_NS) // period * period)
            seen = {0x80: 0, **{int(pdo["cob_id"]): 0 for pdo in k.each[0].tpdos if pdo["cob_id"] >= 0}}
            end = time.monotonic() + seconds

            def count() -> None:
                ids = plane.take_frames()["can_id"]
                for one in seen:
                    seen[one] += int((ids == one).sum())

            while time.monotonic() < end:
                time.sleep(0.05)
                count()
            shared = plane.shared
            wakeup, latency = shared.wakeup_bins.copy(), shared.latency_bins.copy()
            missed, incomplete = int(shared.plane["missed_deadlines"][0]), int(k.host["lost_pdos"][0])
            late = int(k.host["late_cycles"][0]) + int(wakeup[period // 1000 :].sum())
            trip = k.trip
            plane.end_cycle()
            while plane.status is PlaneStatus.CYCLING:
                time.sleep(0.001)
            time.sleep(0.05)
            count()
        cycles = plane.cycles
        # SYNC is sent once more at the end, with the safe set-points, and answered
        never = sum(seen[0x80] - n for one, n in seen.items() if one != 0x80)
        refused = tuple(right["name"] for right in plane.real_time if not right["granted"])
        return Run(wakeup, latency, cycles, missed, late, incomplete, never, plane.cpu_us_per_cycle(), refused, trip)
    finally:
        plane.close()


def twin(program: Path, bus: Bus, seconds: float) -> Run:
    """The same in C (twin.c)."""
    k = Controllers(bus.rig, MODE)
    with nodes_up(bus), Client(bus.address, Hello(Flags.ERRORS, rig_filters(k))) as client:
        c = k.control[0]
        numbers = (client.fileno(), c["period_ns"], c["window_ns"], seconds, HOST_PRIORITY, HOST_CPU)
        out = subprocess.run(
            [str(program), "loop", *map(str, numbers)],
            check=True,
            stdout=subprocess.PIPE,
            text=True,
            pass_fds=(client.fileno(),),
        )
    return _run(out.stdout)


def classic(bus: Bus, seconds: float, *, loaded: bool = False) -> Run:
    """`canopen` Network and Notifier (benchmarks/canopen_loop.py)."""
    settings = {
        "parent": os.getpid(),
        "rig": "bench",
        "overrides": bus.overrides,
        "bus": str(bus.address),
        "seconds": seconds,
        "loaded": loaded,
        "priority": HOST_PRIORITY,
        "cpu": HOST_CPU,
    }
    out = subprocess.run(
        [sys.executable, "-m", "benchmarks.canopen_loop", json.dumps(settings)],
        cwd=ROOT,
        check=True,
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
    )
    run = _run(out.stdout)
    if loaded:
        run.cpu_us = None  # the threads that disturb are in it
    return run


def _run(line: str) -> Run:
    figures = json.loads(line)
    return Run(
        dense(figures["wakeup"]),
        dense(figures["latency"]),
        figures["cycles"],
        figures["missed"],
        figures["late"],
        figures["incomplete"],
        cpu_us=figures["cpu_us"],
    )


def has_cyclictest() -> str | None:
    """Why cyclictest cannot be had, None when it can."""
    if shutil.which("cyclictest") is None:
        return "no cyclictest (Debian: apt install rt-tests)"
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(1))
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    except PermissionError:
        return "SCHED_FIFO is not granted (docs/realtime.md)"
    return None


def cyclictest(
    seconds: float, *, priority: int = HOST_PRIORITY, cpu: int = HOST_CPU, period_us: int = 1000, loaded: bool = False
) -> Run:
    """The reference of wake-ups (rt-tests); `loaded`: beside a process with the threads that
    disturb.
    """
    options = ["-q", "-m", "-t1", f"-p{priority}", f"-a{cpu}", f"-i{period_us}", f"-h{BINS}"]
    other = None
    if loaded:
        other = subprocess.Popen([sys.executable, "-m", "benchmarks.load"], cwd=ROOT, stdout=subprocess.PIPE, text=True)
        assert other.stdout is not None
        select.select([other.stdout], [], [], 60)
    try:
        loops = round(seconds * 1e6 / period_us)
        out = subprocess.run(["cyclictest", *options, f"-l{loops}"], check=True, stdout=subprocess.PIPE, text=True)
    finally:
        if other is not None:
            other.kill()
            other.communicate()
    run = Run()
    for line in out.stdout.splitlines():
        words = line.split()
        if len(words) == 2 and words[0].isdigit():
            run.wakeup[min(int(words[0]), BINS - 1)] += int(words[1])
        elif line.startswith("# Histogram Overflows:"):
            run.wakeup[BINS - 1] += int(words[-1])
    run.cycles = int(run.wakeup.sum())
    run.late_cycles = int(run.wakeup[period_us:].sum())
    run.missed = int((run.wakeup * (np.arange(BINS) // period_us)).sum())
    return run


# the bus itself


PROBE_ID, PROBE_DATA, PROBE_FRAMES = 0x555, b"\x55" * 8, 4
"""What `twin.c` sends to see when it is delivered, in bursts."""


def delivery(
    program: Path, bus: Bus, seconds: float, *, every: int = 0, extra_ns: int = 0
) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """When the bus handed frames out, as a histogram in us after their ends of frame: all, and
    those that it had destroyed once.

    With `every` each so manieth is destroyed once by the bus, which takes `extra_ns`.
    """
    from coulombus.wire.bits import frame_bits

    bits, period_ns = frame_bits(PROBE_ID, PROBE_DATA), 3_000_000
    bit_ns = 1e9 / bus.rig.bus.bitrate_bit_s
    bursts = round(seconds * 1e9 / period_ns)
    if every:
        bursts = max(1, round(bursts / every)) * every  # the bus goes on counting where the next probe begins
    with Client(bus.address) as tx, Client(bus.address) as rx:
        numbers = (tx.fileno(), rx.fileno(), bursts, period_ns, HOST_PRIORITY, HOST_CPU)
        frame = (round(bits * bit_ns), PROBE_FRAMES, round(3 * bit_ns), every, extra_ns)
        out = subprocess.run(
            [str(program), "probe", *map(str, numbers), *map(str, frame)],
            check=True,
            stdout=subprocess.PIPE,
            text=True,
            pass_fds=(tx.fileno(), rx.fileno()),
        )
    figures = json.loads(out.stdout)
    return dense(figures["delivery"]), dense(figures["destroyed"])


def _throughput(program: Path, bus_ends: Sequence[int], rounds: int) -> float:
    """Frames per second that all clients together got through."""
    out = subprocess.run(
        [str(program), "crowd", str(rounds), str(CROWD_FRAMES), str(HOST_CPU), *map(str, bus_ends)],
        check=True,
        stdout=subprocess.PIPE,
        text=True,
        pass_fds=tuple(bus_ends),
    )
    figures = json.loads(out.stdout)
    return float(figures["frames"] / figures["seconds"])


CROWD, CROWD_FRAMES = 8, 16


def crowd_on_bus(program: Path, bus: Bus, rounds: int) -> float:
    """Throughput [frames/s] of clients that all send, and all read what the others sent, on a bus
    without time.
    """
    with ExitStack() as stack:
        hello = Hello(filters=((0x400, 0x7F8),))
        clients = [stack.enter_context(Client(bus.address, hello)) for _ in range(CROWD)]
        return _throughput(program, [client.fileno() for client in clients], rounds)


def crowd_on_twin(program: Path, rounds: int) -> float:
    """The same on a fan-out in C."""
    ends = [socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET) for _ in range(CROWD)]
    for _, server in ends:
        server.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
        server.setsockopt(socket.SOL_SOCKET, SO_TIMESTAMPNS, 1)
    fds = [server.fileno() for _, server in ends]
    process = subprocess.Popen(
        [str(program), "serve", str(BUS_CPU), *map(str, fds)], stdout=subprocess.PIPE, text=True, pass_fds=tuple(fds)
    )
    try:
        for _, server in ends:
            server.close()
        return _throughput(program, [client.fileno() for client, _ in ends], rounds)
    finally:
        for client, _ in ends:
            client.close()
        process.communicate(timeout=30)
