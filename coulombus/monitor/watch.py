"""``coulombus watch``: a bus in a live table, or line by line without a terminal.

A separate thread reads the bus, so that frames do not wait for drawing; the main thread draws and
handles signals. Nothing is ever sent. Chosen signals are plotted over time. A third thread detects
incidents. Keys in a terminal: p or space freezes the display while counting goes on, b shows raw
bytes before other columns, w decodes status- and controlwords in separate lines, 1 to 9 open and
close an incident, q quits.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from typing import Any, TypeAlias

from rich.console import Console
from rich.live import Live as Display

from coulombus.monitor.bus_reader import BusReader
from coulombus.monitor.incident_lines import OpenedIncident, news
from coulombus.monitor.live import Live
from coulombus.monitor.live_incidents import IncidentReader, IncidentRow
from coulombus.monitor.screen import Screen, as_dict, as_lines
from coulombus.monitor.snapshot import Event, HostLine, Snapshot
from coulombus.monitor.traces import Trace, Traces
from coulombus.monitor.view_thread import ViewThread
from coulombus.recording.maps.known_bus import KnownBus
from coulombus.system.foreign_text import printable
from coulombus.system.keyboard import Keys, in_foreground
from coulombus.system.printable_console import PrintableConsole
from coulombus.system.stop_signals import StopSignals
from coulombus.wire.adapter import open_bus
from coulombus.wire.address import BusAddress
from coulombus.wire.frame_batches import Block
from coulombus.wire.handshake import Flags, Hello

__all__ = ["LiveView", "ViewKeys", "look_once", "watch"]

DRAW_S = 0.1
LINE_S = 1.0
BATCH_S = 0.1
EVENTS = 200
HOST_S = 0.5
PAUSE_KEYS, RAW_KEYS, WORD_KEYS, END_KEYS, INCIDENT_KEYS = b"p ", b"b", b"w", b"q", b"123456789"
KEYS_TEXT = "p pause   b bytes   w words   1-9 incident   q end"


@dataclass(frozen=True)
class LiveView:
    """Options of the view of a bus."""

    as_json: bool = False
    """Lines of JSON, also in a terminal."""
    interval_s: float | None = None
    """Interval between updates; None: `DRAW_S` in a terminal, else `LINE_S`."""
    all_nodes: bool = True
    """Also show nodes of the rig that were never heard."""
    scope: Sequence[str] = ()
    """Signals that a terminal plots over the last ten seconds."""
    assumed: bool = False
    """Whether the rig is a guess: it is dropped if the bus turns out to be another rig's."""


EVERYTHING = LiveView()


def watch(
    bus: KnownBus,
    address: BusAddress,
    view: LiveView = EVERYTHING,
    *,
    seconds: float | None = None,
    console: Console | None = None,
    host: Callable[[], HostLine | None] | None = None,
) -> None:
    """Show the bus until a signal, the key q, or for `seconds`.

    Parameters
    ----------
    bus : without a rig, nodes are numbers, and PDOs are learned from the frames and EDS files
    host : returns the state of the bus' host, or the end of the last one, or None; called twice a
        second in a separate thread

    Raises
    ------
    coulombus.wire.address.BusUnavailable
        There is no bus, or it closed meanwhile.
    coulombus.recording.signals.UnknownSignal
        the rig has no signal of ``view.scope``
    """
    console = console or PrintableConsole()
    live = Live(bus, assumed=view.assumed)
    traces = None if bus.rig is None else Traces(bus.rig, view.scope)
    incidents = IncidentReader(bus)
    begin_ns = time.time_ns()
    live.snapshot(begin_ns)  # rates count from here
    hello, lock = Hello(Flags.LISTEN_ONLY | Flags.ERRORS), threading.Lock()
    with (
        open_bus(address, hello) as client,
        StopSignals() as stop,
        incidents,
        BusReader(client, _View(live, traces), lock, incidents, BATCH_S) as reader,
    ):

        def observe() -> tuple[Snapshot, dict[str, Any]]:
            with lock:
                reader.hand_over()
                snapshot = live.snapshot(time.time_ns())
                seen = traces.snapshot(snapshot.t_ns) if terminal and traces is not None else ()
            facts = {"bus": str(address), "bitrate_bit_s": client.bitrate_bit_s}
            facts |= {"lost": client.lost, "malformed": client.malformed}
            facts |= {"incidents_end": incidents.failure} if incidents.failure else {}
            return snapshot, facts | ({"traces": seen} if terminal else {})

        terminal = console.is_terminal and not view.as_json
        pause_s = view.interval_s or (DRAW_S if terminal else LINE_S)
        show = _on_terminal if terminal else _line_by_line
        keys = ViewKeys()
        with (
            Keys(keys.struck) if terminal and in_foreground() else nullcontext(),
            _Asker(host) if terminal and host is not None else nullcontext() as asker,
            show(console, view, begin_ns) as draw,
        ):
            end = None if seconds is None else time.monotonic() + seconds
            running = True
            while running:
                wait_s = pause_s if end is None else min(pause_s, max(0.0, end - time.monotonic()))
                running = not stop.wait(wait_s) and reader.failure is None and not keys.ended
                running = running and (end is None or time.monotonic() < end)
                snapshot, facts = observe()
                options: dict[str, Any] = {
                    "paused": keys.paused,
                    "raw": keys.raw,
                    "words": keys.words,
                    "host": None if asker is None else asker.answer,
                    "number": keys.number,
                    "strokes": keys.strokes,
                }
                draw(snapshot, facts | options if terminal else facts, incidents.rows)
        if reader.failure is not None:
            raise reader.failure


