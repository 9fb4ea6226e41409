"""A page without a bus: frames are given to it by the test."""

from __future__ import annotations

import asyncio
import json
import struct
import threading
from contextlib import asynccontextmanager
from typing import Any

from tornado.httpclient import HTTPRequest
from tornado.httpserver import HTTPServer
from tornado.websocket import websocket_connect

from coulombus.host.cycle.controllers import Controllers
from coulombus.host.cycle.parameter_changes import Change, LiveParameters
from coulombus.host.run.changes import Changes
from coulombus.host.run.law_curve import law_curve
from coulombus.monitor.web.batch import unpacked
from coulombus.monitor.web.capture import LiveCapture
from coulombus.monitor.web.last_page import LastPage
from coulombus.monitor.web.page import Page, application
from coulombus.monitor.web.page_state import FaultDoor, HostDoor
from coulombus.monitor.web.server import Server, listening
from coulombus.rigs.rig import load_rig

MS = 1_000_000
BEGIN_NS = 1_800_000_000_000 * MS
TOKEN = "a" * 32
FACTS = {"bus": "coulombus:bench", "bitrate_bit_s": 1_000_000, "lost": 0, "malformed": 0}
STATUS = {
    "mode": "hybrid",
    "trip": None,
    "axes": [{"axis": "", "phase": "run"}],
    "recording": "/tmp/run.pcapng",
    "arm_key": False,
    "wakeup_us": {"p50": 12.0, "p99": 40.0, "max": 95.0},
    "sync_to_rpdo_us": None,
    "histograms_us": {
        "wakeup": {"edges": [1.0, 3.0, 10.0, 30.0, 100.0], "counts": [5, 900, 80, 2]},
        "sync_to_rpdo": {"edges": [], "counts": []},
        "deadline": 1000.0,
    },
    "meta": {"subject": "S01", "trial": "7"},
    "display_s": 2.5,
}

CONTRAST = """(() => {
  const channel = (c) => (c /= 255) <= 0.04045 ? c / 12.92 : ((c + 0.055) / 1.055) ** 2.4;
  const parse = (text) => (text.match(/[\\d.]+/g) || [0, 0, 0, 0]).map(Number);
  const luminance = ([r, g, b]) => 0.2126 * channel(r) + 0.7152 * channel(g) + 0.0722 * channel(b);
  const ratio = (one, other) => {
    const [low, high] = [luminance(one), luminance(other)].sort((a, b) => a - b);
    return (high + 0.05) / (low + 0.05);
  };
  const ground = (element) => {
    for (let e = element; e; e = e.parentElement) {
      const colour = parse(getComputedStyle(e).backgroundColor);
      if (colour.length < 4 || colour[3] === 1) return colour;
    }
    return parse(getComputedStyle(document.documentElement).getPropertyValue("--ground"));
  };
  const found = [], seen = (e) => e.checkVisibility() && e.getClientRects().length;
  for (const e of document.querySelectorAll("body *")) {
    if (!seen(e)) continue;
    const style = getComputedStyle(e), field = e.matches("input:not([type=range])");
    const text = field || [...e.childNodes].some((n) => n.nodeType === 3 && n.data.trim());
    const name = `${e.tagName} ${e.id || e.className || e.dataset.signal || e.dataset.action || ""}`;
    if (text) found.push([name, ratio(parse(style.color), ground(e)), 4.5, parseFloat(style.fontSize), parseFloat(style.opacity)]);
    if (e.matches("button") || field) {
      found.push([name + " border", ratio(parse(style.borderTopColor), ground(e.parentElement)), 3, 12, 1]);
    }
  }
  return found;
})()"""
"""Each visible text with the contrast to its ground, what WCAG 2.2 AA asks for, its size and
opacity; each button's and field's border against what is around it (1.4.11).
"""


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
    """A host that runs until it is asked to stop, whose parameters are live."""

    def __init__(self, arm_key: str = "", mode: str = "hybrid", overrides: tuple[str, ...] = ()) -> None:
        self.stops, self.now_ns = 0, 0
        self.marks: list[str] = []
        self.orders: list[dict[str, Any]] = []
        self.controllers = Controllers(load_rig("bench", overrides), mode)
        self.changes = Changes(LiveParameters(self.controllers), arm_key, self._apply, lambda: None)
        self.door = HostDoor(
            status=self.status,
            stop=self.stop,
            change=self.change,
            mark=self.mark,
            curve=law_curve,
        )

    def _apply(self, change: Change) -> None:
        live = self.controllers.axes["live"]
        live["wanted"][change.index] = live["taken"][change.index] = change.number

    def status(self) -> dict[str, Any]:
        axes = [{"axis": "", "phase": "run", "parameters": self.changes.rows()[0]}]
        return {**STATUS, "axes": axes, "arm_key": bool(self.changes.arm_key)}

    def change(self, order: dict[str, Any]) -> dict[str, Any]:
        self.orders.append(order)
        found = self.changes.answer(json.dumps(order), self.now_ns)
        if "error" in found:
            raise OSError(found["error"])
        return found

    def mark(self, text: str) -> dict[str, Any]:
        self.marks.append(text)
        return {"marker": f"mark {text}"}

    def stop(self) -> dict[str, Any]:
        self.stops += 1
        return {"mode": "hybrid", "cycles": 7, "trip": None}


