"""A study's report as a page of Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from coulombus.lab.study.results.report import between, lines

__all__ = ["page"]

HAND = ("path [rad]", "reversals", "moving", "speed [rad/s]", "peak [Nm]", "work [J]")


def page(found: Mapping[str, Any], paths: Sequence[Path] = ()) -> str:
    """Return a report as Markdown: tables of the thresholds and of how the hands moved, and the
    pictures.
    """
    unit = f" [{found['level']['unit']}]" if found["level"]["unit"] else ""
    rows, hands = [], []
    for subject, conditions in found["subjects"].items():
        for name, one in conditions.items():
            rows.append((subject, name, one["trials"], *_cells(one)))
            for level, hand in (one["exploration"] or {}).items():
                told = (hand[key] for key in ("path_rad", "reversals", "moving", "speed_rad_s", "peak_Nm", "work_J"))
                hands.append((subject, name, level, *("" if x is None else f"{x:.3g}" for x in told)))
    parts = [f"# {found['study'] or 'What the study came to'}"]
    if found["level"]["unit"]:
        parts.append(f"The level is {found['level']['quantity']}{unit}. Intervals are of 95 %.")
    head = ("subject", "condition", "trials", f"JND{unit}", f"PSE{unit}", "Weber fraction", "right", "exponent")
    parts.append(_table((*head, f"staircase{unit}"), rows))
    together = list(lines({**found, "subjects": {}}))
    if together:
        parts.append("All subjects:\n\n" + "\n".join(f"- {line}" for line in together))
    parts += [f"![{path.stem}]({path.name})" for path in paths if path.suffix == ".png"]
    if hands:
        parts.append("How the hands moved:\n\n" + _table(("subject", "condition", f"level{unit}", *HAND), hands))
    return "\n\n".join(parts) + "\n"


def _cells(one: Mapping[str, Any]) -> tuple[str, ...]:
    """Return JND, PSE, Weber fraction, share of right answers, exponent and staircase of a condition."""
    fit, magnitudes, turned = one["fit"], one["magnitudes"], one["staircase"]
    found = ["", "", "", ""]
    if fit is not None:
        weber = "" if fit["weber"] is None else f"{fit['weber']:.3g}"
        found = [f"{fit['jnd']:.4g}{between(fit['jnd_95'])}", f"{fit['pse']:.4g}", weber, f"{fit['right']:.1%}"]
    exponent = "" if magnitudes is None else f"{magnitudes['exponent']:.3g}{between(magnitudes['exponent_95'])}"
    turns = (
        "" if turned is None else f"{turned['threshold']:.4g} ({turned['turns']} turns, {turned['right']:.1%} right)"
    )
    return *found, exponent, turns


def _table(head: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """Return a table of Markdown without the columns that are empty."""
    kept = [k for k in range(len(head)) if any(str(row[k]) for row in rows)]
    lines_of = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(str(row[k]).replace("|", "\\|") for k in kept) + " |" for row in lines_of)
