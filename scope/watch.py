"""``coulombus watch``: a bus in one live table, or line by line where no terminal is.

The bus is read in a thread of its own, so that frames do not wait for the drawing; the main thread
draws and takes the signals. Nothing is ever sent. Chosen signals are drawn over time. In a terminal
p or the space bar holds the picture while the counting goes on, b shows the raw bytes before other
columns, w takes status- and controlwords apart in lines of their own, q ends it.
"""

from __future__ import annotations

import json
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, replace
from typing import Any

from rich.console import Console, ConsoleOptions, RenderResult
from rich.live import Live as Display
from rich.text import Text

from coulombus.rigs.rig import Rig
from coulombus.scope.braille import drawn
from coulombus.scope.live import Event, Live, NodeRow, PdoRow, Snapshot, Value
from coulombus.scope.traces import WINDOW_S, Trace, Traces
from coulombus.scope.word_bits import WORDS, bits_set, meaning
from coulombus.wire.address import BusAddress
from coulombus.wire.client import BusDown, BusFull, BusGone, Client
from coulombus.wire.hello import Flags, Hello
from coulombus.wire.keys import Keys, in_foreground
from coulombus.wire.stopping import StopSignals

__all__ = ["Screen", "ViewKeys", "as_dict", "as_lines", "look_once", "watch"]

DRAW_S = 0.1
LINE_S = 1.0
ASK_NS = 1_000_000_000
COLLECT_S = 0.002  # frames of this time are taken together: it saves most of the wake-ups
EVENTS = 200
LEAST_EVENTS = 3
GAPS = 3
SCOPE_LINES = 5
"""Of a signal's picture, where the window is high enough."""
STALE_S = 0.1
HOST_S = 0.5
CHANGED = "bold reverse"
PAUSE_KEYS, RAW_KEYS, WORD_KEYS, END_KEYS = b"p ", b"b", b"w", b"q"


def watch(
    rig: Rig,
    address: BusAddress,
    *,
    seconds: float | None = None,
    as_json: bool = False,
    interval_s: float | None = None,
    console: Console | None = None,
    all_nodes: bool = True,
    host: Callable[[], str | None] | None = None,
    scope: Sequence[str] = (),
) -> None:
    """Show the bus until a signal, the key q, or for `seconds`.

    Parameters
    ----------
    scope : signals that a terminal draws over the last ten seconds
    host : tells what the bus' host does, in words, None where none runs; it is asked twice a second
        in a thread of its own
    all_nodes : show also the nodes of the rig that were never heard

    Raises
    ------
    coulombus.wire.address.BusUnavailable
        There is no bus, or it went away meanwhile.
    coulombus.recording.signals.UnknownSignal
        The rig has no signal of `scope`.
    """
    console = console or Console()
    live = Live(rig)
    traces = Traces(rig, scope)
    begin_ns = time.time_ns()
    live.snapshot(begin_ns)  # rates count from here
    hello = Hello(Flags.LISTEN_ONLY | Flags.ERRORS)
    with Client(address, hello) as client, StopSignals() as stop, _Reader(client, live, traces) as reader:

        def look() -> tuple[Snapshot, dict[str, Any]]:
            with reader.lock:
                snapshot = live.snapshot(time.time_ns())
                seen = traces.look(snapshot.t_ns) if terminal else ()
            facts = {"bus": str(address), "bitrate_bit_s": client.bitrate_bit_s}
            return snapshot, facts | {"lost": client.lost, "malformed": client.malformed} | (
                {"traces": seen} if terminal else {}
            )

        terminal = console.is_terminal and not as_json
        pause_s = interval_s or (DRAW_S if terminal else LINE_S)
        show = _on_terminal if terminal else _line_by_line
        keys = ViewKeys()
        with (
            Keys(keys.struck) if terminal and in_foreground() else nullcontext(),
            _Asker(host if terminal else None) as asker,
            show(console, as_json, begin_ns, all_nodes) as draw,
        ):
            end = None if seconds is None else time.monotonic() + seconds
            running = True
            while running:
                wait_s = pause_s if end is None else min(pause_s, max(0.0, end - time.monotonic()))
                running = not stop.wait(wait_s) and reader.failure is None and not keys.ended
                running = running and (end is None or time.monotonic() < end)
                snapshot, facts = look()
                asked = {"paused": keys.paused, "raw": keys.raw, "words": keys.words, "host": asker.told}
                draw(snapshot, facts | asked if terminal else facts)
        if reader.failure is not None:
            raise reader.failure


