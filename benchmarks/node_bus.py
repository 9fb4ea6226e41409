"""One node and one SDO client on an exact bus in virtual time: how much of the bus a block transfer
uses.
"""

from __future__ import annotations

import binascii
from dataclasses import dataclass
from typing import Any

from coulombus.eds.cia301 import CobId
from coulombus.eds.reader import parse_eds
from coulombus.kernels.decorator import kernel
from coulombus.node import core
from coulombus.node.device import Device
from coulombus.node.kinds import GENERIC
from coulombus.node.record import new_nodes
from coulombus.sim_bus.can_bus.arbiter import end_frame, new_bus, start_frame, start_ns
from coulombus.wire.frame import data_bytes, data_word, frames, new_queue, push

__all__ = ["DOMAIN", "NodeBus", "Transfer"]

DOMAIN = 0x2000
NODE_ID = 5
_CLIENT = 16
_RX, _TX = CobId.SDO_RX + NODE_ID, CobId.SDO_TX + NODE_ID
_IDLE, _SERVICE, _HEARD = 0, 1, 2

EDS = b"""[DeviceInfo]
VendorName=benchmark

[1000]
ParameterName=Device type
ObjectType=7
DataType=7
AccessType=ro
DefaultValue=0

[2000]
ParameterName=A domain
ObjectType=7
DataType=15
AccessType=rw
"""


@kernel
def _carry(bus: Any, out: Any, log: Any, node: Any, until_ns: int) -> int:
    """Go on until `until_ns` (0), or until the frame in `log[0]` is for Python's half of the node
    (1) or for the client (2).
    """
    while True:
        start = start_ns(bus[0], out)
        due = node.next_ns
        if min(start, due) > until_ns:
            return _IDLE
        if due < start:
            core.on_time(node, due, out)
            continue
        start_frame(bus[0], out, start)
        while node.next_ns < bus[0].end_ns:
            core.on_time(node, node.next_ns, out)
        end_frame(bus[0], log, 0)
        f = log[0]
        if f.source != _CLIENT:
            return _HEARD
        if core.on_frame(node, f.t_ns, f.can_id, f.length, f.word, out):
            return _SERVICE


@dataclass(frozen=True)
class Transfer:
    """What a transfer took in virtual time; `busy` is the part of it in which the bus carried a
    frame.
    """

    seconds: float
    busy: float
    frames: int


class NodeBus:
    """A node that is powered on, its bus of `bitrate_bit_s`, and a client that answers at once."""

    def __init__(self, bitrate_bit_s: int = 1_000_000) -> None:
        self._node = new_nodes(1)[0]
        self._out = new_queue()
        self._bus, self._log = new_bus(bitrate_bit_s), frames(1)
        eds = parse_eds(EDS, "benchmark.eds")
        self.device = Device(eds, NODE_ID, GENERIC, self._node)
        self.device.power_on(0, self._out)
        self._t = 1_000_000
        while self._step() != _IDLE:
            pass

    def _step(self) -> int:
        arguments = (self._bus, self._out, self._log, self._node)
        why = int(_carry(*arguments, self._t))
        if why != _IDLE:
            f = self._log[0]
            self._t = max(self._t, int(f["t_ns"]))
            if why == _SERVICE:
                frame = (int(f["t_ns"]), int(f["can_id"]), int(f["length"]), int(f["word"]))
                self.device.service(*frame, self._out)
        return why

    def _send(self, data: bytes) -> None:
        push(self._out, _CLIENT, self._t, _RX, 8, data_word(data))

    def _hear(self) -> bytes:
        """Let time pass until the node answers."""
        while True:
            why = self._step()
            if why == _HEARD and self._log[0]["can_id"] == _TX:
                answer = data_bytes(int(self._log[0]["word"]), 8)
                if answer[0] == 0x80:
                    raise RuntimeError(f"aborted: {answer.hex()}")
                return answer
            if why == _IDLE:
                self._t += 100_000

    def _measured(self, start_ns: int, frames_before: int, bits_before: int) -> Transfer:
        bus, seconds = self._bus[0], (self._t - start_ns) * 1e-9
        bits = int(bus["bits"]) - bits_before
        return Transfer(seconds, bits / int(bus["bit_rate"]) / seconds, int(bus["frames"]) - frames_before)

    def download(self, content: bytes) -> Transfer:
        """Write the domain by a block download with CRC."""
        begin = (self._t, int(self._bus[0]["frames"]), int(self._bus[0]["bits"]))
        head = DOMAIN.to_bytes(2, "little") + b"\0"
        self._send(b"\xc6" + head + len(content).to_bytes(4, "little"))
        size, position = self._hear()[4], 0
        segments = -(-len(content) // 7)
        while position < segments:
            for number in range(1, min(size, segments - position) + 1):
                at = 7 * (position + number - 1)
                last = position + number == segments
                self._send(bytes((number | 0x80 * last,)) + content[at : at + 7])
            answer = self._hear()
            position, size = position + answer[1], answer[2]
        crc = binascii.crc_hqx(content, 0).to_bytes(2, "little")
        self._send(bytes((0xC1 | (7 * segments - len(content)) << 2,)) + crc)
        self._hear()
        return self._measured(*begin)

    def upload(self) -> tuple[bytes, Transfer]:
        """Read the domain by a block upload with CRC."""
        begin = (self._t, int(self._bus[0]["frames"]), int(self._bus[0]["bits"]))
        self._send(b"\xa4" + DOMAIN.to_bytes(2, "little") + b"\0\x7f")
        self._hear()
        self._send(b"\xa3")
        content = bytearray()
        while True:
            answer = self._hear()
            content += answer[1:]
            if answer[0] & 0x80 or answer[0] == 127:
                self._send(bytes((0xA2, answer[0] & 0x7F, 127)))
                if answer[0] & 0x80:
                    break
        end = self._hear()
        self._send(b"\xa1")
        del content[len(content) - (end[0] >> 2 & 7) :]
        if int.from_bytes(end[1:3], "little") != binascii.crc_hqx(content, 0):
            raise RuntimeError("the CRC differs")
        return bytes(content), self._measured(*begin)
