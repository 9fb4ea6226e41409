"""Report of a commissioning: a self-contained HTML page with its figures."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from getpass import getuser
from hashlib import sha256
from html import escape
from importlib import metadata
from pathlib import Path
from typing import Any

from coulombus.host.commission.session import STEPS, Progress, Session
from coulombus.rigs.rig import Rig
from coulombus.system.unfinished_file import write_whole

__all__ = ["Signature", "report", "signature", "value_texts", "write_report"]

SMALLEST_PLACE = 9
"""Decimals beyond which a value is shown with an exponent."""
PICTURE_INCHES = (4.4, 2.9)
STYLE = """
:root { color-scheme: light dark; --ink: #1a1a1a; --paper: #fff; --soft: #555; --line: #bbb; --good: #e4f3e6; --open: #fdf0d5; }
@media (prefers-color-scheme: dark) { :root { --ink: #e6e6e6; --paper: #16181b; --soft: #aaa; --line: #555; --good: #17351c; --open: #4a3612; } }
body { font: 15px/1.45 system-ui, sans-serif; color: var(--ink); background: var(--paper); max-width: 980px; margin: 2em auto; padding: 0 1em; }
h1 { font-size: 1.5em; margin-bottom: 0; } h2 { font-size: 1.15em; margin: 1.6em 0 .3em; border-bottom: 1px solid var(--line); }
p { margin: .3em 0; } .small { color: var(--soft); font-size: .87em; }
.verdict { font-weight: 600; padding: .5em .8em; margin: .8em 0; background: var(--good); } .verdict.open { background: var(--open); }
dl { display: grid; grid-template-columns: max-content 1fr; gap: .1em 1em; margin: .6em 0; } dt { color: var(--soft); } dd { margin: 0; }
h2::first-letter { text-transform: uppercase; }
table { border-collapse: collapse; width: 100%; font-size: .92em; margin: .4em 0; table-layout: fixed; }
th:nth-child(1) { width: 34%; } th:nth-child(n+2):nth-child(-n+3) { width: 10%; } th:nth-child(4) { width: 8%; }
th:nth-child(5) { width: 9%; } code { overflow-wrap: anywhere; }
th { text-align: left; border-bottom: 1px solid var(--line); font-weight: 600; } td, th { padding: .18em .6em .18em 0; vertical-align: top; }
td.n, th.n { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
tr.written td { font-weight: 600; } code { font-size: .93em; }
.pictures { display: flex; flex-wrap: wrap; gap: .6em; } .pictures svg { max-width: 100%; height: auto; background: #fff; }
@media print {
  :root { color-scheme: light; --ink: #000; --paper: #fff; --soft: #444; --line: #888; --good: #fff; --open: #fff; }
  body { margin: 0; max-width: none; font-size: 11pt; } .verdict { border: 1px solid #000; }
  h2 { break-after: avoid; } tr, .pictures { break-inside: avoid; }
}
"""


@dataclass(frozen=True)
class Signature:
    """Facts that a report is signed with.

    Attributes
    ----------
    operator : name of the person at the rig
    version : of this program
    rig_sha256 : of the rig file as it is now
    """

    operator: str
    version: str
    rig_sha256: str


def signature(rig_path: Path, operator: str) -> Signature:
    """Return the signature of a report.

    Raises
    ------
    OSError
        The rig file cannot be read.
    """
    try:
        version = metadata.version("coulombus")
    except metadata.PackageNotFoundError:
        version = "not installed"
    return Signature(operator, version, sha256(rig_path.read_bytes()).hexdigest())


def report(rig: Rig, state: Progress, titles: Mapping[str, str], signed: Signature) -> str:
    """Return the report as HTML.

    Parameters
    ----------
    titles : titles of all steps in their order, including steps that are not done
    """
    return "\n".join(_page(rig, state, titles, signed)) + "\n"


def write_report(session: Session, operator: str | None = None) -> Path:
    """Write the report of a session into its folder, and return its path.

    Parameters
    ----------
    operator : name of the person at the rig; None: the user's
    """
    path = session.state.folder / "report.html"
    titles = {step.name: step.title for step in STEPS}
    signed = signature(session.path, _user() if operator is None else operator)
    write_whole(path, report(session.rig(), session.state, titles, signed).encode())
    return path


def _user() -> str:
    try:
        return getuser()
    except (OSError, KeyError):  # KeyError: an id without a name, before Python 3.13
        return "unknown"


def _page(rig: Rig, state: Progress, titles: Mapping[str, str], signed: Signature) -> Iterator[str]:
    done = [name for name in titles if name in state.steps]
    missing = [title for name, title in titles.items() if name not in state.steps]
    yield f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>Commissioning of {escape(rig.name)}</title>'
    yield f"<style>{STYLE}</style></head><body>"
    yield f"<h1>Commissioning of {escape(rig.name)}</h1>"
    yield f'<p class="small">{escape(rig.about.description)}<br><code>{escape(rig.path)}</code></p>'
    yield from _head([state.steps[name] for name in done], len(titles), signed)
    yield "<p>Bold rows were written into the rig file. The intervals are 95 % on a rig as modelled; uneven friction,"
    yield "bristles or drift beside it are not in them (docs/commissioning.md, Intervals).</p>"
    for name in done:
        yield from _step(titles[name], state.steps[name])
    if missing:
        yield f"<h2>Not done</h2><p>{escape('; '.join(missing))}</p>"
    yield "</body></html>"


def _head(steps: list[Mapping[str, Any]], count: int, signed: Signature) -> Iterator[str]:
    """Yield verdict and signature."""
    findings = [finding for step in steps for finding in step["findings"]]
    written = sum(bool(finding["key"] and finding["changed"]) for finding in findings)
    notes = sum(len(step["remarks"]) for step in steps)
    complete = len(steps) == count
    words = f"{'Complete' if complete else 'Not complete'}: {len(steps)} of {count} steps done"
    words += f", values written: {written}, notes: {notes}"
    yield f'<p class="verdict{"" if complete else " open"}">{words}</p>'
    rows = {
        "operator": escape(signed.operator),
        "last step": escape(max((step["at"] for step in steps), default="none")),
        "version": f"coulombus {escape(signed.version)}",
        "rig file, SHA-256": f"<code>{signed.rig_sha256}</code>",
    }
    yield f"<dl>{''.join(f'<dt>{name}</dt><dd>{value}</dd>' for name, value in rows.items())}</dl>"


def _step(title: str, outcome: Mapping[str, Any]) -> Iterator[str]:
    yield f"<h2>{escape(title)}</h2>"
    files = ", ".join(f"<code>{escape(name)}</code>" for name in outcome["recordings"])
    yield f'<p class="small">{escape(outcome["at"])}; {files}</p>'
    yield '<table><tr><th>what</th><th class="n">was</th><th class="n">is</th><th class="n">&plusmn;</th><th>unit</th><th>rests on</th></tr>'
    for finding in outcome["findings"]:
        written = ' class="written"' if finding["key"] and finding["changed"] else ""
        name = escape(finding["name"]) + (f" <code>{escape(finding['key'])}</code>" if finding["key"] else "")
        new, reach = value_texts(finding["new"], finding["uncertainty"])
        yield (
            f'<tr{written}><td>{name}</td><td class="n">{_figure(finding["old"])}</td><td class="n">{new}</td>'
            f'<td class="n">{reach}</td><td>{escape(finding["unit"])}</td><td class="small">{escape(finding["basis"])}</td></tr>'
        )
    yield "</table>"
    for text in outcome["remarks"]:
        yield f'<p class="small">Note: {escape(text)}</p>'
    if outcome["curves"]:
        yield f'<div class="pictures">{"".join(_picture(curve) for curve in outcome["curves"])}</div>'


def value_texts(value: Any, reach: float | None) -> tuple[str, str]:
    """Return a value and half of its interval with the digits that the interval allows: two digits
    of the interval, and the value to the same place.
    """
    if not isinstance(value, float) or reach is None or not math.isfinite(reach) or reach <= 0.0:
        return _figure(value), "" if reach is None else f"{reach:.2g}"
    place = 1 - math.floor(math.log10(float(f"{reach:.1e}")))
    if place > SMALLEST_PLACE:
        return f"{value:.3g}", f"{reach:.2g}"
    decimals = max(place, 0)
    return f"{round(value, place):.{decimals}f}", f"{round(reach, place):.{decimals}f}"


def _figure(value: Any) -> str:
    if isinstance(value, list):
        return "<br>".join(f"{point[0]:g}: {point[1]:.3f}" for point in value)
    if value is None:
        return "&ndash;"
    return escape(f"{value:.5g}" if isinstance(value, float) else str(value))


def _picture(curve: Mapping[str, Any]) -> str:
    """Return a curve as an SVG element."""
    from matplotlib import rc_context
    from matplotlib.backends.backend_svg import FigureCanvasSVG

    from coulombus.recording.pictures.style import COLOURS, figure, label

    with figure(*PICTURE_INCHES) as (fig, ax), rc_context({"svg.fonttype": "none"}):
        lines = tuple(curve["lines"].items())
        for colour, (name, (x, y, style)) in zip(COLOURS * 3, lines, strict=False):
            ax.plot(x, y, style, color=colour, label=name, markersize=3.5)
        label(ax, curve["x"], curve["y"], curve["title"])
        low, high = ax.get_ylim()
        middle = 0.5 * (low + high)
        if high - low < 0.1 * abs(middle):  # small differences must look small
            ax.set_ylim(middle - 0.1 * abs(middle), middle + 0.1 * abs(middle))
        if len(lines) > 1:
            ax.legend()
        file = io.StringIO()
        FigureCanvasSVG(fig).print_svg(file, metadata={"Date": None})  # type: ignore[no-untyped-call]
    text = file.getvalue()
    return text[text.index("<svg") :]
