"""Render a snapshot for ``coulombus watch``: a terminal table, lines, or plain values."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
from rich.console import Console, ConsoleOptions, RenderResult
from rich.text import Text

from coulombus.monitor.incident_lines import incident_dict, incident_lines
from coulombus.monitor.live_incidents import IncidentRow
from coulombus.monitor.snapshot import Event, HostLine, NodeRow, PdoRow, Snapshot, Value
from coulombus.monitor.traces import WINDOW_S, Trace
from coulombus.monitor.word_bits import WORDS, bits_set, meaning

__all__ = ["Screen", "as_dict", "as_lines", "drawn"]

LEAST_EVENTS = 3
GAPS = 3
KEYS_HEIGHT = 20
"""Least height at which the last line lists the keys."""
SCOPE_LINES = 5
"""Lines of a signal's plot, if the window is high enough."""
STALE_S = 0.1
CHANGED = "bold reverse"
HOST_STYLES = {"runs": "", "tripped": "red", "ended": "dim"}
BLANK = 0x2800
"""Unicode's first braille pattern; the others have a bit for each of the eight dots."""
DOTS = ((0x01, 0x08), (0x02, 0x10), (0x04, 0x20), (0x40, 0x80))
"""The bit of each dot, by its row from above and its column."""


def as_dict(
    snapshot: Snapshot, facts: dict[str, Any], begin_ns: int, incidents: Sequence[IncidentRow] = ()
) -> dict[str, Any]:
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
        "incidents": [incident_dict(row, begin_ns) for row in incidents],
    }


