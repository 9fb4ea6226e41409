"""The live page: state shared by all viewers, and its HTTP and WebSocket handlers.

All URLs begin with the token; others get 403. A request for another host gets 421::

    GET  /TOKEN/            the page (?axis=NAME for a rig with several)
    GET  /TOKEN/static/F    its style and its scripts
    GET  /TOKEN/layout      plots and their signals
    GET  /TOKEN/data        WebSocket: batches there (`monitor.web.batch`), "took N", "control", "set {...}",
                            "mark N", "inject {...}" and "clear {...}" here
    POST /TOKEN/stop        a safe stop, as by ``coulombus stop``

Nothing that a browser sends reaches the bus; faults reach simulated nodes only. The stop needs neither plots nor WebSocket.
"""

from __future__ import annotations

import asyncio
import itertools
import json
import re
import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from html import escape
from importlib.resources import files
from typing import Any
from weakref import WeakSet

import tornado.web
import tornado.websocket
from tornado.iostream import IOStream

from coulombus.monitor.live_incidents import IncidentRow
from coulombus.monitor.snapshot import Snapshot
from coulombus.monitor.web.access import ControlLock, same_origin
from coulombus.monitor.web.batch import Flow, batch, layout
from coulombus.monitor.web.capture import AFTER_NS, Curve, LiveCapture
from coulombus.monitor.web.guard import FORBIDDEN, Guarded, Handler, Nothing, Static
from coulombus.monitor.web.last_page import LastData, LastPage, packed
from coulombus.monitor.web.page_state import FaultDoor, HostDoor, HostView, document
from coulombus.monitor.web.tip import tip_track
from coulombus.rigs.axis import Axis

__all__ = ["Page", "application", "fault_of", "order_of"]

STATE_S = 0.2
GOODBYE_S = 1.0
"""Time limit for a page to receive the last state."""
KEEP_NS, SETTLED_NS = 1_000_000_000, 5_000_000_000
"""Interval of keeping the page after a trip, and how long it goes on: nodes still report the host's end."""
SESSIONS = 16
STOPS = 8
"""Maximum concurrent stop requests."""
MESSAGE_BYTES = 512
QUESTIONS = 4
"""Maximum concurrent changes and markers."""
ANSWERS = 8
"""Maximum answers pending for a page; each state carries one."""
RUBBISH = 100
"""Invalid messages after which a page is disconnected."""
TOOK = re.compile(r"took ([0-9]{1,15})")
MARK = re.compile(r"mark ([1-9])")


