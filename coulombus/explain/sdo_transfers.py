"""SDO transfers: who did not answer, who did not wait, what was refused, and what is wrong (CiA 301, 7.2.4).

`eds.sdo_channel` decodes the frames of each node, with one transfer at a time as the standard has it. Requests that
do not wait, late answers and time-outs need stamps and the nodes' heartbeats: they are judged here.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from coulombus.eds import sdo_frames as forms
from coulombus.eds.cia301 import Abort, abort_text
from coulombus.eds.sdo_channel import NO_BEGINNING, SdoChannel
from coulombus.eds.sdo_frames import named, where
from coulombus.eds.sdo_joining import are_wrong
from coulombus.explain.bus import SDO_RX, Bus
from coulombus.explain.clues import Clue
from coulombus.explain.device_errors import ABORT_CHECKS
from coulombus.explain.written_objects import WrittenObjects, number_text
from coulombus.wire.clock import NEVER_NS
from coulombus.wire.data_word import data_bytes

__all__ = ["SdoTransfers"]

ANSWER_NS = 1_000_000_000
"""Time after which a response is missing."""
SOON_NS = 200_000_000
"""The same for a node that never sent a frame."""
LATE_NS = 10_000_000_000
"""Time after a request within which a response may still be its."""
WAITING_NS = 5_000_000_000
"""Time for which a client may wait for a node that is alive."""
PATIENT_NS = 500_000_000
"""A client that gives up sooner is impatient."""
REPEATED_NS = 2_000_000
IDLE_NS = 2_000_000_000
SCAN = 8
"""Number of unanswered node ids that make a scan."""
FEW = 3
STRAY = "it sends answers that no client waits for"
OVERLAP_NS = 100_000_000
"""Time after a request within which another one does not wait for its answer."""
IN_A_ROW = 3
"""Unanswered requests in a row to a node whose heartbeats go on: it does not hear."""
PROGRAMS = range(0x1F50, 0x1F58)
"""Programs of a device (CiA 302-3)."""
NODES_OWN = (Abort.MEMORY, Abort.HARDWARE)
"""Codes of a node that cannot do what it should, whoever asks."""
OPTIONAL = (Abort.NO_OBJECT, Abort.NO_SUBINDEX, Abort.WRITE_ONLY)
READS = (forms.UPLOAD_INITIATE.phase, forms.BLOCK_UPLOAD_INITIATE.phase)
WRITES = (forms.DOWNLOAD_INITIATE.phase, forms.BLOCK_DOWNLOAD_INITIATE.phase)
INITIATED_READS = (forms.UPLOAD_INITIATED.phase, forms.BLOCK_UPLOAD_INITIATED.phase)
INITIATED = (*INITIATED_READS, forms.DOWNLOAD_INITIATED.phase, forms.BLOCK_DOWNLOAD_INITIATED.phase)
UPSETS = ("sdo_abort", "sdo_refused_read", "sdo_incomplete", "sdo_data")
"""Kinds about an object that a later transfer of it ends."""


@dataclass
class _Request:
    t_ns: int
    row: int
    data: bytes
    writes: bool
    index: int
    subindex: int
    value: int | None  # of an expedited download
    repeated_ns: int = -1  # time at which the client sent it again
    has_wrong_data: bool = False  # size or CRC
    overlaps: bool = False  # another request of the channel was not answered yet
    left_ns: int = -1  # time at which the client asked for something else
    misanswered: bool = False  # an answer about another object came

    @property
    def at(self) -> tuple[int, int]:
        return self.index, self.subindex

    def fits(self, data: bytes, phase: str) -> bool:
        """Return whether a response is about its object and service."""
        return named(data) == self.at and self.writes == (phase not in INITIATED_READS)


@dataclass
class _Server:
    """One node's SDO server: its channel, and its pending responses."""

    channel: SdoChannel = field(default_factory=lambda: SdoChannel(None))
    waiting: list[_Request] = field(default_factory=list)
    abandoned: list[tuple[_Request, int]] = field(default_factory=list)
    """Requests without an answer, and the times at which the client gave up; -1: it did not."""
    aborted_ns: int = -1  # the last abort of the client
    running: _Request | None = None  # a segmented or block transfer under way
    kind: str = ""  # of it
    last_ns: int = 0
    last_by_server: bool = False
    answered: _Request | None = None  # the last one, and its answer
    answer: bytes = b""
    answer_ns: int = -1
    extra: int = 0  # answers that repeated requests still may have
    strays: int = 0  # answers that no client waits for, since the last request
    stray_ns: int = -1
    silent: list[_Request] = field(default_factory=list)
    """Unanswered requests since the last answer."""

    def leave(self, t_ns: int) -> None:
        """Note that the client does not wait any more."""
        self.abandoned = [(request, t_ns if left < 0 else left) for request, left in self.abandoned]


