"""Render an explanation: overview, incident in detail, JSON, Markdown, HTML."""

from __future__ import annotations

import html
from collections.abc import Iterator
from typing import Any

from coulombus.explain.clues import Clue
from coulombus.explain.explained import Explanation
from coulombus.explain.incident_words import KINDS
from coulombus.explain.incidents import Incident

__all__ = [
    "as_dict",
    "cause",
    "checks",
    "course",
    "detail_lines",
    "html_page",
    "markdown",
    "news",
    "node_lines",
    "screen",
    "title",
]

VERDICT_TEXT = {
    "ok": "ok: nothing is wrong in this log",
    "warnings": "warnings: nothing stopped, and something deserves a look",
    "recovered": "recovered: something went wrong, and it is over",
    "unresolved": "unresolved: something went wrong, and it still is at the end of the log",
}
REST = "; some rows were not read: this is of the rest"
SHOWN_EVENTS = 40
SHOWN_IDENTIFIERS = 24


def verdict(explanation: Explanation) -> str:
    """Return the verdict in a line."""
    if not explanation.frames:
        return "ok: no frame came, so nothing is known: look at supply, cable and bit rate"
    return VERDICT_TEXT[explanation.verdict] + ("" if explanation.whole else REST)


def title(explanation: Explanation, incident: Incident) -> str:
    """Return an incident in a line: node and title."""
    whose = explanation.bus.name(incident.node)
    axes = incident.axes if max(incident.axes, default=1) > 1 else ()
    axis = f", axis {' and '.join(map(str, axes))}" if axes else ""
    words = KINDS[incident.root.kind].title
    begin = words[:1] if words[1:2].isupper() else words[:1].lower()  # SYNC, EMCY
    return f"{whose}{axis}: {begin}{words[1:]}"


def cause(incident: Incident) -> str:
    """Return an incident's cause: the observation, and its usual meaning."""
    diagnosis = incident.diagnosis
    return f"{_capital(diagnosis.text)}. {KINDS[diagnosis.kind].cause}"


def checks(incident: Incident) -> tuple[str, ...]:
    """Return the checks, the cheapest first."""
    usual, diagnosis = KINDS[incident.root.kind].checks, incident.diagnosis
    first = incident.root.check
    if not first and diagnosis is not incident.root:  # the code is known already
        first = diagnosis.check or KINDS[diagnosis.kind].checks[0]
    return (first, *usual[1:]) if first else usual


def as_dict(explanation: Explanation) -> dict[str, Any]:
    """Return the object of ``explain --json``."""
    return {
        "verdict": explanation.verdict,
        "seconds": explanation.at_s(explanation.end_ns) if explanation.frames else 0.0,
        "frames": explanation.frames,
        "nodes": [
            {
                "node": node.number, "name": node.name or None, "state": node.state or None,
                "frames": node.frames, "maps": node.maps or None, "well": node.well,
                "boots": node.boots, "heartbeat_s": _seconds(node.heartbeat_ns),
                "sdo_response_s": _seconds(node.sdo_response_ns), "sdo_transfers": node.sdo_transfers,
                "emcy": node.emergencies, "pdos_per_s": round(node.pdos_per_s, 3),
                "states": {state: round(share, 4) for state, share in node.states.items()},
                "identity": None if node.identity is None else list(node.identity),
                "profile": node.profile or None, "eds": node.eds or None,
            }
            for node in explanation.nodes
        ],
        "incidents": [_incident(explanation, incident) for incident in explanation.incidents],
        "identifiers": [
            {
                "can_id": row.can_id, "extended": row.extended, "frames": row.frames, "period_s": row.period_ns / 1e9,
                "pgn": row.group if row.extended else None, "source": row.source if row.extended else None,
            }
            for row in explanation.identifiers
        ],
        "remarks": list(explanation.remarks),
    }  # fmt: skip


def _seconds(spread: tuple[int, float, int] | None) -> list[float] | None:
    return None if spread is None else [round(value / 1e9, 9) for value in spread]


