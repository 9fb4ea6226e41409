"""``coulombus bridge A B``: connects two buses of any kind; frames of each bus are sent on the other.

No frame returns: a bus does not send a client its own frames, and the bridge is one client of each.
Error frames are not forwarded: they belong to their own wire. The queues are bounded; frames
without room are dropped and counted. An end may be a server for other programs
(`sim_bus.server.socketcand_server`), whose clients wait instead.
"""

from __future__ import annotations

import heapq
import random
import select
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import asdict, dataclass, field
from typing import Any, TypeAlias

from coulombus.sim_bus.server.socketcand_server import SocketcandServer
from coulombus.system.errors import CoulombusError
from coulombus.system.sd_notify import Notifier
from coulombus.system.stop_signals import StopSignals
from coulombus.wire.adapter import open_bus
from coulombus.wire.address import BusAddress, BusUnavailable
from coulombus.wire.can_flags import CAN_RTR_FLAG
from coulombus.wire.client import CAN_FRAME, BusDown, BusFull, OpenBus
from coulombus.wire.handshake import Hello
from coulombus.wire.identifiers import Ranges

__all__ = ["QUEUE_FRAMES", "Between", "Counts", "Frame", "SameBus", "bridge", "faults"]

QUEUE_FRAMES = 4096
MESSAGE_FRAMES = 64
RETRY_S = 1e-3
ASK_S = 1.0
LONGEST_S = 0.5

Frame: TypeAlias = tuple[int, int, bytes]
"""Identifier with flags, length, eight data bytes."""

Between: TypeAlias = Callable[[Frame], Iterable[tuple[int, Frame]]]
"""Filter between the buses: returns (delay [ns], frame) for each frame to forward.

None: the frame is dropped.
"""


class SameBus(CoulombusError, ValueError):
    """Both ends are the same bus."""

    exit_status = 2


