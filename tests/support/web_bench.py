"""A page without a bus: frames are given to it by the test."""

from __future__ import annotations

import struct
import threading
from contextlib import asynccontextmanager
from typing import Any

from tornado.httpserver import HTTPServer

from coulombus.rigs.rig import load_rig
from coulombus.scope.web.capture import Capture
from coulombus.scope.web.server import Page, application, listening
from coulombus.scope.web.state import HostDoor

MS = 1_000_000
BEGIN_NS = 1_800_000_000_000 * MS
TOKEN = "a" * 32
FACTS = {"bus": "coulombus:bench", "bitrate_bit_s": 1_000_000, "lost": 0, "malformed": 0}
STATUS = {
    "mode": "hybrid",
    "trip": None,
    "axes": [{"axis": "", "phase": "run"}],
    "recording": "/tmp/run.pcapng",
    "display_s": 2.5,
}


def cycles(first: int, count: int) -> list[tuple[int, int, int, bytes]]:
    """Return the frames of `count` cycles of the bench rig, one a millisecond: an enabled drive on
    a handle that turns backwards, from -100 counts.
    """
    found = []
    for k in range(first, first + count):
        t_ns = BEGIN_NS + k * MS
        for after, can_id, data in (
            (0, 0x80, b""),
            (200_000, 0x181, struct.pack("<Hih", 0x0237, -100 - 3 * k, -20)),
            (300_000, 0x182, struct.pack("<hhh", -1200 + k % 7, 250, 221)),
            (400_000, 0x201, struct.pack("<Hh", 0x000F, -21)),
            (500_000, 0x202, struct.pack("<h", 3000)),
        ):
            found.append((t_ns + after, can_id, len(data), data.ljust(8, b"\0")))
    return found


class Door:
    """A host that runs until it is asked to stop."""

    def __init__(self) -> None:
        self.stops = 0
        self.door = HostDoor(lambda: STATUS, self.stop, lambda trip: f"docs/runbook.md#{trip.split(':')[0].lower()}")

    def stop(self) -> dict[str, Any]:
        self.stops += 1
        return {"mode": "hybrid", "cycles": 7, "trip": None}


def page(rig: str = "bench", door: Door | None = None) -> Page:
    """Return a page with nothing on its bus yet."""
    capture = Capture(load_rig(rig))
    capture.snapshot(BEGIN_NS)
    found = Page(capture, (door or Door()).door, TOKEN, lambda: FACTS, threading.Lock())
    found.host.tell(STATUS)
    return found


@asynccontextmanager
async def served(page: Page, port: int = 0):
    """Serve a page; yields its address."""
    sockets = listening("127.0.0.1", port)
    server = HTTPServer(application(page))
    server.add_sockets(sockets)
    try:
        yield f"http://127.0.0.1:{sockets[0].getsockname()[1]}/{TOKEN}/"
    finally:
        server.stop()
        await server.close_all_connections()