def _node_table(explanation: Explanation) -> list[str]:
    """Return what is known of each node, a line each."""
    rows: list[tuple[str, ...]] = [
        ("node", "boots", "heartbeat [ms]", "SDO response [ms]", "SDO", "EMCY", "PDO/s", "OPERATIONAL")
    ]
    for node in explanation.nodes:
        rows.append(
            (
                explanation.bus.name(node.number),
                str(node.boots),
                _spread_text(node.heartbeat_ns),
                _spread_text(node.sdo_response_ns),
                str(node.sdo_transfers),
                str(node.emergencies),
                f"{node.pdos_per_s:.4g}",
                f"{100 * node.states['OPERATIONAL']:.0f} %" if "OPERATIONAL" in node.states else "-",
            )
        )
    return _aligned(rows)


def node_lines(explanation: Explanation) -> Iterator[str]:
    """Yield the nodes of a log: what they are, and their figures."""
    rows: list[tuple[str, ...]] = [("node", "name", "profile", "vendor", "product", "state", "EDS file")]
    for node in explanation.nodes:
        vendor, product = node.identity or (0, 0)
        rows.append(
            (
                str(node.number),
                node.name or "-",
                str(node.profile or "-"),
                f"{vendor:X}h" if vendor else "-",
                f"{product:X}h" if product else "-",
                node.state or "-",
                node.eds or "-",
            )
        )
    yield from _aligned(rows)
    yield ""
    yield "minimum / median / maximum"
    yield from _node_table(explanation)


def _aligned(rows: list[tuple[str, ...]]) -> list[str]:
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return ["  ".join(text.ljust(width) for text, width in zip(row, widths, strict=True)).rstrip() for row in rows]


def _spread_text(spread: tuple[int, float, int] | None) -> str:
    return "-" if spread is None else " / ".join(f"{value / 1e6:.4g}" for value in spread)


def _incident(explanation: Explanation, incident: Incident) -> dict[str, Any]:
    root = incident.root
    return {
        "number": incident.number,
        "status": incident.status,
        "node": incident.node,
        "axis": incident.axes[0] if len(incident.axes) == 1 else None,
        "kind": root.kind,
        "who": incident.who,
        "count": incident.count,
        "title": title(explanation, incident),
        "t_s": explanation.at_s(incident.begin_ns),
        "end_s": explanation.at_s(incident.end_ns),
        "cause": cause(incident),
        "sure": incident.sure,
        "check": list(checks(incident)),
        "why": KINDS[root.kind].why,
        "clause": KINDS[root.kind].clause,
        "course": [
            {
                "t_s": explanation.at_s(clue.begin_ns), "end_s": explanation.at_s(clue.end_ns), "kind": clue.kind,
                "node": clue.node, "times": clue.count, "text": clue.text, "end": clue.end_text or None,
            }
            for clue in incident.clues
        ],
        "frames": [
            {"number": row, "t_s": explanation.at_s(t_ns), "can_id": can_id & 0x1FFFFFFF, "data": data.hex()}
            for row, (t_ns, can_id, data) in _frames(explanation, incident)
        ],
    }  # fmt: skip


def _frames(explanation: Explanation, incident: Incident) -> list[tuple[int, tuple[int, int, bytes]]]:
    rows = {row for clue in incident.clues for row in clue.rows}
    return [(row, explanation.shown[row]) for row in sorted(rows) if row in explanation.shown]


def screen(explanation: Explanation, source: str) -> Iterator[str]:
    """Yield the lines of the overview; `source` is the file or bus for the suggested command."""
    yield verdict(explanation)
    length = explanation.at_s(explanation.end_ns) or 0.0
    yield f"{explanation.frames} frames until {length:.3f} s"
    yield from (f"note: {remark}" for remark in explanation.remarks)
    yield from _identifier_table(explanation)
    serious = [incident for incident in explanation.incidents if incident.status != "warning"]
    warnings = [incident for incident in explanation.incidents if incident.status == "warning"]
    for incident in serious:
        yield ""
        yield f"{incident.number}  {incident.status.upper()}  {_when(explanation, incident)}  {title(explanation, incident)}"
        yield f"   cause ({incident.sure}): {cause(incident)}"
        trip = next((clue for clue in incident.clues if clue.kind == "host_trip"), incident.root)
        if trip is not incident.root:
            yield f"   the host tripped: {trip.text}"
        outcome = incident.root.end_text
        if outcome and incident.status == "recovered":
            yield f"   over: {outcome}"
        yield f"   check first: {checks(incident)[0]}"
    if warnings:
        yield ""
        yield "warnings"
        for incident in warnings:
            times = f" ({incident.count} times)" if incident.count > 1 else ""
            yield f"{incident.number}  {_when(explanation, incident)}  {title(explanation, incident)}: {incident.root.text}{times}"
    well = [explanation.bus.name(node.number) for node in explanation.nodes if node.well]
    if well:
        yield ""
        yield "well: " + ", ".join(well)
    if explanation.incidents:
        yield ""
        yield f"next: coulombus explain {source} 1"


