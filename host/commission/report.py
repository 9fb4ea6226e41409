"""Report of a commissioning: a self-contained HTML page with its figures."""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from html import escape
from pathlib import Path
from typing import Any

from coulombus.host.commission.progress import Progress
from coulombus.host.commission.session import Session
from coulombus.host.commission.steps import STEPS
from coulombus.rigs.rewrite import write_whole
from coulombus.rigs.rig import Rig

__all__ = ["report", "write_report"]

PICTURE_INCHES = (4.4, 2.9)
STYLE = """
body { font: 15px/1.45 system-ui, sans-serif; color: #1a1a1a; max-width: 980px; margin: 2em auto; padding: 0 1em; }
h1 { font-size: 1.5em; margin-bottom: 0; } h2 { font-size: 1.15em; margin: 1.6em 0 .3em; border-bottom: 1px solid #bbb; }
p { margin: .3em 0; } .small { color: #555; font-size: .87em; }
h2::first-letter { text-transform: uppercase; }
table { border-collapse: collapse; width: 100%; font-size: .92em; margin: .4em 0; table-layout: fixed; }
th:nth-child(1) { width: 34%; } th:nth-child(n+2):nth-child(-n+3) { width: 10%; } th:nth-child(4) { width: 8%; }
th:nth-child(5) { width: 9%; } code { overflow-wrap: anywhere; }
th { text-align: left; border-bottom: 1px solid #888; font-weight: 600; } td, th { padding: .18em .6em .18em 0; vertical-align: top; }
td.n, th.n { text-align: right; font-variant-numeric: tabular-nums; white-space: nowrap; }
tr.written td { font-weight: 600; } code { font-size: .93em; }
.pictures { display: flex; flex-wrap: wrap; gap: .6em; } .pictures svg { max-width: 100%; height: auto; }
@media print { body { margin: 0; } h2 { break-after: avoid; } .pictures { break-inside: avoid; } }
"""


def report(rig: Rig, state: Progress, titles: Mapping[str, str]) -> str:
    """Return the report as HTML.

    Parameters
    ----------
    titles : titles of all steps in their order, including steps that are not done
    """
    return "\n".join(_page(rig, state, titles)) + "\n"


def write_report(session: Session) -> Path:
    """Write the report of a session into its folder, and return its path."""
    path = session.state.folder / "report.html"
    write_whole(path, report(session.rig(), session.state, {step.name: step.title for step in STEPS}).encode())
    return path


def _page(rig: Rig, state: Progress, titles: Mapping[str, str]) -> Iterator[str]:
    done = [name for name in titles if name in state.steps]
    missing = [title for name, title in titles.items() if name not in state.steps]
    yield f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>Commissioning of {escape(rig.name)}</title>'
    yield f"<style>{STYLE}</style></head><body>"
    yield f"<h1>Commissioning of {escape(rig.name)}</h1>"
    yield f'<p class="small">{escape(rig.about.description)}<br><code>{escape(rig.path)}</code></p>'
    yield "<p>Bold rows were written into the rig file. The intervals are 95 %.</p>"
    for name in done:
        yield from _step(titles[name], state.steps[name])
    if missing:
        yield f"<h2>Not done</h2><p>{escape('; '.join(missing))}</p>"
    yield "</body></html>"


def _step(title: str, outcome: Mapping[str, Any]) -> Iterator[str]:
    yield f"<h2>{escape(title)}</h2>"
    files = ", ".join(f"<code>{escape(name)}</code>" for name in outcome["recordings"])
    yield f'<p class="small">{escape(outcome["at"])}; {files}</p>'
    yield '<table><tr><th>what</th><th class="n">was</th><th class="n">is</th><th class="n">&plusmn;</th><th>unit</th><th>rests on</th></tr>'
    for finding in outcome["findings"]:
        written = ' class="written"' if finding["key"] and finding["changed"] else ""
        name = escape(finding["name"]) + (f" <code>{escape(finding['key'])}</code>" if finding["key"] else "")
        reach = "" if finding["uncertainty"] is None else f"{finding['uncertainty']:.2g}"
        yield (
            f'<tr{written}><td>{name}</td><td class="n">{_figure(finding["old"])}</td><td class="n">{_figure(finding["new"])}</td>'
            f'<td class="n">{reach}</td><td>{escape(finding["unit"])}</td><td class="small">{escape(finding["basis"])}</td></tr>'
        )
    yield "</table>"
    for text in outcome["remarks"]:
        yield f'<p class="small">Note: {escape(text)}</p>'
    if outcome["curves"]:
        yield f'<div class="pictures">{"".join(_picture(curve) for curve in outcome["curves"])}</div>'


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

    with figure(*PICTURE_INCHES) as (made, ax), rc_context({"svg.fonttype": "none"}):
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
        FigureCanvasSVG(made).print_svg(file, metadata={"Date": None})  # type: ignore[no-untyped-call]
    text = file.getvalue()
    return text[text.index("<svg") :]
