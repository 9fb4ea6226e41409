"""The page's plots, made with Bokeh: empty figures whose sources the page fills.

Bokeh draws them in the browser. Its server is not used: by its protocol a browser changes the
server's document, and what a page does not take would pile up.
"""

from __future__ import annotations

from typing import Any, Literal

from bokeh.embed import json_item
from bokeh.models import ColumnDataSource, CrosshairTool, Range1d
from bokeh.plotting import figure

__all__ = ["COLOURS", "THEMES", "legends", "plots"]

Theme = Literal["light", "dark"]
THEMES: dict[str, dict[str, str]] = {
    "light": {"text": "#1b1f24", "grid": "#d5dae0", "ground": "#ffffff", "law": "#57606a"},
    "dark": {"text": "#e6edf3", "grid": "#30363d", "ground": "#161b22", "law": "#9ba5b0"},
}
COLOURS: dict[str, tuple[str, ...]] = {
    "light": ("#0060b0", "#b34700", "#187a2f", "#8a3ffc"),
    "dark": ("#5cb3ff", "#ffa657", "#56d364", "#d2a8ff"),
}
"""One colour for each signal of a plot, each with a contrast of at least 4.5 to the ground."""
SPAN_S, RAW_S = 10.0, 0.2


def plots(layout: list[dict[str, Any]], theme: Theme) -> dict[str, Any]:
    """Return the plots as Bokeh's JSON, by the identifier of the element that takes each.

    Sources are called "envelope:NAME", "raw:NAME", "friction" and "law".
    """
    found: dict[str, Any] = {}
    for row in layout:
        short, last = row["title"], row is layout[-1]
        found[f"{short}-envelope"] = json_item(_envelopes(row, theme, last), f"{short}-envelope")
        found[f"{short}-raw"] = json_item(_raw(row, theme, last), f"{short}-raw")
    found["friction-plot"] = json_item(_friction(theme), "friction-plot")
    return found


def legends(layout: list[dict[str, Any]], theme: Theme) -> dict[str, list[tuple[str, str]]]:
    """Return the plots' legends: name and colour of each line, by the identifier of the element."""
    found = {
        f"{row['title']}-envelope": [
            (_short(name, row["unit"]), colour) for name, colour in zip(row["signals"], COLOURS[theme], strict=False)
        ]
        for row in layout
    }
    return found | {"friction-plot": [("measured", COLOURS[theme][0]), ("law", THEMES[theme]["law"])]}


def _figure(theme: Theme, title: str, **options: Any) -> Any:
    """Return an empty figure in the page's colours."""
    colours = THEMES[theme]
    p = figure(
        sizing_mode="stretch_both",
        tools="xwheel_zoom,ywheel_zoom,box_zoom,pan,reset",
        toolbar_location=None,
        title=title,
        background_fill_color=colours["ground"],
        border_fill_color=colours["ground"],
        outline_line_color=colours["grid"],
        min_border=4,
        min_border_right=14,
        output_backend="canvas",
        **options,
    )
    p.title.text_color = colours["text"]
    p.title.text_font_size = "12px"
    for axis in p.axis:
        axis.axis_label_text_color = axis.major_label_text_color = colours["text"]
        axis.axis_line_color = axis.major_tick_line_color = colours["grid"]
        axis.minor_tick_line_color = None
        axis.major_label_text_font_size = axis.axis_label_text_font_size = "11px"
        axis.axis_label_text_font_style = "normal"
        axis.axis_label_standoff = 2
        axis.ticker.desired_num_ticks = 4
    p.grid.grid_line_color = colours["grid"]
    return p


def _envelopes(row: dict[str, Any], theme: Theme, last: bool) -> Any:
    p = _figure(theme, f"{row['title']} [{row['unit']}], 10 s", x_range=Range1d(-SPAN_S, 0))
    for name, colour in zip(row["signals"], COLOURS[theme], strict=False):
        source = ColumnDataSource({"t": [], "y": []}, name=f"envelope:{name}")
        p.line(x="t", y="y", source=source, color=colour, line_width=1.2)  # up and down within each bin
    p.add_tools(CrosshairTool(dimensions="height", line_color=THEMES[theme]["law"]))
    if last:
        p.xaxis.axis_label = "time before now [s]"
    return p


def _raw(row: dict[str, Any], theme: Theme, last: bool) -> Any:
    p = _figure(theme, "each sample, 0.2 s", x_range=Range1d(-RAW_S, 0))
    p.xaxis.ticker.desired_num_ticks = 2
    for name, colour in zip(row["signals"], COLOURS[theme], strict=False):
        source = ColumnDataSource({"t": [], "y": []}, name=f"raw:{name}")
        p.step(x="t", y="y", source=source, color=colour, line_width=1.2, mode="after")
    if last:
        p.xaxis.axis_label = "time [s]"
    return p


def _friction(theme: Theme) -> Any:
    p = _figure(theme, "friction against velocity, 2 s", x_range=Range1d(-1, 1), y_range=Range1d(-1, 1))
    p.xaxis.axis_label, p.yaxis.axis_label = "velocity [rad/s]", "handle torque [Nm]"
    law = ColumnDataSource({"v": [], "f": []}, name="law")
    p.line(x="v", y="f", source=law, color=THEMES[theme]["law"], line_width=2, line_dash="dashed")
    source = ColumnDataSource({"v": [], "f": [], "alpha": []}, name="friction")
    p.scatter(x="v", y="f", source=source, color=COLOURS[theme][0], alpha="alpha", size=5, line_color=None)
    return p


def _short(name: str, unit: str) -> str:
    return name.rpartition(".")[2].removesuffix("_" + unit.replace("/", "_")).replace("_", " ")