def look_once(rig: Rig, address: BusAddress, seconds: float) -> Snapshot:
    """Listen to a bus for so long; return what it carries then. Nothing is sent.

    Raises
    ------
    coulombus.wire.address.BusUnavailable
        There is no bus, or it went away meanwhile.
    """
    live = Live(rig)
    live.snapshot(time.time_ns())
    hello = Hello(Flags.LISTEN_ONLY | Flags.ERRORS)
    with Client(address, hello) as client, StopSignals() as stop, _Reader(client, live) as reader:
        stop.wait(seconds)
        if reader.failure is not None:
            raise reader.failure
        with reader.lock:
            return live.snapshot(time.time_ns())


class ViewKeys:
    """What the keys of the terminal ask for; `struck` is called in the keys' thread."""

    def __init__(self) -> None:
        self.paused = self.raw = self.words = self.ended = False

    def struck(self, strokes: bytes) -> None:
        """Take strokes as the terminal gives them; keys that mean nothing are passed over."""
        for key in strokes:
            self.paused ^= key in PAUSE_KEYS
            self.raw ^= key in RAW_KEYS
            self.words ^= key in WORD_KEYS
            self.ended |= key in END_KEYS


class _Asker:
    """Asks again and again in a thread of its own; `told` is the last answer."""

    def __init__(self, ask: Callable[[], str | None] | None) -> None:
        self.told: str | None = None
        self._ask = ask
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="host asker", daemon=True)

    def __enter__(self) -> _Asker:
        if self._ask is not None:
            self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        if self._ask is not None:
            self._thread.join()

    def _run(self) -> None:
        while self._ask is not None and not self._stop.is_set():
            try:
                self.told = self._ask()
            except Exception as error:  # whatever is wrong with the host's answer, the view goes on
                self.told = f"host: {error}"
            self._stop.wait(HOST_S)


class _Reader:
    """Takes frames off the bus in a thread of its own; `failure` is why it ended by itself."""

    def __init__(self, client: Client, live: Live, traces: Traces | None = None) -> None:
        self.lock = threading.Lock()
        self.failure: OSError | None = None
        self._client, self._live, self._traces = client, live, traces
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="bus reader", daemon=True)

    def __enter__(self) -> _Reader:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()

    def _run(self) -> None:
        asked_ns = time.monotonic_ns()
        while not self._stop.is_set():
            try:
                self._client.wait(STALE_S)
                while found := self._client.receive():
                    with self.lock:
                        self._live.take(found)
                        if self._traces is not None and self._traces.names:
                            self._traces.take(found)
                if time.monotonic_ns() - asked_ns > ASK_NS:
                    asked_ns = time.monotonic_ns()
                    self._client.ask()
            except BusDown as error:
                with self.lock:
                    self._live.tell(time.time_ns(), str(error), grave=True)
            except BusFull:
                pass  # it does not read: its own affair, and told by the silence of all nodes
            except BusGone as error:
                self.failure = error
                return
            except OSError as error:
                self.failure = error
                return
            self._stop.wait(COLLECT_S)


@contextmanager
def _on_terminal(
    console: Console, as_json: bool, begin_ns: int, all_nodes: bool
) -> Iterator[Callable[[Snapshot, Any], None]]:
    past: deque[Event] = deque(maxlen=EVENTS)
    held: list[tuple[Snapshot, tuple[Event, ...], tuple[Trace, ...]]] = []
    with Display(console=console, auto_refresh=False) as display:

        def draw(snapshot: Snapshot, facts: dict[str, Any]) -> None:
            past.extend(snapshot.events)
            if not held or not facts.get("paused"):
                held[:] = [(snapshot, tuple(past), facts["traces"])]
            facts = facts | {"frames": snapshot.frames}
            seen, events, traces = held[0]
            display.update(Screen(seen, facts, events, begin_ns, all_nodes, traces), refresh=True)

        yield draw


