"""SDO transfers: requests, aborts, missing responses, values not applied (CiA 301, 7.2.4)."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from coulombus.eds import sdo_forms as forms
from coulombus.eds.cia301 import Abort, abort_text
from coulombus.eds.sdo_answers import named
from coulombus.eds.sdo_channel import SdoChannel
from coulombus.eds.sdo_frames import where
from coulombus.explain.bus import SDO_RX, Bus
from coulombus.explain.device_errors import ABORT_CHECKS, error_text
from coulombus.wire.data_word import data_bytes

__all__ = ["SdoTransfers"]

ANSWER_NS = 1_000_000_000
"""Time after which a response is missing."""
REPEATED_NS = 2_000_000
IDLE_NS = 2_000_000_000
SCAN = 8
"""Number of unanswered node ids that make a scan."""
SETTINGS = (range(0x1005, 0x1008), range(0x1012, 0x1018), range(0x1400, 0x1C00))
OPTIONAL = (Abort.NO_OBJECT, Abort.NO_SUBINDEX, Abort.WRITE_ONLY)
READS = (forms.UPLOAD_INITIATE.phase, forms.BLOCK_UPLOAD_INITIATE.phase)
WRITES = (forms.DOWNLOAD_INITIATE.phase, forms.BLOCK_DOWNLOAD_INITIATE.phase)
INITIATED = (
    *(forms.UPLOAD_INITIATED.phase, forms.BLOCK_UPLOAD_INITIATED.phase),
    *(forms.DOWNLOAD_INITIATED.phase, forms.BLOCK_DOWNLOAD_INITIATED.phase),
)


@dataclass
class _Request:
    t_ns: int
    row: int
    data: bytes
    writes: bool
    index: int
    subindex: int
    value: int | None  # of an expedited download


@dataclass
class _Server:
    """One node's SDO server: its channel, and its pending responses."""

    channel: SdoChannel = field(default_factory=lambda: SdoChannel(None))
    request: _Request | None = None
    running: _Request | None = None  # a segmented or block transfer under way
    kind: str = ""  # of it
    last_ns: int = 0
    answer: bytes = b""
    answer_ns: int = -1
    written: dict[tuple[int, int], int] = field(default_factory=dict)
    unanswered: list[_Request] = field(default_factory=list)