class Page:
    """State shared by all viewers: capture, host view, control lock, sessions."""

    def __init__(
        self,
        capture: LiveCapture,
        door: HostDoor,
        token: str,
        facts: Callable[[], dict[str, Any]],
        lock: threading.Lock,
    ) -> None:
        self.capture, self.door, self.token, self.facts, self.lock = capture, door, token, facts, lock
        self.name = ""
        """Its host name in requests, besides the address itself."""
        self.host = HostView(door.entry)
        self.trip_ns: int | None = None
        self.trip_batches: dict[str, bytes] = {}
        """The batch of the last trip for each axis."""
        self._kept_ns = 0
        self.incidents: Callable[[], Sequence[IncidentRow]] = tuple
        """The incidents of the bus so far."""
        self.curves: Mapping[str, Curve | None] = {}
        """Curve of each axis' law, by the axis' name."""
        self.tip = tip_track(capture)
        """Tip of an arm; None for other rigs."""
        self.ring: Callable[[], tuple[tuple[float, ...], tuple[float, ...]] | None] = lambda: None
        """Force of an arm's law over the directions, x and y [N]."""
        self.faults: FaultDoor | None = None
        """The faults of a simulated bus."""
        self.fault_state: Callable[[], Mapping[str, Any] | None] = lambda: None
        """What can be broken, and what is; None: nothing can."""
        self.control = ControlLock()
        self.sessions: set[Data] = set()
        self.sockets: WeakSet[IOStream] = WeakSet()
        """The connections of the sessions."""
        self.numbers = itertools.count(1)
        self.stops = ThreadPoolExecutor(STOPS, "stop")
        self.stopping = 0
        self.questions = ThreadPoolExecutor(1, "question")  # separate: a stop does not wait for them
        self.asking = 0
        self._state_s = -1.0
        self._state: dict[str, Any] | None = None
        self._version = 0

    def axis(self, name: str) -> Axis:
        """Return the axis of this name, or the first."""
        axes = self.capture.rig.axes
        return next((axis for axis in axes if axis.name == name), axes[0])

    def tick(self, now_ns: int) -> None:
        """Send new data to each page that is ready."""
        with self.lock:
            pause_s = 0.0 if self.stopping else STATE_S  # show a stop at once
            if now_ns * 1e-9 - self._state_s >= pause_s or now_ns * 1e-9 < self._state_s:
                self._update_state(now_ns)
            if self.tip is not None and self.sessions:
                self.tip.update()
            for session in self.sessions:
                if session.flow.free:
                    session.send(self._state, self._version)

    def _update_state(self, now_ns: int) -> None:
        self._state_s = now_ns * 1e-9
        if self.tip is not None:
            self.tip.align(self.host.positions())
        snapshot: Snapshot = self.capture.snapshot(now_ns)
        state = document(self.capture, snapshot, self.facts(), self.host, self.incidents())
        self._state = {**state, "start": self.door.start, "faults": self.fault_state()}
        self._version += 1
        self._keep_trip(now_ns)

    def _keep_trip(self, now_ns: int) -> None:
        """Make the batches of a trip once the samples after it have come; after the host's end keep the page, for some seconds."""
        trip_ns = self.host.tripped_ns
        if trip_ns is None:
            self.trip_ns, self.trip_batches, self._kept_ns = None, {}, 0
        elif self.trip_ns is None and now_ns >= trip_ns + AFTER_NS and 0 < self.capture.begin_ns < trip_ns:
            self.trip_ns = trip_ns
            self.trip_batches = {axis.name: self.message(axis, Flow(), {}, trip_ns) for axis in self.capture.rig.axes}
        if self.trip_ns is None or self.host.runs:
            return
        if now_ns - self._kept_ns > KEEP_NS and self._kept_ns < self.trip_ns + SETTLED_NS:
            self._kept_ns = now_ns
            with suppress(Exception):  # it must not end the page
                self.door.keep(packed(self))

    @property
    def axis_names(self) -> tuple[str, ...]:
        """The names of the rig's axes."""
        return tuple(axis.name for axis in self.capture.rig.axes)

    @property
    def rig_name(self) -> str:
        """The rig's name."""
        return self.capture.rig.name

    def layout(self, name: str) -> dict[str, Any]:
        """Return the plots of an axis, or of the first, and the effects of faults."""
        effects = {} if self.faults is None else dict(self.faults.effects)
        return {"rows": layout(self.capture, self.axis(name)), "arm": self.tip is not None, "effects": effects}

    def message(self, axis: Axis, flow: Flow, more: dict[str, Any], trip_ns: int | None = None) -> bytes:
        """Return the next batch of a page on an axis, or that of a trip; law and ring come with a state or a trip."""
        tip = self.tip
        if "state" in more or trip_ns is not None:
            curve = self.curves.get(axis.name)
            law = None if curve is None else {"v": curve.velocity_rad_s, "f": curve.friction_Nm}
            more = {**more, "law": law, "ring": None if tip is None else self.ring(), "axis": axis.name}
        if tip is not None:
            more = {**more, "arm": tip.arm()}
        return batch(self.capture, axis, flow, more, () if tip is None else tip.parts(), trip_ns)

    def last_batches(self, name: str) -> list[bytes]:
        """Return the batches of an axis for a page that is opened later: that of the trip, and the final state."""
        more = {"state": {**(self._state or {}), "final": True}, "controls": False, "refused": False, "answer": ""}
        return [self.trip_batches[name], self.message(self.axis(name), Flow(), more)]

    async def say_goodbye(self, now_ns: int) -> None:
        """Send every page the final state, with the host's end, and close it."""
        loop = asyncio.get_running_loop()
        end = loop.time() + GOODBYE_S
        while self.stopping and loop.time() < end:  # deliver the result to the page that requested the stop
            await asyncio.sleep(GOODBYE_S / 100)
        with self.lock:
            with suppress(Exception):
                self.host.update(None, self.door.last())
            self._update_state(now_ns)
            assert self._state is not None
            self._state["final"] = True
            sent = [session.send(self._state, self._version) for session in self.sessions]
        waiting = [future for future in sent if future is not None]
        if waiting:
            await asyncio.wait(waiting, timeout=GOODBYE_S)
        for session in list(self.sessions):
            session.close(1001, "the run is over")

    async def stop(self) -> dict[str, Any]:
        """Request a safe stop from the host, wait for its end, and return the result as text."""
        if self.stopping >= STOPS:
            return {"ok": False, "text": "a stop is under way already"}
        self.stopping += 1
        try:
            result = await asyncio.get_running_loop().run_in_executor(self.stops, self.door.stop)
        except Exception as error:
            return {"ok": False, "text": str(error)}
        finally:
            self.stopping -= 1
        with self.lock:
            self.host.ended(result)
        trip = result.get("trip")
        if trip:
            return {"ok": True, "text": f"the host had tripped: {trip}", "tripped": True}
        return {"ok": True, "text": "the host stopped safely"}

    async def ask(self, session: Data, what: str, question: Callable[[], Mapping[str, Any]]) -> None:
        """Send the controlling page's change, marker or fault; the answer goes to that page as text."""
        if self.control.holder != session.number:
            session.answers.append(f"{what}: this page is viewing; take control first")
            return
        if self.asking >= QUESTIONS:
            session.answers.append(f"{what}: too many are under way; again in a moment")
            return
        self.asking += 1
        try:
            answer = await asyncio.get_running_loop().run_in_executor(self.questions, question)
            session.answers.append(str(answer.get("marker", what)).partition(" [")[0])
        except Exception as error:
            session.answers.append(f"{what}: {error}")
        finally:
            self.asking -= 1


