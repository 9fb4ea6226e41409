"""Request checks: correct token, served address, and same origin."""

from __future__ import annotations

import logging
from importlib.resources import files
from pathlib import Path
from typing import Any, Protocol

import tornado.web
from tornado.iostream import IOStream

from coulombus.monitor.web.access import right_token, same_origin, served_as

__all__ = ["FORBIDDEN", "Guarded", "GuardedPage", "Handler", "Nothing", "Static"]

TYPES = {".css": "text/css", ".js": "text/javascript", ".html": "text/html"}
POLICY = "; ".join(
    (
        *("default-src 'none'", "script-src 'self'", "style-src 'self'", "connect-src 'self'"),
        *("img-src 'self' data:", "form-action 'self'", "frame-ancestors 'none'", "base-uri 'none'"),
    )
)
"""Headers that forbid loading from other origins."""
FORBIDDEN, MISDIRECTED = 403, 421
REFUSALS = {
    FORBIDDEN: "the address needs the page's token: open the URL that the command printed",
    MISDIRECTED: "this page is not served under that name and port: open the URL that the command printed",
}

_LOG = logging.getLogger("tornado")  # clients could flood the terminal, and it prints the token
_LOG.addHandler(logging.NullHandler())
_LOG.propagate = False


class GuardedPage(Protocol):
    """A served page: its token, and its name besides its address."""

    token: str
    name: str


class Guarded(tornado.web.RequestHandler):
    """Mixin of a request with the token, for the served address."""

    page: GuardedPage

    def initialize(self, page: GuardedPage) -> None:
        """Store the page."""
        self.page = page

    def admit(self) -> IOStream:
        """Return the connection of an admitted request.

        Raises
        ------
        tornado.web.HTTPError
            its header Host names another server, or its URL lacks the token
        """
        stream: IOStream = self.request.connection.stream  # type: ignore[union-attr]  # it has one
        address, port = stream.socket.getsockname()[:2]
        if not served_as(self.request.headers.get("Host"), address, port, self.page.name):
            raise tornado.web.HTTPError(MISDIRECTED)
        if not right_token(self.path_args[0] if self.path_args else "", self.page.token):
            raise tornado.web.HTTPError(FORBIDDEN)
        return stream

    def from_the_page(self) -> bool:
        """Return whether the request comes from the page itself."""
        return same_origin(self.request.headers.get("Origin"), self.request.headers.get("Host"))

    def write_error(self, status_code: int, **_: Any) -> None:
        """Write the reason as plain text."""
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.finish(REFUSALS.get(status_code, self._reason) + "\n")


class Handler(Guarded):
    """An HTTP request, answered with headers that forbid other origins."""

    def set_default_headers(self) -> None:
        """Forbid content from other origins."""
        for name, value in (
            ("Content-Security-Policy", POLICY),
            ("Referrer-Policy", "same-origin"),
            ("X-Content-Type-Options", "nosniff"),
            ("X-Frame-Options", "DENY"),
            ("Cache-Control", "no-store"),
            ("Server", "coulombus"),
        ):
            self.set_header(name, value)

    def prepare(self) -> None:
        """Admit the request, or refuse it."""
        self.admit()
        if self.request.method == "POST" and not self.from_the_page():
            raise tornado.web.HTTPError(FORBIDDEN)


class Nothing(Handler):
    """Unknown paths: 403, even with the correct token."""

    def prepare(self) -> None:
        """Refuse it."""
        self.admit()
        raise tornado.web.HTTPError(FORBIDDEN)


class Static(Handler):
    """The page's style and scripts."""

    OWN = (
        *("page.css", "elements.js", "stop.js", "data.js", "axes.js", "plots.js", "controls.js", "incidents.js"),
        *("tip.js", "bus.js", "bus.css", "words.js", "page.js", "recording.css", "recording.js"),
    )

    async def get(self, _: str, name: str) -> None:
        """Send a file."""
        if name not in self.OWN:
            raise tornado.web.HTTPError(404)
        self.set_header("Content-Type", TYPES[Path(name).suffix] + "; charset=utf-8")
        self.finish(files(__package__).joinpath(name).read_bytes())