class SdoTransfers:
    """Monitors the default SDO channel of every node."""

    def __init__(self, bus: Bus) -> None:
        self.bus, self.clues = bus, bus.clues
        self._servers: dict[int, _Server] = {}

    def frame(self, row: int, t_ns: int, key: int, word: int, length: int) -> None:
        """Process a request or a response."""
        if length != 8:
            return
        number, from_server = key & 0x7F, key < SDO_RX
        server = self._servers.setdefault(number, _Server())
        data = data_bytes(word, 8)
        says = server.channel.row(data, from_server)
        phase = says["phase"]
        if from_server:
            self.bus.node(number, t_ns)
            self.bus.canopen += 1
        if "code" in says:
            self._abort(row, t_ns, number, server, data, "the node" if from_server else "the client")
        elif not from_server and (phase in READS or phase in WRITES):
            self._request(number, server, _Request(t_ns, row, data, phase in WRITES, *named(data), _expedited(says)))
        elif phase in INITIATED:
            self._answer(row, t_ns, number, server, data)
        if server.running is not None and server.channel.transfer is None:
            self._done(t_ns, number, server.running)
            server.running = None
        server.last_ns = t_ns

    def look(self, t_ns: int) -> None:
        """Note responses overdue at a time."""
        for number, server in self._servers.items():
            request = server.request
            if request is not None and t_ns - request.t_ns > ANSWER_NS:
                self._silent(number, server, request)
                server.request = None
            if server.running is not None and t_ns - server.last_ns > IDLE_NS:
                self._unfinished(number, server, server.last_ns)

    def end(self, t_ns: int) -> None:
        """Note nodes that never existed."""
        absent = [number for number, server in self._servers.items() if number not in self.bus.nodes]
        for number in absent if len(absent) < SCAN else ():
            requests = self._servers[number].unanswered or [r for r in [self._servers[number].request] if r]
            if requests:
                number_of = "an SDO request" if len(requests) == 1 else f"{len(requests)} SDO requests"
                text = f"{number_of} to it, and no frame of it in the log"
                self.clues.begin("node_missing", number, requests[0].t_ns, text, row=requests[0].row)

    def _request(self, number: int, server: _Server, request: _Request) -> None:
        before = server.request
        if before is not None:
            if before.data == request.data and request.t_ns - before.t_ns < REPEATED_NS:
                return
            self._silent(number, server, before)
        if server.running is not None:
            self._unfinished(number, server, request.t_ns)
        server.request = request

    def _answer(self, row: int, t_ns: int, number: int, server: _Server, data: bytes) -> None:
        request, transfer = server.request, server.channel.transfer
        if request is None:
            self._second_answer(row, t_ns, number, server, data)
            return
        if named(data) != (request.index, request.subindex):
            return
        server.request, server.answer, server.answer_ns = None, data, t_ns
        self.clues.end_all("sdo_timeout", number, t_ns, "it answers again")
        if transfer is not None:
            server.running, server.kind = request, transfer.kind
            return
        if not request.writes:
            size = 4 - (data[0] >> 2 & 3) if data[0] & 1 else 4
            request.value = int.from_bytes(data[4 : 4 + size], "little")
        self._value(row, t_ns, number, server, request, request.value)
        self._done(t_ns, number, request)

    def _done(self, t_ns: int, number: int, request: _Request) -> None:
        subject = (request.index, request.subindex)
        for kind in ("sdo_abort", "sdo_refused_read", "sdo_incomplete"):
            self.clues.end(kind, number, t_ns, "a later transfer of it succeeded", subject=subject)

    def _value(self, row: int, t_ns: int, number: int, server: _Server, request: _Request, value: int | None) -> None:
        if value is None:
            return
        at = (request.index, request.subindex)
        node = self.bus.node(number, t_ns)
        if request.writes:
            server.written[at] = value
        elif any(request.index in some for some in SETTINGS) and at in server.written and node.booted_ns < t_ns:
            was = server.written[at]
            if value & ~(1 << 30) != was & ~(1 << 30) and node.objects.get(at) == was:
                text = f"{where(*at)} was written with {_number(was)} and confirmed; read back it is {_number(value)}"
                self.clues.begin("not_applied", number, t_ns, text, row=row, subject=at)
            else:
                self.clues.end("not_applied", number, t_ns, "it reads as written", subject=at)
        if at[0] == 0x1003 and at[1] and value and not request.writes:
            text = f"{where(*at)} (error history) has {error_text(value & 0xFFFF)}"
            self.clues.note("error_history", number, t_ns, text, row=row, subject=value)
        if at == (0x1000, 0):
            node.device_type = value
        if at[0] == 0x1016 and request.writes and at[1]:
            self.bus.host = value >> 16 & 0x7F or self.bus.host
        if 0x6000 <= at[0] < 0xA000 or at[0] == 0x603F:
            self.bus.words.append((row, t_ns, number, at[0], value))
            self._mode(row, t_ns, number, server, at, value, request.writes)
        if node.objects.get(at) != value:
            node.objects[at] = value
            self.bus.stale = True

    def _mode(
        self, row: int, t_ns: int, number: int, server: _Server, at: tuple[int, int], value: int, writes: bool
    ) -> None:
        """Compare a drive's displayed mode (6061h) with the written one (6060h)."""
        if (at[0] - 0x6000) % 0x800 != 0x61 or writes:
            return
        wish = server.written.get((at[0] - 1, 0))
        if wish is None:
            return
        if wish == value:
            self.clues.end("mode_refused", number, t_ns, "it shows the mode", subject=at[0])
        else:
            text = f"mode of operation {wish} was written, {where(*at)} shows {value}"
            self.clues.begin("mode_refused", number, t_ns, text, row=row, subject=at[0])

    def _second_answer(self, row: int, t_ns: int, number: int, server: _Server, data: bytes) -> None:
        if server.answer_ns < 0 or t_ns - server.answer_ns > 50_000_000:
            return
        if data == server.answer:
            if t_ns - server.answer_ns < REPEATED_NS:
                self.clues.note("repeated", number, t_ns, "an SDO answer came twice", row=row)
        elif data[1:4] == server.answer[1:4]:
            text = f"two answers that differ to one request of {self._object(number, server.answer)}"
            self.clues.begin("duplicate_node", number, t_ns, text, row=row, subject="sdo")

    def _abort(self, row: int, t_ns: int, number: int, server: _Server, data: bytes, by: str) -> None:
        code = int.from_bytes(data[4:8], "little")
        request = server.request or server.running
        server.request = server.running = None
        at = named(data)
        if code == Abort.TIMEOUT:
            if request is not None:
                server.unanswered.append(request)
            text = f"{self._object(number, request.data if request else data)}: {by} gave up waiting"
            self.clues.begin("sdo_timeout", number, request.t_ns if request else t_ns, text, row=row)
            return
        writes = request is not None and request.writes
        if by == "the node":
            self.clues.end_all("sdo_timeout", number, t_ns, "it answers again")
        kind = "sdo_refused_read" if not writes and code in OPTIONAL else "sdo_abort"
        verb = "write" if writes else "read"
        value = f" of {_number(request.value)}" if request is not None and request.value is not None else ""
        text = f"{by} refused the {verb}{value} of {self._object(number, data)}: {abort_text(code)}"
        if kind == "sdo_abort" and writes:
            clue = self.clues.begin(kind, number, t_ns, text, row=row, subject=at)
        else:
            clue = self.clues.note(kind, number, t_ns, text, row=row, subject=at if writes else None)
        clue.check = ABORT_CHECKS.get(code, "")

    def _silent(self, number: int, server: _Server, request: _Request) -> None:
        server.unanswered.append(request)
        if number in self.bus.nodes:
            text = f"no answer to the {'write' if request.writes else 'read'} of {self._object(number, request.data)}"
            self.clues.begin("sdo_timeout", number, request.t_ns, text, row=request.row)

    def _unfinished(self, number: int, server: _Server, t_ns: int) -> None:
        running = server.running
        assert running is not None
        text = f"the {server.kind} transfer of {self._object(number, running.data)} ends half way"
        subject = (running.index, running.subindex)
        self.clues.begin("sdo_incomplete", number, t_ns, text, row=running.row, subject=subject)
        server.running = None

    def _object(self, number: int, data: bytes) -> str:
        index, subindex = named(data)
        description = self.bus.describe(number)
        name = ""
        if description is not None and description.has(index, subindex):
            name = f" ({description.variable(index, subindex).name})"
        elif index in NAMES:
            name = f" ({NAMES[index]})"
        return where(index, subindex) + name