class _Html(Handler):
    page: Page | LastPage

    async def get(self, _: str) -> None:
        names = self.page.axis_names
        shown = self.get_query_argument("axis", "")
        shown = shown if shown in names else names[0]
        links = "".join(
            f'<a href="?axis={escape(name)}"{" aria-current=page" if name == shown else ""}>{escape(name)}</a>'
            for name in names
            if name
        )
        text = files(__package__).joinpath("page.html").read_text(encoding="utf-8")
        text = text.replace("{{rig}}", escape(self.page.rig_name)).replace("{{axes}}", links)
        self.finish(text)


class _Layout(Handler):
    page: Page | LastPage

    async def get(self, _: str) -> None:
        self.finish(self.page.layout(self.get_query_argument("axis", "")))


class _Stop(Handler):
    page: Page | LastPage

    async def post(self, _: str) -> None:
        self.finish(await self.page.stop())


class Data(Guarded, tornado.websocket.WebSocketHandler):
    """WebSocket session of one page."""

    page: Page

    def initialize(self, page: Page) -> None:  # type: ignore[override]  # it is served nothing else
        """Store the shared state."""
        super().initialize(page)
        self.flow = Flow()
        self.trip_ns: int | None = None
        self.number, self.rubbish, self.version, self.refused = next(page.numbers), 0, 0, False
        self.answers: deque[str] = deque(maxlen=ANSWERS)
        self._tasks: set[asyncio.Task[None]] = set()

    def prepare(self) -> None:
        """Refuse a request without the token, from another page, or beyond the limit."""
        self._stream = self.admit()
        if not self.from_the_page():
            raise tornado.web.HTTPError(FORBIDDEN)
        if len(self.page.sessions) >= SESSIONS:
            raise tornado.web.HTTPError(503)

    def check_origin(self, origin: str) -> bool:
        """Return True: `prepare` has checked it."""
        return same_origin(origin, self.request.headers.get("Host"))

    def open(self, *_: str, **__: str) -> None:
        """Open the session; the first page controls."""
        self.set_nodelay(True)
        self.axis = self.page.axis(self.get_query_argument("axis", ""))
        self.page.control.acquire(self.number)
        self.page.sessions.add(self)
        self.page.sockets.add(self._stream)

    def on_close(self) -> None:
        """Remove the session and release its control."""
        self.page.sessions.discard(self)
        self.page.control.release(self.number)

    def on_message(self, message: str | bytes) -> None:
        """Process a message; invalid ones are counted, and too many end the session."""
        text = message if isinstance(message, str) else ""
        took = TOOK.fullmatch(text)
        if took is not None and self.flow.acknowledge(int(took[1])):
            return
        if text == "control":
            self.refused = not self.page.control.acquire(self.number)
            return
        mark = MARK.fullmatch(text)
        if mark is not None:
            self._ask(f"mark {mark[1]}", lambda: self.page.door.mark(mark[1]))
            return
        parameter_change = order_of(text, self.axis.name)
        if parameter_change is not None:
            self._ask("not changed", lambda: self.page.door.change(parameter_change))
            return
        fault = fault_of(text)
        if fault is not None and self.page.faults is not None:
            verb, *place = fault
            faults = self.page.faults
            act, refused = (faults.inject, "not broken") if verb == "inject" else (faults.clear, "not repaired")
            self._ask(refused, lambda: {"marker": act(*place)})
            return
        self.rubbish += 1
        if self.rubbish > RUBBISH:
            self.close(1008, "too many messages of no known form")

    def _ask(self, what: str, question: Callable[[], Mapping[str, Any]]) -> None:
        task = asyncio.get_running_loop().create_task(self.page.ask(self, what, question))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    def send(self, state: dict[str, Any] | None, version: int) -> asyncio.Future[None] | None:
        """Send the next batch, with the state if it is new to the page; return after sending, None if the page closed."""
        more: dict[str, Any] = {}
        if version != self.version:
            self.version = version
            controls = self.page.control.holder == self.number
            more = {"state": state, "controls": controls, "refused": self.refused and not controls}
            more["answer"] = self.answers.popleft() if self.answers else ""
        try:
            if self.trip_ns != self.page.trip_ns:
                self.trip_ns = self.page.trip_ns
                if self.trip_ns is not None:
                    self.write_message(self.page.trip_batches[self.axis.name], binary=True)
            sent = self.write_message(self.page.message(self.axis, self.flow, more), binary=True)
            sent.add_done_callback(lambda done: done.exception())  # a closed page: on_close follows
        except tornado.websocket.WebSocketClosedError:
            return None
        return sent


