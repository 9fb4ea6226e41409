"""Answers of a node to one SDO client: detects repeated frames, and two devices with the same node id.

CAN delivers a frame twice if the last bit of its end is disturbed: its receivers have it already,
and its sender repeats it. So an answer that is identical to the previous one, and follows it
directly, is the same frame; a request that was delivered twice has two answers. Two devices with
the same node id show otherwise: a request has different answers, or several requests in a row have
a second answer.

A listener does not know what a client will make of an answer: it has `eds.sdo_channel`.
"""

from __future__ import annotations

from dataclasses import dataclass

from coulombus.eds.sdo_frames import named

__all__ = ["SdoAnswers"]

IN_A_ROW = 3
"""Second answers to this many requests in a row come from a second device."""
COMMUNICATION = range(0x1000, 0x2000)
"""Objects whose value is the same when read twice; a measured value is not."""
_UPLOAD, _DOWNLOAD, _ABORT = 2, 3, 4
_ANSWERS = {1: (3, 4), 2: (2, 4), 5: (2, 4, 6), 6: (4, 5)}
"""Command of an initiating request -> commands of its possible answers (bits 7 to 5 of byte 0)."""


@dataclass
class _Request:
    """A request, how often it was repeated, how often it was answered, and its first answer."""

    request: bytes
    times: int = 1
    answers: int = 0
    first: bytes = b""

    def ends(self, answer: bytes) -> bool:
        """Tell whether an answer ends this request; a longer transfer ends with other frames."""
        command = answer[0] >> 5
        if self.request[0] >> 5 == 2:
            return command == _ABORT or (command == _UPLOAD and bool(answer[0] & 0x02))
        if self.request[0] >> 5 == 1:
            return command == _ABORT or (command == _DOWNLOAD and bool(self.request[0] & 0x02))
        return False

    def contradicts(self, answer: bytes) -> bool:
        """Tell whether a single device cannot give this answer after the first: a second write may be refused,
        and a measured value changes.
        """
        if self.request[0] >> 5 != 2 or self.times > 1 or answer == self.first:
            return False
        return answer[0] != self.first[0] or named(answer)[0] in COMMUNICATION


class SdoAnswers:
    """Requests of one client to a node, and the node's answers.

    Attributes
    ----------
    again : repetition of the previous answer, after the client's last message; b"" without one
    stray : last answer about another object than the requested one; b"" without one
    second : last answer to a request that had been answered; b"" without one
    """

    def __init__(self) -> None:
        self.again = self.stray = self.second = b""
        self._request = self._last = b""  # the request is stored while the client waits for its first answer
        self._behind = 0  # messages sent after the last answer
        self._count = 0  # number of initiating requests
        self._requests: dict[tuple[int, int], _Request] = {}
        self._place: tuple[int, int] | None = None  # object of the last initiating request
        self._twice: set[int] = set()  # numbers of the requests during which second answers came
        self._differ = False

    def ask(self, request: bytes) -> None:
        """Record a request of the client that initiates a transfer."""
        self.sent()
        self._count += 1
        self._request, self.stray = request, b""
        place = named(request)
        before = self._requests.pop(place, None)
        if place != self._place:
            self._requests[place] = _Request(request)
        elif before is not None and before.request == request:
            before.times += 1
            self._requests[place] = before
        self._place = place

    def sent(self) -> None:
        """Record a message of the client that continues or ends a transfer."""
        self._request, self.again, self._behind = b"", b"", self._behind + 1

    def add_answer(self, answer: bytes) -> bool:
        """Record a message of the server; tell whether it continues the transfer.

        A repeated frame does not, nor does an answer to an earlier request.
        """
        self._judge(answer)
        is_stray = bool(self._request) and answer[0] >> 5 > 1 and named(answer) not in (self._place, (0, 0))
        if is_stray:
            self.stray = answer
            self._last = answer
            return False
        if answer == self._last and not self._repeats(answer):
            self.again = answer if self._behind else b""
            return False
        self._last = answer
        self._behind = 0
        return True

    @property
    def duplicate_node_id(self) -> bool:
        """Whether two devices have answered."""
        return self._differ or any(
            all(number + k in self._twice for k in range(IN_A_ROW)) for number in tuple(self._twice)
        )

    def _repeats(self, answer: bytes) -> bool:
        """Tell whether a new answer may be identical to the previous one."""
        if self._request:
            return (
                self._behind > 0 and named(answer) == self._place and answer[0] >> 5 in _ANSWERS[self._request[0] >> 5]
            )
        return answer[0] & 0xE3 == 0xA2 and answer[1] <= self._behind  # blocks of the same length

    def _judge(self, answer: bytes) -> None:
        request = self._requests.get(named(answer))
        if request is None or not request.ends(answer):
            return
        request.answers += 1
        request.first = request.first or answer
        if request.answers <= request.times:
            return
        self.second = answer
        self._twice.add(self._count)
        self._differ = self._differ or request.contradicts(answer)
