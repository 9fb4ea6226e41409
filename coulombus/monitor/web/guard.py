"""Who is answered: a request with the token, for the address that is served, and from the page itself."""

from __future__ import annotations

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
"""Nothing is loaded from anywhere else."""
FORBIDDEN, MISDIRECTED = 403, 421
REFUSALS = {
    FORBIDDEN: "the address needs the page's token: open the URL that the command printed",
    MISDIRECTED: "this page is not served under that name and port: open the URL that the command printed",
}


class GuardedPage(Protocol):
    """What is served: behind which token, and by which name beside its address."""

    token: str
    name: str


class Guarded(tornado.web.RequestHandler):
    """A request of who has the token, for the address that is served."""

    page: GuardedPage

    def initialize(self, page: GuardedPage) -> None:
        """Keep what is served."""
        self.page = page

    def admit(self) -> IOStream:
        """Return the connection of a request that may be answered.

        Raises
        ------
        tornado.web.HTTPError
            its header Host names another server, or its address has not the token
        """
        stream: IOStream = self.request.connection.stream  # type: ignore[union-attr]  # it has one
        address, port = stream.socket.getsockname()[:2]
        if not served_as(self.request.headers.get("Host"), address, port, self.page.name):
            raise tornado.web.HTTPError(MISDIRECTED)
        if not right_token(self.path_args[0] if self.path_args else "", self.page.token):
            raise tornado.web.HTTPError(FORBIDDEN)
        return stream

    def from_the_page(self) -> bool:
        """Tell whether the page itself asks, and no other one."""
        return same_origin(self.request.headers.get("Origin"), self.request.headers.get("Host"))

    def write_error(self, status_code: int, **_: Any) -> None:
        """Say why, as plain text."""
        self.set_header("Content-Type", "text/plain; charset=utf-8")
        self.finish(REFUSALS.get(status_code, self._reason) + "\n")


class Handler(Guarded):
    """An HTTP request that is answered with the headers of a page which loads nothing from elsewhere."""

    def set_default_headers(self) -> None:
        """Allow nothing that comes from elsewhere."""
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
    """What is nowhere: 403, also with the right token."""

    def prepare(self) -> None:
        """Refuse it."""
        self.admit()
        raise tornado.web.HTTPError(FORBIDDEN)


class Static(Handler):
    """The page's style and scripts."""

    OWN = (
        *("page.css", "elements.js", "stop.js", "data.js", "axes.js", "plots.js", "controls.js", "incidents.js"),
        *("words.js", "page.js", "recording.css", "recording.js"),
    )

    async def get(self, _: str, name: str) -> None:
        """Send a file."""
        if name not in self.OWN:
            raise tornado.web.HTTPError(404)
        self.set_header("Content-Type", TYPES[Path(name).suffix] + "; charset=utf-8")
        self.finish(files(__package__).joinpath(name).read_bytes())
