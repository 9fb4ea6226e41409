"""SDO client on a link: sequential transfers with one node, or with several nodes in parallel.

`BusAnswers` detects two devices with the same node id, for bring-up, `sdo`, `scan` and the check of free
node ids.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from typing import Generic, TypeVar

from coulombus.eds.cia301 import Abort, CobId
from coulombus.eds.sdo_answers import SdoAnswers
from coulombus.eds.sdo_frames import named, where
from coulombus.host.errors import HostError
from coulombus.host.sdo.transfers import (
    APART,
    MOST_BYTES,
    DuplicateNodeId,
    Progress,
    SdoProtocolError,
    SdoSilent,
    Transfer,
    abort,
    download,
    upload,
)
from coulombus.wire.bus_link import BusFrame, FrameLink

__all__ = [
    "LATE_S",
    "STORING_S",
    "TIMEOUT_S",
    "BusAnswers",
    "SdoClient",
    "SdoSession",
    "load_defaults",
    "run_transfers",
    "store_parameters",
]

MESSAGE_BYTES = 8
"""Bytes of an SDO message (CiA 301, section 7.2.4.3)."""


class BusAnswers:
    """Requests of one client to each node, and the responses (`eds.sdo_answers`)."""

    def __init__(self) -> None:
        self._nodes: defaultdict[int, SdoAnswers] = defaultdict(SdoAnswers)

    def node(self, node_id: int) -> SdoAnswers:
        """Return the answers of one node."""
        return self._nodes[node_id]

    def hear(self, frame: BusFrame) -> None:
        """Handle a frame that no transfer waits for; only SDO responses of requested nodes count."""
        node_id = frame.can_id - CobId.SDO_TX
        if node_id in self._nodes and frame.length == MESSAGE_BYTES:
            self._nodes[node_id].add_answer(frame.data)

    def listen(self, link: FrameLink, until_ns: int) -> None:
        """Handle all frames until `until_ns`: a second device may answer later."""
        while (frame := link.receive(until_ns)) is not None:
            self.hear(frame)

    @property
    def duplicate_node_ids(self) -> tuple[int, ...]:
        """The node ids with answers of two devices."""
        return tuple(node_id for node_id, answers in sorted(self._nodes.items()) if answers.duplicate_node_id)


T = TypeVar("T")
TIMEOUT_S = 1.0
"""Time-out of an answer."""
STORING_S = 10.0
"""Time-out of a write to 1010h or 1011h: flash takes seconds."""
STORING = (0x1010, 0x1011)
LATE_S = 2.0
"""Time of listening after a time-out, to distinguish a late answer from none."""
SETTLE_S = 0.02
"""Longest delay of a second device's answer to the last request."""


