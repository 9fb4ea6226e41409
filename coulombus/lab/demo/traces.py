"""Plots of runs: torque and velocity of recordings side by side, like the paper's Fig. 14."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from coulombus.recording.measures import Floats, PhaseSpan, phases, velocity
from coulombus.recording.pictures.style import BLUE, GREEN, GREY, ORANGE, VERMILION, figure
from coulombus.recording.signals import Source, series

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

__all__ = ["HANDLE", "DemoTraces", "draw_detail", "draw_traces", "figure_14", "share_labels", "traces"]

SHADES = {"rest": "#ffffff", "hold": "#ececec", "stroke": "#f7f7f7"}
HANDLE = "brake.handle_torque_Nm"
COMMANDS = {"motor": ("motor.target_torque_Nm", VERMILION), "brake": ("brake.setpoint_Nm", ORANGE)}
"""Signal and colour of each quantity; the colour is the same in every panel."""
DETAIL_FROM_S, DETAIL_S = 2.5, 0.1  # of the hold
BINS = 400
WIDTH, MARGIN, HEIGHT = 3.1, 0.6, 7.4


@dataclass(frozen=True)
class DemoTraces:
    """Curves of a panel; times count from the start of the schedule."""

    title: str
    t_s: Floats
    velocity_rad_s: Floats
    torque_t_s: Floats
    handle_Nm: Floats
    """The hand's torque; empty if the rig does not measure it."""
    commands: Mapping[str, tuple[Floats, Floats]]
    """Times and values of the host's commands by device, without those that stayed 0."""
    phases: tuple[PhaseSpan, ...]

    @property
    def handle_label(self) -> str:
        """Label of the hand's torque in a legend."""
        return f"hand, {'measured' if len(self.handle_Nm) else 'not measured'}"


def traces(recording: Source, mode: str) -> DemoTraces:
    """Return the traces of `recording`, made in `mode`, over its schedule."""
    spans = phases(recording)
    start = spans[0].begin_s if spans else 0.0
    end = spans[-1].end_s if spans else np.inf
    names = {device: name for device, (name, _) in COMMANDS.items() if recording.has(name)}
    measured = recording.has(HANDLE)
    angle, *others = series(recording, "motor.position_rad", *names.values(), *((HANDLE,) if measured else ()))
    handle = others.pop() if measured else replace(angle, t_s=angle.t_s[:0], values=angle.values[:0])
    t, v = velocity(angle.t_s, angle.values, recording.rig.bus.period_s)

    def cut(times: Floats, values: Floats) -> tuple[Floats, Floats]:
        inside = (times >= start) & (times <= end)
        return times[inside] - start, values[inside]

    moved = tuple(replace(span, begin_s=span.begin_s - start, end_s=span.end_s - start) for span in spans)
    commands = {device: cut(signal.t_s, signal.values) for device, signal in zip(names, others, strict=True)}
    shown = {device: command for device, command in commands.items() if command[1].any()}
    return DemoTraces(_title(recording, mode), *cut(t, v), *cut(handle.t_s, handle.values), shown, moved)


def _title(recording: Source, mode: str) -> str:
    """Return the displayed friction as a title."""
    settings = recording.rig.one_axis().mode[mode]
    return f"F_s = {settings.F_s_Nm:g} Nm, F_d = {settings.F_d_Nm:g} Nm,\nK_p = {settings.K_p_Nm_rad:,.6g} Nm/rad"


def _draw_envelope(axes: Axes, t_s: Floats, values: Floats, colour: str, label: str | None = None) -> None:
    """Draw the mean in each of `BINS` bins, and the band from minimum to maximum: a limit cycle."""
    if not len(t_s):
        axes.plot([], [], color=colour, label=label)
        return
    first = np.searchsorted(t_s, np.linspace(t_s[0], t_s[-1], BINS + 1)[:-1])
    first = np.unique(first)
    low, high = np.minimum.reduceat(values, first), np.maximum.reduceat(values, first)
    mean = np.add.reduceat(values, first) / np.diff(np.append(first, len(values)))
    axes.fill_between(t_s[first], low, high, color=colour, alpha=0.3, lw=0)
    axes.plot(t_s[first], mean, color=colour, lw=1.0, label=label)