def look_once(bus: KnownBus, address: BusAddress, seconds: float) -> Snapshot:
    """Listen to a bus for some time; return a snapshot. Nothing is sent.

    Raises
    ------
    coulombus.wire.address.BusUnavailable
        There is no bus, or it closed meanwhile.
    """
    live = Live(bus)
    live.snapshot(time.time_ns())
    hello, lock = Hello(Flags.LISTEN_ONLY | Flags.ERRORS), threading.Lock()
    with open_bus(address, hello) as client, StopSignals() as stop, BusReader(client, live, lock) as reader:
        stop.wait(seconds)
        if reader.failure is not None:
            raise reader.failure
        with lock:
            reader.hand_over()
            return live.snapshot(time.time_ns())


class ViewKeys:
    """State set by the terminal's keys; `struck` is called in the keys' thread."""

    def __init__(self) -> None:
        self.paused = self.raw = self.words = self.ended = False
        self.number = self.strokes = 0
        """Number of the last incident key, and count of such strokes."""

    def struck(self, strokes: bytes) -> None:
        """Process key strokes; unknown keys are ignored."""
        for key in strokes:
            self.paused ^= key in PAUSE_KEYS
            self.raw ^= key in RAW_KEYS
            self.words ^= key in WORD_KEYS
            self.ended |= key in END_KEYS
            if key in INCIDENT_KEYS:
                self.number, self.strokes = key - ord("0"), self.strokes + 1


class _Asker(ViewThread):
    """Calls a function repeatedly in a separate thread; `answer` is the last result."""

    def __init__(self, ask: Callable[[], HostLine | None]) -> None:
        super().__init__("host asker")
        self.answer: HostLine | None = None
        self._ask = ask

    def _run(self) -> None:
        while not self.stop.is_set():
            try:
                self.answer = self._ask()
            except Exception as error:  # whatever is wrong with the host's answer, the view goes on
                self.answer = HostLine(f"host: {error}")
            self.stop.wait(HOST_S)


class _View:
    """The table of a bus, and the signals that are plotted over time."""

    def __init__(self, live: Live, traces: Traces | None) -> None:
        self._live, self._traces = live, traces

    def add_frames(self, block: Block) -> None:
        self._live.add_frames(block)
        if self._traces is not None:
            self._traces.add_frames(block)

    def add_event(self, t_ns: int, text: str, *, grave: bool) -> None:
        self._live.add_event(t_ns, text, grave)


_Draw: TypeAlias = Callable[[Snapshot, Any, Sequence[IncidentRow]], None]


@contextmanager
def _on_terminal(console: Console, view: LiveView, begin_ns: int) -> Iterator[_Draw]:
    past: deque[Event] = deque(maxlen=EVENTS)
    held: list[tuple[Snapshot, tuple[Event, ...], tuple[Trace, ...], Sequence[IncidentRow]]] = []
    opened = OpenedIncident()
    with Display(console=console, auto_refresh=False) as display:

        def draw(snapshot: Snapshot, facts: dict[str, Any], incidents: Sequence[IncidentRow]) -> None:
            past.extend(snapshot.events)
            if not held or not facts.get("paused"):
                held[:] = [(snapshot, tuple(past), facts["traces"], incidents)]
            facts = facts | {"frames": snapshot.frames, "keys": KEYS_TEXT}
            seen, events, traces, rows = held[0]
            key = opened.follow(facts["number"], facts["strokes"], rows)
            display.update(Screen(seen, facts, events, begin_ns, view.all_nodes, traces, rows, key), refresh=True)

        yield draw


@contextmanager
def _line_by_line(console: Console, view: LiveView, begin_ns: int) -> Iterator[_Draw]:
    statuses: dict[str, str] = {}

    def draw(snapshot: Snapshot, facts: dict[str, Any], incidents: Sequence[IncidentRow]) -> None:
        if view.as_json:
            sys.stdout.write(json.dumps(as_dict(snapshot, facts, begin_ns, incidents), allow_nan=False) + "\n")
        else:
            lines = [*news(incidents, statuses, begin_ns), *as_lines(snapshot, facts, begin_ns, view.all_nodes)]
            sys.stdout.write("".join(printable(line) + "\n" for line in lines))
        sys.stdout.flush()

    yield draw
