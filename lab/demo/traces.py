"""Pictures of runs: torque and velocity of recordings beside each other, like the paper's
Fig. 14.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from coulombus.recording.measures import Floats, PhaseSpan, phases, velocity
from coulombus.recording.signals import Source, series

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["HANDLE", "Traces", "draw_detail", "draw_traces", "figure_14", "traces"]

HANDLE_COLOUR, COMMAND_COLOUR, VELOCITY_COLOUR = (
    "#0072B2",
    "#D55E00",
    "#009E73",
)  # Okabe-Ito: safe for colour-blind eyes
SHADES = {"rest": "#ffffff", "hold": "#ececec", "stroke": "#f7f7f7"}
HANDLE = "brake.handle_torque_Nm"
DETAIL_FROM_S, DETAIL_S = 2.5, 0.1  # of the hold
LABELS = {
    "active": "(a) active force feedback",
    "hybrid": "(b) hybrid force feedback",
    "passive": "passive force feedback",
}


@dataclass(frozen=True)
class Traces:
    """What a panel shows; times count from the start of the schedule."""

    t_s: Floats
    velocity_rad_s: Floats
    torque_t_s: Floats
    handle_Nm: Floats
    """The hand's torque; empty where the rig does not measure it."""
    command_t_s: Floats
    command_Nm: Floats
    """The display's command: the motor's torque in mode active, the brake's set-point otherwise."""
    command_label: str
    phases: tuple[PhaseSpan, ...]

    @property
    def handle_label(self) -> str:
        """What a legend says of the hand's torque."""
        return f"hand on the handle, {'measured' if len(self.handle_Nm) else 'not measured'}"


def traces(recording: Source, mode: str) -> Traces:
    """Return the traces of `recording` from the start of its schedule to the end of it."""
    spans = phases(recording)
    start = spans[0].begin_s if spans else 0.0
    end = spans[-1].end_s if spans else np.inf
    name, label = (
        ("motor.target_torque_Nm", "motor, commanded")
        if mode == "active"
        else ("brake.setpoint_Nm", "brake, commanded")
    )
    measured = recording.has(HANDLE)
    angle, command, *handles = series(recording, "motor.position_rad", name, *((HANDLE,) if measured else ()))
    handle = handles[0] if measured else replace(command, t_s=command.t_s[:0], values=command.values[:0])
    t, v = velocity(angle.t_s, angle.values, recording.rig.bus.period_s)

    def cut(times: Floats, values: Floats) -> tuple[Floats, Floats]:
        inside = (times >= start) & (times <= end)
        return times[inside] - start, values[inside]

    moved = tuple(replace(span, begin_s=span.begin_s - start, end_s=span.end_s - start) for span in spans)
    return Traces(*cut(t, v), *cut(handle.t_s, handle.values), *cut(command.t_s, command.values), label, moved)


def draw_traces(torque: Axes, speed: Axes, data: Traces, mode: str) -> None:
    """Draw torque and velocity of one recording into two axes, phases marked."""
    torque.set_title(LABELS.get(mode, mode), loc="left", fontsize=11)
    torque.plot(data.command_t_s, data.command_Nm, lw=0.5, color=COMMAND_COLOUR, label=data.command_label, alpha=0.8)
    torque.plot(data.torque_t_s, data.handle_Nm, lw=0.8, color=HANDLE_COLOUR, label=data.handle_label)
    torque.set_ylabel("torque [Nm]")
    torque.legend(loc="lower center", bbox_to_anchor=(0.5, -0.02), fontsize=7, ncols=2, frameon=False)
    speed.plot(data.t_s, data.velocity_rad_s, lw=0.5, color=VELOCITY_COLOUR)
    speed.set_ylabel("velocity [rad/s]")
    speed.set_xlabel("time since Operation Enabled [s]")
    for axes in (torque, speed):
        for span in data.phases:
            axes.axvspan(span.begin_s, span.end_s, color=SHADES.get(span.kind, "#ffffff"), zorder=0, lw=0)
            axes.axvline(span.begin_s, color="0.6", lw=0.6, ls=":")
        axes.grid(True, lw=0.3, color="0.85")
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


def draw_detail(axes: Axes, data: Traces, begin_s: float) -> None:
    """Draw a tenth of a second of the velocity, sample by sample: a limit cycle, or nothing."""
    inside = (data.t_s >= begin_s) & (data.t_s < begin_s + DETAIL_S)
    axes.plot(data.t_s[inside], data.velocity_rad_s[inside], lw=0.8, marker=".", ms=3, color=VELOCITY_COLOUR)
    axes.set_title("0.1 s of the hold, sample by sample", loc="left", fontsize=9)
    axes.set_ylabel("velocity [rad/s]")
    axes.set_xlabel("time since Operation Enabled [s]")
    axes.grid(True, lw=0.3, color="0.85")
    axes.margins(x=0)


def figure_14(recordings: Mapping[str, Source], path: Path) -> None:
    """Save torque and velocity of each recording, one column a mode, as a picture (the ending names
    the format).
    """
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(3, len(recordings), figsize=(5.6 * len(recordings), 8.2), sharey="row", squeeze=False)
    for column, (mode, recording) in enumerate(recordings.items()):
        data = traces(recording, mode)
        draw_traces(axes[0, column], axes[1, column], data, mode)
        hold = next((span for span in data.phases if span.kind == "hold"), None)
        draw_detail(axes[2, column], data, DETAIL_FROM_S + (hold.begin_s if hold is not None else 0.0))
    low, high = axes[0, 0].get_ylim()
    axes[0, 0].set_ylim(low - 0.18 * (high - low), high + 0.1 * (high - low))  # room for legend and phases
    figure.suptitle(
        f"Friction display on the rig '{next(iter(recordings.values())).rig.name}', from the recorded PDOs",
        fontsize=12,
    )
    figure.tight_layout()
    metadata: dict[str, Any] = {"Date": None} if path.suffix == ".svg" else {"Software": None}
    figure.savefig(path, dpi=130, metadata=metadata)
    plt.close(figure)