def draw_traces(torque: Axes, speed: Axes, data: DemoTraces, title: str) -> None:
    """Draw torque and velocity of one recording into two axes, phases marked."""
    torque.set_title(f"{title}\n{data.title}")
    for device, (t_s, values) in data.commands.items():
        _draw_envelope(torque, t_s, values, COMMANDS[device][1], f"{device}, commanded")
    _draw_envelope(torque, data.torque_t_s, data.handle_Nm, BLUE, data.handle_label)
    torque.set_ylabel("torque [Nm]")
    _draw_envelope(speed, data.t_s, data.velocity_rad_s, GREEN)
    speed.set_ylabel("velocity [rad/s]")
    speed.set_xlabel("time since Operation Enabled [s]")
    for axes in (torque, speed):
        for span in data.phases:
            axes.axvspan(span.begin_s, span.end_s, color=SHADES.get(span.kind, "#ffffff"), zorder=0, lw=0)
            axes.axvline(span.begin_s, color="0.6", lw=0.6, ls=":")
        axes.margins(x=0)
    for span in data.phases:
        torque.annotate(
            span.kind,
            (0.5 * (span.begin_s + span.end_s), 1.0),
            xycoords=("data", "axes fraction"),
            xytext=(0, -3),
            textcoords="offset points",
            ha="center",
            va="top",
            fontsize=8,
            color="0.25",
        )


def draw_detail(axes: Axes, data: DemoTraces) -> None:
    """Draw a tenth of a second of the velocity in the hold, sample by sample: a limit cycle, or rest."""
    begin_s = DETAIL_FROM_S + next((span.begin_s for span in data.phases if span.kind == "hold"), 0.0)
    inside = (data.t_s >= begin_s) & (data.t_s < begin_s + DETAIL_S)
    axes.plot(data.t_s[inside], data.velocity_rad_s[inside], lw=0.8, marker=".", ms=3, color=GREEN)
    axes.set_title("0.1 s of the hold")
    axes.set_ylabel("velocity [rad/s]")
    axes.set_xlabel("time since Operation Enabled [s]")
    axes.margins(x=0)


def share_labels(fig: Figure, axes: Any) -> None:
    """Share the labels of the quantities between columns, with one legend below them."""
    for panel in axes[:, 1:].flat:
        panel.set_ylabel("")
    low, high = axes[0, 0].get_ylim()
    axes[0, 0].set_ylim(low, high + 0.1 * (high - low))  # space for the phases' names
    artists: dict[str, Any] = {
        label: artist for panel in axes[0] for artist, label in zip(*panel.get_legend_handles_labels(), strict=True)
    }
    from matplotlib.patches import Patch

    artists["band: smallest to largest; line: mean"] = Patch(color=GREY, alpha=0.3, lw=0)
    columns = len(artists) if axes.shape[1] > 2 else 2
    fig.legend(artists.values(), artists.keys(), loc="outside lower center", ncols=columns)


def figure_14(recordings: Mapping[str, tuple[str, Source]], path: Path) -> None:
    """Save torque and velocity of recordings, a column each, as an image (format by suffix).

    Parameters
    ----------
    recordings : mode and recording by column title
    """
    count = len(recordings)
    with figure(MARGIN + WIDTH * count, HEIGHT, 3, count, sharey="row", squeeze=False) as (fig, axes):
        for column, (name, (mode, recording)) in enumerate(recordings.items()):
            data = traces(recording, mode)
            draw_traces(axes[0, column], axes[1, column], data, name)
            draw_detail(axes[2, column], data)
        share_labels(fig, axes)
        rig = next(iter(recordings.values()))[1].rig.name
        fig.suptitle(f"Friction display on the rig '{rig}', from the recorded PDOs", fontsize=12)
        metadata: dict[str, Any] = {"Date": None} if path.suffix == ".svg" else {"Software": None}
        fig.savefig(path, dpi=130, metadata=metadata)
