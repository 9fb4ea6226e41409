"""WebSocket clients at the socket for worlds of a running host (``coulombus world``).

A process of its own, between the browser, game engine or other machine and the host. The host sees each
client as a program at its AF_UNIX socket. Paths begin with the token; others get 403::

    GET  /TOKEN/world   WebSocket: messages of docs/worlds.md
    GET  /TOKEN/        the page that the command was given

A browser names its page's origin, which must be this server. Programs send no Origin; they need the token.
"""

from __future__ import annotations

import asyncio
import math
import socket
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import tornado.httpserver
import tornado.web
import tornado.websocket

from coulombus.monitor.web.access import same_origin
from coulombus.monitor.web.guard import FORBIDDEN, Guarded, Handler, Nothing
from coulombus.monitor.web.server import listening, named, serve_until
from coulombus.system.errors import CoulombusError

__all__ = ["ClientRelay", "Gateway", "gateway_application", "serve_gateway"]

CLIENTS = 14
"""Maximum number of clients; the host has room for 16 programs."""
MESSAGE_BYTES = 8192
BATCH_S = 0.01
SHORTEST_BATCH_S, LONGEST_BATCH_S = 0.001, 1.0
MALFORMED = 100
"""Malformed messages after which a client is disconnected."""
CHUNK = 1 << 16
UNSENT_BYTES = 1 << 16
"""Size of the kernel's buffer for a client: what waits in it is old for a slow one."""
IDLE_S = 10.0
GOING_AWAY, POLICY, TRY_AGAIN = 1001, 1008, 1013
"""Status codes of a close (RFC 6455, section 7.4.1)."""
PAGE_POLICY = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; connect-src 'self'"


class ClientRelay(Protocol):
    """Translates between a client's messages and the records of the host's socket."""

    malformed: int

    def translate(self, message: str | bytes) -> bytes:
        """Return the records of a client's message; a malformed one is counted and raises CoulombusError."""

    def receive(self, data: bytes) -> None:
        """Take bytes of the host's socket."""

    @property
    def is_pending(self) -> bool:
        """Whether `batch` has something to send."""

    def batch(self) -> list[str | bytes]:
        """Return the messages for the client."""


@dataclass
class Gateway:
    """The socket of the host, and the clients.

    Attributes
    ----------
    path : the AF_UNIX socket
    relay : makes the relay of a client
    page : file that is served as the page
    name : the server's name in requests, besides its address
    """

    path: Path
    relay: Callable[[], ClientRelay]
    token: str
    name: str = ""
    page: Path | None = None
    clients: set[WorldClient] = field(default_factory=set)