@contextmanager
def _line_by_line(
    console: Console, as_json: bool, begin_ns: int, all_nodes: bool
) -> Iterator[Callable[[Snapshot, Any], None]]:
    def draw(snapshot: Snapshot, facts: dict[str, Any]) -> None:
        if as_json:
            sys.stdout.write(json.dumps(as_dict(snapshot, facts, begin_ns), allow_nan=False) + "\n")
        else:
            sys.stdout.write("".join(line + "\n" for line in as_lines(snapshot, facts, begin_ns, all_nodes)))
        sys.stdout.flush()

    yield draw


def as_dict(snapshot: Snapshot, facts: dict[str, Any], begin_ns: int) -> dict[str, Any]:
    """Return a snapshot for ``--json``: times in seconds from the start, ages and rates in SI."""
    return {
        "t_s": (snapshot.t_ns - begin_ns) / 1e9,
        **facts,
        "frames": snapshot.frames,
        "frames_per_s": snapshot.frames_per_s,
        "sync_per_s": snapshot.sync_per_s,
        "load": snapshot.bits_per_s / facts["bitrate_bit_s"] if facts["bitrate_bit_s"] else None,
        "error_frames": snapshot.error_frames,
        "unknown": snapshot.unknown,
        "signals": {value.name: value.value for row in snapshot.pdos for value in row.values},
        "pdos": {
            row.name: {
                "can_id": row.can_id,
                "frames": row.count,
                "rate_per_s": row.rate_per_s,
                "age_s": row.age_s,
                "malformed": row.malformed,
                "least_period_s": row.least_s,
                "most_period_s": row.most_s,
            }
            for row in snapshot.pdos
        },
        "nodes": {
            row.name: {
                "node_id": row.node_id,
                "state": row.state,
                "heartbeat_age_s": row.age_s,
                "silent": row.silent,
                "known": row.known,
                "frames": row.frames,
                "rate_per_s": row.rate_per_s,
                "power_state": row.power_state,
                "emergency": row.emergency,
            }
            for row in snapshot.nodes
        },
        "events": [
            {"t_s": (event.t_ns - begin_ns) / 1e9, "text": event.text, "grave": event.grave}
            for event in snapshot.events
        ],
    }


def as_lines(snapshot: Snapshot, facts: dict[str, Any], begin_ns: int, all_nodes: bool = True) -> Iterator[str]:
    """Yield a snapshot as lines: events first, then a line for each PDO and one for the nodes."""
    for event in snapshot.events:
        yield f"{(event.t_ns - begin_ns) / 1e9:10.3f}  {'!' if event.grave else '*'} {event.text}"
    at = f"{(snapshot.t_ns - begin_ns) / 1e9:10.3f}"
    for row in _pdos(snapshot, all_nodes):
        content = "  ".join(f"{_short(value)}={_number(value)}{_unit(value)}" for value in row.values)
        yield f"{at}  {row.name:<11} {row.rate_per_s:7.1f}/s  {_age(row.age_s):>8}  {content}"
    nodes = "  ".join(
        f"{row.name} {'silent' if row.silent else row.state or '-'}" for row in _heard(snapshot.nodes, all_nodes)
    )
    yield f"{at}  {_head(snapshot, facts)}  {nodes}"


def _head(snapshot: Snapshot, facts: dict[str, Any]) -> str:
    text = (
        f"{facts['bus']}  {snapshot.frames_per_s:.0f} frames/s  SYNC {snapshot.sync_per_s:.1f}/s"
        + (f"  load {100 * snapshot.bits_per_s / facts['bitrate_bit_s']:.0f} %" if facts["bitrate_bit_s"] else "")
        + f"  lost {facts['lost']}"
    )
    for name, count in (
        ("error frames", snapshot.error_frames),
        ("unknown", snapshot.unknown),
        ("malformed", facts["malformed"] + sum(row.malformed for row in snapshot.pdos)),
    ):
        text += f"  {name} {count}" if count else ""
    return text