def order_of(message: str, axis: str) -> dict[str, Any] | None:
    """Return the host order of a page's message ``set {...}``, or None. A page changes the parameters of its own axis."""
    verb, _, content = message.partition(" ")
    try:
        parameter_change = json.loads(content) if verb == "set" else None
    except (ValueError, RecursionError):
        return None
    if not isinstance(parameter_change, dict) or not parameter_change.keys() <= {"values", "undo", "key"}:
        return None
    return {**parameter_change, "axis": axis}


def fault_of(message: str) -> tuple[str, str, str] | None:
    """Return "inject" or "clear", fault and place of a page's message ``inject {...}`` or ``clear {...}``, or None."""
    verb, _, content = message.partition(" ")
    try:
        fault = json.loads(content) if verb in ("inject", "clear") else None
    except (ValueError, RecursionError):
        return None
    if (
        not isinstance(fault, dict)
        or fault.keys() != {"fault", "on"}
        or not all(isinstance(v, str) for v in fault.values())
    ):
        return None
    return verb, fault["fault"], fault["on"]


def application(page: Page | LastPage) -> tornado.web.Application:
    """Return the web application of a live page, or of a kept one."""
    shared = {"page": page}
    return tornado.web.Application(
        [
            (r"/([^/]*)/", _Html, shared),
            (r"/([^/]*)/static/([a-z.]+)", Static, shared),
            (r"/([^/]*)/layout", _Layout, shared),
            (r"/([^/]*)/data", Data if isinstance(page, Page) else LastData, shared),
            (r"/([^/]*)/stop", _Stop, shared),
        ],
        default_handler_class=Nothing,
        default_handler_args=shared,
        log_function=lambda handler: None,
        websocket_max_message_size=MESSAGE_BYTES,
        websocket_ping_interval=10,
        websocket_ping_timeout=10,
    )
