"""The pictures of a study's report, and the page with them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from coulombus.lab.study.results.fit import Fit
from coulombus.lab.study.results.report_text import page
from coulombus.recording.pictures.style import COLOURS, DASHES, GREY, figure, save
from coulombus.system.unfinished_file import write_whole

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["write_figures"]

CHANCE = 0.5
"""Proportion of levels that cannot be told from the reference."""
LARGEST_POINT = 90.0
"""Area of the point with most answers [pt^2]."""
DECADE = 10.0
"""JNDs that span more than this are drawn on a logarithmic axis."""


def write_figures(results: Mapping[str, Any], folder: Path) -> list[Path]:
    """Draw what a report has, and return the files: PNG and SVG, and report.md with all of them."""
    paths: list[Path] = []
    level, unit = results["level"]["quantity"], results["level"]["unit"]
    named = f"level: {level} [{unit}]" if unit else "level"
    study = f"{results['study']}, " if results["study"] else ""
    for subject, conditions in results["subjects"].items():
        for name, condition_has, draw in _OF_SUBJECTS:
            shown = {key: condition for key, condition in conditions.items() if condition_has(condition)}
            if shown:
                with figure(6.0, 4.0 + 0.2 * len(shown)) as (fig, axes):
                    draw(axes, shown, named, unit)
                    axes.set_title(f"{study}subject {subject}")
                    fig.legend(loc="outside lower left")
                    paths += save(fig, folder, f"sub-{subject}_{name}")
    if (
        any(condition["jnd"] is not None for condition in results["conditions"].values())
        and len(results["subjects"]) > 1
    ):
        with figure(6.0, 4.0) as (fig, axes):
            draw_conditions(axes, results, unit)
            paths += save(fig, folder, "conditions")
    write_whole(folder / "report.md", page(results, paths).encode())
    return [*paths, folder / "report.md"]


def draw_psychometric(axes: Axes, shown: Mapping[str, Any], level: str, unit: str) -> None:
    """Draw the share of answers at each level, the fitted function with its band of 95 %, the point
    of subjective equality with its interval, and the chance level.

    The area of a point is proportional to its number of answers.
    """
    largest_count = max(count for condition in shown.values() for _, count in condition["levels"].values())
    axes.axhline(CHANCE, color=GREY, lw=0.8, ls="--", zorder=0)
    axes.annotate(
        "chance", (1.0, CHANCE), (-2, 2), "axes fraction", "offset points", ha="right", color=GREY, fontsize=8
    )
    for k, (name, condition) in enumerate(shown.items()):
        fit, colour = Fit(**condition["fit"]), COLOURS[k % len(COLOURS)]
        levels = np.array([float(level) for level in condition["levels"]])
        counts = np.array(list(condition["levels"].values()), float)
        sizes = LARGEST_POINT * counts[:, 1] / largest_count
        axes.scatter(levels, counts[:, 0] / counts[:, 1], s=sizes, color=colour, alpha=0.5, lw=0)
        if condition.get("band_95") is not None:
            band = condition["band_95"]
            axes.fill_between(band["level"], band["low"], band["high"], color=colour, alpha=0.15, lw=0)
        x = np.linspace(levels.min(), levels.max(), 200)
        words = f"{name}: JND {fit.jnd:.3g} {unit}".rstrip() + f", PSE {fit.pse:.3g} {unit}".rstrip()
        axes.plot(x, fit.chance(x), color=colour, ls=DASHES[k % len(DASHES)], label=words)
        at = float(fit.chance(fit.pse))
        axes.plot([fit.pse, fit.pse], [-0.03, at], color=colour, lw=0.8, ls=":")
        axes.plot(fit.pse_95, [at, at], color=colour, lw=1.6)
        axes.plot(fit.pse, at, marker="|", ms=10, mew=1.6, color=colour)
    axes.scatter([], [], s=LARGEST_POINT, color=GREY, alpha=0.5, lw=0, label=f"{largest_count} answers; area by number")
    axes.fill_between([], [], [], color=GREY, alpha=0.15, lw=0, label="95 % of the function; bar: of the PSE")
    axes.set(xlabel=level, ylabel="proportion judged larger", ylim=(-0.03, 1.03))
    edge = 0.04 * (axes.get_xlim()[1] - axes.get_xlim()[0])
    axes.set_xlim(axes.get_xlim()[0] - edge, axes.get_xlim()[1] + edge)


def draw_track(axes: Axes, shown: Mapping[str, Any], level: str, unit: str) -> None:
    """Draw the levels of an adaptive method in their order; wrong answers are crosses."""
    for k, (name, condition) in enumerate(shown.items()):
        levels, right = np.array(condition["track"], float).T
        trial = np.arange(1, len(levels) + 1)
        axes.plot(trial, levels, color=f"C{k}", lw=0.8, label=name)
        axes.scatter(trial[right > 0], levels[right > 0], s=8, color=f"C{k}")
        axes.scatter(trial[right == 0], levels[right == 0], s=20, color=f"C{k}", marker="x")
        if condition["staircase"] is not None:
            axes.axhline(condition["staircase"]["threshold"], color=f"C{k}", ls=":", lw=1.0)
    axes.set(xlabel="trial of the condition (x: wrong)", ylabel=level)


def draw_magnitudes(axes: Axes, shown: Mapping[str, Any], level: str, unit: str) -> None:
    """Draw estimated magnitudes over the levels, both logarithmic."""
    for k, (name, condition) in enumerate(shown.items()):
        levels, answers = np.array(condition["track"], float).T
        label = f"{name}: exponent {condition['magnitudes']['exponent']:.3g}"
        axes.scatter(levels, answers, s=10, color=f"C{k}", alpha=0.6, label=label)
    axes.set(xlabel=level, ylabel="magnitude", xscale="log", yscale="log")


def draw_exploration(axes: Axes, shown: Mapping[str, Any], level: str, unit: str) -> None:
    """Draw how far and how fast the hand turned the handle at each level."""
    for k, (name, condition) in enumerate(shown.items()):
        levels = [float(level) for level in condition["exploration"]]
        path = [hand["path_rad"] for hand in condition["exploration"].values()]
        axes.plot(levels, path, marker="o", color=f"C{k}", label=name)
    axes.set(xlabel=level, ylabel="path of the handle [rad]")
    axes.set_ylim(bottom=0)


def draw_conditions(axes: Axes, results: Mapping[str, Any], unit: str) -> None:
    """Draw each subject's JND in each condition, the geometric mean and its interval."""
    names = [name for name, condition in results["conditions"].items() if condition["jnd"] is not None]
    drawn: list[float] = []
    for x, name in enumerate(names):
        whole = results["conditions"][name]
        counted = [subject for subject in results["subjects"] if subject not in whole["left_out"]]
        jnds = [results["subjects"][subject][name]["fit"]["jnd"] for subject in counted]
        drawn += [*jnds, whole["jnd"], *(whole["jnd_95"] or ())]
        axes.scatter([x] * len(jnds), jnds, s=14, color="C0", alpha=0.5)
        axes.scatter([x + 0.15], [whole["jnd"]], s=40, color="C1", marker="D")
        if whole["jnd_95"] is not None:
            axes.plot([x + 0.15] * 2, whole["jnd_95"], color="C1")
    counts = [results["conditions"][name]["subjects"] for name in names]
    axes.set_xticks(range(len(names)), [f"{name}\nn = {count}" for name, count in zip(names, counts, strict=True)])
    label = f"JND of {results['level']['quantity']} [{unit}]" if unit else "JND"
    axes.set(ylabel=label, title="n subjects, geometric mean, interval of 95 %")
    axes.set_xlim(-0.5, len(names) - 0.3)
    if max(drawn) > DECADE * min(drawn):
        axes.set_yscale("log")
    else:
        axes.set_ylim(bottom=0)


_OF_SUBJECTS: tuple[tuple[str, Callable[[Any], bool], Callable[[Axes, Mapping[str, Any], str, str], None]], ...] = (
    ("psychometric", lambda condition: condition["fit"] is not None, draw_psychometric),
    ("track", lambda condition: condition["fit"] is not None and condition["track"] is not None, draw_track),
    ("magnitudes", lambda condition: condition["magnitudes"] is not None, draw_magnitudes),
    ("exploration", lambda condition: bool(condition["exploration"]), draw_exploration),
)
"""Name of a picture -> which conditions it shows, and how."""
