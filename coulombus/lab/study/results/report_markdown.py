"""A study's report as a page of Markdown."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from coulombus.lab.study.results.report_text import between, lines

__all__ = ["page"]

HAND = ("path [rad]", "reversals", "moving", "speed [rad/s]", "peak [Nm]", "work [J]")


def page(results: Mapping[str, Any], paths: Sequence[Path] = ()) -> str:
    """Return a report as Markdown: tables of the thresholds and of how the hands moved, and the
    pictures.
    """
    unit = f" [{results['level']['unit']}]" if results["level"]["unit"] else ""
    rows, hands = [], []
    for subject, conditions in results["subjects"].items():
        for name, condition in conditions.items():
            rows.append((subject, name, condition["trials"], *_cells(condition)))
            for level, hand in (condition["exploration"] or {}).items():
                values = (hand[key] for key in ("path_rad", "reversals", "moving", "speed_rad_s", "peak_Nm", "work_J"))
                hands.append((subject, name, level, *("" if x is None else f"{x:.3g}" for x in values)))
    parts = [f"# {results['study'] or 'What the study came to'}"]
    if results["level"]["unit"]:
        parts.append(f"The level is {results['level']['quantity']}{unit}. Intervals are of 95 %.")
    head = ["subject", "condition", "trials", f"JND{unit}", f"PSE{unit}", "Weber fraction", "right", "lapses"]
    head += [f"interval bias{unit}", "deviance p", "overdispersion", "exponent", f"staircase{unit}"]
    head += ["JND felt [Nm]", "PSE felt [Nm]", "reference felt [Nm]"]
    parts.append(_table(head, rows))
    together = list(lines({**results, "subjects": {}}))
    if together:
        parts.append("All subjects:\n\n" + "\n".join(f"- {line}" for line in together))
    parts += [f"![{path.stem}]({path.name})" for path in paths if path.suffix == ".png"]
    if hands:
        parts.append("How the hands moved:\n\n" + _table(("subject", "condition", f"level{unit}", *HAND), hands))
    return "\n\n".join(parts) + "\n"


def _cells(condition: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the cells of a condition behind its number of trials."""
    fit, magnitudes, turned = condition["fit"], condition["magnitudes"], condition["staircase"]
    cells = [""] * 8
    if fit is not None:
        weber = "" if fit["weber"] is None else f"{fit['weber']:.3g}"
        cells = [f"{fit['jnd']:.4g}{between(fit['jnd_95'])}", f"{fit['pse']:.4g}{between(fit['pse_95'])}", weber]
        bias = "" if fit["bias"] is None else f"{fit['bias']:.2g}{between(fit['bias_95'])}"
        cells += [f"{fit['right']:.1%}", f"{fit['lapse']:.1%}", bias]
        cells += [f"{fit['probability']:.2g}", f"{fit['overdispersion']:.2g}"]
    elif condition["levels"]:
        cells[0] = f"not fitted: {condition['no_fit']}"
    exponent = "" if magnitudes is None else f"{magnitudes['exponent']:.3g}{between(magnitudes['exponent_95'])}"
    turns = (
        "" if turned is None else f"{turned['threshold']:.4g} ({turned['turns']} turns, {turned['right']:.1%} right)"
    )
    return *cells, exponent, turns, *_felt_cells(condition["felt"])


def _felt_cells(felt: Mapping[str, Any] | None) -> tuple[str, str, str]:
    if felt is None:
        return "", "", ""
    jnd, pse = (f"{felt['fit'][name]:.4g}{between(felt['fit'][f'{name}_95'])}" for name in ("jnd", "pse"))
    return jnd, pse, f"{felt['reference_Nm']:.4g}"


def _table(head: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """Return a table of Markdown without the columns that are empty."""
    filled = [k for k in range(len(head)) if any(str(row[k]) for row in rows)]
    lines_of = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(str(row[k]).replace("|", "\\|") for k in filled) + " |" for row in lines_of)