NAMES = {
    0x1000: "device type", 0x1001: "error register", 0x1003: "error history", 0x1005: "COB-ID SYNC",
    0x1006: "communication cycle period", 0x1010: "store parameters", 0x1011: "restore parameters",
    0x1014: "COB-ID EMCY", 0x1016: "consumer heartbeat time", 0x1017: "producer heartbeat time",
    0x1018: "identity", 0x1029: "error behaviour", 0x603F: "error code", 0x6040: "controlword",
    0x6041: "statusword", 0x6060: "modes of operation", 0x6061: "modes of operation display",
    0x6064: "position actual value", 0x6071: "target torque", 0x6072: "max torque", 0x607A: "target position",
    0x60FF: "target velocity", 0x6502: "supported drive modes",
    **{index: f"RPDO{index - 0x13FF} parameters" for index in range(0x1400, 0x1408)},
    **{index: f"RPDO{index - 0x15FF} map" for index in range(0x1600, 0x1608)},
    **{index: f"TPDO{index - 0x17FF} parameters" for index in range(0x1800, 0x1808)},
    **{index: f"TPDO{index - 0x19FF} map" for index in range(0x1A00, 0x1A08)},
}  # fmt: skip
"""Objects of CiA 301 and 402 by name, for nodes without an EDS file."""


def _expedited(says: dict[str, Any]) -> int | None:
    """Return the value of an expedited download, None for any other request."""
    value = says.get("value")
    return value if isinstance(value, int) else None


def _number(value: int | None) -> str:
    return "?" if value is None else f"{value} ({value:X}h)" if value > 9 else str(value)
