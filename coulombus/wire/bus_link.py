"""One end of a bus for request and response: send a frame, receive the next.

Time is an argument, in ns, and may be virtual. The conformance run and the host's device services
use it.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from types import TracebackType
from typing import Protocol

from coulombus.wire.adapter import open_bus
from coulombus.wire.address import BusAddress, BusUnavailable
from coulombus.wire.client import BusFull, pack_frame
from coulombus.wire.handshake import Flags, Hello

__all__ = ["RTR", "BusFrame", "BusLink", "FrameLink"]

RTR = 0x40000000
"""Flag of a remote frame in `BusFrame.can_id`, as in Linux."""

_ERR, _EFF = 0x20000000, 0x80000000
_PATIENCE_S = 2.0


@dataclass(frozen=True)
class BusFrame:
    """A frame that this end received or (`sent`) sent.

    For a remote frame, `length` is the length that it requests.
    """

    t_ns: int
    can_id: int
    data: bytes
    length: int
    sent: bool = False

    def line(self, start_ns: int) -> str:
        """Return one line for people: time since `start_ns` in ms, direction, identifier, data."""
        name = f"{self.can_id & 0x1FFFFFFF:03X}" + ("x" if self.can_id & _EFF else "")
        content = f"remote, {self.length} bytes" if self.can_id & RTR else self.data.hex(" ").upper()
        way = "tester" if self.sent else "node  "
        return f"{(self.t_ns - start_ns) / 1e6:10.3f} ms  {way}  {name}  [{self.length}]  {content}".rstrip()


class FrameLink(Protocol):
    """Interface that a client of devices requires of a bus."""

    def now_ns(self) -> int:
        """Return the time."""

    def send(self, can_id: int, data: bytes = b"", length: int | None = None) -> None:
        """Send a frame; `length` is for remote frames only."""

    def receive(self, until_ns: int) -> BusFrame | None:
        """Return the next frame of another station, or None if none comes before `until_ns`."""


class BusLink:
    """A link in real time to a bus of any kind.

    Parameters
    ----------
    filters
        (identifier, mask) of the frames to receive; empty: all.

    Attributes
    ----------
    error_frames, error_classes
        Number of error frames received, and the union of their classes (bits of ``linux/can/error.h``).

    Raises
    ------
    BusUnavailable
        No such bus; later: the bus is gone, or accepts no frame.
    """

    def __init__(self, address: BusAddress, filters: Sequence[tuple[int, int]] = ()) -> None:
        self._client = open_bus(address, Hello(Flags.ERRORS, tuple(filters)))
        self.address = address
        self.error_frames, self.error_classes = 0, 0
        self._waiting: deque[BusFrame] = deque()
        self._epoch_ns = time.time_ns() - time.monotonic_ns()  # stamps count from 1970

    def __enter__(self) -> BusLink:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Leave the bus."""
        self._client.close()

    def fileno(self) -> int:
        """Return the socket, for `select`."""
        return self._client.fileno()

    def set_filters(self, filters: Sequence[tuple[int, int]]) -> None:
        """Receive other frames from now on; frames already under way may still come."""
        self._client.ask(Hello(Flags.ERRORS, tuple(filters)))

    @property
    def bitrate_bit_s(self) -> int:
        """Bit rate of a virtual bus or of an adapter; 0: unknown, as on SocketCAN."""
        return self._client.bitrate_bit_s

    def now_ns(self) -> int:
        """Return the monotonic time."""
        return time.monotonic_ns()

    def send(self, can_id: int, data: bytes = b"", length: int | None = None) -> None:
        """Send a frame; wait while the queue is full."""
        deadline_ns = self.now_ns() + int(_PATIENCE_S * 1e9)
        while True:
            try:
                self._client.send(pack_frame(can_id, data, length))
                return
            except BusFull as error:
                if self.now_ns() > deadline_ns:
                    text = f"bus {self._client.address} takes no frame: is another node on it, at the same bit rate?"
                    raise BusUnavailable(text) from error
                self._fetch(0.005)

    def receive(self, until_ns: int) -> BusFrame | None:
        """Return the next frame, or None at `until_ns`."""
        while not self._waiting:
            left_ns = until_ns - self.now_ns()
            self._fetch(max(0.0, left_ns / 1e9))
            if not self._waiting and left_ns <= 0:
                return None
        return self._waiting.popleft()

    def _fetch(self, timeout_s: float) -> None:
        if not self._client.wait(timeout_s):
            return
        for stamp, can_id, length, data in self._client.receive():
            if can_id & _ERR:
                self.error_frames += 1
                self.error_classes |= can_id & ~_ERR
                continue
            t_ns = stamp - self._epoch_ns if stamp else self.now_ns()
            content = b"" if can_id & RTR else bytes(data[:length])
            self._waiting.append(BusFrame(t_ns, can_id, content, length))
