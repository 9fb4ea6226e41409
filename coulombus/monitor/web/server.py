"""The page's server: HTTP and WebSocket by Tornado, on the loopback interface by default."""

from __future__ import annotations

import asyncio
import errno
import os
import socket
import threading
import time
from collections import deque
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from typing import Any

import tornado.httpserver
from tornado.iostream import IOStream

from coulombus.monitor.bus_reader import BATCH_S, BusReader
from coulombus.monitor.live_incidents import IncidentReader
from coulombus.monitor.web import WebError
from coulombus.monitor.web.capture import LiveCapture
from coulombus.monitor.web.last_page import LastPage
from coulombus.monitor.web.page import Page, application
from coulombus.monitor.web.page_state import FaultDoor, HostDoor
from coulombus.monitor.web.reader import CurveReader, FaultReader, HostReader
from coulombus.recording.maps.known_bus import KnownBus
from coulombus.rigs.rig import Rig
from coulombus.system.stop_signals import StopSignals
from coulombus.wire.adapter import open_bus
from coulombus.wire.address import BusAddress, BusUnavailable
from coulombus.wire.client import OpenBus
from coulombus.wire.handshake import Flags, Hello

__all__ = ["Server", "Shown", "end_on_signal", "listening", "named", "serve", "serve_last", "serve_until"]

CONNECTIONS = 128
"""Maximum open connections besides the pages' sockets: another one replaces the oldest."""
IDLE_S = 10.0
"""Idle time-out of a connection."""
RETRY_S = 0.5
WORD_S = 5.0
"""Time limit for a host to end and report after the bus has closed."""


class Server(tornado.httpserver.HTTPServer):
    """The HTTP server of a page, with limits for clients: number and duration of connections, and size of requests."""

    def initialize(self, page: Page) -> None:  # type: ignore[override]  # tornado's constructor
        """Keep the page; see `tornado.util.Configurable`."""
        super().initialize(
            application(page),
            max_header_size=16384,
            max_body_size=4096,
            idle_connection_timeout=IDLE_S,
            body_timeout=IDLE_S,
        )
        self._page, self._streams = page, deque[IOStream]()

    def handle_stream(self, stream: IOStream, address: tuple[Any, ...]) -> None:
        """Serve a connection; if there are too many, close the oldest that is not a page's."""
        page_streams = self._page.sockets
        self._streams = deque(stream for stream in self._streams if not stream.closed() and stream not in page_streams)
        while len(self._streams) >= CONNECTIONS:
            self._streams.popleft().close()
        self._streams.append(stream)
        super().handle_stream(stream, address)


def listening(host: str, port: int, option: str = "--web-port") -> list[socket.socket]:
    """Return the listening sockets; port 0: a free port. `option` names the port on the command line.

    Raises
    ------
    WebError
        the port is in use or not permitted, or there is no such address
    """
    try:
        return [_bound(host, port)]
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise WebError(
                f"port {port} of {host} is in use: choose another with {option}, or 0 for a free one"
            ) from None
        if error.errno == errno.EACCES:
            raise WebError(f"port {port} may not be taken: choose one of 1024 or more with {option}") from None
        raise WebError(
            f"the page cannot be served at {host}: {error.strerror or error}; --web-host names an address of this machine"
        ) from None


def _bound(host: str, port: int) -> socket.socket:
    family, kind, protocol, _, place = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    listener = socket.socket(family, kind, protocol)
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.bind(place)
        listener.listen(CONNECTIONS)
        listener.setblocking(False)
    except OSError:
        listener.close()
        raise
    return listener


@dataclass(frozen=True)
class Shown:
    """Content of a page: a rig, its bus, the connections to its host and to its faults; and the access token."""

    rig: Rig
    address: BusAddress
    door: HostDoor
    token: str
    faults: FaultDoor | None = None


def serve(
    shown: Shown,
    ready: Callable[[str], None],
    *,
    host: str = "127.0.0.1",
    port: int = 0,
    seconds: float | None = None,
    parent: int | None = None,
) -> None:
    """Serve the page until a signal, or for `seconds`.

    Parameters
    ----------
    ready : called with the page's URL when it is served
    parent : a pipe of the parent process: its end ends the page; the server then waits for the bus, and
        the page stays when the bus closes

    Raises
    ------
    WebError
        the port or address is not available
    coulombus.wire.address.BusUnavailable
        there is no bus, or it closed meanwhile
    """
    sockets = listening(host, port)
    name = named(host)
    url = f"http://{name}:{sockets[0].getsockname()[1]}/{shown.token}/"
    try:
        with StopSignals() as stop:
            asyncio.run(_serve(shown, lambda: ready(url), name, sockets, seconds, parent, stop))
    except BusUnavailable:
        if parent is None:
            raise
    finally:
        for socket_ in sockets:
            socket_.close()


