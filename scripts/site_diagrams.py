"""Draws the documents' diagrams as SVG, from the same text that GitHub draws with Mermaid.

The site must work without the network, and Mermaid is 3 MB of script. Of its language this takes
what the documents use: `stateDiagram-v2` (the text comes from the tables of the code), `graph` and
`sequenceDiagram`. Anything else raises, and the site is not built.
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from html import escape

__all__ = ["svg"]

LINE, CHARACTER = 18, 7.2
"""Height of a line of text and width of a character [px]."""
ARROW = (
    '<marker id="tip" viewBox="0 0 8 8" refX="8" refY="4" markerWidth="8" markerHeight="8" orient="auto">'
    '<path d="M0 0L8 4L0 8z" fill="currentColor"/></marker>'
)


def svg(text: str) -> str:
    """Return the SVG element of a diagram in Mermaid's language."""
    lines = [line.strip() for line in text.strip().splitlines()]
    kind = lines[0].split()[0]
    rest = [line for line in lines[1:] if line and not line.startswith("direction ")]
    if kind == "sequenceDiagram":
        return _sequence(rest)
    if kind == "stateDiagram-v2":
        return _arcs([_transition(line) for line in rest])
    if kind == "graph":
        edges = [_edge(line) for line in rest]
        return _loop(edges) if lines[0].split()[1:] == ["LR"] else _arcs(edges)
    raise ValueError(f"no diagram: {lines[0]!r}")


def _transition(line: str) -> tuple[str, str, str]:
    match = re.fullmatch(r"(\S+) --> (\S+?)(?:: (.*))?", line)
    if match is None:
        raise ValueError(f"no transition: {line!r}")
    start, end, label = match.groups()
    return "start" if start == "[*]" else start, "end" if end == "[*]" else end, label or ""


def _edge(line: str) -> tuple[str, str, str]:
    match = re.fullmatch(r'(\w+) (?:-->|-- "(.*)" -->) (\w+)', line)
    if match is None:
        raise ValueError(f"no edge: {line!r}")
    return match[1], match[3], match[2] or ""


def _text(x: float, y: float, text: str, anchor: str = "middle") -> str:
    return f'<text x="{x:.0f}" y="{y:.0f}" text-anchor="{anchor}">{escape(text)}</text>'


def _canvas(width: float, height: float, parts: Iterable[str]) -> str:
    return (
        f'<svg class="diagram" role="img" viewBox="0 0 {width:.0f} {height:.0f}" width="{width:.0f}" '
        'style="max-width:100%;font:12px monospace" fill="none" stroke="none" xmlns="http://www.w3.org/2000/svg">'
        f"<defs>{ARROW}</defs>"
        f'<g stroke="currentColor">{"".join(part for part in parts if not part.startswith("<text"))}</g>'
        f'<g fill="currentColor">{"".join(part for part in parts if part.startswith("<text"))}</g></svg>'
    )


def _arcs(edges: list[tuple[str, str, str]]) -> str:
    """Draw states in a column, each edge in a lane of its own: down at the right, back at the left."""
    names = list(dict.fromkeys(name for edge in edges for name in edge[:2]))
    places = {name: row for row, name in enumerate(names)}
    ends = {name: [n for n, edge in enumerate(edges) if name in edge[:2]] for name in names}
    down = [n for n, edge in enumerate(edges) if places[edge[0]] <= places[edge[1]]]
    back = [n for n in range(len(edges)) if n not in down]
    box = max(len(name) for name in names) * CHARACTER + 20
    widest = {True: 0.0, False: 0.0}
    for n, (_, _, label) in enumerate(edges):
        widest[n in down] = max(widest[n in down], len(label) * CHARACTER)
    left = widest[False] + 14 * (len(back) + 1) + 10 if back else 10.0
    tops, y = {}, 10.0
    for name in names:
        tops[name] = y
        y += LINE * max(len(ends[name]), 1) + 26
    parts = []
    for name in names:
        tall = LINE * max(len(ends[name]), 1) + 8
        parts.append(f'<rect x="{left:.0f}" y="{tops[name]:.0f}" width="{box:.0f}" height="{tall:.0f}" rx="5"/>')
        parts.append(_text(left + box / 2, tops[name] + tall / 2 + 4, name))
    for side, lanes in ((1, down), (-1, back)):
        edge_x = left + box if side == 1 else left
        for lane, n in enumerate(sorted(lanes, key=lambda n: abs(places[edges[n][0]] - places[edges[n][1]]))):
            start, end, label = edges[n]
            y0, y1 = (tops[name] + 4 + LINE * (ends[name].index(n) + 0.5) for name in (start, end))
            y1 += 7 if start == end else 0
            x = edge_x + side * (widest[side == 1] + 14 * (lane + 1))
            parts.append(f'<path d="M{edge_x:.0f} {y0:.0f}H{x:.0f}V{y1:.0f}H{edge_x:.0f}" marker-end="url(#tip)"/>')
            if label:
                parts.append(_text(edge_x + side * 6, y0 - 3, label, "start" if side == 1 else "end"))
    right = widest[True] + 14 * (len(down) + 1) + 10 if down else 10.0
    return _canvas(left + box + right, y, parts)


