"""The map of a sweep: the region of its first two varied keys in which a condition holds.

With more than two keys, the others are projected on the plane, so points of both kinds may be
neighbours. Non-numeric values are placed side by side in their order.
"""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from coulombus.lab.sweep.ranges import Vary
from coulombus.lab.sweep.rates import Rate
from coulombus.recording.pictures.style import BLUE, GREY, VERMILION, figure

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["MapPoint", "draw_figure", "draw_map", "map_of"]

LOGARITHMIC = 30.0
"""Least ratio of largest to smallest chosen number for a logarithmic axis."""


@dataclass(frozen=True)
class MapPoint:
    """A run on the map: `holds` and `figure` are None if it has no figure."""

    values: tuple[Any, ...]
    holds: bool | None
    figure: float | None = None


def draw_map(axes: Axes, vary: Sequence[Vary], points: Sequence[MapPoint], title: str) -> None:
    """Draw the points into `axes`."""
    places = [_places(vary[k], [point.values[k] for point in points]) for k in range(min(2, len(vary)))]
    if len(places) < 2:
        places.append([1.0 if point.holds else 0.0 for point in points])
        axes.set_yticks([0.0, 1.0], ["does not hold", "holds"])
        axes.set_ylim(-0.5, 1.5)
    for holds, colour, marker, name in (
        (True, BLUE, "o", "holds"),
        (False, VERMILION, "X", "does not hold"),
        (None, GREY, "+", "failed"),
    ):
        alike = [k for k, point in enumerate(points) if point.holds is holds]
        if alike:
            x, y = ([row[k] for k in alike] for row in places)
            size = 30 if marker == "+" else 18
            axes.scatter(x, y, s=size, c=colour, marker=marker, label=f"{name} ({len(alike)})", linewidths=0.6)
    for k, variation in enumerate(vary[:2]):
        _scale(axes, "xy"[k], variation, [point.values[k] for point in points])
    axes.set_title(title)
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))


def _places(variation: Vary, values: Sequence[Any]) -> list[float]:
    if variation.numeric:
        return [float(value) for value in values]
    return [float(variation.values.index(value)) for value in values]


def _scale(axes: Axes, which: str, variation: Vary, values: Sequence[Any]) -> None:
    getattr(axes, f"set_{which}label")(variation.key)
    if not variation.numeric:
        getattr(axes, f"set_{which}ticks")(range(len(variation.values)), [str(value) for value in variation.values])
    elif variation.logarithmic or (min(values) > 0 and max(values) / min(values) > LOGARITHMIC):
        getattr(axes, f"set_{which}scale")("log")


def draw_figure(axes: Axes, vary: Sequence[Vary], points: Sequence[MapPoint], name: str) -> None:
    """Draw the figure `name` of the points into `axes`, as colours; for a single key as heights."""
    measured = [point for point in points if point.figure is not None]
    figures = [float(point.figure or 0.0) for point in measured]
    places = [_places(vary[k], [point.values[k] for point in measured]) for k in range(min(2, len(vary)))]
    if len(places) < 2:
        axes.scatter(places[0], figures, s=18, c=BLUE)
        axes.set_ylabel(name)
    else:
        shown = axes.scatter(places[0], places[1], s=18, c=figures, cmap="viridis")
        axes.figure.colorbar(shown, ax=axes, label=name)
    for k, variation in enumerate(vary[:2]):
        _scale(axes, "xy"[k], variation, [point.values[k] for point in points])
    axes.set_title(f"{name} of {len(measured)} runs; {len(points) - len(measured)} have none")


def map_of(vary: Sequence[Vary], points: Sequence[MapPoint], shown: Rate | str) -> bytes:
    """Return the map of a rate, or of a figure by its name, as a PNG: the same bytes for the same
    points.
    """
    with figure(7.0, 4.2) as (fig, axes):
        if isinstance(shown, str):
            draw_figure(axes, vary, points, shown)
        else:
            draw_map(axes, vary, points, shown.text)
        content = io.BytesIO()
        fig.savefig(content, format="png", metadata={"Software": None})
    return content.getvalue()