@dataclass(frozen=True)
class Screen:
    """What the terminal shows, made to fit: columns go by their importance, no number is cut, and
    the newest events are always there.

    Attributes
    ----------
    all_nodes : also those of the rig that were never heard
    """

    snapshot: Snapshot
    facts: dict[str, Any]
    events: Sequence[Event]
    begin_ns: int
    all_nodes: bool = True
    traces: Sequence[Trace] = ()
    """Signals that are drawn over time, below the head."""

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        width, height = options.max_width, options.size.height - 1  # a line is left for the shell
        head = Text(_head(self.snapshot, self.facts), style="red" if self.facts["lost"] else "bold").wrap(
            console, width
        )
        if host := self.facts.get("host"):
            head.extend(Text(host).wrap(console, width))
        if self.facts.get("paused"):
            since = self.facts["frames"] - self.snapshot.frames
            head.append(Text(f"PAUSED: p goes on, q ends; {since} frames came since", style="bold reverse"))
        if self.facts.get("words"):
            head.extend(line for text in _words(self.snapshot) for line in Text(text).wrap(console, width))
        for trace in self.traces:
            head.extend(_scope(trace, width, max(1, min(SCOPE_LINES, (height // 2) // len(self.traces) - 1))))
        nodes = _table(NODE_COLUMNS, list(map(_node_row, _heard(self.snapshot.nodes, self.all_nodes))), width)
        pdos = _table(
            RAW_COLUMNS if self.facts.get("raw") else PDO_COLUMNS,
            [row for pdo in _pdos(self.snapshot, self.all_nodes) for row in _pdo_rows(pdo)],
            width,
        )
        if not nodes:
            nodes = [Text("none of the rig's nodes was heard; --rig says which rig it is")]
        news = [line for event in self.events for line in self._event(event).wrap(console, width)]
        room = height - len(head) - len(nodes) - min(len(news), LEAST_EVENTS)
        if len(pdos) > room:
            shown = max(0, room - 1)
            pdos = [*pdos[:shown], Text(f"{len(pdos) - shown} more lines: in a higher window", style="dim")]
        rest = height - len(head) - len(nodes) - len(pdos)
        gap = [Text()] if rest - min(len(news), LEAST_EVENTS) >= GAPS else []
        room = max(0, rest - len(gap) * GAPS)
        for line in [*head, *gap, *pdos, *gap, *nodes, *gap, *(news[-room:] if room else [])]:
            line.no_wrap, line.overflow = True, "ellipsis"
            yield line

    def _event(self, event: Event) -> Text:
        text = f"{(event.t_ns - self.begin_ns) / 1e9:10.3f}  {event.text}"
        return Text(text, style="red" if event.grave else "")


def _words(snapshot: Snapshot) -> Iterator[str]:
    """Yield status- and controlwords in words, a line for each that came: no column is wide enough."""
    for value in (value for row in snapshot.pdos for value in row.values):
        if value.value is not None and _short(value) in WORDS:
            set_bits = bits_set(value)
            yield f"{value.name} {_number(value)}: {meaning(value)}" + (f"; {set_bits}" if set_bits else "")


def _scope(trace: Trace, width: int, height: int) -> list[Text]:
    """Return a signal's picture: a line with its range, and `height` lines of dots."""
    lines, least, most = drawn(trace.low, trace.high, width, height)
    seen = next((k for k in range(len(trace.low) - 1, -1, -1) if trace.low[k] == trace.low[k]), None)
    unit = f" {trace.unit}" if trace.unit else ""
    told = "none came" if seen is None else f"{least:+.5g} to {most:+.5g}{unit}"
    return [
        Text(f"{trace.name}  {told}  ({WINDOW_S:g} s)", style="bold"),
        *(Text(line, style="green") for line in lines),
    ]


def _heard(nodes: Sequence[NodeRow], all_nodes: bool) -> list[NodeRow]:
    return [node for node in nodes if all_nodes or node.state is not None or node.frames]


def _pdos(snapshot: Snapshot, all_nodes: bool) -> list[PdoRow]:
    """Return the PDOs that came, or belong to a node that was heard."""
    heard = {node.name for node in _heard(snapshot.nodes, all_nodes)}
    return [row for row in snapshot.pdos if row.count or row.malformed or row.name.rpartition(".")[0] in heard]


@dataclass(frozen=True)
class _Column:
    title: str
    key: int
    """Place in the row's cells."""
    least: int = 0
    """Width that is kept also while the cells are narrower, so that columns do not come and go with
    a value.
    """
    right: bool = False
    order: int = 0
    """0: always there; the others in this order, as long as they fit."""


PDO_COLUMNS = (
    _Column("PDO", 0, order=1), _Column("COB-ID", 1, right=True, order=4), _Column("signal", 2), _Column("value", 3, 10, right=True),
    _Column("", 4, 20, order=5), _Column("rate", 5, 9, right=True, order=2), _Column("age", 6, 7, right=True, order=3),
    _Column("bytes", 8, 16, order=8), _Column("period [ms]", 7, 13, right=True, order=6), _Column("bits", 9, 20, order=7),
)  # fmt: skip
RAW_COLUMNS = tuple(replace(column, order=1) if column.title == "bytes" else column for column in PDO_COLUMNS)
NODE_COLUMNS = (
    _Column("node", 0), _Column("id", 1, 3, right=True), _Column("NMT state", 2, 15), _Column("rate", 3, 9, right=True, order=3),
    _Column("heartbeat", 4, 9, right=True, order=2), _Column("drive", 5, 18, order=1), _Column("last emergency", 6, order=4),
)  # fmt: skip
SPACE = 2


def _table(columns: Sequence[_Column], rows: list[tuple[tuple[str | Text, ...], str]], width: int) -> list[Text]:
    """Return the rows (cells, style) under their titles, with the columns for which there is room.

    Nothing for no row.
    """
    wide = {c: max(len(c.title), c.least, *(len(cells[c.key]) for cells, _ in rows)) for c in columns} if rows else {}
    kept: set[_Column] = set()
    for column in sorted(wide, key=lambda c: c.order):
        if column.order == 0 or sum(wide[c] + SPACE for c in kept) + wide[column] <= width:
            kept.add(column)
    shown = [column for column in columns if column in kept]

    def line(cells: Sequence[str | Text], style: str) -> Text:
        text = Text(style=style)
        for column, cell in zip(shown, cells, strict=True):
            room = " " * (wide[column] - len(cell))
            text.append(" " * SPACE if text else "")
            text.append(room if column.right else "").append(cell).append("" if column.right else room)
        text.rstrip()
        return text

    found = [line([cells[c.key] for c in shown], style) for cells, style in rows]
    return [line([c.title for c in shown], "bold"), *found] if rows else []


def _node_row(node: NodeRow) -> tuple[tuple[str | Text, ...], str]:
    style = "red" if node.silent or node.emergency else "dim" if node.state is None else "" if node.known else "cyan"
    state = (
        f"{node.state}, silent" if node.silent else node.state or ("not heard" if not node.frames else "no heartbeat")
    )
    name = node.name if node.known else "-"
    rate = f"{node.rate_per_s:.1f} /s"
    power, emergency = node.power_state or "", node.emergency or ""
    return (name, str(node.node_id), state, rate, _age(node.age_s), power, emergency), style


def _pdo_rows(row: PdoRow) -> Iterator[tuple[tuple[str | Text, ...], str]]:
    style = "dim" if row.age_s is None else "yellow" if row.age_s > STALE_S else ""
    period = "" if row.least_s is None or row.most_s is None else f"{1e3 * row.least_s:.2f}-{1e3 * row.most_s:.2f}"
    head, tail = (row.name, f"{row.can_id:03X}h"), (f"{row.rate_per_s:.1f} /s", _age(row.age_s), period)
    raw = Text()
    for place, byte in enumerate(row.data):
        raw.append(f"{byte:02X}", CHANGED if place in row.changed else "")
    for value in row.values:
        shown = (_short(value), _number(value), value.unit or meaning(value))
        yield (*head, *shown, *tail, raw, bits_set(value)), style
        head, tail, raw = ("", ""), ("", "", ""), Text()


def _short(value: Value) -> str:
    return value.name.rpartition(".")[2]


def _number(value: Value) -> str:
    if value.value is None:
        return "-"
    if _short(value) in WORDS:
        return f"0x{int(value.value):04X}"
    return f"{value.value:+.5f}" if isinstance(value.value, float) else str(value.value)


def _unit(value: Value) -> str:
    return f" {value.unit}" if value.unit and value.value is not None else ""


def _age(age_s: float | None) -> str:
    if age_s is None:
        return "-"
    return f"{age_s * 1e3:.0f} ms" if age_s < 10 else f"{age_s:.0f} s"
