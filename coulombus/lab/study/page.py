"""The page that asks a subject: one text, its answers as buttons and keys, and Stop at any time.

On the loopback interface alone, with the checks of every page (`monitor.web.guard`)::

    GET  /TOKEN/                the page
    GET  /TOKEN/state?after=N   what is shown, as soon as it is another than number N
    POST /TOKEN/answer          {"n": N, "answer": "1"}: the answer to number N
    POST /TOKEN/stop            the subject stops: the display that is on ends safely

An answer that comes late, twice, or to another question is refused.
"""

from __future__ import annotations

import asyncio
import json
import secrets
import threading
from collections.abc import Callable
from importlib.resources import files
from types import TracebackType
from typing import Any, Self

import tornado.httpserver
import tornado.web

from coulombus.lab.study.trials import Trial, is_answer
from coulombus.monitor.web.access import new_token
from coulombus.monitor.web.guard import Handler, Nothing
from coulombus.monitor.web.server import listening

__all__ = ["AnswerPage"]

HOST = "127.0.0.1"
HELD_S = 10.0
"""So long a question for news is held before it is answered with none."""
POLL_S, LOOK_S = 0.05, 0.2
BODY_BYTES = 4096
REFUSED = 409


class AnswerPage:
    """Asks a subject in a browser; entered, it serves.

    Parameters
    ----------
    question : of the study
    stop : called when the subject stops, from another thread

    Raises
    ------
    coulombus.monitor.web.WebError
        the port is not available
    """

    def __init__(self, question: str, stop: Callable[[], None], port: int = 0) -> None:
        self._question, self._stop = question, stop
        self._news = threading.Condition()
        self.shown: dict[str, Any] = {"n": 0, "kind": "wait", "text": "The study begins soon."}
        self._answer: str | None = None
        self._valid: Callable[[str], bool] = lambda text: False
        self.stopped = self.ended = False
        self.token, self.name = new_token(), HOST
        self._sockets = listening(HOST, port, "--port")
        self._thread = threading.Thread(target=lambda: asyncio.run(self._serve()), name="page", daemon=True)

    @property
    def url(self) -> str:
        """Where the page is."""
        return f"http://{HOST}:{self._sockets[0].getsockname()[1]}/{self.token}/"

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.ended = True
        self._thread.join()
        for listener in self._sockets:
            listener.close()

    async def _serve(self) -> None:
        shared = {"page": self}
        routes = [(r"/([^/]*)/", _SubjectPage), (r"/([^/]*)/state", _State), (r"/([^/]*)/answer", _SubjectAnswer)]
        server = tornado.httpserver.HTTPServer(
            tornado.web.Application(
                [(place, handler, shared) for place, handler in (*routes, (r"/([^/]*)/stop", _SubjectStop))],
                default_handler_class=Nothing,
                default_handler_args=shared,
            ),
            max_body_size=BODY_BYTES,
        )
        server.add_sockets(self._sockets)
        while not self.ended:
            await asyncio.sleep(POLL_S)
        server.stop()
        await server.close_all_connections()

    # the session's thread

    def show(self, text: str) -> None:
        """Show a text that wants no answer."""
        self._put("wait", text)

    def ask(self, trial: Trial) -> str | None:
        """Ask the study's question, and wait for the answer; None: the subject stops."""
        kind = "number" if trial.reference is None else "choice"
        return self._answer_to(kind, self._question, lambda text: is_answer(text, trial))

    def go_on(self, text: str) -> bool:
        """Show a text and wait; False: the subject stops."""
        return self._answer_to("go_on", text, lambda answer: answer == "y") is not None

    def over(self, text: str) -> None:
        """Show the last text."""
        self._put("over", text)

    def _put(self, kind: str, text: str, valid: Callable[[str], bool] = lambda text: False) -> None:
        with self._news:
            self.shown = {"n": self.shown["n"] + 1, "kind": kind, "text": text}
            self._valid, self._answer = valid, None

    def _answer_to(self, kind: str, text: str, valid: Callable[[str], bool]) -> str | None:
        self._put(kind, text, valid)
        with self._news:
            while self._answer is None and not self.stopped:
                self._news.wait(LOOK_S)  # a signal is taken in between
            return None if self.stopped else self._answer

    # the page's thread

    def accept(self, number: int, answer: str) -> bool:
        """Accept an answer to the question of this number; return whether it is valid."""
        with self._news:
            if number != self.shown["n"] or self._answer is not None or not self._valid(answer):
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


class _SubjectPage(Handler):
    async def get(self, _: str) -> None:
        nonce = secrets.token_urlsafe(16)
        policy = f"default-src 'none'; script-src 'nonce-{nonce}'; style-src 'nonce-{nonce}'; connect-src 'self'; "
        policy += "frame-ancestors 'none'; base-uri 'none'; form-action 'none'"
        self.set_header("Content-Security-Policy", policy)
        text = files("coulombus.lab.study").joinpath("page.html").read_text(encoding="utf-8")
        self.finish(text.replace("NONCE", nonce))


class _State(Handler):
    page: AnswerPage

    async def get(self, _: str) -> None:
        after, loop = self.get_query_argument("after", "-1"), asyncio.get_running_loop()
        until_s = loop.time() + HELD_S
        while str(self.page.shown["n"]) == after and not self.page.ended and loop.time() < until_s:
            await asyncio.sleep(POLL_S)
        self.finish(self.page.shown)


class _SubjectAnswer(Handler):
    page: AnswerPage

    async def post(self, _: str) -> None:
        try:
            message = json.loads(self.request.body)
            number, answer = message["n"], message["answer"]
        except (ValueError, TypeError, KeyError, RecursionError):
            raise tornado.web.HTTPError(REFUSED) from None
        if type(number) is not int or not isinstance(answer, str) or not self.page.accept(number, answer):
            raise tornado.web.HTTPError(REFUSED)
        self.finish("taken\n")


class _SubjectStop(Handler):
    page: AnswerPage

    async def post(self, _: str) -> None:
        self.page.stop()
        self.finish("stopped\n")