def _identifier_table(explanation: Explanation) -> Iterator[str]:
    """Yield the identifiers of a log that is not CANopen."""
    rows = explanation.identifiers
    if rows:
        yield ""
        yield f"{'identifier':>10}  {'frames':>8}  {'every':>10}  J1939"
    for row in rows[:SHOWN_IDENTIFIERS]:
        every = f"{row.period_ns / 1e6:.2f} ms" if row.period_ns else ""
        yield f"{row.can_id:>9X}h  {row.frames:>8}  {every:>10}  {row.text}".rstrip()
    if len(rows) > SHOWN_IDENTIFIERS:
        yield f"... and {len(rows) - SHOWN_IDENTIFIERS} more"


def detail_lines(explanation: Explanation, incident: Incident, source: str) -> Iterator[str]:
    """Yield the lines of one incident."""
    root = incident.root
    yield f"{incident.number}  {incident.status.upper()}  {_when(explanation, incident)}  {title(explanation, incident)}"
    yield ""
    yield f"cause ({incident.sure}): {cause(incident)}"
    yield ""
    yield "what happened"
    yield from (f"  {line}" for line in _course(explanation, incident))
    yield ""
    yield "check first"
    yield from (f"  {number}. {check}" for number, check in enumerate(checks(incident), 1))
    yield ""
    yield f"why it matters: {KINDS[root.kind].why}"
    yield f"see: {KINDS[root.kind].clause}"
    yield ""
    yield "nodes (minimum / median / maximum)"
    yield from (f"  {line}" for line in _node_table(explanation))
    frames = _frames(explanation, incident)
    if frames:
        yield ""
        yield "frames"
        for row, (t_ns, can_id, data) in frames[:12]:
            yield f"  {row:>8}  {explanation.at_s(t_ns):12.6f} s  {can_id & 0x1FFFFFFF:03X}  {data.hex(' ')}"
    yield ""
    begin = explanation.at_s(incident.begin_ns) or 0.0
    yield f"next: coulombus decode {source}   # around {begin:.3f} s"


def news(explanation: Explanation, incident: Incident) -> str:
    """Return the line for a new incident or a change of its state."""
    return f"{_when(explanation, incident)}  {incident.status.upper()}  {title(explanation, incident)}: {incident.diagnosis.text}"


def course(explanation: Explanation, incident: Incident) -> list[tuple[int, str, str]]:
    """Return the events of an incident in time order: time [ns], role ("cause", "consequence", "end" ...), text."""
    events = [(clue.begin_ns, _role(incident, clue), _clue(explanation, clue)) for clue in incident.clues]
    events += [
        (clue.end_ns, "end", f"{explanation.bus.name(clue.node)}: {clue.end_text}")
        for clue in incident.clues
        if clue.end_ns is not None and clue.end_text
    ]
    return sorted(events, key=lambda event: event[0])


def _course(explanation: Explanation, incident: Incident) -> Iterator[str]:
    events = course(explanation, incident)
    for t_ns, role, text in events[:SHOWN_EVENTS]:
        yield f"{explanation.at_s(t_ns):12.6f} s  {role:<11}  {text}"
    if len(events) > SHOWN_EVENTS:
        yield f"... and {len(events) - SHOWN_EVENTS} more"


def _role(incident: Incident, clue: Clue) -> str:
    if clue is incident.root:
        return "cause"
    return (
        "diagnosis"
        if clue is incident.diagnosis
        else "consequence"
        if clue.begin_ns >= incident.root.begin_ns
        else "sign"
    )


def _clue(explanation: Explanation, clue: Clue) -> str:
    times = f" ({clue.count} times)" if clue.count > 1 else ""
    whose = "host" if clue.kind == "host_trip" else explanation.bus.name(clue.node)
    return f"{whose}: {clue.text}{times}"


