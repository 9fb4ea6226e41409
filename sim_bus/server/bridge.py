"""``coulombus bridge A B``: two buses of any kind as one; what one carries is sent on the other.

No frame goes round: a bus does not give a client its own frames, and the bridge is one client of
each. Error frames stay where they are: they belong to their own wire. What waits is bounded; what
finds no room is dropped and counted.
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

from coulombus.system.errors import CoulombusError
from coulombus.system.sd_notify import Notifier
from coulombus.system.stop_signals import StopSignals
from coulombus.wire.address import BusAddress, BusUnavailable
from coulombus.wire.can_flags import CAN_RTR_FLAG
from coulombus.wire.client import CAN_FRAME, BusDown, BusFull, Client
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
"""What happens to a frame in between: gives (delay [ns], frame) for each one that goes on.

None: it is dropped.
"""


class SameBus(CoulombusError, ValueError):
    """Both ends are one bus."""

    exit_status = 2


def faults(
    delay_ms: float = 0.0, drop: float = 0.0, seed: int = 0, *, duplicate: float = 0.0, corrupt: float = 0.0
) -> Between:
    """Return a `Between` that delays every frame, and of them drops, sends twice, or turns one data
    bit around in, such shares at random.

    It has dice of its own, so each way of a bridge needs one: what comes of a frame then depends on
    the frames of its way alone.
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
    """What went one way."""

    received: int = 0
    forwarded: int = 0
    filtered: int = 0
    dropped: int = 0
    """By the faults in between."""
    overflow: int = 0
    """For want of room: the other bus carries less than comes."""
    refused: int = 0
    """Times that the other bus was full, or down."""
    lost: int = 0
    """Frames that this bus dropped because the bridge did not read in time."""


@dataclass
class Result:
    """Both ways, and why the bridge ended by itself."""

    ways: dict[str, Counts] = field(default_factory=dict)
    seconds: float = 0.0
    gone: str | None = None

    @property
    def exit_status(self) -> int:
        """4 when a bus went away."""
        return 4 if self.gone else 0

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return asdict(self)


class _Way:
    """From one client to another."""

    def __init__(self, source: Client, sink: Client, between: Between, ranges: Ranges, room: int) -> None:
        self.source, self.sink, self.between, self.ranges, self.room = source, sink, between, ranges, room
        self.counts = Counts()
        self.packed = MESSAGE_FRAMES if sink.address.packs_frames else 1
        self._queue: list[tuple[int, int, Frame]] = []
        self._number = 0
        self._again_ns = 0

    def take(self, now_ns: int) -> None:
        """Receive what there is."""
        counts = self.counts
        try:
            frames = self.source.receive()
        except BusDown:
            return
        for _, can_id, length, data in frames:
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
                    heapq.heappush(self._queue, (now_ns + delay_ns, self._number, frame))
            counts.dropped += self._number == before
        counts.lost = self.source.lost

    def give(self, now_ns: int) -> None:
        """Send what is due."""
        queue, counts = self._queue, self.counts
        while queue and queue[0][0] <= now_ns and now_ns >= self._again_ns:
            batch: list[tuple[int, int, Frame]] = []
            while queue and queue[0][0] <= now_ns and len(batch) < self.packed:
                batch.append(heapq.heappop(queue))
            try:
                self.sink.send(b"".join(CAN_FRAME.pack(*frame) for _, _, frame in batch))
                counts.forwarded += len(batch)
            except (BusFull, BusDown):
                counts.refused += 1
                for entry in batch:
                    heapq.heappush(queue, entry)
                self._again_ns = now_ns + round(RETRY_S * 1e9)

    @property
    def next_ns(self) -> int | None:
        """When something is to be sent."""
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
    ready: Callable[[], None] = lambda: None,
) -> Result:
    """Join two buses until a signal, or for `seconds`, or until one of them goes away.

    Parameters
    ----------
    between, back : what happens to a frame on its way from `a` to `b`, and on the way back; None:
        nothing
    ranges : identifiers that pass; empty: all
    one_way : from `a` to `b` only
    room : frames that may wait, each way
    ready : called when both buses are there

    Raises
    ------
    SameBus
    coulombus.wire.address.BusUnavailable
        One of them is not there.
    """
    if a == b:
        raise SameBus(f"both ends are {a}: a bridge joins two buses")
    with Client(a, Hello()) as left, Client(b, Hello()) as right, StopSignals() as stop:
        ways = {f"{a} -> {b}": _Way(left, right, between or faults(), ranges, room)}
        if not one_way:
            ways[f"{b} -> {a}"] = _Way(right, left, back or faults(), ranges, room)
        result = Result({name: way.counts for name, way in ways.items()})
        notifier = Notifier()
        ready()
        notifier.tell(READY=1, STATUS=f"{a} and {b} are joined")
        begin = time.monotonic()
        end = None if seconds is None else begin + seconds
        try:
            _serve(tuple(ways.values()), (left, right), stop, end, notifier)
        except BusUnavailable as error:
            result.gone = str(error)
        finally:
            notifier.tell(STOPPING=1)
            result.seconds = time.monotonic() - begin
        return result


def _serve(
    ways: tuple[_Way, ...], clients: tuple[Client, ...], stop: StopSignals, end: float | None, notifier: Notifier
) -> None:
    poll = select.poll()
    poll.register(stop, select.POLLIN)
    by_fd = {way.source.fileno(): way for way in ways}
    for client in clients:  # also the one that nothing is taken from: its end is to be seen
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
                by_fd[fd].take(time.monotonic_ns())
            elif fd in others:
                with suppress(BusDown):  # as where frames are taken: it may come up again
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
