"""Common style of all figures: Okabe-Ito colours, dashes for greyscale, deterministic PNG and SVG."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = [
    "BLACK",
    "BLUE",
    "COLOURS",
    "DASHES",
    "GREEN",
    "GREY",
    "ORANGE",
    "PINK",
    "QUANTITIES",
    "SKY",
    "VERMILION",
    "WORDS",
    "figure",
    "label",
    "save",
    "shade",
]

BLUE, VERMILION, GREEN, ORANGE, SKY, PINK, BLACK = (
    "#0072B2",
    "#D55E00",
    "#009E73",
    "#E69F00",
    "#56B4E9",
    "#CC79A7",
    "#000000",
)
GREY = "#808080"
COLOURS = (BLUE, VERMILION, GREEN, ORANGE, SKY, PINK)
DASHES = ("-", "--", ":", "-.", (0, (5, 1, 1, 1, 1, 1)), (0, (1, 3)))
"""Dashes: each curve has its own, in addition to its colour."""

QUANTITIES = MappingProxyType(
    {
        "target_torque_Nm": VERMILION,
        "torque_Nm": PINK,
        "handle_torque_Nm": BLUE,
        "setpoint_Nm": ORANGE,
        "position_rad": BLACK,
        "velocity_rad_s": GREEN,
        "coil_current_A": SKY,
        "coil_temperature_degC": GREY,
    }
)
"""Colour of each quantity in every figure, by the end of the signal's name."""

WORDS = MappingProxyType(
    {"Nm": "torque", "rad": "angle", "rad/s": "velocity", "A": "current", "degC": "temperature", "V": "voltage"}
)
"""Quantity of each unit."""

SETTINGS: Any = {
    "font.size": 9,
    "axes.titlesize": 10,
    "axes.titlelocation": "left",
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "0.88",
    "grid.linewidth": 0.4,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "lines.linewidth": 1.2,
    "legend.frameon": False,
    "legend.fontsize": 8,
    "svg.hashsalt": "coulombus",
    "svg.fonttype": "path",
    "figure.dpi": 100,
    "savefig.dpi": 140,
}


def shade(colour: str, place: int) -> str:
    """Return a colour (#RRGGBB) for the curve in place 0, 1, 2 ... of one quantity: itself, darker,
    lighter, and so on; black has greys, the lighter the later.
    """
    parts = [int(colour[k : k + 2], 16) for k in (1, 3, 5)]
    step = place % 3
    if max(parts) == 0:
        parts = [100 * step] * 3
    elif step:
        parts = [round(0.55 * part + 0.45 * (0 if step == 1 else 255)) for part in parts]
    return "#" + "".join(f"{part:02X}" for part in parts)


@contextmanager
def figure(
    width: float, height: float, rows: int = 1, columns: int = 1, **options: Any
) -> Iterator[tuple[Figure, Any]]:
    """Yield a figure in the common style and its axes (an array if there are several).

    No window, no global state left behind.
    """
    import matplotlib
    from matplotlib.figure import Figure

    with matplotlib.rc_context(SETTINGS):
        picture = Figure(figsize=(width, height), layout="constrained")
        yield picture, picture.subplots(rows, columns, **options)


def save(picture: Figure, directory: str | os.PathLike[str], name: str) -> tuple[Path, Path]:
    """Write `name`.png and `name`.svg, the same bytes for the same figure.

    Call it within `figure`.
    """
    directory = Path(directory)
    directory.mkdir(parents=True, exist_ok=True)
    png, svg = directory / f"{name}.png", directory / f"{name}.svg"
    picture.savefig(png, metadata={"Software": None})
    picture.savefig(svg, metadata={"Date": None, "Creator": None})
    return png, svg


def label(axes: Axes, x: str, y: str, title: str = "") -> None:
    """Label both axes, with their units."""
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    if title:
        axes.set_title(title)