ROW, BESIDE = 92, 14
"""Height of a row of boxes, and distance of an arrow from the middle of its row [px]."""


def _loop(edges: list[tuple[str, str, str]]) -> str:
    """Draw a loop from left to right: columns of boxes, the arrows forward above those back.

    A column with a single box makes it as high as all rows, so that each arrow is a straight line.
    """
    column = {edges[0][0]: 0}
    for start, end, _ in edges:
        column.setdefault(end, column[start] + 1)
    columns = [[name for name in column if column[name] == k] for k in range(max(column.values()) + 1)]
    rows = max(len(names) for names in columns)
    box = max(len(name) for name in column) * CHARACTER + 20
    gap = max(len(label) for *_, label in edges) * CHARACTER + 26
    left = {name: 10 + column[name] * (box + gap) for name in column}
    parts = []
    for names in columns:
        tall = ROW * rows / len(names)
        for row, name in enumerate(names):
            top = 10 + row * tall
            size = f'width="{box:.0f}" height="{tall - 12:.0f}"'
            parts.append(f'<rect x="{left[name]:.0f}" y="{top:.0f}" {size} rx="5"/>')
            parts.append(_text(left[name] + box / 2, top + (tall - 12) / 2 + 4, name))
    for start, end, label in edges:
        ahead = column[end] - column[start]
        ends = [columns[column[name]] for name in (start, end)]
        many = [names.index(name) for names, name in zip(ends, (start, end), strict=True) if len(names) > 1]
        if abs(ahead) != 1 or len(many) > 1:
            raise ValueError(f"no edge of a loop: {start} to {end}")
        middle = 10 + ROW * (many[0] + 0.5 if many else rows / 2) - 6
        y = middle - ahead * BESIDE
        x0, x1 = (left[start] + box, left[end]) if ahead == 1 else (left[start], left[end] + box)
        parts.append(f'<path d="M{x0:.0f} {y:.0f}H{x1:.0f}" marker-end="url(#tip)"/>')
        parts.append(_text((x0 + x1) / 2, y - 5 if ahead == 1 else y + 15, label))
    return _canvas(20 + len(columns) * (box + gap) - gap, 20 + ROW * rows - 12, parts)


def _sequence(lines: list[str]) -> str:
    names: dict[str, str] = {}
    steps: list[tuple[str, str, str, list[str]]] = []
    for line in lines:
        if match := re.fullmatch(r"participant (\w+) as (.+)", line):
            names[match[1]] = match[2]
        elif match := re.fullmatch(r"Note over (\w+)(?:,(\w+))?: (.*)", line):
            steps.append(("note", match[1], match[2] or match[1], match[3].split("<br/>")))
        elif match := re.fullmatch(r"(\w+)->>(\w+): (.*)", line):
            steps.append(("arrow", match[1], match[2], [match[3]]))
        else:
            raise ValueError(f"no step: {line!r}")
    apart = 20 + CHARACTER * max(len(text) for *_, texts in steps for text in texts)
    across = {key: 80 + n * apart for n, key in enumerate(names)}
    parts, y = [], 50.0
    for kind, start, end, texts in steps:
        x0, x1 = across[start], across[end]
        y += LINE * len(texts) + (14 if kind == "note" else 8)
        if kind == "note":
            wide = max(len(text) for text in texts) * CHARACTER + 16
            wide, middle = max(wide, abs(x1 - x0) + 16), (x0 + x1) / 2
            top = y - LINE * len(texts) - 4
            parts.append(
                f'<rect x="{middle - wide / 2:.0f}" y="{top:.0f}" width="{wide:.0f}" height="{LINE * len(texts) + 6}" '
                'stroke-dasharray="3 3" style="fill:var(--md-code-bg-color,#eee)"/>'
            )
            parts += [_text(middle, top + LINE * (n + 1) - 2, text) for n, text in enumerate(texts)]
        else:
            parts.append(f'<path d="M{x0:.0f} {y:.0f}H{x1:.0f}" marker-end="url(#tip)"/>')
            parts.append(_text((x0 + x1) / 2, y - 4, texts[0]))
    lives = [f'<path d="M{x:.0f} 32V{y + 20:.0f}" stroke-opacity="0.4"/>' for x in across.values()]
    heads = [_text(across[key], 24, name) for key, name in names.items()]
    right = max(across.values()) + 80
    left = min([0.0, *((across[s] + across[e]) / 2 - max(map(len, t)) * CHARACTER / 2 - 10 for _, s, e, t in steps)])
    drawn = _canvas(right - left, y + 30, [*lives, *heads, *parts])
    return drawn.replace('viewBox="0 0', f'viewBox="{left:.0f} 0')