class SdoSession(Generic[T]):
    """An active transfer with one node.

    Attributes
    ----------
    done : whether it has ended, with `value` or with `error`
    odd_length : length of the last frame whose length is not eight bytes; None without one
    deadline_ns : time by which the node must answer
    """

    def __init__(
        self, link: FrameLink, node_id: int, transfer: Transfer[T], timeout_ns: int, answers: SdoAnswers
    ) -> None:
        self._link, self._node_id, self._transfer, self._timeout_ns = link, node_id, transfer, timeout_ns
        self._answers = answers
        self._object: tuple[int, int] | None = None
        self.done, self.deadline_ns = False, 0
        self.odd_length: int | None = None
        self.error: HostError | None = None
        self.value: T | None = None
        self._go_on()

    def hear(self, message: bytes) -> None:
        """Handle a message of the server."""
        if self._answers.add_answer(message):
            self._go_on(message)

    def check_timeout(self, now_ns: int) -> None:
        """End the transfer after the server's time-out."""
        if self.done or now_ns < self.deadline_ns:
            return
        if again := self._answers.again:  # no other answer came, so the repeated frame was the answer
            self._answers.again = b""
            self._go_on(again)
            return
        text, stray = f"node {self._node_id} does not answer (SDO of {where(*self._place)})", self._answers.stray
        self._send(abort(*self._place, Abort.TIMEOUT))
        if stray:
            about = where(*named(stray))
            reason = f"it answers about {about}"
            self._end(SdoProtocolError(f"{text}, but about {about}: {APART}", Abort.TIMEOUT, reason))
        elif self.odd_length is not None:
            reason = f"it answers with {self.odd_length} bytes; an SDO message has {MESSAGE_BYTES} (CiA 301)"
            text = f"node {self._node_id}, SDO of {where(*self._place)}: {reason}"
            self._end(SdoProtocolError(text, Abort.TIMEOUT, reason))
        else:
            self._end(SdoSilent(text))

    def leave(self) -> None:
        """Abort the transfer if it has not ended: the server would wait for it."""
        if not self.done:
            with suppress(OSError):
                self._send(abort(*self._place))
            self._transfer.close()
            self.done = True

    @property
    def _place(self) -> tuple[int, int]:
        return self._object or (0, 0)

    def _go_on(self, answer: bytes | None = None) -> None:
        """Begin the transfer, or continue it with an answer, up to its next wait or its end."""
        try:
            step = next(self._transfer) if answer is None else self._transfer.send(answer)
            while True:
                for message in step.messages:
                    self._object = self._object or named(message)
                    self._send(message, initiates=step.initiates)
                if step.waits:
                    break
                step = self._transfer.send(b"")
            self.deadline_ns = self._link.now_ns() + self._timeout_ns
        except StopIteration as stop:
            self.value, self.done = stop.value, True
        except SdoProtocolError as error:
            self._send(abort(*self._place, error.code))
            self._end(error)
        except HostError as error:
            self._end(error)

    def _end(self, error: HostError) -> None:
        self.error, self.done = error, True

    def _send(self, message: bytes, *, initiates: bool = False) -> None:
        if initiates:
            self._answers.ask(message)
        else:
            self._answers.sent()
        self._link.send(CobId.SDO_RX + self._node_id, message)


def run_transfers(
    link: FrameLink,
    transfers: Mapping[int, Iterator[Transfer[T]]],
    timeout_s: float,
    on_result: Callable[[int, T | HostError], None],
    answers: BusAnswers,
    hear: Callable[[BusFrame], None] | None = None,
) -> None:
    """Run transfers sequentially per node, nodes in parallel.

    Parameters
    ----------
    transfers : the transfers of each node id
    on_result : called with (node id, value or error) at the end of each transfer
    answers : requests and responses so far
    hear : handles the frames that no transfer waits for, instead of `answers`
    """
    hear = hear or answers.hear
    waiting = {node_id: iter(row) for node_id, row in transfers.items()}
    sessions: dict[int, SdoSession[T]] = {}

    def begin(node_id: int) -> None:
        transfer = next(waiting[node_id], None)
        sessions.pop(node_id, None)
        if transfer is not None:
            sessions[node_id] = SdoSession(link, node_id, transfer, round(timeout_s * 1e9), answers.node(node_id))

    try:
        for node_id in waiting:
            begin(node_id)
        while sessions:
            frame = link.receive(min(session.deadline_ns for session in sessions.values()))
            if frame is not None:
                session = sessions.get(frame.can_id - CobId.SDO_TX)
                if session is None:
                    hear(frame)
                elif frame.length == MESSAGE_BYTES:
                    session.hear(frame.data)
                else:
                    session.odd_length = frame.length
            now_ns = link.now_ns()
            for node_id, session in list(sessions.items()):
                session.check_timeout(now_ns)
                if session.done:
                    on_result(node_id, session.error or session.value)  # type: ignore[arg-type]  # one of the two is set
                    begin(node_id)
    finally:
        for session in sessions.values():
            session.leave()