class Faults:
    """The faults of a simulated bus with a motor and a brake, which are only noted."""

    def __init__(self) -> None:
        self.acting: list[tuple[str, str]] = []
        effects = {"power_off": "The node has no supply.", "cut": "Cut the cable.", "noise": "Invert random bits."}
        self.door = FaultDoor(self.state, self.inject, self.clear, effects)

    def state(self) -> dict[str, Any]:
        rows = [{"fault": fault, "on": on, "since_s": 1.5, "for_s": None} for fault, on in self.acting]
        nodes = [
            {
                "name": name,
                "node_id": k,
                "powered": ("power_off", name) not in self.acting,
                "faults": ["power_off", "cut"],
            }
            for k, name in enumerate(("motor", "brake"), 1)
        ]
        return {"bus": "coulombus:bench", "nodes": nodes, "wire": ["noise"], "acting": rows}

    def inject(self, fault: str, where: str) -> str:
        if fault not in self.door.effects:
            raise OSError(f"there is no fault '{fault}'")
        self.acting.append((fault, where))
        return f"inject {fault} on {where}"

    def clear(self, fault: str, where: str) -> str:
        ended = [row for row in self.acting if fault in ("", row[0]) and where in ("", row[1])]
        self.acting = [row for row in self.acting if row not in ended]
        return ", ".join(f"clear {kind} on {on}" for kind, on in ended)


def page(rig: str = "bench", door: Door | None = None) -> Page:
    """Return a page with nothing on its bus yet."""
    capture = LiveCapture(load_rig(rig))
    capture.snapshot(BEGIN_NS)
    door = door or Door()
    found = Page(capture, door.door, TOKEN, lambda: FACTS, threading.Lock())
    found.host.update(door.status())
    return found


def origin(url):
    return {"Origin": url.rpartition("/")[0].rpartition("/")[0]}


async def socket_of(url, **headers):
    return await websocket_connect(HTTPRequest(url.replace("http", "ws") + "data", headers=headers or origin(url)))


async def answer_of(shown, connection, message, k):
    """Send what a page says, and return the words that come back with the next state."""
    await connection.write_message(message)
    while not any(session.answers for session in shown.sessions):
        await asyncio.sleep(0.001)
    shown.tick(BEGIN_NS + 1000 * k * MS)
    head, _ = unpacked(await connection.read_message())
    await connection.write_message(f"took {head['n']}")
    return head["answer"]


@asynccontextmanager
async def served(page: Page | LastPage, port: int = 0):
    """Serve a live page or a kept one; yields its address."""
    sockets = listening("127.0.0.1", port)
    server = Server(page) if isinstance(page, Page) else HTTPServer(application(page))
    server.add_sockets(sockets)
    try:
        yield f"http://127.0.0.1:{sockets[0].getsockname()[1]}/{TOKEN}/"
    finally:
        server.stop()
        await server.close_all_connections()


@asynccontextmanager
async def going_on(shown: Page, status: Any):
    """Let 33 ms of cycles come each 33 ms, with the host's status that `status` returns."""

    async def ticking() -> None:
        k = 400
        while True:
            with shown.lock:
                shown.capture.add_frames(cycles(k, 33))
                shown.host.update(status())
            k += 33
            shown.tick(BEGIN_NS + k * MS)
            await asyncio.sleep(0.033)

    shown.capture.add_frames(cycles(0, 400))
    task = asyncio.create_task(ticking())
    yield
    task.cancel()