async def _serve(
    shown: Shown,
    ready: Callable[[], None],
    name: str,
    sockets: list[socket.socket],
    seconds: float | None,
    parent: int | None,
    stop: StopSignals,
) -> None:
    loop, over = asyncio.get_running_loop(), asyncio.Event()
    loop.add_reader(stop.fileno(), over.set)
    if parent is not None:
        loop.add_reader(parent, lambda: None if os.read(parent, 64) else over.set())
    if seconds is not None:
        loop.call_later(seconds, over.set)
    incidents = IncidentReader(KnownBus(shown.rig))
    client = await _client(shown.address, patient=parent is not None, over=over)
    if client is None:
        return
    capture = LiveCapture(shown.rig)
    capture.snapshot(time.time_ns())  # rates count from here
    with client:
        lock = threading.Lock()
        reader = BusReader(client, capture, lock, incidents)
        page = Page(capture, shown.door, shown.token, reader.facts, lock)
        page.name = name
        server = Server(page)
        curves = CurveReader(shown.door, page.host, shown.rig, lock)
        page.curves = curves.curves
        page.ring = lambda: curves.ring
        page.incidents = lambda: incidents.rows
        faults = FaultReader(shown.faults, lambda: bool(page.sessions))
        page.faults, page.fault_state = shown.faults, lambda: faults.state
        with reader, incidents, HostReader(shown.door, page.host, lock), curves, faults:
            server.add_sockets(sockets)
            ready()
            due_s = loop.time()
            while not over.is_set() and (reader.failure is None or parent is not None):
                page.tick(reader.until_ns if reader.failure is None else time.time_ns())
                due_s = max(due_s + BATCH_S, loop.time())  # late updates are not caught up
                await asyncio.sleep(due_s - loop.time())  # `_pause` makes a task and cancels it
            if reader.failure is not None:
                await _last_word(shown.door, over)
            await page.say_goodbye(reader.until_ns)
        server.stop()
        await server.close_all_connections()
        page.stops.shutdown(wait=False)
        page.questions.shutdown(wait=False, cancel_futures=True)
        if reader.failure is not None:
            raise reader.failure


async def _last_word(door: HostDoor, over: asyncio.Event) -> None:
    """Wait until the host has reported its end, or a time limit: a closed bus ends the host a
    little later than this server's reader.
    """
    end = asyncio.get_running_loop().time() + WORD_S
    with suppress(Exception):
        while not over.is_set() and door.last() is None and asyncio.get_running_loop().time() < end:
            await _pause(over, WORD_S / 50)


async def _client(address: BusAddress, *, patient: bool, over: asyncio.Event) -> OpenBus | None:
    """Return a client of the bus; if it does not exist yet and the caller is patient, wait until `over` (None)."""
    while not over.is_set():
        try:
            return open_bus(address, Hello(Flags.LISTEN_ONLY | Flags.ERRORS))
        except BusUnavailable:
            if not patient:
                raise
            await _pause(over, RETRY_S)
    return None


@asynccontextmanager
async def end_on_signal(seconds: float | None) -> AsyncIterator[asyncio.Event]:
    """Yield an event that a signal sets, or the end of `seconds`."""
    loop, over = asyncio.get_running_loop(), asyncio.Event()
    with StopSignals() as stop:
        loop.add_reader(stop.fileno(), over.set)
        if seconds is not None:
            loop.call_later(seconds, over.set)
        try:
            yield over
        finally:
            loop.remove_reader(stop.fileno())


def serve_until(
    server: tornado.httpserver.HTTPServer,
    sockets: list[socket.socket],
    ready: Callable[[int], None],
    seconds: float | None,
    leave: Callable[[], None] = lambda: None,
) -> None:
    """Serve at listening sockets until a signal, or for `seconds`, and close them.

    Parameters
    ----------
    ready : called with the port when it is served
    leave : called at the end, to close WebSockets
    """

    async def run() -> None:
        async with end_on_signal(seconds) as over:
            server.add_sockets(sockets)
            ready(sockets[0].getsockname()[1])
            await over.wait()
            server.stop()
            leave()
            await server.close_all_connections()

    try:
        asyncio.run(run())
    finally:
        for listener in sockets:
            listener.close()


def serve_last(
    page: LastPage,
    ready: Callable[[str], None],
    *,
    host: str = "127.0.0.1",
    port: int = 0,
    seconds: float | None = None,
) -> None:
    """Serve the page of the last trip until a signal, or for `seconds`; parameters and errors as of `serve`."""
    sockets = listening(host, port)
    page.name = named(host)
    server = tornado.httpserver.HTTPServer(application(page))
    serve_until(server, sockets, lambda at: ready(f"http://{page.name}:{at}/{page.token}/"), seconds)


async def _pause(over: asyncio.Event, seconds: float) -> None:
    """Wait for a time, or until the end."""
    with suppress(TimeoutError):
        await asyncio.wait_for(over.wait(), seconds)


def named(host: str) -> str:
    """Return the address for a browser: a name of this machine if it listens on all addresses."""
    if host in ("0.0.0.0", "::", ""):
        return socket.gethostname()
    return f"[{host}]" if ":" in host else host