def faults(
    delay_ms: float = 0.0, drop: float = 0.0, seed: int = 0, *, duplicate: float = 0.0, corrupt: float = 0.0
) -> Between:
    """Return a `Between` that delays every frame, and drops, duplicates or corrupts (one data bit) random
    frames with the given probabilities.

    It has its own random generator, so each direction of a bridge needs its own filter: the result then
    depends on the frames of that direction alone.
    """
    delay_ns = round(delay_ms * 1e6)
    dice = random.Random(seed)

    def between(frame: Frame) -> Iterable[tuple[int, Frame]]:
        if drop and dice.random() < drop:
            return ()
        can_id, length, data = frame
        if corrupt and dice.random() < corrupt and length and not can_id & CAN_RTR_FLAG:
            bit = dice.randrange(8 * length)
            turned = data[bit // 8] ^ 1 << bit % 8
            frame = can_id, length, data[: bit // 8] + bytes((turned,)) + data[bit // 8 + 1 :]
        return ((delay_ns, frame),) * (2 if duplicate and dice.random() < duplicate else 1)

    return between


@dataclass
class Counts:
    """Counts of one direction."""

    received: int = 0
    forwarded: int = 0
    filtered: int = 0
    dropped: int = 0
    """Frames dropped by the filter."""
    overflow: int = 0
    """Frames dropped for lack of room: the other bus is slower than the arrivals."""
    refused: int = 0
    """Times that the other bus was full, or down."""
    lost: int = 0
    """Frames that this bus dropped because the bridge did not read in time."""
    malformed: int = 0
    """What came from this bus and is no frame."""


@dataclass
class Result:
    """Both directions, and why the bridge ended by itself."""

    ways: dict[str, Counts] = field(default_factory=dict)
    seconds: float = 0.0
    gone: str | None = None

    @property
    def exit_status(self) -> int:
        """4 if a bus went away."""
        return 4 if self.gone else 0

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return asdict(self)


class _Way:
    """Direction from one client to another."""

    def __init__(self, source: OpenBus, sink: OpenBus, between: Between, ranges: Ranges, room: int) -> None:
        self.source, self.sink, self.between, self.ranges, self.room = source, sink, between, ranges, room
        self.counts = Counts()
        self.packed = MESSAGE_FRAMES if sink.address.packs_frames else 1
        self._queue: list[tuple[int, int, Frame, int]] = []
        self._number = 0
        self._again_ns = 0

    def receive(self, now_ns: int) -> None:
        """Receive the available frames."""
        counts = self.counts
        try:
            frames = self.source.receive()
        except BusDown:
            return
        for stamp_ns, can_id, length, data in frames:
            counts.received += 1
            bare = can_id & ~CAN_RTR_FLAG
            if self.ranges and not any(low <= bare <= high for low, high in self.ranges):
                counts.filtered += 1
                continue
            before = self._number
            for delay_ns, frame in self.between((can_id, length, data)):
                self._number += 1
                if len(self._queue) >= self.room:
                    counts.overflow += 1
                else:
                    heapq.heappush(self._queue, (now_ns + delay_ns, self._number, frame, stamp_ns + delay_ns))
            counts.dropped += self._number == before
        counts.lost, counts.malformed = self.source.lost, self.source.malformed
        self.source.hold(len(self._queue) > self.room // 2)

    def give(self, now_ns: int) -> None:
        """Send the frames that are due."""
        queue, counts = self._queue, self.counts
        while queue and queue[0][0] <= now_ns and now_ns >= self._again_ns:
            batch: list[tuple[int, int, Frame, int]] = []
            while queue and queue[0][0] <= now_ns and len(batch) < self.packed:
                batch.append(heapq.heappop(queue))
            try:
                self.sink.send(b"".join(CAN_FRAME.pack(*frame) for _, _, frame, _ in batch), batch[0][3])
                counts.forwarded += len(batch)
            except (BusFull, BusDown):
                counts.refused += 1
                for entry in batch:
                    heapq.heappush(queue, entry)
                self._again_ns = now_ns + round(RETRY_S * 1e9)
        self.source.hold(len(queue) > self.room // 2)

    @property
    def next_ns(self) -> int | None:
        """Time of the next frame to send."""
        return max(self._queue[0][0], self._again_ns) if self._queue else None


def bridge(
    a: BusAddress,
    b: BusAddress,
    *,
    between: Between | None = None,
    back: Between | None = None,
    ranges: Ranges = (),
    one_way: bool = False,
    seconds: float | None = None,
    room: int = QUEUE_FRAMES,
    ready: Callable[[BusAddress, BusAddress], None] = lambda a, b: None,
    say: Callable[[str], None] = lambda text: None,
) -> Result:
    """Connect two buses until a signal, or for `seconds`, or until one of them goes away.

    Parameters
    ----------
    between, back : filters from `a` to `b`, and back; None: no filter
    ranges : forwarded identifiers; empty: all
    one_way : from `a` to `b` only
    room : largest number of pending frames in each direction
    ready : called with both addresses when the buses are connected
    say : called with what a server reports of its clients

    Raises
    ------
    SameBus
    coulombus.wire.address.BusUnavailable
        One of them does not exist.
    """
    if a == b:
        raise SameBus(f"both ends are {a}: a bridge joins two buses")
    with _opened(a, say) as left, _opened(b, say) as right, StopSignals() as stop:
        a, b = left.address, right.address
        ways = {f"{a} -> {b}": _Way(left, right, between or faults(), ranges, room)}
        if not one_way:
            ways[f"{b} -> {a}"] = _Way(right, left, back or faults(), ranges, room)
        result = Result({name: way.counts for name, way in ways.items()})
        notifier = Notifier()
        ready(a, b)
        notifier.send(READY=1, STATUS=f"{a} and {b} are joined")
        begin = time.monotonic()
        end = None if seconds is None else begin + seconds
        try:
            _serve(tuple(ways.values()), (left, right), stop, end, notifier)
        except BusUnavailable as error:
            result.gone = str(error)
        finally:
            notifier.send(STOPPING=1)
            result.seconds = time.monotonic() - begin
        return result


def _opened(address: BusAddress, say: Callable[[str], None]) -> OpenBus:
    return SocketcandServer(address, say) if address.is_server else open_bus(address, Hello())


def _serve(
    ways: tuple[_Way, ...], clients: tuple[OpenBus, ...], stop: StopSignals, end: float | None, notifier: Notifier
) -> None:
    poll = select.poll()
    poll.register(stop, select.POLLIN)
    by_fd = {way.source.fileno(): way for way in ways}
    for client in clients:  # also a client that is not read: its end must be detected
        poll.register(client, select.POLLIN)
    others = {client.fileno(): client for client in clients if client.fileno() not in by_fd}
    last_ask = time.monotonic()
    while True:
        now = time.monotonic()
        notifier.alive(now)
        if end is not None and now >= end:
            return
        pause = LONGEST_S if end is None else min(LONGEST_S, end - now)
        due = [way.next_ns for way in ways if way.next_ns is not None]
        if due:
            pause = min(pause, max(0.0, min(due) / 1e9 - now))
        for fd, _ in poll.poll(pause * 1e3):
            if fd in by_fd:
                by_fd[fd].receive(time.monotonic_ns())
            elif fd in others:
                with suppress(BusDown):  # as when receiving: it may come up again
                    others[fd].receive()
            elif stop.number:
                return
        for way in ways:
            way.give(time.monotonic_ns())
        if now - last_ask > ASK_S:
            last_ask = now
            for client in clients:
                try:
                    if not client.unanswered:
                        client.ask()
                except (BusFull, BusDown):
                    pass
