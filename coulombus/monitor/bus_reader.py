"""Read a bus in a separate thread, in batches, for a view. Nothing is ever sent to the bus."""

from __future__ import annotations

import threading
import time
from typing import Any, Protocol

from coulombus.monitor.live_incidents import IncidentReader
from coulombus.monitor.view_thread import ViewThread
from coulombus.wire.client import BusDown, BusFull, OpenBus
from coulombus.wire.frame_batches import Block, block_reader

__all__ = ["BATCH_S", "BusReader", "BusView"]

BATCH_S = 0.033
COLLECT_S = 0.01
"""Interval of reading a SocketCAN socket, whose buffer holds some 270 frames."""
ASK_S = 1.0


class BusView(Protocol):
    """What gets the frames."""

    def add_frames(self, block: Block) -> None:
        """Process received frames."""

    def add_event(self, t_ns: int, text: str, *, grave: bool) -> None:
        """Note an event of the bus."""


class BusReader(ViewThread):
    """Reads frames from the bus into `view`; `failure` is the reason of its own end.

    Parameters
    ----------
    lock : held while `view` changes
    incidents : gets the frames, too
    batch_s : frames of this time are processed together
    """

    def __init__(
        self,
        client: OpenBus,
        view: BusView,
        lock: threading.Lock,
        incidents: IncidentReader | None = None,
        batch_s: float = BATCH_S,
    ) -> None:
        super().__init__("bus reader")
        self.failure: OSError | None = None
        self.until_ns = time.time_ns()
        """All frames up to this time are in `view`."""
        self._client, self._view, self._lock, self._incidents = client, view, lock, incidents
        self._batch_s = batch_s
        self._reader = block_reader(client)
        self._waiting: list[Block] = []
        self._quiet_until_s = time.monotonic()
        self._question_s = self._quiet_until_s + ASK_S

    def facts(self) -> dict[str, Any]:
        """Return facts on the bus besides its frames."""
        c = self._client
        return {"bus": c.address, "bitrate_bit_s": c.bitrate_bit_s, "lost": c.lost, "malformed": c.malformed}

    def hand_over(self) -> None:
        """Pass the frames received by now to the view; the caller holds the lock."""
        now_ns = time.time_ns()
        if self.failure is None:
            self._receive()
        block = Block.joined(self._waiting)
        self._waiting = []
        self._view.add_frames(block)
        self.until_ns = now_ns
        if self._incidents is not None:
            self._incidents.add_frames(block)

    def _receive(self) -> None:
        """Keep what the socket has, and ask the bus for its state once a second."""
        now = time.monotonic()
        try:
            if len(block := self._reader.receive()):
                self._waiting.append(block)
            if now >= self._question_s:
                self._question_s = now + ASK_S
                self._client.ask()
        except BusDown as error:  # read on: frames may come again at once
            if now >= self._quiet_until_s:
                self._quiet_until_s = now + ASK_S
                self._view.add_event(time.time_ns(), str(error), grave=True)
        except BusFull:
            pass  # a failure to read shows as silence of all nodes
        except OSError as error:
            self.failure = error

    def _run(self) -> None:
        last_batch_s = time.monotonic()
        pause_s = BATCH_S if self._client.address.packs_frames else COLLECT_S
        while self.failure is None and not self.stop.wait(pause_s):
            now = time.monotonic()
            with self._lock:
                if now - last_batch_s >= self._batch_s:
                    # so that batches are of that time on average
                    last_batch_s = max(last_batch_s + self._batch_s, now - pause_s)
                    self.hand_over()
                else:
                    self._receive()
        if self.failure is not None:
            with self._lock:
                self.hand_over()
