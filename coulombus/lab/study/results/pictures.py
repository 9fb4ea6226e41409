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


def write_figures(found: Mapping[str, Any], folder: Path) -> list[Path]:
    """Draw what a report has, and return the files: PNG and SVG, and report.md with all of them."""
    paths: list[Path] = []
    level, unit = found["level"]["quantity"], found["level"]["unit"]
    named = f"level: {level} [{unit}]" if unit else "level"
    study = f"{found['study']}, " if found["study"] else ""
    for subject, conditions in found["subjects"].items():
        for name, wanted, draw in _OF_SUBJECTS:
            shown = {key: one for key, one in conditions.items() if wanted(one)}
            if shown:
                with figure(6.0, 4.0) as (made, axes):
                    draw(axes, shown, named, unit)
                    axes.set_title(f"{study}subject {subject}")
                    axes.legend()
                    paths += save(made, folder, f"sub-{subject}_{name}")
    if any(one["jnd"] is not None for one in found["conditions"].values()) and len(found["subjects"]) > 1:
        with figure(6.0, 4.0) as (made, axes):
            draw_conditions(axes, found, unit)
            paths += save(made, folder, "conditions")
    write_whole(folder / "report.md", page(found, paths).encode())
    return [*paths, folder / "report.md"]


def draw_psychometric(axes: Axes, shown: Mapping[str, Any], level: str, unit: str) -> None:
    """Draw the share of answers at each level, and the fitted function."""
    for k, (name, one) in enumerate(shown.items()):
        fit = Fit(**one["fit"])
        levels = np.array([float(level) for level in one["levels"]])
        counts = np.array(list(one["levels"].values()), float)
        axes.scatter(levels, counts[:, 0] / counts[:, 1], s=8 + 2 * counts[:, 1], color=f"C{k}", alpha=0.6)
        x = np.linspace(levels.min(), levels.max(), 200)
        axes.plot(x, fit.chance(x), color=f"C{k}", label=f"{name}: JND {fit.jnd:.3g} {unit}".rstrip())
    axes.set(xlabel=level, ylabel="share taken as larger", ylim=(-0.03, 1.03))


def draw_track(axes: Axes, shown: Mapping[str, Any], level: str, unit: str) -> None:
    """Draw the levels of an adaptive method in their order; wrong answers are crosses."""
    for k, (name, one) in enumerate(shown.items()):
        levels, right = np.array(one["track"], float).T
        trial = np.arange(1, len(levels) + 1)
        axes.plot(trial, levels, color=f"C{k}", lw=0.8, label=name)
        axes.scatter(trial[right > 0], levels[right > 0], s=8, color=f"C{k}")
        axes.scatter(trial[right == 0], levels[right == 0], s=20, color=f"C{k}", marker="x")
        if one["staircase"] is not None:
            axes.axhline(one["staircase"]["threshold"], color=f"C{k}", ls=":", lw=1.0)
    axes.set(xlabel="trial of the condition (x: wrong)", ylabel=level)


def draw_magnitudes(axes: Axes, shown: Mapping[str, Any], level: str, unit: str) -> None:
    """Draw estimated magnitudes over the levels, both logarithmic."""
    for k, (name, one) in enumerate(shown.items()):
        levels, answers = np.array(one["track"], float).T
        label = f"{name}: exponent {one['magnitudes']['exponent']:.3g}"
        axes.scatter(levels, answers, s=10, color=f"C{k}", alpha=0.6, label=label)
    axes.set(xlabel=level, ylabel="magnitude", xscale="log", yscale="log")


def draw_exploration(axes: Axes, shown: Mapping[str, Any], level: str, unit: str) -> None:
    """Draw how far and how fast the hand turned the handle at each level."""
    for k, (name, one) in enumerate(shown.items()):
        levels = [float(level) for level in one["exploration"]]
        path = [hand["path_rad"] for hand in one["exploration"].values()]
        axes.plot(levels, path, marker="o", color=f"C{k}", label=name)
    axes.set(xlabel=level, ylabel="path of the handle [rad]")
    axes.set_ylim(bottom=0)


def draw_conditions(axes: Axes, found: Mapping[str, Any], unit: str) -> None:
    """Draw each subject's JND in each condition, the geometric mean and its interval."""
    names = [name for name, one in found["conditions"].items() if one["jnd"] is not None]
    for x, name in enumerate(names):
        fits = [one[name]["fit"] for one in found["subjects"].values() if name in one]
        jnds = [fit["jnd"] for fit in fits if fit is not None]
        axes.scatter([x] * len(jnds), jnds, s=14, color="C0", alpha=0.5)
        whole = found["conditions"][name]
        axes.scatter([x + 0.15], [whole["jnd"]], s=40, color="C1", marker="D")
        if whole["jnd_95"] is not None:
            axes.plot([x + 0.15] * 2, whole["jnd_95"], color="C1")
    axes.set_xticks(range(len(names)), names)
    told = f"JND of {found['level']['quantity']} [{unit}]" if unit else "JND"
    axes.set(ylabel=told, title=f"{len(found['subjects'])} subjects; geometric mean with interval of 95 %")
    axes.set_xlim(-0.5, len(names) - 0.3)
    axes.set_ylim(bottom=0)


_OF_SUBJECTS: tuple[tuple[str, Callable[[Any], bool], Callable[[Axes, Mapping[str, Any], str, str], None]], ...] = (
    ("psychometric", lambda one: one["fit"] is not None, draw_psychometric),
    ("track", lambda one: one["fit"] is not None and one["track"] is not None, draw_track),
    ("magnitudes", lambda one: one["magnitudes"] is not None, draw_magnitudes),
    ("exploration", lambda one: bool(one["exploration"]), draw_exploration),
)
"""Name of a picture -> which conditions it shows, and how."""
