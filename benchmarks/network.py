"""Many nodes on one virtual bus: what a node and a frame cost, and what memory a node takes beside
its dictionary.

Each node sends a heartbeat and a TPDO on SYNC, both at 100 Hz. The bus is as fast as the number of
nodes needs, so that it is equally busy with 2 and with 126. The sizes take turns, and each figure
is the median of the rounds.
"""

from __future__ import annotations

import statistics
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path

from benchmarks.size import size
from coulombus.eds.reader import read_eds
from coulombus.sim_bus.network.network import VirtualNetwork

__all__ = ["network"]

SIZES = (2, 8, 32, 126)
BITRATE_PER_NODE = 160_000  # 20 Mbit/s with 126
PERIOD_NS = 10_000_000
SIMULATED_NS = 5_000_000_000
ROUNDS = size(5, 1)
EDS = Path(__file__).resolve().parent.parent / "eds" / "motor.eds"
START = b"\x01\x00"


def operational(count: int) -> VirtualNetwork:
    """Return a network of `count` nodes that are OPERATIONAL; the first produces SYNC."""
    network = VirtualNetwork(count * BITRATE_PER_NODE, capacity=count)
    description = read_eds(EDS)
    for row in range(count):
        network.add(description, row + 1)
    network.power_on()
    network.wait_ns(100_000_000)
    for device in network.devices:
        device[0x1017, 0] = PERIOD_NS // 1_000_000
        for k in range(1, 4):  # one TPDO, the others are silent
            if (0x1800 + k, 1) in device.dictionary:
                device[0x1800 + k, 1] = 0x80000000
        device[0x1800, 2] = 1
    first = network.devices[0]
    first[0x1006, 0] = PERIOD_NS // 1000
    first[0x1005, 0] = 0x40000080
    network.station(()).send(0x000, START)
    network.wait_ns(1_000_000_000)
    return network


def memory_bytes() -> tuple[float, float]:
    """Return what one more node takes: its records, and all that Python allocates for it beside its
    dictionary.
    """
    description = read_eds(EDS)
    network = VirtualNetwork(capacity=32)
    records = float(network.nodes.nbytes) / 32
    network.add(description, 1)
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    for node_id in range(2, 32):
        network.add(description, node_id)
    network.power_on()
    network.wait_ns(1_000_000_000)
    python = (tracemalloc.get_traced_memory()[0] - before) / 30
    tracemalloc.stop()
    return records, python


def network(show: Callable[..., None]) -> None:
    """Print the figures with `show`."""
    networks = {count: operational(count) for count in SIZES}
    times: dict[int, list[float]] = {count: [] for count in SIZES}
    frames = {}
    for _ in range(ROUNDS):
        for count, one in networks.items():
            before, begin = int(one.bus["frames"][0]), time.process_time()
            one.wait_ns(SIMULATED_NS)
            times[count].append(time.process_time() - begin)
            frames[count] = int(one.bus["frames"][0]) - before
    cpu_s = {count: statistics.median(times[count]) for count in SIZES}
    a_frame = {count: cpu_s[count] / frames[count] for count in SIZES}
    least, simulated_s = min(a_frame.values()), SIMULATED_NS * 1e-9
    least_node = min(cpu_s[count] / count for count in SIZES)
    for count in SIZES:
        rate = frames[count] / simulated_s / count
        what = f"{count} nodes, {rate:.0f} frames/s of each, its share of SYNC with them"
        show(what, f"{simulated_s / cpu_s[count]:.0f} x", "at least 1 x")
        ratio = f"{cpu_s[count] / count / least_node:.2f} x the least"
        show("... CPU time for a node in a second", f"{cpu_s[count] / simulated_s / count * 1e6:.1f} us", ratio)
        what = f"... for a frame, its sender's and its receivers' share with it, {count} nodes: of the least"
        show(what, f"{a_frame[count] / least:.2f} x", "at most 1.2 x")
    records, python = memory_bytes()
    show("memory of a node: its compiled records", f"{records / 1e6:.2f} MB")
    show(
        "... and Python's objects, its dictionary with them",
        f"{python / 1e6:.2f} MB",
        "at most 3 MB beyond the dictionary",
    )
