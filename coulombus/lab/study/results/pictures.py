"""The pictures of a study's report, and the page with them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from coulombus.lab.study.results.fit import Fit
from coulombus.lab.study.results.report_markdown import page
from coulombus.recording.pictures.style import figure, save
from coulombus.rigs.rewrite import write_whole

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["write_figures"]


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
                with figure(6.0, 4.0) as (made, axes):
                    draw(axes, shown, named, unit)
                    axes.set_title(f"{study}subject {subject}")
                    axes.legend()
                    paths += save(made, folder, f"sub-{subject}_{name}")
    if (
        any(condition["jnd"] is not None for condition in results["conditions"].values())
        and len(results["subjects"]) > 1
    ):
        with figure(6.0, 4.0) as (made, axes):
            draw_conditions(axes, results, unit)
            paths += save(made, folder, "conditions")
    write_whole(folder / "report.md", page(results, paths).encode())
    return [*paths, folder / "report.md"]


def draw_psychometric(axes: Axes, shown: Mapping[str, Any], level: str, unit: str) -> None:
    """Draw the share of answers at each level, and the fitted function."""
    for k, (name, condition) in enumerate(shown.items()):
        fit = Fit(**condition["fit"])
        levels = np.array([float(level) for level in condition["levels"]])
        counts = np.array(list(condition["levels"].values()), float)
        axes.scatter(levels, counts[:, 0] / counts[:, 1], s=8 + 2 * counts[:, 1], color=f"C{k}", alpha=0.6)
        x = np.linspace(levels.min(), levels.max(), 200)
        axes.plot(x, fit.chance(x), color=f"C{k}", label=f"{name}: JND {fit.jnd:.3g} {unit}".rstrip())
    axes.set(xlabel=level, ylabel="proportion judged larger", ylim=(-0.03, 1.03))


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
    for x, name in enumerate(names):
        whole = results["conditions"][name]
        counted = [subject for subject in results["subjects"] if subject not in whole["left_out"]]
        jnds = [results["subjects"][subject][name]["fit"]["jnd"] for subject in counted]
        axes.scatter([x] * len(jnds), jnds, s=14, color="C0", alpha=0.5)
        axes.scatter([x + 0.15], [whole["jnd"]], s=40, color="C1", marker="D")
        if whole["jnd_95"] is not None:
            axes.plot([x + 0.15] * 2, whole["jnd_95"], color="C1")
    counts = [results["conditions"][name]["subjects"] for name in names]
    axes.set_xticks(range(len(names)), [f"{name}\nn = {count}" for name, count in zip(names, counts, strict=True)])
    label = f"JND of {results['level']['quantity']} [{unit}]" if unit else "JND"
    axes.set(ylabel=label, title="n subjects, geometric mean, interval of 95 %")
    axes.set_xlim(-0.5, len(names) - 0.3)
    axes.set_ylim(bottom=0)


_OF_SUBJECTS: tuple[tuple[str, Callable[[Any], bool], Callable[[Axes, Mapping[str, Any], str, str], None]], ...] = (
    ("psychometric", lambda condition: condition["fit"] is not None, draw_psychometric),
    ("track", lambda condition: condition["fit"] is not None and condition["track"] is not None, draw_track),
    ("magnitudes", lambda condition: condition["magnitudes"] is not None, draw_magnitudes),
    ("exploration", lambda condition: bool(condition["exploration"]), draw_exploration),
)
"""Name of a picture -> which conditions it shows, and how."""
