"""What a block download costs a live `coulombus node`, in processor time a frame, beside frames
that nobody on its bus wants.
"""

from __future__ import annotations

import binascii
import os
import random
import statistics
import struct
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from socket import socket

from benchmarks.node_bus import DOMAIN, EDS, NODE_ID
from coulombus.eds.cia301 import CobId
from coulombus.wire.address import parse_address
from coulombus.wire.handshake import connect

__all__ = ["Cost", "block_download"]

_FRAME = struct.Struct("=IB3x8s")
_RX, _TX, _UNWANTED = CobId.SDO_RX + NODE_ID, CobId.SDO_TX + NODE_ID, 0x7F0
_BLOCK = 127
_TIMEOUT_S = 30.0


@dataclass(frozen=True)
class Cost:
    """Processor time of the node's process [us a frame]: a segment of a block download, and a frame
    that nobody wants.
    """

    segment_us: float
    unwanted_us: float


def block_download(blocks: int = 60, turns: int = 5) -> Cost:
    """Measure it at 1 Mbit/s, in turns.

    Each turn sends `blocks` blocks of 127 frames of either sort, a response behind each.
    """
    content = random.Random(1).randbytes(7 * _BLOCK * blocks)
    with _node() as (bus, processor_ns):
        segments = _Client(bus)
        segments.download(content)

        def cost_us(send: Callable[[bytes], None]) -> float:
            before = processor_ns()
            send(content)
            return (processor_ns() - before) / (_BLOCK * blocks) * 1e-3

        rows = [(cost_us(segments.download), cost_us(segments.unwanted)) for _ in range(turns)]
    return Cost(*(statistics.median(column) for column in zip(*rows, strict=True)))


class _Client:
    def __init__(self, bus: socket) -> None:
        self._bus = bus

    def _ask(self, *requests: bytes) -> bytes:
        """Send frames as one message, and return the node's response to the last."""
        self._bus.send(b"".join(_FRAME.pack(_RX, 8, data) for data in requests))
        while True:
            for can_id, _, data in _FRAME.iter_unpack(self._bus.recv(1 << 16)):
                if can_id == _TX:
                    if data[0] == 0x80:
                        raise RuntimeError(f"aborted: {data.hex()}")
                    return bytes(data)

    def download(self, content: bytes) -> None:
        """Write the domain."""
        head = DOMAIN.to_bytes(2, "little") + b"\0"
        self._ask(b"\xc6" + head + len(content).to_bytes(4, "little"))
        parts = [content[at : at + 7] for at in range(0, len(content), 7)]
        for first in range(0, len(parts), _BLOCK):
            block = parts[first : first + _BLOCK]
            last = first + _BLOCK >= len(parts)
            numbers = [k + 1 | 0x80 * (last and k + 1 == len(block)) for k in range(len(block))]
            answer = self._ask(*(bytes((number,)) + part for number, part in zip(numbers, block, strict=True)))
            if answer[1] != len(block):
                raise RuntimeError(f"{answer[1]} segments acknowledged of {len(block)}")
        self._ask(b"\xc1" + binascii.crc_hqx(content, 0).to_bytes(2, "little") + bytes(5))

    def unwanted(self, content: bytes) -> None:
        """Send as many frames as a download of `content`, of an identifier that the node does not
        want.
        """
        segments = len(content) // 7
        for first in range(0, segments, _BLOCK):
            count = min(_BLOCK, segments - first)
            self._bus.send(b"".join(_FRAME.pack(_UNWANTED, 8, bytes(8)) for _ in range(count)))
            self._ask(b"\x40\x00\x10\x00\0\0\0\0")


@contextmanager
def _node() -> Iterator[tuple[socket, Callable[[], int]]]:
    """A live node on a bus of its own: a socket on it, and what its process has used of the
    processor [ns].
    """
    with tempfile.TemporaryDirectory() as directory:
        eds = Path(directory) / "domain.eds"
        eds.write_bytes(EDS)
        address = parse_address(f"coulombus:download-{os.getpid()}")
        words = ["node", str(eds), "--node-id", str(NODE_ID), "--bus", str(address), "--json"]
        process = subprocess.Popen(
            [sys.executable, "-m", "coulombus", *words], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )

        def processor_ns() -> int:
            tasks = Path(f"/proc/{process.pid}/task").iterdir()
            return sum(int((task / "schedstat").read_text().split()[0]) for task in tasks)

        try:
            assert process.stdout is not None
            process.stdout.readline()
            bus = connect(address)
            bus.settimeout(_TIMEOUT_S)
            with bus:
                yield bus, processor_ns
        finally:
            process.terminate()
            process.communicate()