class SdoClient:
    """The client of one node.

    Parameters
    ----------
    timeout_s : time-out of an answer [s]
    storing_s : time-out of a write to 1010h or 1011h, if longer [s]
    late_s : time of listening after a time-out, to report a late answer [s]
    answers : shared by the clients of several nodes on one link, which receive each other's late answers
    """

    def __init__(
        self,
        link: FrameLink,
        node_id: int,
        timeout_s: float = TIMEOUT_S,
        *,
        storing_s: float = STORING_S,
        late_s: float = 0.0,
        answers: BusAnswers | None = None,
    ) -> None:
        self.link, self.node_id, self.timeout_s = link, node_id, timeout_s
        self._storing_s, self._late_s = max(timeout_s, storing_s), late_s
        self._answers = answers or BusAnswers()

    def upload(
        self,
        index: int,
        subindex: int,
        *,
        most: int = MOST_BYTES,
        unsized: Callable[[bytes], bytes] = bytes,
        progress: Progress = lambda done, total: None,
    ) -> bytes:
        """Return the bytes of an object (`host.sdo.transfers.upload`).

        Raises
        ------
        SdoSilent
            (exit status 5) the node does not answer
        SdoRefused
            (6) the node aborted the transfer
        SdoProtocolError
            (6) the node's answer is not valid
        DuplicateNodeId
            (3) two devices have this node id
        """
        transfer = upload(index, subindex, most=most, unsized=unsized, progress=progress)
        return self._do((index, subindex), transfer, self.timeout_s)

    def download(
        self, index: int, subindex: int, data: bytes, *, progress: Progress = lambda done, total: None
    ) -> None:
        """Write an object; raises as `upload`."""
        timeout_s = self._storing_s if index in STORING else self.timeout_s
        self._do((index, subindex), download(index, subindex, data, progress=progress), timeout_s)

    def settle(self) -> None:
        """Wait for a second answer to the last request; raises `DuplicateNodeId` as `upload`."""
        self._answers.listen(self.link, self.link.now_ns() + round(SETTLE_S * 1e9))
        self._refuse_duplicate()

    def _do(self, place: tuple[int, int], transfer: Transfer[T], timeout_s: float) -> T:
        self._answers.listen(self.link, self.link.now_ns())  # late answers, for which no transfer waits
        self._refuse_duplicate()
        results: list[T | HostError] = []
        run_transfers(
            self.link,
            {self.node_id: iter((transfer,))},
            timeout_s,
            lambda _, result: results.append(result),
            self._answers,
        )
        self._refuse_duplicate()
        (result,) = results
        if isinstance(result, SdoSilent):
            self._refuse_late(place, timeout_s)
        if isinstance(result, HostError):
            raise result
        return result

    def _refuse_late(self, place: tuple[int, int], timeout_s: float) -> None:
        begin_ns = self.link.now_ns()
        while (frame := self.link.receive(begin_ns + round(self._late_s * 1e9))) is not None:
            self._answers.hear(frame)
            if (
                frame.can_id == CobId.SDO_TX + self.node_id
                and frame.length == MESSAGE_BYTES
                and named(frame.data) == place
            ):
                seconds = timeout_s + (frame.t_ns - begin_ns) / 1e9
                raise SdoSilent(
                    f"node {self.node_id} answers late: after {seconds:.1f} s (SDO of {where(*place)}), "
                    f"and {timeout_s:g} s are allowed; --timeout gives it longer"
                )

    def _refuse_duplicate(self) -> None:
        answers = self._answers.node(self.node_id)
        if answers.duplicate_node_id:
            place = where(*named(answers.second))
            raise DuplicateNodeId(
                f"two devices answer as node {self.node_id} (SDO of {place}): one request has two answers; {APART}",
                Abort.GENERAL,
            )


def store_parameters(link: FrameLink, node_id: int, part: int = 1, timeout_s: float = STORING_S) -> None:
    """Store a node's parameters permanently: 1010h, "save" (part 1: all, 2: communication, 3:
    application). Raises as `SdoClient.upload`.
    """
    _storing(link, node_id, timeout_s).download(0x1010, part, b"save")


def load_defaults(link: FrameLink, node_id: int, part: int = 1, timeout_s: float = STORING_S) -> None:
    """Restore a node's default parameters, from its next reset on: 1011h, "load". Raises as
    `SdoClient.upload`.
    """
    _storing(link, node_id, timeout_s).download(0x1011, part, b"load")


def _storing(link: FrameLink, node_id: int, timeout_s: float) -> SdoClient:
    return SdoClient(link, node_id, timeout_s, storing_s=timeout_s, late_s=LATE_S)
