"""A study's report as lines of text, and as a page of Markdown."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

__all__ = ["lines", "page"]


POOR = 0.05
"""Below this probability of the deviance the fit is said to be poor, and the PSE to drift."""


def _hand_text(hand: Mapping[str, Any]) -> str:
    text = f"path {hand['path_rad']:.3g} rad, {hand['reversals']:.3g} reversals, moving {hand['moving']:.0%}"
    text += f" at {hand['speed_rad_s']:.3g} rad/s"
    return text if hand["work_J"] is None else f"{text}, peak {hand['peak_Nm']:.3g} Nm, work {hand['work_J']:.3g} J"


def _between(bounds: Sequence[float | None] | None) -> str:
    """Return an interval as text: " (0.1 to 0.2)", with `?` for an end that nothing bounds."""
    if bounds is None:
        return ""
    low, high = ("?" if bound is None else f"{bound:.4g}" for bound in bounds)
    return f" ({low} to {high})"


def lines(results: Mapping[str, Any]) -> Iterable[str]:
    """Yield a report as text."""
    unit = f" {results['level']['unit']}".rstrip()
    for subject, conditions in results["subjects"].items():
        for name, condition in conditions.items():
            text = f"{subject} {name}: {condition['trials']} trials"
            fit, magnitudes = condition["fit"], condition["magnitudes"]
            if fit is not None:
                text += _fit_text(fit, unit)
            elif condition["levels"]:
                text += f", not fitted: {condition['no_fit']}"
            if magnitudes is not None:
                text += f", exponent {magnitudes['exponent']:.3g}{_between(magnitudes['exponent_95'])}"
            if condition["staircase"] is not None:
                turned = condition["staircase"]
                text += f", {turned['turns']} turns around {turned['threshold']:.4g}{unit} ({turned['right']:.1%} right there)"
            yield text
            if condition["felt"] is not None:
                yield f"  {_felt_text(condition['felt'], unit)}"
            for level, hand in (condition["exploration"] or {}).items():
                yield f"  level {level}{unit}: {_hand_text(hand)}"
    for name, condition in results["conditions"].items():
        if condition["subjects"] > 1:
            text = f"{name}: JND {condition['jnd']:.4g}{unit}{_between(condition['jnd_95'])}"
            yield f"{text}, geometric mean of {condition['subjects']} subjects{_left_out(condition)}"
        if condition["hierarchical"] is not None:
            group = condition["hierarchical"]
            text = f"{name}: JND {group['jnd']:.4g}{unit}{_between(group['jnd_95'])}, hierarchical fit of the answers"
            yield f"{text} of {group['subjects']} subjects, spread of log JND {group['spread']:.2g}{_between(group['spread_95'])}"
    model = results["mixed_model"]
    for name, effect in (model or {"jnd_ratio": {}})["jnd_ratio"].items():
        text = f"{name}: JND {effect['ratio']:.3g}{_between(effect['ratio_95'])} times that of {model['against']}"
        yield f"{text}, mixed model of {model['subjects']} subjects"


def _fit_text(fit: Mapping[str, Any], unit: str) -> str:
    text = f", JND {fit['jnd']:.4g}{unit}{_between(fit['jnd_95'])}, PSE {fit['pse']:.4g}{unit}{_between(fit['pse_95'])}"
    text += "" if fit["weber"] is None else f", Weber fraction {fit['weber']:.3g}"
    text += f", {fit['right']:.1%} right, lapses {fit['lapse']:.1%} (if 10 %: JND {fit['jnd_lapses']:.4g}{unit})"
    if fit["bias"] is not None:
        text += f", interval bias {fit['bias']:.2g}{unit}{_between(fit['bias_95'])}"
    text += (
        f", deviance {fit['deviance']:.3g} (p = {fit['probability']:.2g}, overdispersion {fit['overdispersion']:.2g})"
    )
    if fit["probability"] < POOR:
        text += "; the function does not describe these answers"
    if fit["drift_probability"] < POOR:
        text += (
            f"; the PSE drifts by {fit['drift']:.2g}{unit} over the trials (p = {fit['drift_probability']:.1g}), which "
            "widens the JND"
        )
    if fit["one_sided"]:
        text += "; levels on one side of the reference: PSE and slope are hardly told apart"
    return text


def _felt_text(felt: Mapping[str, Any], unit: str) -> str:
    fit = felt["fit"]
    text = (
        f"as felt: JND {fit['jnd']:.4g} Nm{_between(fit['jnd_95'])}, PSE {fit['pse']:.4g} Nm{_between(fit['pse_95'])}"
    )
    text += f", reference {felt['reference_Nm']:.4g} Nm, {felt['gain']:.3g} Nm for each{unit or ' unit'} of the level"
    return f"{text}, spread {felt['spread_Nm']:.2g} Nm"


def _left_out(condition: Mapping[str, Any]) -> str:
    named = "; ".join(f"{subject}: {reason}" for subject, reason in condition["left_out"].items())
    return f"; left out: {named}" if named else ""


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
        cells = [f"{fit['jnd']:.4g}{_between(fit['jnd_95'])}", f"{fit['pse']:.4g}{_between(fit['pse_95'])}", weber]
        bias = "" if fit["bias"] is None else f"{fit['bias']:.2g}{_between(fit['bias_95'])}"
        cells += [f"{fit['right']:.1%}", f"{fit['lapse']:.1%}", bias]
        cells += [f"{fit['probability']:.2g}", f"{fit['overdispersion']:.2g}"]
    elif condition["levels"]:
        cells[0] = f"not fitted: {condition['no_fit']}"
    exponent = "" if magnitudes is None else f"{magnitudes['exponent']:.3g}{_between(magnitudes['exponent_95'])}"
    turns = (
        "" if turned is None else f"{turned['threshold']:.4g} ({turned['turns']} turns, {turned['right']:.1%} right)"
    )
    return *cells, exponent, turns, *_felt_cells(condition["felt"])


def _felt_cells(felt: Mapping[str, Any] | None) -> tuple[str, str, str]:
    if felt is None:
        return "", "", ""
    jnd, pse = (f"{felt['fit'][name]:.4g}{_between(felt['fit'][f'{name}_95'])}" for name in ("jnd", "pse"))
    return jnd, pse, f"{felt['reference_Nm']:.4g}"


def _table(head: Sequence[str], rows: Sequence[Sequence[Any]]) -> str:
    """Return a table of Markdown without the columns that are empty."""
    filled = [k for k in range(len(head)) if any(str(row[k]) for row in rows)]
    lines_of = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(str(row[k]).replace("|", "\\|") for k in filled) + " |" for row in lines_of)
