"""Plot of a plan: the worst cycle frame by frame, and the delay of the last RPDO by kind of traffic."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from coulombus.rigs.plan.rig_plan import RigPlan

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw_cycle", "draw_interference", "write_gantt"]

COLOURS = {
    "sync": "#000000",
    "tpdo": "#0072B2",
    "rpdo": "#D55E00",
    "other": "#999999",
    "gap": "#F0E442",
    "error": "#CC79A7",
}  # Okabe-Ito: safe for colour-blind eyes
WINDOW_SHADE = "#E6F0F7"
SLACK = "#009E73"
LATE = "#B00020"
LEGEND = {
    "sync": "SYNC",
    "tpdo": "TPDO",
    "rpdo": "RPDO",
    "other": "heartbeat, SDO",
    "gap": "computing",
    "error": "errors",
}
INTERFERENCE = {
    "cycle": ("SYNC and PDOs alone", "#F3C7A6"),
    "heartbeats": ("with heartbeats", "#E69A5C"),
    "sdo": ("with SDO: ordinary operation", "#D55E00"),
    "emcy_nmt": ("with EMCY of all nodes and NMT", "#BBBBBB"),
}
SETTINGS: Any = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "figure.dpi": 100,
    "savefig.dpi": 140,
}
LABELS_INSIDE_SHARE = 0.045
"""Least share of the axis at which a bar has room for its duration."""
LINES = 3
"""Rows below the bars for the line labels."""


def _end_us(plan: RigPlan) -> float:
    return max(plan.timing.period_ns, *plan.interference_ns.values()) * 1.07e-3


def _on_white(pad: float = 0.12) -> dict[str, Any]:
    """Return a background that keeps a text readable across a line."""
    return {"boxstyle": f"round,pad={pad}", "facecolor": "white", "edgecolor": "none"}


def draw_cycle(axes: Axes, plan: RigPlan) -> None:
    """Draw the worst cycle of ordinary operation: one row per frame, in sending order from the top."""
    from matplotlib.patches import Patch

    bars = plan.cycle.bars
    ids = {message.name: f"{message.can_id:03X}h" for message in plan.messages}
    window, period, latest = plan.timing.window_ns / 1e3, plan.timing.period_ns / 1e3, plan.latest_rpdo_ns / 1e3
    end, rows = _end_us(plan), len(bars)
    axes.axvspan(0, window, color=WINDOW_SHADE, lw=0, zorder=0)
    axes.axhline(-1, color="0.75", lw=0.6)
    for row, bar in enumerate(bars):
        begin, width = bar.begin_ns / 1e3, (bar.end_ns - bar.begin_ns) / 1e3
        colour = COLOURS[bar.kind]
        axes.barh(row, width, left=begin, height=0.62, color=colour, zorder=3)
        axes.barh(-1, width, left=begin, height=0.62, color=colour, edgecolor="white", lw=0.5, zorder=3)
        inside = width >= LABELS_INSIDE_SHARE * end
        axes.text(
            begin + width / 2 if inside else begin - 0.006 * end,
            row,
            f"{width:.0f}",
            ha="center" if inside else "right",
            va="center_baseline",
            fontsize=7.5,
            color="white" if inside and bar.kind in ("sync", "tpdo", "rpdo") else "black",
            zorder=4,
        )
    if latest < period:
        slack: Any = {"color": "#E4F1EA", "edgecolor": SLACK, "lw": 0.5, "hatch": "///"}
        axes.barh(-1, period - latest, left=latest, height=0.62, zorder=2, **slack)
        middle, text = (latest + period) / 2, f"slack {period - latest:.0f}"
        if period - latest > 0.1 * end:
            axes.text(middle, -1, text, ha="center", va="center", fontsize=8, zorder=4, bbox=_on_white())
        else:
            axes.annotate(
                text, (middle, -0.69), (middle, 0.35), ha="center", va="center", fontsize=8, zorder=4, color=SLACK
            )
    lines = (
        (window, f"TPDO window ends, {window:g}", COLOURS["tpdo"]),
        (latest, f"latest RPDO through, {latest:.0f}", COLOURS["rpdo"]),
        (period, f"next SYNC, {period:g}", "black"),
    )
    for number, (x, text, colour) in enumerate(lines):
        axes.axvline(x, color=colour, lw=1.1, ls="--", zorder=2)
        side = "right" if x > 0.5 * end else "left"
        shift = end * (0.008 if side == "left" else -0.008)
        place = rows - 0.2 + 0.8 * number
        axes.text(x + shift, place, text, ha=side, va="center", color=colour, fontsize=8, zorder=4, bbox=_on_white())
    axes.set_yticks(range(-1, rows), ["the bus", *(f"{b.name} {ids.get(b.name, '')}".strip() for b in bars)])
    late = {response.message.name for response in plan.responses if not response.fits}
    for tick, bar in zip(axes.get_yticklabels()[1:], bars, strict=True):
        if bar.kind in ("sync", "tpdo", "rpdo") and bar.name in late:
            tick.set_color(LATE)
    axes.tick_params(axis="y", length=0)
    axes.set_ylim(rows - 0.2 + 0.8 * LINES, -1.6)
    axes.set_xlim(0, end)
    axes.grid(axis="x", color="0.9", lw=0.5)
    kinds = {bar.kind for bar in bars}
    patches = [Patch(color=COLOURS[kind], label=text) for kind, text in LEGEND.items() if kind in kinds]
    axes.legend(handles=patches, loc="lower left", fontsize=8, framealpha=1.0, edgecolor="0.85", handlelength=1.2)
    slack_us = period - latest
    margin = f"{slack_us:.0f} us to spare before" if slack_us >= 0 else f"{-slack_us:.0f} us beyond"
    axes.set_title(
        f"Worst cycle at {plan.timing.bitrate_bit_s / 1e3:g} kbit/s: {margin} the next SYNC"
        + ("" if plan.fits else " (late: red)"),
        loc="left",
        fontsize=10.5,
    )


def draw_interference(axes: Axes, plan: RigPlan) -> None:
    """Draw the completion of the last RPDO under increasing shares of the bus traffic."""
    waits_ns = plan.interference_ns
    period, end = plan.timing.period_ns / 1e3, _end_us(plan)
    for row, (key, (_, colour)) in enumerate(INTERFERENCE.items()):
        value = waits_ns[key] / 1e3
        axes.barh(row, value, height=0.55, color=colour, zorder=3)
        axes.text(value - 0.008 * end, row, f"{value:.0f}", ha="right", va="center_baseline", fontsize=8, zorder=4)
    axes.axvline(period, color="black", lw=1.1, ls="--", zorder=3.5)
    axes.set_yticks(range(len(INTERFERENCE)), [text for text, _ in INTERFERENCE.values()])
    axes.tick_params(axis="y", length=0)
    axes.set_ylim(len(INTERFERENCE) - 0.4, -0.6)
    axes.set_xlim(0, end)
    axes.grid(axis="x", color="0.9", lw=0.5)
    axes.set_title("Latest RPDO, with more and more traffic", loc="left", fontsize=10)
    axes.set_xlabel("us after SYNC is released")


def write_gantt(path: Path, plan: RigPlan) -> None:
    """Write the plot to `path` (.png, .svg, .pdf)."""
    import matplotlib
    from matplotlib.figure import Figure

    with matplotlib.rc_context(SETTINGS):
        rows = len(plan.cycle.bars) + LINES
        figure = Figure(figsize=(8.4, 0.27 * rows + 2.5), layout="constrained")
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[rows, 5.5])
        draw_cycle(upper, plan)
        draw_interference(lower, plan)
        metadata = {"Software": None} if path.suffix.lower() == ".png" else None
        figure.savefig(path, metadata=metadata)
