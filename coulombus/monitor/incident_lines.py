"""Incidents of a live bus for ``coulombus watch``: terminal lines, news, plain values."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from rich.console import Console
from rich.text import Text

from coulombus.monitor.live_incidents import IncidentRow

__all__ = ["OpenedIncident", "incident_dict", "incident_lines", "news"]

STYLES = {"unresolved": "bold red", "recovered": "yellow", "warning": "dim"}
SHOWN = 9
"""Maximum shown incidents: those that the keys 1 to 9 open."""
INDENT = 4
COURSE = 6


def _when(row: IncidentRow, begin_ns: int) -> str:
    begin = f"{(row.begin_ns - begin_ns) / 1e9:.3f} s"
    if row.end_ns is None:
        return f"{begin} to now"
    seconds = (row.end_ns - row.begin_ns) / 1e9
    return f"{begin}, for {seconds:.3f} s" if seconds >= 1e-3 else begin


def incident_lines(
    rows: Sequence[IncidentRow], opened: str, begin_ns: int, console: Console, size: tuple[int, int]
) -> list[Text]:
    """Return the panel of a terminal: a line for each incident, and the opened one's cause, checks
    and course.

    Parameters
    ----------
    opened : key of the opened incident; empty: none
    begin_ns : the time from which seconds count
    size : maximum of the panel in characters: width, height
    """
    width, height = size
    if not rows or height < 2:
        return []
    unresolved = sum(row.status == "unresolved" for row in rows)
    head = f"incidents: {len(rows)}" + (f", {unresolved} unresolved" if unresolved else "")
    lines = [Text(head + "; keys 1 to 9 open and close", style="bold")]
    for row in rows[:SHOWN]:
        lines.append(
            Text(
                f"{row.number:>2}  {row.status:<10}  {_when(row, begin_ns)}  {row.title}",
                style=STYLES.get(row.status, ""),
            )
        )
        if row.key == opened:
            texts = [f"cause ({row.sure}): {row.cause}", "check first:"]
            texts += [f"{number}. {check}" for number, check in enumerate(row.checks, 1)]
            for t_ns, role, text in row.course[:COURSE]:
                texts.append(f"{(t_ns - begin_ns) / 1e9:.3f} s  {role}: {text}")
            for text in texts:
                for part in Text(text).wrap(console, max(20, width - INDENT)):
                    lines.append(Text(" " * INDENT).append(part))
    hidden = len(rows) - SHOWN
    if hidden > 0:
        lines.append(Text(f"... and {hidden} more: coulombus explain --bus", style="dim"))
    if len(lines) > height:
        lines = [
            *lines[: height - 1],
            Text(f"... {len(lines) - height + 1} more lines: in a higher window", style="dim"),
        ]
    return lines


class OpenedIncident:
    """The opened incident: the one that had the number when its key was struck."""

    def __init__(self) -> None:
        self.key = ""
        self._strokes = 0

    def follow(self, number: int, strokes: int, rows: Sequence[IncidentRow]) -> str:
        """Return the key of the opened incident, after `strokes` so far, `number` the last of them."""
        if strokes != self._strokes:
            self._strokes = strokes
            key = next((row.key for row in rows if row.number == number), "")
            self.key = "" if key == self.key else key
        return self.key


def news(rows: Sequence[IncidentRow], statuses: dict[str, str], begin_ns: int) -> Iterator[str]:
    """Yield a line for each new incident and each change of state; `statuses` keeps the states."""
    for row in rows:
        if statuses.get(row.key) != row.status:
            statuses[row.key] = row.status
            mark = "!" if row.status == "unresolved" else "*"
            at = (row.begin_ns - begin_ns) / 1e9
            yield f"{at:10.3f}  {mark} incident {row.number}, {row.status}: {row.title}; check: {row.checks[0]}"


def incident_dict(row: IncidentRow, begin_ns: int) -> dict[str, Any]:
    """Return an incident for ``--json``, with the names of ``explain --json``."""
    return {
        "number": row.number,
        "status": row.status,
        "title": row.title,
        "t_s": (row.begin_ns - begin_ns) / 1e9,
        "end_s": None if row.end_ns is None else (row.end_ns - begin_ns) / 1e9,
        "cause": row.cause,
        "sure": row.sure,
        "check": list(row.checks),
    }
