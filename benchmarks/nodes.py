"""``python -m benchmarks nodes``: what a simulated device costs, against `canopen`'s LocalNode and
against its bus.
"""

from __future__ import annotations

import random
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import canopen
import numpy as np

from benchmarks.node_bus import NodeBus
from benchmarks.node_download import block_download
from benchmarks.size import size
from coulombus.eds.codec import PDO
from coulombus.eds.reader import parse_eds, read_eds
from coulombus.kernels.decorator import Entry, kernel
from coulombus.kernels.records import new_records
from coulombus.node import core
from coulombus.node.device import Device
from coulombus.node.drive402 import DRIVE402
from coulombus.node.record import MAX_PDOS, NODE, new_nodes
from coulombus.wire.frame import Queue, data_word, new_queue

__all__ = ["expedited_us", "fuzz", "nodes"]

MOTOR = Path(__file__).resolve().parent.parent / "eds" / "motor.eds"
REQUEST = bytes.fromhex("4000100000000000")
CALLS, TURNS = size(3000, 100), size(9, 1)


class _Deaf(canopen.Network):  # type: ignore[misc]  # canopen has no types
    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:
        """Take the answer and do nothing with it."""


@kernel
def _upload(nodes: Any, word: int, calls: int, out: Any) -> int:
    """Let the node answer the request `calls` times, and return the number of responses."""
    answers = 0
    for k in range(calls):
        core.on_frame(nodes[0], 1000 + k, 0x601, 8, word, out[0])
        answers += out[0].count
        out[0].count = 0
    return answers


def expedited_us() -> tuple[float, float]:
    """Time of an expedited upload from the request to its response, in us: ours, LocalNode's.

    They take turns, each called as its bus calls it: ours by compiled code, LocalNode by Python. A call of
    ours by Python costs much more than the upload, for any identifier: NumPy writes the type of the
    node's record as text for each call that takes the record.
    """
    nodes = new_nodes(1)
    out = new_records(Queue)
    Device(read_eds(MOTOR), 1, DRIVE402, nodes[0]).power_on(0, out[0])
    out["count"] = 0
    upload = Entry(_upload)

    def ours() -> None:
        answers = upload(nodes, data_word(REQUEST), CALLS, out)
        if answers != CALLS:
            raise RuntimeError(f"{answers} responses to {CALLS} requests")

    local, network = canopen.LocalNode(1, str(MOTOR)), _Deaf()
    network.add_node(local)
    request = bytearray(REQUEST)

    def theirs() -> None:
        for _ in range(CALLS):
            local.sdo.on_request(0x601, request, 0.0)

    ours()
    times: tuple[list[float], list[float]] = ([], [])
    for _ in range(TURNS):
        for function, row in zip((ours, theirs), times, strict=True):
            row.append(_seconds(function) / CALLS * 1e6)
    return statistics.median(times[0]), statistics.median(times[1])


def _seconds(function: Callable[[], None]) -> float:
    begin = time.perf_counter()
    function()
    return time.perf_counter() - begin


def fuzz(frames: int, seed: int = 0) -> dict[str, int]:
    """Send random and mutated frames to a node in virtual time and return its counters.

    Any exception is a failure.
    """
    rng = random.Random(seed)
    nodes = new_nodes(1)
    out = new_queue()
    device = Device(parse_eds(MOTOR.read_bytes(), str(MOTOR)), 1, DRIVE402, nodes[0])
    device.power_on(0, out)
    handle, on_time = Entry(core.handle), Entry(core.on_time)
    row, t, answers = nodes.view(np.ndarray)[0], 0, 0
    for _ in range(frames):
        t += rng.randrange(50_000, 400_000)
        while row["next_ns"] < t:
            on_time(nodes[0], int(row["next_ns"]), out)
            answers += int(out["count"])
            out["count"] = 0
        can_id, data = random_frame(rng)
        word = data_word(data)
        if handle(nodes[0], t, can_id, len(data), word, out):
            device.service(t, can_id, len(data), word, out)
        answers += int(out["count"])
        out["count"] = 0
    names = ("dropped_length", "dropped_unknown", "emcy_count", "outbox_count")
    return {"answers": answers, "queue_dropped": int(out["dropped"]), **{name: int(row[name]) for name in names}}