def as_lines(snapshot: Snapshot, facts: dict[str, Any], begin_ns: int, all_nodes: bool = True) -> Iterator[str]:
    """Yield a snapshot as lines: events first, then a line for each PDO and one for the nodes."""
    for event in snapshot.events:
        yield f"{(event.t_ns - begin_ns) / 1e9:10.3f}  {'!' if event.grave else '*'} {event.text}"
    at = f"{(snapshot.t_ns - begin_ns) / 1e9:10.3f}"
    if failure := facts.get("incidents_end"):
        yield f"{at}  ! {failure}"
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
    """The terminal view, fitted to the window.

    Columns are dropped by importance, no number is truncated, and the newest events are always shown.

    Attributes
    ----------
    all_nodes : include nodes of the rig that were never heard
    """

    snapshot: Snapshot
    facts: dict[str, Any]
    events: Sequence[Event]
    begin_ns: int
    all_nodes: bool = True
    traces: Sequence[Trace] = ()
    """Signals plotted over time, below the head."""
    incidents: Sequence[IncidentRow] = ()
    opened: str = ""
    """Key of the opened incident, whose cause and checks are shown."""

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        width, height = options.max_width, options.size.height - 1  # a line is left for the shell
        keys = [Text(self.facts["keys"], style="dim")] if height >= KEYS_HEIGHT and self.facts.get("keys") else []
        height -= len(keys)
        head = Text(_head(self.snapshot, self.facts), style="red" if self.facts["lost"] else "bold").wrap(
            console, width
        )
        host: HostLine | None = self.facts.get("host")
        if host is not None:
            head.extend(Text(host.text, style=HOST_STYLES[host.state]).wrap(console, width))
        if failure := self.facts.get("incidents_end"):
            head.append(Text(failure, style="red"))
        if self.facts.get("paused"):
            since = self.facts["frames"] - self.snapshot.frames
            head.append(Text(f"PAUSED: p goes on, q ends; {since} frames came since", style="bold reverse"))
        if self.facts.get("words"):
            head.extend(line for text in _words(self.snapshot) for line in Text(text).wrap(console, width))
        for trace in self.traces:
            head.extend(_scope(trace, width, max(1, min(SCOPE_LINES, (height // 2) // len(self.traces) - 1))))
        panel = (width, height // 2 if self.opened else height // 3)
        incidents = incident_lines(self.incidents, self.opened, self.begin_ns, console, panel)
        nodes = _table(NODE_COLUMNS, list(map(_node_row, _heard(self.snapshot.nodes, self.all_nodes))), width)
        pdos = _table(
            RAW_COLUMNS if self.facts.get("raw") else PDO_COLUMNS,
            [row for pdo in _pdos(self.snapshot, self.all_nodes) for row in _pdo_rows(pdo)],
            width,
        )
        if not nodes:
            nodes = [Text("none of the rig's nodes was heard; --rig says which rig it is")]
        news = [line for event in self.events for line in self._event(event).wrap(console, width)]
        below = len(nodes) + len(incidents)
        room = height - len(head) - below - min(len(news), LEAST_EVENTS)
        if len(pdos) > room:
            shown = max(0, room - 1)
            pdos = [*pdos[:shown], Text(f"{len(pdos) - shown} more lines: in a higher window", style="dim")]
        rest = height - len(head) - below - len(pdos)
        gaps = GAPS + bool(incidents)
        gap = [Text()] if rest - min(len(news), LEAST_EVENTS) >= gaps else []
        room = max(0, rest - len(gap) * gaps)
        panels = [*head, *gap, *incidents, *(gap if incidents else []), *pdos, *gap, *nodes, *gap]
        for line in [*panels, *(news[-room:] if room else []), *keys]:
            line.no_wrap, line.overflow = True, "ellipsis"
            yield line

    def _event(self, event: Event) -> Text:
        text = f"{(event.t_ns - self.begin_ns) / 1e9:10.3f}  {event.text}"
        return Text(text, style="red" if event.grave else "")


def _words(snapshot: Snapshot) -> Iterator[str]:
    """Yield received status- and controlwords as text, a line each: no column is wide enough."""
    for value in (value for row in snapshot.pdos for value in row.values):
        if value.value is not None and _short(value) in WORDS:
            set_bits = bits_set(value)
            yield f"{value.name} {_number(value)}: {meaning(value)}" + (f"; {set_bits}" if set_bits else "")


def _scope(trace: Trace, width: int, height: int) -> list[Text]:
    """Return a signal's plot: a line with its range, and `height` lines of dots."""
    lines, least, greatest = drawn(trace.low, trace.high, width, height)
    seen = next((k for k in range(len(trace.low) - 1, -1, -1) if trace.low[k] == trace.low[k]), None)
    unit = f" {trace.unit}" if trace.unit else ""
    range_ = "none came" if seen is None else f"{least:+.5g} to {greatest:+.5g}{unit}"
    return [
        Text(f"{trace.name}  {range_}  ({WINDOW_S:g} s)", style="bold"),
        *(Text(line, style="green") for line in lines),
    ]


def _heard(nodes: Sequence[NodeRow], all_nodes: bool) -> list[NodeRow]:
    return [node for node in nodes if all_nodes or node.state is not None or node.frames]


def _pdos(snapshot: Snapshot, all_nodes: bool) -> list[PdoRow]:
    """Return the PDOs that were received or belong to a heard node."""
    heard = {node.name for node in _heard(snapshot.nodes, all_nodes)}
    return [row for row in snapshot.pdos if row.count or row.malformed or row.name.rpartition(".")[0] in heard]


@dataclass(frozen=True)
class _Column:
    title: str
    key: int
    """Place in the row's cells."""
    least: int = 0
    """Least width, so that columns do not change with the values."""
    right: bool = False
    order: int = 0
    """0: always shown; the others in this order, as long as they fit."""


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
    """Return the rows (cells, style) under their titles, with the columns that fit.

    Empty without rows.
    """
    wide = {c: max(len(c.title), c.least, *(len(cells[c.key]) for cells, _ in rows)) for c in columns} if rows else {}
    fitting: set[_Column] = set()
    for column in sorted(wide, key=lambda c: c.order):
        if column.order == 0 or sum(wide[c] + SPACE for c in fitting) + wide[column] <= width:
            fitting.add(column)
    shown = [column for column in columns if column in fitting]

    def line(cells: Sequence[str | Text], style: str) -> Text:
        text = Text(style=style)
        for column, cell in zip(shown, cells, strict=True):
            room = " " * (wide[column] - len(cell))
            text.append(" " * SPACE if text else "")
            text.append(room if column.right else "").append(cell).append("" if column.right else room)
        text.rstrip()
        return text

    body = [line([cells[c.key] for c in shown], style) for cells, style in rows]
    return [line([c.title for c in shown], "bold"), *body] if rows else []


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


def drawn(
    low: npt.NDArray[np.float64], high: npt.NDArray[np.float64], width: int, height: int
) -> tuple[list[str], float, float]:
    """Draw minima and maxima over time in braille patterns; return lines, and the values at the lower and upper edge.

    Each column of dots is filled from its least to its greatest value, the newest at the right. NaN is blank.

    Parameters
    ----------
    low, high : n values each, in any unit
    width, height : of the picture, in characters
    """
    columns, rows = min(2 * width, len(low)), 4 * height
    seen = np.isfinite(low) & np.isfinite(high)
    if not columns or not seen.any():
        return [" " * width] * height, 0.0, 0.0
    least, greatest = float(low[seen].min()), float(high[seen].max())
    span = (greatest - least) or 1.0
    edges = np.linspace(0, len(low), columns + 1).astype(int)
    cells = np.zeros((height, width), np.int64)
    for column, (begin, end) in enumerate(pairwise(edges), 2 * width - columns):
        right = seen[begin:end]
        if not right.any():
            continue
        bottom, top = (
            min(rows - 1, int((value - least) / span * rows))
            for value in (low[begin:end][right].min(), high[begin:end][right].max())
        )
        for dot in range(bottom, top + 1):
            row = rows - 1 - dot
            cells[row // 4, column // 2] |= DOTS[row % 4][column % 2]
    return ["".join(chr(BLANK + cell) if cell else " " for cell in line) for line in cells], least, greatest