class SdoTransfers:
    """Monitors the default SDO channel of every node."""

    def __init__(self, bus: Bus) -> None:
        self.bus, self.clues, self._objects = bus, bus.clues, WrittenObjects(bus)
        self._servers: dict[int, _Server] = {}
        self._next_ns = NEVER_NS  # nothing is overdue before

    def frame(self, row: int, t_ns: int, key: int, word: int, length: int) -> None:
        """Process a request or a response."""
        if length != 8:
            return
        number, from_server = key & 0x7F, key < SDO_RX
        server = self._servers.setdefault(number, _Server())
        data = data_bytes(word, 8)
        says = server.channel.row(data, from_server)
        phase, remark = says["phase"], says.get("remark", "")
        if from_server:
            self.bus.node(number, t_ns)
            self.bus.canopen += 1
        if "code" in says:
            self._abort(row, t_ns, number, server, data, from_server)
        elif not from_server and (phase in READS or phase in WRITES):
            self._request(number, server, _Request(t_ns, row, data, phase in WRITES, *named(data), _expedited(says)))
        elif phase in INITIATED:
            self._answer(row, t_ns, number, server, data, phase)
        elif from_server and server.answered is not None and (server.running is None or remark == NO_BEGINNING):
            self._stray(row, t_ns, number, server, f"{phase[:1].lower()}{phase[1:]}")
        if are_wrong(remark):
            self._wrong_data(row, t_ns, number, server, remark)
        if server.running is not None and server.channel.transfer is None:
            if not server.running.has_wrong_data:
                self._done(t_ns, number, server.running)
            server.running = None
        server.last_ns, server.last_by_server = t_ns, from_server
        if server.running is not None:
            self._next_ns = min(self._next_ns, t_ns + IDLE_NS)

    def note_overdue(self, t_ns: int) -> None:
        """Note responses overdue at a time."""
        if t_ns <= self._next_ns:
            return
        self._next_ns = NEVER_NS
        for number, server in self._servers.items():
            for request in list(server.waiting):
                due_ns = self._due_ns(number, request, t_ns)
                if t_ns > due_ns:
                    server.waiting.remove(request)
                    self._gave_up(number, server, request, due_ns, "no answer comes", waits=request.left_ns < 0)
                else:
                    self._next_ns = min(self._next_ns, due_ns)
            if server.running is not None:
                if t_ns > server.last_ns + IDLE_NS:
                    self._unfinished(number, server, server.last_ns)
                else:
                    self._next_ns = min(self._next_ns, server.last_ns + IDLE_NS)

    def _due_ns(self, number: int, request: _Request, t_ns: int) -> int:
        """Return the time [ns] at which a response is overdue, as far as it is known at `t_ns`.

        A client that neither asks again nor for something else may wait for a node that is alive.
        """
        due_ns = request.t_ns + ANSWER_NS
        if request.repeated_ns >= 0:
            return max(due_ns, min(request.repeated_ns, due_ns) + ANSWER_NS)
        node = self.bus.nodes.get(number)
        if t_ns <= due_ns or request.left_ns >= 0 or node is None:
            return max(due_ns, request.left_ns)
        beats = node.heartbeat_ns > request.t_ns or 0 <= due_ns - node.heartbeat_ns < 2 * node.period_ns
        return request.t_ns + WAITING_NS if beats or request.index in PROGRAMS else due_ns

    def missing(self) -> list[Clue]:
        """Return the nodes that were asked and never sent a frame, but for those of a scan."""
        unanswered = {n: self._unanswered(server) for n, server in self._servers.items() if n not in self.bus.nodes}
        absent = [n for n, requests in unanswered.items() if requests]
        clues = []
        for number in absent if len(absent) < SCAN else ():
            requests = unanswered[number]
            number_of = "an SDO request" if len(requests) == 1 else f"{len(requests)} SDO requests"
            text, first = f"{number_of} to it, and no frame of it in the log", requests[0]
            clues.append(Clue("node_missing", number, first.t_ns, text, due_ns=first.t_ns, rows=[first.row]))
        return clues

    def _is_scan(self) -> bool:
        """Return whether so many node ids are asked in vain that a client looks for nodes."""
        return sum(bool(server.silent) for n, server in self._servers.items() if n not in self.bus.nodes) >= SCAN

    def _unanswered(self, server: _Server) -> list[_Request]:
        return [*server.silent, *(r for r in server.waiting if self.bus.last_ns - r.t_ns > SOON_NS)]

    def _request(self, number: int, server: _Server, request: _Request) -> None:
        for before in server.waiting:
            if before.data == request.data:
                if request.t_ns - max(before.t_ns, before.repeated_ns) > REPEATED_NS:
                    before.repeated_ns = request.t_ns
                    server.extra += 1
                return
        request.overlaps = any(request.t_ns - before.t_ns < OVERLAP_NS for before in server.waiting)
        server.leave(request.t_ns)
        for before in server.waiting:
            before.left_ns = request.t_ns if before.left_ns < 0 else before.left_ns
            self._next_ns = min(self._next_ns, before.t_ns + ANSWER_NS)
        if server.answered is not None and server.running is None:
            self.clues.end("sdo_not_taken", number, server.answer_ns, "the client took a later answer")
        if server.running is not None:
            self._unfinished(number, server, request.t_ns)
        server.waiting.append(request)
        server.strays = 0
        self._next_ns = min(self._next_ns, request.t_ns + ANSWER_NS)

    def _answer(self, row: int, t_ns: int, number: int, server: _Server, data: bytes, phase: str) -> None:
        request = next((pending for pending in server.waiting if pending.fits(data, phase)), None)
        if request is None:
            self._unasked(row, t_ns, number, server, data, phase)
            return
        transfer = server.channel.transfer
        server.waiting.remove(request)
        self._answered(t_ns, number, server, request, data)
        if request.repeated_ns >= 0 and self.bus.nodes[number].since_ns < request.t_ns:
            again, took = (request.repeated_ns - request.t_ns) / 1e6, (t_ns - request.t_ns) / 1e6
            text = f"{self._object(number, data)} was asked again after {again:.0f} ms, its answer came after {took:.0f} ms"
            self.clues.note("sdo_repeated", number, request.repeated_ns, text, row=request.row)
        if request.overlaps:
            text = f"{self._object(number, data)} was asked while another request had no answer yet"
            self.clues.note("sdo_overlap", number, request.t_ns, text, row=request.row)
        if transfer is not None and transfer.place == request.at:
            server.running, server.kind = request, transfer.kind
            return
        if not request.writes:
            size = 4 - (data[0] >> 2 & 3) if data[0] & 1 else 4
            request.value = int.from_bytes(data[4 : 4 + size], "little")
        if request.value is not None:
            self._objects.add(row, t_ns, number, request.at, request.value, writes=request.writes)
        self._done(t_ns, number, request)

    def _answered(self, t_ns: int, number: int, server: _Server, request: _Request, data: bytes) -> None:
        """Note that a request has its answer."""
        server.answered, server.answer, server.answer_ns = request, data, t_ns
        server.silent.clear()
        self.bus.node(number, t_ns).sdo_response.add(t_ns - request.t_ns)
        for kind in ("sdo_timeout", "sdo_wrong_object", "not_hearing"):
            self.clues.end_all(kind, number, t_ns, "it answers again")

    def _done(self, t_ns: int, number: int, request: _Request) -> None:
        self.bus.node(number, t_ns).transfers += 1
        for kind in UPSETS:
            self.clues.end(kind, number, t_ns, "a later transfer of it succeeded", subject=request.at)

    def _unasked(self, row: int, t_ns: int, number: int, server: _Server, data: bytes, phase: str) -> None:
        """Process an answer for which no request waits: late, second, about another object, or stray."""
        since_ns = t_ns - server.answer_ns if server.answer_ns >= 0 else LATE_NS
        late = next((pair for pair in server.abandoned if pair[0].fits(data, phase)), None)
        if late is not None and t_ns - late[0].t_ns < LATE_NS:
            server.abandoned.remove(late)
            self._late(t_ns, number, server, *late, data)
        elif data == server.answer and since_ns < REPEATED_NS:
            self.clues.note("repeated", number, t_ns, "an SDO answer came twice", row=row)
        elif server.extra and data[1:4] == server.answer[1:4] and since_ns < ANSWER_NS:
            server.extra -= 1
        elif data[1:4] == server.answer[1:4] and since_ns < 50_000_000:
            text = f"two answers that differ to one request of {self._object(number, server.answer)}"
            self.clues.begin("duplicate_node", number, t_ns, text, row=row, subject="sdo")
        elif server.waiting:
            request = server.waiting[-1]
            request.misanswered = True
            text = f"asked about {where(*request.at)}, it answered about {self._object(number, data)}"
            self.clues.begin("sdo_wrong_object", number, request.t_ns, text, row=row)
        elif server.answered is not None:
            self._stray(row, t_ns, number, server, f"about {self._object(number, data)}")

    def _stray(self, row: int, t_ns: int, number: int, server: _Server, what: str) -> None:
        server.strays += 1
        server.stray_ns = t_ns if server.strays == 1 else server.stray_ns
        self.clues.note("sdo_stray", number, t_ns, f"{STRAY}, the first one {what}", row=row)

    def _late(self, t_ns: int, number: int, server: _Server, request: _Request, gave_up_ns: int, data: bytes) -> None:
        """Note an answer after the client gave up."""
        took, waited = t_ns - request.t_ns, gave_up_ns - request.t_ns
        self._answered(t_ns, number, server, request, data)
        if gave_up_ns < 0:
            return  # the client waited
        text = f"{self._object(number, data)}: the answer came after {took / 1e6:.4g} ms, the client gave up after {waited / 1e6:.4g} ms"
        clue = self.clues.begin("sdo_late", number, request.t_ns, text, row=request.row, subject=request.at)
        clue.who = "client" if waited < PATIENT_NS else "node"
        self.clues.end("sdo_late", number, t_ns, "it answered", subject=request.at)

    def _abort(self, row: int, t_ns: int, number: int, server: _Server, data: bytes, by_server: bool) -> None:
        code, at = int.from_bytes(data[4:8], "little"), named(data)
        request = next((r for r in server.waiting if r.at == at), None)
        request = request or (server.waiting[-1] if server.waiting else None)
        running, server.running = server.running, None
        if request is not None:
            server.waiting.remove(request)
        if not by_server:
            server.aborted_ns = t_ns
            server.leave(t_ns)
        if code == Abort.TIMEOUT:
            if by_server:
                text = f"{self._object(number, data)}: the node waited for the client, which did not go on"
                self.clues.begin("sdo_not_taken", number, t_ns, text, row=row)
            else:
                self._timed_out(row, t_ns, number, server, request, running)
            return
        request = request or running
        if by_server and request is None and server.extra and data[1:4] == server.answer[1:4]:
            server.extra -= 1  # the answer to a request that was repeated
            return
        if (
            by_server
            and request is None
            and 0 <= server.aborted_ns == server.last_ns
            and t_ns - server.last_ns < ANSWER_NS
        ):
            return  # the client gave the transfer up just before
        if by_server and request is not None:
            self._answered(t_ns, number, server, request, data)
        writes = request is not None and request.writes
        if not by_server:
            text = f"{self._object(number, data)}: {abort_text(code)}"
            clue = self.clues.note("sdo_client_abort", number, t_ns, text, row=row)
            clue.who = "node" if code == Abort.TOGGLE and server.last_by_server else ""
            return
        kind = "sdo_refused_read" if not writes and code in OPTIONAL else "sdo_abort"
        verb = "write" if writes else "read" if request is not None else "transfer"
        value = f" of {number_text(request.value)}" if request is not None and request.value is not None else ""
        text = f"the node refused the {verb}{value} of {self._object(number, data)}: {abort_text(code)}"
        if kind == "sdo_abort" and writes:
            clue = self.clues.begin(kind, number, t_ns, text, row=row, subject=at)
        else:
            clue = self.clues.note(kind, number, t_ns, text, row=row, subject=at if writes else None)
        clue.check = ABORT_CHECKS.get(code, "")
        clue.who = "node" if code in NODES_OWN else ""

    def _timed_out(
        self, row: int, t_ns: int, number: int, server: _Server, request: _Request | None, running: _Request | None
    ) -> None:
        """Process the client's abort because of a time-out: who waited for whom?"""
        if request is not None:
            self._gave_up(
                number, server, request, t_ns, f"the client gave up after {(t_ns - request.t_ns) / 1e6:.4g} ms"
            )
        elif server.strays >= FEW:
            clue = self.clues.begin("sdo_stray", number, server.stray_ns, STRAY, row=row)
            clue.text = f"{STRAY} ({server.strays}), and its client gives up"
        elif running is not None and (server.kind == "block" or not server.last_by_server):
            self._gave_up(number, server, running, t_ns, "the client gave up within the transfer")
        elif server.answered is not None and t_ns - server.answer_ns < LATE_NS:
            answered = server.answered
            took, waited = (server.answer_ns - answered.t_ns) / 1e6, (t_ns - answered.t_ns) / 1e6
            text = f"{self._object(number, answered.data)}: answered after {took:.4g} ms, and the client gave up after {waited:.4g} ms"
            self.clues.begin("sdo_not_taken", number, answered.t_ns, text, row=row)
            server.answered = None

    def _gave_up(
        self, number: int, server: _Server, request: _Request, t_ns: int, how: str, *, waits: bool = False
    ) -> None:
        """Note a request without an answer; `waits`: nothing says that the client does not wait for it."""
        server.abandoned = [*server.abandoned[-3:], (request, -1 if waits and request.repeated_ns < 0 else t_ns)]
        if request.misanswered:
            return
        server.silent.append(request)
        if not self.bus.present(number, request.t_ns) or (server.answered is None and self._is_scan()):
            return
        node = self.bus.nodes[number]
        beats = node.heartbeat_ns > request.t_ns or (node.period_ns and t_ns - node.heartbeat_ns < 2 * node.period_ns)
        alive = "; its heartbeats go on" if beats else ""
        verb = "write" if request.writes else "read"
        text = f"{verb} of {self._object(number, request.data)}: {how}{alive}"
        clue = self.clues.begin("sdo_timeout", number, request.t_ns, text, row=request.row)
        clue.check = (
            "Ask again with a longer time-out: the node lives, so plug and cable are not the first suspects."
            if alive
            else ""
        )
        first = server.silent[0]
        if len(server.silent) >= IN_A_ROW and beats and node.heartbeat_ns > first.t_ns:
            text = f"{len(server.silent)} SDO requests in a row have no answer, and its heartbeats go on"
            if not self.clues.stands("not_hearing", number):
                self.clues.begin("not_hearing", number, first.t_ns, text, row=first.row)

    def _unfinished(self, number: int, server: _Server, t_ns: int) -> None:
        running = server.running
        assert running is not None
        text = f"the {server.kind} transfer of {self._object(number, running.data)} ends half way"
        clue = self.clues.begin("sdo_incomplete", number, t_ns, text, row=running.row, subject=running.at)
        clue.who = "client" if server.last_by_server and server.kind != "block" else "node"
        server.running = None

    def _wrong_data(self, row: int, t_ns: int, number: int, server: _Server, remark: str) -> None:
        """Note a transfer whose size or CRC is wrong."""
        request = server.running or server.answered
        if request is None:
            return
        request.has_wrong_data = True
        verb = "write" if request.writes else "read"
        text = f"{verb} of {self._object(number, request.data)}: {remark}"
        clue = self.clues.begin("sdo_data", number, t_ns, text, row=row, subject=request.at)
        clue.who = "client" if request.writes else "node"

    def _object(self, number: int, data: bytes) -> str:
        return self.bus.object_text(number, *named(data))


def _expedited(says: dict[str, Any]) -> int | None:
    """Return the value of an expedited download, None for any other request."""
    value = says.get("value")
    return value if isinstance(value, int) else None
