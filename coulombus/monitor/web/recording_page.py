"""Page of a recording: the plots of the live page over its whole time; other signals on request.

All URLs begin with the token, as on the live page::

    GET  /TOKEN/                        the page
    GET  /TOKEN/static/F                its style and its scripts
    GET  /TOKEN/recording               rig, length, plots, signals, markers, incidents
    GET  /TOKEN/samples?s=S&a=A&b=B     a signal from A to B [s]: times, values; of many samples the
                                        least and the most of each piece
    GET  /TOKEN/at?t=T                  the last value of each signal at T [s]
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from html import escape
from importlib.resources import files
from typing import Any

import numpy as np
import tornado.httpserver
import tornado.web

from coulombus.explain.explained import Explanation
from coulombus.monitor.live_incidents import incident_rows
from coulombus.monitor.web.capture import ROWS
from coulombus.monitor.web.guard import Handler, Nothing, Static
from coulombus.monitor.web.page_state import incident_dicts
from coulombus.monitor.web.server import listening, named, serve_until
from coulombus.recording.signals import Recording, Series

__all__ = ["PIECES", "RecordingPage", "recording_application", "serve_recording"]

PIECES = 1500
"""Pieces of a plot: with more than twice as many samples, each piece is its minimum and maximum."""


@dataclass
class RecordingPage:
    """The served data: a recording, its incidents, and the access token."""

    recording: Recording
    explanation: Explanation
    token: str
    name: str = ""

    def document(self) -> dict[str, Any]:
        """Return the initial document of the page."""
        recording = self.recording
        times = [series.t_s for series in recording.signals.values() if len(series)]
        begin, end = (min(t[0] for t in times), max(t[-1] for t in times)) if times else (0.0, 1.0)
        return {
            "path": recording.path,
            "rig": "" if recording.known_rig is None else recording.rig.name,
            "begin": float(begin),
            "end": float(end) if end > begin else float(begin) + 1.0,
            "plots": self._plots(),
            "signals": [
                {"name": name, "unit": series.unit, "samples": len(series)}
                for name, series in recording.signals.items()
            ],
            "markers": [[float(t_s), text] for t_s, text in recording.markers],
            "incidents": incident_dicts(incident_rows(self.explanation), self.explanation.epoch_ns),
        }

    def _plots(self) -> list[dict[str, Any]]:
        """Return the live page's plots of all axes, without a rig one of each PDO, for the signals that
        were received.
        """
        rig, plots = self.recording.known_rig, list[dict[str, Any]]()
        if rig is None:
            for pdo in self.recording.pdos:
                names = [signal.name for signal in pdo.signals if len(self.recording.signals.get(signal.name, ()))]
                plots.append({"title": f"{pdo.node} {pdo.name}", "unit": "", "signals": names})
        prefixes = [] if rig is None else [axis.prefix for axis in rig.axes]
        for title, unit, keys in ROWS:
            names = [prefix + key for prefix in prefixes for key in keys]
            names = [name for name in names if len(self.recording.signals.get(name, ()))]
            plots.append({"title": title, "unit": unit, "signals": names})
        return [plot for plot in plots if plot["signals"]]

    def samples(self, name: str, begin_s: float, end_s: float) -> dict[str, list[float | None]] | None:
        """Return a signal's times [s] and values from `begin_s` to `end_s`, including a sample
        before and after; None if there is no such signal.
        """
        series = self.recording.signals.get(name)
        if series is None:
            return None
        first = max(0, int(series.t_s.searchsorted(begin_s)) - 1)
        behind = min(len(series), int(series.t_s.searchsorted(end_s, "right")) + 1)
        t_s, values = _pieces(series.t_s[first:behind], series.values[first:behind].astype(np.float64))
        return {"t": t_s.tolist(), "y": [value if math.isfinite(value) else None for value in values.tolist()]}

    def at(self, t_s: float) -> dict[str, float | None]:
        """Return the last value of each signal at a time [s], or None."""
        return {name: _held(series, t_s) for name, series in self.recording.signals.items()}


def _held(series: Series, t_s: float) -> float | None:
    last = int(series.t_s.searchsorted(t_s, "right")) - 1
    value = math.nan if last < 0 else float(series.values[last])
    return value if math.isfinite(value) else None


def _pieces(t_s: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the samples, or with many samples the minimum and maximum of each piece, in order."""
    if len(t_s) <= 2 * PIECES:
        return t_s, values
    starts = np.linspace(0, len(t_s), PIECES, endpoint=False).astype(np.int64)
    ends = np.append(starts[1:], len(t_s))
    rows = np.empty((PIECES, 2), np.int64)
    for piece, (start, end) in enumerate(zip(starts.tolist(), ends.tolist(), strict=True)):
        part = np.nan_to_num(values[start:end])
        rows[piece] = sorted((start + int(part.argmin()), start + int(part.argmax())))
    indices = rows.reshape(-1)
    return t_s[indices], values[indices]


class _Html(Handler):
    page: RecordingPage

    async def get(self, _: str) -> None:
        text = files(__package__).joinpath("recording.html").read_text(encoding="utf-8")
        self.finish(text.replace("{{title}}", escape(self.page.recording.path.rpartition("/")[2])))


class _Document(Handler):
    page: RecordingPage

    async def get(self, _: str) -> None:
        self.set_header("Content-Type", "application/json")
        self.finish(json.dumps(self.page.document(), allow_nan=False))


class _Samples(Handler):
    page: RecordingPage

    async def get(self, _: str) -> None:
        samples = self.page.samples(self.get_query_argument("s"), *(_second(self, name) for name in "ab"))
        if samples is None:
            raise tornado.web.HTTPError(404)
        self.finish(samples)


class _At(Handler):
    page: RecordingPage

    async def get(self, _: str) -> None:
        self.finish({"values": self.page.at(_second(self, "t"))})


def _second(handler: Handler, name: str) -> float:
    """Return a time from a request [s]; invalid values give status 400."""
    try:
        value = float(handler.get_query_argument(name))
    except ValueError:
        raise tornado.web.HTTPError(400) from None
    if not math.isfinite(value):
        raise tornado.web.HTTPError(400)
    return value


def recording_application(page: RecordingPage) -> tornado.web.Application:
    """Return the web application of a recording's page."""
    shared = {"page": page}
    return tornado.web.Application(
        [
            (r"/([^/]*)/", _Html, shared),
            (r"/([^/]*)/static/([a-z.]+)", Static, shared),
            (r"/([^/]*)/recording", _Document, shared),
            (r"/([^/]*)/samples", _Samples, shared),
            (r"/([^/]*)/at", _At, shared),
        ],
        default_handler_class=Nothing,
        default_handler_args=shared,
        log_function=lambda handler: None,
    )


def serve_recording(
    recording: Recording,
    explanation: Explanation,
    token: str,
    ready: Callable[[str], None],
    *,
    host: str = "127.0.0.1",
    port: int = 0,
    seconds: float | None = None,
) -> None:
    """Serve a recording's page until a signal, or for `seconds`.

    Parameters
    ----------
    ready : called with the page's URL when it is served

    Raises
    ------
    coulombus.monitor.web.WebError
        the port or address is not available
    """
    sockets = listening(host, port)
    page = RecordingPage(recording, explanation, token, named(host))
    server = tornado.httpserver.HTTPServer(recording_application(page))
    serve_until(server, sockets, lambda at: ready(f"http://{page.name}:{at}/{token}/"), seconds)
