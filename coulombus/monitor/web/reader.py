"""Threads of the page's server: one reads the bus in batches, one queries the host, one computes the law's curve.

Nothing is ever sent to the bus.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Mapping
from typing import Any

from coulombus.monitor.live_incidents import IncidentReader
from coulombus.monitor.web.capture import Curve, LiveCapture
from coulombus.monitor.web.page_state import HostDoor, HostView
from coulombus.rigs.axis import Axis
from coulombus.rigs.rig import Rig
from coulombus.wire.client import BusDown, BusFull, Client
from coulombus.wire.frame_batches import Block, BlockReader

__all__ = ["BATCH_S", "BusReader", "CurveReader", "HostReader"]

BATCH_S = 0.033
COLLECT_S = 0.01
"""Interval of reading a SocketCAN socket, whose buffer holds some 270 frames."""
ASK_S = 1.0
HOST_S = 0.2


class _Worker:
    """A thread that ends with its ``with`` block."""

    def __init__(self, name: str) -> None:
        self.stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)

    def __enter__(self) -> _Worker:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop.set()
        self._thread.join(timeout=5)

    def _run(self) -> None:
        raise NotImplementedError


class BusReader(_Worker):
    """Reads frames from the bus into `capture`; `failure` is the reason of its own end.

    Parameters
    ----------
    lock : held while `capture` changes
    incidents : gets the frames, too
    """

    def __init__(
        self, client: Client, capture: LiveCapture, lock: threading.Lock, incidents: IncidentReader | None = None
    ) -> None:
        super().__init__("bus reader")
        self._incidents = incidents
        self.failure: OSError | None = None
        self.until_ns = time.time_ns()
        """All frames up to this time are in `capture`."""
        self._client, self._capture, self._lock = client, capture, lock
        self._reader = BlockReader(client)

    def facts(self) -> dict[str, Any]:
        """Return facts on the bus besides its frames."""
        c = self._client
        return {"bus": c.address, "bitrate_bit_s": c.bitrate_bit_s, "lost": c.lost, "malformed": c.malformed}

    def _run(self) -> None:
        last_question_s = last_batch_s = time.monotonic()
        blocks: list[Block] = []
        pause_s = BATCH_S if self._client.address.packs_frames else COLLECT_S
        while not self.stop.wait(pause_s):
            now, now_ns = time.monotonic(), time.time_ns()
            try:
                if len(block := self._reader.receive()):
                    blocks.append(block)
                if now - last_question_s > ASK_S:
                    last_question_s = now
                    self._client.ask()
            except BusDown as error:
                with self._lock:
                    self._capture.tell(time.time_ns(), str(error), grave=True)
                self.stop.wait(ASK_S)
            except BusFull:
                pass  # a failure to read shows as silence of all nodes
            except OSError as error:
                self.failure = error
            if now - last_batch_s >= BATCH_S or self.failure is not None:
                last_batch_s = max(last_batch_s + BATCH_S, now - pause_s)  # so that batches are of BATCH_S on average
                block = Block.joined(blocks)
                with self._lock:
                    self._capture.take_block(block)
                    self.until_ns = now_ns
                if self._incidents is not None:
                    self._incidents.take(block)
                blocks = []
            if self.failure is not None:
                return


class HostReader(_Worker):
    """Queries the host's status five times a second, and passes it to `view`."""

    def __init__(self, door: HostDoor, view: HostView, lock: threading.Lock) -> None:
        super().__init__("host reader")
        self._door, self._view, self._lock = door, view, lock

    def _run(self) -> None:
        while not self.stop.wait(HOST_S):
            try:
                status, word = self._door.status(), None
            except Exception:  # no host, or no answer: must not end the page
                status, word = None, self._word()
            with self._lock:
                self._view.tell(status, word)

    def _word(self) -> Mapping[str, Any] | None:
        try:
            return self._door.last()
        except Exception:  # must not end the page
            return None


class CurveReader(_Worker):
    """Recomputes the curve of each axis' law when the mode or a parameter changes.

    The curves are in `curves`, by the axis' name; None for a law without a curve or a failing law.
    """

    def __init__(self, door: HostDoor, view: HostView, rig: Rig, lock: threading.Lock) -> None:
        super().__init__("curve reader")
        self.curves: dict[str, Curve | None] = {}
        self.ring: tuple[tuple[float, ...], tuple[float, ...]] | None = None
        """Force of an arm's law over the directions: x and y [N]; None without such a law."""
        self._made: dict[str, object] = {}
        self._door, self._view, self._rig, self._lock = door, view, rig, lock

    def _run(self) -> None:
        while not self.stop.wait(HOST_S):
            for axis in self._rig.axes:
                with self._lock:
                    mode, live = self._view.mode, self._view.live(axis.name)
                self.make(axis, mode, live)

    def make(self, axis: Axis, mode: str, live: dict[str, float]) -> None:
        """Recompute a curve if its inputs changed."""
        key = (mode, tuple(live.items()))
        if self._made.get(axis.name) == key or mode not in axis.mode:
            return
        self._made[axis.name] = key
        try:
            curve = self._door.curve(axis, mode, live)
        except Exception:  # a user-defined law: the host reports its errors
            curve = None
        self.curves[axis.name] = None if curve is None else Curve(*curve)
        if self._rig.in_plane is not None and axis is self._rig.axes[0]:
            self._make_ring(mode, live)

    def _make_ring(self, mode: str, live: dict[str, float]) -> None:
        """Recompute the force of an arm's law over the directions."""
        try:
            self.ring = self._door.ring(self._rig, mode, live)
        except Exception:  # a user-defined law: the host reports its errors
            self.ring = None