class WorldClient(Guarded, tornado.websocket.WebSocketHandler):
    """A WebSocket client, and its connection to the host."""

    page: Gateway

    def initialize(self, page: Gateway) -> None:  # type: ignore[override]  # it is served nothing else
        """Store the gateway."""
        super().initialize(page)
        self.relay = page.relay()
        self._pending = asyncio.Event()
        self._tasks: list[asyncio.Task[None]] = []
        self._host: asyncio.StreamWriter | None = None

    def prepare(self) -> None:
        """Refuse a request without the token, from a foreign page, or beyond the limit."""
        self._stream = self.admit()
        origin = self.request.headers.get("Origin")
        if origin is not None and not self.from_the_page():
            raise tornado.web.HTTPError(FORBIDDEN)
        if len(self.page.clients) >= CLIENTS:
            raise tornado.web.HTTPError(503)
        self.batch_s = self._batch_s()

    def _batch_s(self) -> float:
        """Return the time between two batches [s]."""
        try:
            batch_s = float(self.get_query_argument("batch_s", str(BATCH_S)))
        except ValueError:
            raise tornado.web.HTTPError(400) from None
        if not math.isfinite(batch_s):
            raise tornado.web.HTTPError(400)
        return min(max(batch_s, SHORTEST_BATCH_S), LONGEST_BATCH_S)

    def check_origin(self, origin: str) -> bool:
        """Return whether a page of this server asks; called only where there is an Origin."""
        return same_origin(origin, self.request.headers.get("Host"))

    async def open(self, *_: str, **__: str) -> None:
        """Connect to the host."""
        self.set_nodelay(True)
        self._stream.socket.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, UNSENT_BYTES)
        self.page.clients.add(self)
        try:
            reader, self._host = await asyncio.open_unix_connection(self.page.path)
        except OSError:
            self.close(TRY_AGAIN, "no host lets a world in: start coulombus run --world")
            return
        if self not in self.page.clients:  # it closed meanwhile
            self._host.close()
            return
        loop = asyncio.get_running_loop()
        self._tasks = [loop.create_task(self._read_host(reader)), loop.create_task(self._send_batches())]

    def on_close(self) -> None:
        """Leave the host; the model of the client fades."""
        self.page.clients.discard(self)
        for task in self._tasks:
            task.cancel()
        if self._host is not None:
            self._host.close()

    async def on_message(self, message: str | bytes) -> None:
        """Pass a message to the host; while the host does not read, the client is not read either."""
        if self._host is None:
            return
        try:
            self._host.write(self.relay.translate(message))
        except CoulombusError:
            self._pending.set()
            if self.relay.malformed >= MALFORMED:
                self.close(POLICY, f"{MALFORMED} malformed messages")
            return
        with suppress(ConnectionError):
            await self._host.drain()

    async def _read_host(self, reader: asyncio.StreamReader) -> None:
        with suppress(ConnectionError, CoulombusError):
            while data := await reader.read(CHUNK):
                self.relay.receive(data)
                self._pending.set()
        await asyncio.sleep(2 * self.batch_s)  # the last batch, with the host's reason
        self.close(GOING_AWAY, "the host has ended, or has disconnected this client")

    async def _send_batches(self) -> None:
        """Send what has come, one batch after the other; the next one waits until the client has room."""
        with suppress(tornado.websocket.WebSocketClosedError):
            while True:
                await self._pending.wait()
                self._pending.clear()
                for message in self.relay.batch():
                    await self.write_message(message, binary=isinstance(message, bytes))
                await asyncio.sleep(self.batch_s)


class _WorldPage(Handler):
    page: Gateway

    async def get(self, _: str) -> None:
        if self.page.page is None:
            raise tornado.web.HTTPError(404)
        self.set_header("Content-Security-Policy", PAGE_POLICY)
        self.set_header("Content-Type", "text/html; charset=utf-8")
        try:
            self.finish(self.page.page.read_bytes())
        except OSError:
            raise tornado.web.HTTPError(404) from None


def gateway_application(gateway: Gateway) -> tornado.web.Application:
    """Return the web application of a gateway."""
    shared: dict[str, Any] = {"page": gateway}
    return tornado.web.Application(
        [(r"/([^/]*)/world", WorldClient, shared), (r"/([^/]*)/", _WorldPage, shared)],
        default_handler_class=Nothing,
        default_handler_args=shared,
        log_function=lambda handler: None,
        websocket_max_message_size=MESSAGE_BYTES,
        websocket_ping_interval=10,
        websocket_ping_timeout=10,
    )


def serve_gateway(
    gateway: Gateway,
    ready: Callable[[str], None],
    *,
    host: str = "127.0.0.1",
    port: int = 0,
    seconds: float | None = None,
) -> None:
    """Serve the clients until a signal, or for `seconds`.

    Parameters
    ----------
    ready : called with the server's URL, which ends with the token

    Raises
    ------
    coulombus.monitor.web.WebError
        the port or address is not available
    """
    sockets = listening(host, port)
    gateway.name = named(host)
    limits = {"max_header_size": 16384, "max_body_size": 4096, "idle_connection_timeout": IDLE_S}
    server = tornado.httpserver.HTTPServer(gateway_application(gateway), **limits)

    def leave() -> None:
        for client in list(gateway.clients):
            client.close(GOING_AWAY, "the gateway ends")

    serve_until(server, sockets, lambda at: ready(f"http://{gateway.name}:{at}/{gateway.token}/"), seconds, leave)