def _when(explanation: Explanation, incident: Incident) -> str:
    begin, end = explanation.at_s(incident.begin_ns) or 0.0, explanation.at_s(incident.end_ns)
    return (
        f"{begin:.3f} s"
        if end is not None and end - begin < 0.001
        else f"{begin:.3f} s to " + ("the end" if end is None else f"{end:.3f} s")
    )


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]


def markdown(explanation: Explanation, source: str) -> str:
    """Return a report in Markdown."""
    lines = [f"# {_plain(source)}", "", f"**{verdict(explanation)}**", ""]
    lines += [f"{explanation.frames} frames until {explanation.at_s(explanation.end_ns) or 0.0:.3f} s", ""]
    lines += [f"- {_plain(remark)}" for remark in explanation.remarks]
    for incident in explanation.incidents:
        lines += ["", f"## {incident.number}. {_plain(title(explanation, incident))}", ""]
        lines += [
            f"{incident.status}, {_when(explanation, incident)}",
            "",
            _plain(cause(incident)) + f" ({incident.sure})",
            "",
        ]
        lines += [f"{number}. {_plain(check)}" for number, check in enumerate(checks(incident), 1)]
        lines += ["", *(f"    {_plain(line)}" for line in _course(explanation, incident))]
        lines += ["", f"{KINDS[incident.root.kind].why} See {KINDS[incident.root.kind].clause}."]
    well = [explanation.bus.name(node.number) for node in explanation.nodes if node.well]
    lines += ["", f"Well: {_plain(', '.join(well)) or 'none'}", "", "Nodes (minimum / median / maximum)", ""]
    lines += [f"    {_plain(line)}" for line in _node_table(explanation)]
    return "\n".join(lines) + "\n"


def _plain(text: str) -> str:
    """Return a text escaped for Markdown."""
    return "".join(f"\\{c}" if c in "\\`*_<>[]|#" else c for c in text if c.isprintable())


STYLE = """body{font:16px/1.5 sans-serif;max-width:60em;margin:2em auto;padding:0 1em;color:#222;background:#fff}
section{border-left:.4em solid #888;padding:.2em 1em;margin:1.5em 0}
.unresolved{border-color:#b00020}.recovered{border-color:#c77700}.warning{border-color:#888}
pre{overflow-x:auto;background:#f4f4f4;padding:.7em;font-size:13px}"""


def html_page(explanation: Explanation, source: str) -> str:
    """Return a report as a single self-contained HTML file."""

    def safe(text: str) -> str:
        return html.escape("".join(c for c in text if c.isprintable()))

    parts = [f"<h1>{safe(source)}</h1><p><strong>{safe(verdict(explanation))}</strong></p>"]
    parts.append(f"<p>{explanation.frames} frames until {explanation.at_s(explanation.end_ns) or 0.0:.3f} s</p>")
    parts += [f"<p>{safe(remark)}</p>" for remark in explanation.remarks]
    for incident in explanation.incidents:
        course = "\n".join(safe(line) for line in _course(explanation, incident))
        steps = "".join(f"<li>{safe(check)}</li>" for check in checks(incident))
        kind = KINDS[incident.root.kind]
        parts.append(
            f'<section class="{incident.status}"><h2>{incident.number}. {safe(title(explanation, incident))}</h2>'
            f"<p>{incident.status}, {safe(_when(explanation, incident))}</p>"
            f"<p>{safe(cause(incident))} ({incident.sure})</p><ol>{steps}</ol><pre>{course}</pre>"
            f"<p>{safe(kind.why)} See {safe(kind.clause)}.</p></section>"
        )
    well = [explanation.bus.name(node.number) for node in explanation.nodes if node.well]
    parts.append(f"<p>Well: {safe(', '.join(well)) or 'none'}</p>")
    table = "\n".join(safe(line) for line in _node_table(explanation))
    parts.append(f"<h2>Nodes (minimum / median / maximum)</h2><pre>{table}</pre>")
    head = f'<meta charset="utf-8"><title>{safe(source)}</title><style>{STYLE}</style>'
    return f'<!doctype html><html lang="en"><head>{head}</head><body>{"".join(parts)}</body></html>\n'
