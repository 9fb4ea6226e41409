"""The page that asks a subject: one text, its answers as buttons and keys, and Stop at any time.

On the loopback interface alone. All addresses begin with a token that nobody guesses::

    GET  /TOKEN/                the page
    GET  /TOKEN/state?after=N   what is shown, as soon as it is another than number N
    POST /TOKEN/answer          {"n": N, "answer": "1"}: the answer to number N
    POST /TOKEN/stop            the subject stops: the display that is on ends safely

An answer that comes late, twice, or to another question is refused.
"""

from __future__ import annotations

import json
import secrets
import threading
from collections.abc import Callable
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from types import TracebackType
from typing import Any, Self
from urllib.parse import parse_qs, urlsplit

from coulombus.lab.study.trials import Trial, is_answer
from coulombus.monitor.web import WebError
from coulombus.monitor.web.access import new_token, right_token, same_origin

__all__ = ["AnswerPage"]

HELD_S = 10.0
"""So long a question for news is held before it is answered with none."""
LOOK_S = 0.2
BODY_BYTES = 1000


class AnswerPage:
    """Asks a subject in a browser; entered, it serves.

    Parameters
    ----------
    question : of the study
    stop : called when the subject stops, from another thread
    """

    def __init__(self, question: str, stop: Callable[[], None], port: int = 0) -> None:
        self._question, self._stop = question, stop
        self._news = threading.Condition()
        self._state: dict[str, Any] = {"n": 0, "kind": "wait", "text": "The study begins soon."}
        self._answer: str | None = None
        self._valid: Callable[[str], bool] = lambda text: False
        self.stopped = False
        self.token = new_token()
        try:
            self._server = _Server(("127.0.0.1", port), _Handler)
        except (OSError, OverflowError) as error:
            raise WebError(
                f"port {port} of 127.0.0.1: {error}; choose another with --port, or 0 for a free one"
            ) from None
        self._server.page = self
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.05,), name="page", daemon=True)

    @property
    def url(self) -> str:
        """Where the page is."""
        return f"http://127.0.0.1:{self._server.server_port}/{self.token}/"

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()

    # the session's thread

    def tell(self, text: str) -> None:
        """Show a text that wants no answer."""
        self._put("wait", text)

    def ask(self, trial: Trial) -> str | None:
        """Ask the study's question, and wait for the answer; None: the subject stops."""
        kind = "number" if trial.reference is None else "choice"
        return self._answer_to(kind, self._question, lambda text: is_answer(text, trial))

    def go_on(self, text: str) -> bool:
        """Show a text and wait; False: the subject stops."""
        return self._answer_to("go_on", text, lambda given: given == "y") is not None

    def over(self, text: str) -> None:
        """Show the last text."""
        self._put("over", text)

    def _put(self, kind: str, text: str, valid: Callable[[str], bool] = lambda text: False) -> None:
        with self._news:
            self._state = {"n": self._state["n"] + 1, "kind": kind, "text": text}
            self._valid, self._answer = valid, None
            self._news.notify_all()

    def _answer_to(self, kind: str, text: str, valid: Callable[[str], bool]) -> str | None:
        self._put(kind, text, valid)
        with self._news:
            while self._answer is None and not self.stopped:
                self._news.wait(LOOK_S)  # a signal is taken in between
            return None if self.stopped else self._answer

    # the page's threads

    def state(self, after: int) -> dict[str, Any]:
        """Return what is shown, once it is another than `after`, or a while has gone by."""
        with self._news:
            self._news.wait_for(lambda: self._state["n"] != after, HELD_S)
            return self._state

    def take(self, number: int, answer: str) -> bool:
        """Take an answer to the question of this number; tell whether it is one."""
        with self._news:
            if number != self._state["n"] or self._answer is not None or not self._valid(answer):
                return False
            self._answer = answer
            self._news.notify_all()
            return True

    def stop(self) -> None:
        """Stop for the subject."""
        with self._news:
            self.stopped = True
            self._news.notify_all()
        self._stop()


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    page: AnswerPage


class _Handler(BaseHTTPRequestHandler):
    server: _Server
    timeout = 30
    server_version, sys_version = "coulombus", ""

    def log_message(self, format: str, *args: Any) -> None:
        """Tell nothing."""

    def _place(self) -> str | None:
        token, _, place = urlsplit(self.path).path.lstrip("/").partition("/")
        if not right_token(token, self.server.page.token):
            self._send(403, "text/plain", b"403: the address of the page is printed at the terminal\n")
            return None
        return place

    def do_GET(self) -> None:
        """Answer with the page, or with what is shown."""
        place = self._place()
        if place == "":
            nonce = secrets.token_urlsafe(16)
            text = files("coulombus.lab.study").joinpath("page.html").read_text(encoding="utf-8")
            policy = f"default-src 'none'; script-src 'nonce-{nonce}'; style-src 'nonce-{nonce}'; connect-src 'self'; "
            policy += "frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
            self._send(200, "text/html; charset=utf-8", text.replace("NONCE", nonce).encode(), policy)
        elif place == "state":
            after = parse_qs(urlsplit(self.path).query).get("after", ["-1"])[0]
            number = int(after) if after.isascii() and after.isdecimal() and len(after) < 10 else -1
            self._send(200, "application/json", json.dumps(self.server.page.state(number)).encode())
        elif place is not None:
            self._send(404, "text/plain", b"404\n")

    def do_POST(self) -> None:
        """Take an answer, or the subject's stop."""
        place = self._place()
        if place is None:
            return
        if not same_origin(self.headers.get("Origin"), self.headers.get("Host")):
            self._send(403, "text/plain", b"403: not from the page itself\n")
        elif place == "stop":
            self.server.page.stop()
            self._send(200, "text/plain", b"stopped\n")
        elif place == "answer":
            accepted = self._take()
            self._send(
                200 if accepted else 409, "text/plain", b"taken\n" if accepted else b"409: no answer to what is asked\n"
            )
        else:
            self._send(404, "text/plain", b"404\n")

    def _take(self) -> bool:
        length = self.headers.get("Content-Length", "")
        if not (length.isascii() and length.isdecimal() and len(length) < 5 and int(length) <= BODY_BYTES):
            return False
        try:
            given = json.loads(self.rfile.read(int(length)))
        except (ValueError, RecursionError):
            return False
        if not isinstance(given, dict):
            return False
        number, answer = given.get("n"), given.get("answer")
        return type(number) is int and isinstance(answer, str) and self.server.page.take(number, answer)

    def _send(self, status: int, kind: str, body: bytes, policy: str = "default-src 'none'") -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(body)))
        self.send_header("Content-Security-Policy", policy)
        self.send_header("Cache-Control", "no-store")
        self.send_header("X-Content-Type-Options", "nosniff")
        self.send_header("Referrer-Policy", "no-referrer")
        self.send_header("Connection", "close")
        self.end_headers()
        self.wfile.write(body)
        self.close_connection = True