_SDO = tuple(bytes.fromhex(text) for text in (
    "4000100000000000", "4008100000000000", "6000000000000000", "7000000000000000", "2b17100032000000",
    "2104200010000000", "0061626364656667", "1161626364656667", "a42110007f000000", "a300000000000000",
    "a27f7f0000000000", "a100000000000000", "c604200010000000", "0161626364656667", "8261626364656667",
    "c100000000000000", "8000000000000000", "2310100173617665", "231110016c6f6164", "2300140101020080",
    "2f00160000000000", "2300160108004060", "2f00160001000000", "2300140101020000", "2f05100080000040",
))  # fmt: skip
_IDS = (0x601, 0x601, 0x601, 0x601, 0x000, 0x080, 0x100, 0x201, 0x301, 0x7E5, 0x702, 0x701 | 1 << 30, 0x181 | 1 << 30)


def random_frame(rng: random.Random) -> tuple[int, bytes]:
    """Return a frame: of a service of the node, right, mutated or random, or of an identifier that
    may mean nothing.
    """
    can_id = rng.choice(_IDS) if rng.random() < 0.97 else rng.getrandbits(11)
    if can_id == 0x000:
        return can_id, bytes((rng.choice((1, 1, 1, 2, 128, 129, 130, rng.getrandbits(8))), rng.choice((0, 1, 2))))
    data = bytearray(rng.choice(_SDO) if can_id == 0x601 else rng.randbytes(rng.randrange(9)))
    if data and rng.random() < 0.3:
        data[rng.randrange(len(data))] = rng.getrandbits(8)
    if rng.random() < 0.02:
        data = data[: rng.randrange(9)]
    return can_id, bytes(data)


def nodes(show: Callable[..., None]) -> None:
    """Print the figures."""
    ours, theirs = expedited_us()
    show(
        "expedited SDO upload, request to response: ours against LocalNode's time",
        f"{ours / theirs:.3f}",
        "at most 0.5",
    )
    bus = NodeBus()
    content = random.Random(1).randbytes(1 << 20)
    transfer = bus.download(content)
    theory = len(content) / transfer.seconds / _block_rate(content)
    show(
        "1 MiB by SDO block download at 1 Mbit/s, of the rate of its segments back to back",
        f"{theory:.1%}",
        "at least 90 %",
    )
    show("... of the time the bus is busy", f"{transfer.busy:.1%}")
    _, transfer = bus.upload()
    show("1 MiB by SDO block upload: of the time the bus is busy", f"{transfer.busy:.1%}")
    cost = block_download()
    show(
        "a segment of a block download to a live node: processor time, of a frame's that nobody wants",
        f"{cost.segment_us / cost.unwanted_us:.1f}",
        f"at most 2 ({cost.segment_us:.0f} us; the frame is on the wire for 110 us and more)",
    )
    memory = NODE.itemsize + 2 * MAX_PDOS * PDO.itemsize
    show("memory of a node beside its object dictionary", f"{memory / 2**20:.2f} MiB", "at most 3 MiB")
    begin = time.perf_counter()
    result = fuzz(1_000_000)
    show("a million random and mutated frames: exceptions", "0", f"{time.perf_counter() - begin:.0f} s, {result}")


def _block_rate(content: bytes, bitrate: int = 1_000_000) -> float:
    """Bytes a second when nothing but the segments of `content` were on the bus."""
    from coulombus.wire.bits import data_frame_bits

    bits: Any = 0
    for k in range(0, len(content), 7):
        data = bytes((k // 7 % 127 + 1,)) + content[k : k + 7]
        bits += data_frame_bits(0x605, 8, data_word(data))
    return len(content) / (int(bits) / bitrate)
