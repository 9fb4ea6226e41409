"""Figures of runs through PDOs: Figs. 12 to 14, the limit cycle on the bus, and the maps."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from coulombus.analysis.rig.chatter import Chatter
from coulombus.analysis.rig.friction_study import FrictionStudy
from coulombus.analysis.rig.hold import HoldStudy
from coulombus.analysis.rig.maps import OscillationMap, at
from coulombus.analysis.rig.through_bus import BusCycle
from coulombus.analysis.rig.wall_plane import WallPlane
from coulombus.analysis.theory.karnopp import KarnoppStudy, karnopp_study
from coulombus.lab.demo.traces import draw_detail, draw_traces, share_labels
from coulombus.recording.friction.identify import Identification
from coulombus.recording.pictures.style import BLACK, BLUE, COLOURS, DASHES, GREY, VERMILION, figure, label, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = [
    "draw_bus_cycle",
    "draw_identification",
    "draw_map",
    "write_bus_figure",
    "write_chatter",
    "write_fig12",
    "write_fig13",
    "write_fig14",
    "write_identification",
    "write_map",
    "write_stick_figure",
    "write_wall_plane",
]

SCATTER = 4000
RESIDUAL_BINS, FEWEST = 24, 20
MOST_ANGLE_RAD = 0.040
"""Largest angle in the plot of a stuck handle: beyond it the handle slides."""


def write_fig12(directory: Path, data: KarnoppStudy | None = None) -> list[Path]:
    """Fig. 12: Karnopp's model, in slip and in stick, and both readings of eq. (20) on a handle at
    rest.
    """
    data = karnopp_study() if data is None else data
    with figure(10.5, 3.2, 1, 3) as (fig, axes):
        slip, stick, rest = axes
        slip.axvspan(-data.band_rad_s, data.band_rad_s, color="0.87", lw=0)
        slip.plot(data.v_rad_s, data.slip_Nm, color=BLUE)
        slip.vlines(0, -data.F_s_Nm, data.F_s_Nm, color=VERMILION, ls="--")
        slip.annotate(r"$|v|\leq\Delta v$: stick", (0, -1.55), ha="center", fontsize=8)
        slip.annotate(r"$F_d$", (0.6, data.F_d_Nm - 0.2), fontsize=9)
        slip.annotate(r"$F_s$", (0.02, data.F_s_Nm + 0.05), ha="center", fontsize=9)
        slip.set_ylim(-1.8, 1.8)
        label(slip, "velocity [rad/s]", "friction [Nm]", "(a) slip, and the band of stick")
        stick.plot(data.load_Nm, data.corrected_Nm, color=BLUE, label="saturation (as it must be)")
        stick.plot(data.load_Nm, data.printed_Nm, color=VERMILION, ls="--", label=r"$\max(F_s, F_a)$ (as printed)")
        stick.legend(loc="upper left")
        label(stick, "load $F_a$ [Nm]", "friction [Nm]", "(b) stick")
        rest.plot(data.t_s, data.corrected_rad * 1e3, color=BLUE, label="saturation: stays")
        rest.plot(
            data.t_s, data.printed_rad * 1e3, color=VERMILION, ls="--", label="as printed: kicked again and again"
        )
        rest.legend(loc="best")
        label(rest, "time [s]", "angle [mrad]", "(c) a handle at rest, without a hand")
        return [*save(fig, directory, "fig12-karnopp")]


def draw_identification(axes: Axes, identification: Identification, title: str) -> None:
    """Draw the samples (without inertia and bias), the fit, and the fitted Coulomb friction with its interval."""
    every = max(1, len(identification.v_rad_s) // SCATTER)
    v, felt, fit = identification.v_rad_s[::every], identification.felt_Nm[::every], identification.felt
    shown = f"{len(v)} of {len(identification.v_rad_s)} samples that slide"
    axes.plot(v, felt, ".", ms=2, color=GREY, alpha=0.5, rasterized=True, zorder=3, label=shown)
    span = float(np.max(np.abs(v)))
    slow = float(np.min(np.abs(v)))
    for side in (-1, 1):
        line = side * np.linspace(slow, span, 200)
        axes.plot(line, fit.friction_Nm(line), color=VERMILION, lw=1.6, label="fit" if side > 0 else None)
    lines = [f"Coulomb {fit.coulomb_Nm} Nm"]
    if fit.viscous_Nms_rad is not None:
        lines.append(f"viscous {fit.viscous_Nms_rad} Nms/rad")
    if fit.stribeck_Nm is not None:
        lines.append(f"Stribeck {fit.stribeck_Nm} Nm at {fit.stribeck_rad_s:.3g} rad/s")
    axes.text(0.02, 0.98, "\n".join(lines), transform=axes.transAxes, va="top", fontsize=8)
    axes.legend(loc="lower right", markerscale=4, handlelength=1.2)
    label(axes, "velocity [rad/s]", "friction felt [Nm]", title)


def draw_residuals(axes: Axes, identification: Identification) -> None:
    """Draw the residuals of the fit, and their mean in each of `RESIDUAL_BINS` speeds: a curve
    means friction of another form.
    """
    v, left = identification.v_rad_s, identification.felt_Nm - identification.felt.friction_Nm(identification.v_rad_s)
    every = max(1, len(v) // SCATTER)
    axes.plot(v[::every], left[::every], ".", ms=2, color=GREY, alpha=0.5, rasterized=True)
    edges = np.linspace(v.min(), v.max(), RESIDUAL_BINS + 1)
    bins = np.clip(np.searchsorted(edges, v, "right") - 1, 0, RESIDUAL_BINS - 1)
    count, total = (np.bincount(bins, weights, RESIDUAL_BINS) for weights in (None, left))
    filled = count >= FEWEST
    centres = 0.5 * (edges[:-1] + edges[1:])
    axes.plot(centres[filled], total[filled] / count[filled], "o", ms=4, color=BLUE, label="mean at a speed")
    axes.axhline(0.0, color=VERMILION, lw=1.0)
    axes.legend(loc="lower right")
    label(axes, "velocity [rad/s]", "residual [Nm]")


def write_identification(path: str | os.PathLike[str], identification: Identification) -> Path:
    """Write the plot of one identification, with its residuals; format by suffix."""
    path = Path(path)
    with figure(6.4, 6.0, 2, 1, sharex=True, height_ratios=(2, 1)) as (fig, (axes, below)):
        draw_identification(axes, identification, f"Friction identified: {Path(identification.path).name}")
        axes.set_xlabel("")
        low, high = axes.get_ylim()
        axes.set_ylim(low, high + 0.25 * (high - low))
        draw_residuals(below, identification)
        fig.savefig(path, metadata={"Date": None} if path.suffix == ".svg" else None)
    return path


def write_fig13(directory: Path, data: FrictionStudy) -> list[Path]:
    """Fig. 13: friction before and after its compensation, and the residuals."""
    with figure(9.5, 5.6, 2, 2, sharex="col", sharey="row", height_ratios=(2, 1)) as (fig, axes):
        whole = f"(b) compensated with {data.compensation_Nm:.4f} Nm"
        for column, identification, title in ((0, data.before, "(a) uncompensated"), (1, data.after, whole)):
            draw_identification(axes[0, column], identification, title)
            draw_residuals(axes[1, column], identification)
            axes[0, column].set_xlabel("")
        low, high = axes[0, 0].get_ylim()
        axes[0, 0].set_ylim(low, high + 0.2 * (high - low))
        for place in axes[:, 1]:
            place.set_ylabel("")
        return [*save(fig, directory, "fig13-friction-compensation")]


def write_fig14(directory: Path, data: HoldStudy) -> list[Path]:
    """Fig. 14: hold and stroke, active and hybrid."""
    with figure(11, 7.6, 3, 2, sharey="row") as (fig, axes):
        for column, (mode, name) in enumerate((("active", "(a) active"), ("hybrid", "(b) hybrid"))):
            traces = data.traces[mode]
            draw_traces(axes[0, column], axes[1, column], traces, name)
            draw_detail(axes[2, column], traces)
        share_labels(fig, axes)
        return [*save(fig, directory, "fig14-hold-and-stroke")]


def write_stick_figure(directory: Path, data: HoldStudy) -> list[Path]:
    """Hybrid's stick phase in each variant: angle and set-point of a stuck handle under a fast push."""
    rows = [row for row in data.rows if row.fast is not None]
    with figure(9.5, 5.4, 2, 2, sharex="col", height_ratios=(3, 2)) as (fig, axes):
        for column, (name, text) in enumerate((("slow", "pushed within 1 s"), ("fast", "pushed within 50 ms"))):
            angle, torque = axes[:, column]
            for i, row in enumerate(rows):
                ramp: Any = getattr(row, name)
                share = ramp.verdict(".0%", " of $F_s$")
                ways = f"{row.stick_entry}, {row.brake_stick}: slides at {share}"
                shown = np.where(ramp.angle_rad <= MOST_ANGLE_RAD, ramp.angle_rad, np.nan)  # space for the legend above
                angle.plot(ramp.t_s * 1e3, shown * 1e3, color=COLOURS[i], ls=DASHES[i], label=ways)
                torque.plot(ramp.t_s * 1e3, ramp.setpoint_Nm, color=COLOURS[i], ls=DASHES[i])
            first: Any = getattr(rows[0], name)
            push = 1.15 * rows[0].F_s_Nm * np.minimum(first.t_s / first.ramp_s, 1.0)
            torque.plot(first.t_s * 1e3, push, color=BLACK, lw=0.9, label="push")
            angle.set_ylim(-2, 1.6e3 * MOST_ANGLE_RAD)
            angle.legend(loc="upper left", title="stick entry, brake in stick", alignment="left", title_fontsize=8)
            torque.legend(loc="lower right")
            label(angle, "", "angle [mrad]", f"stuck, then {text}")
            label(torque, "time since the push began [ms]", "brake set-point [Nm]")
            torque.set_xlim(0, 1.1 * first.ramp_s * 1e3)
        return [*save(fig, directory, "stick-entry")]


def draw_bus_cycle(axes: Axes, cycle: BusCycle, colour: str, dash: Any, show_s: float = 0.05) -> None:
    """Draw v^ of one limit cycle, sample by sample, from the window's start."""
    inside = cycle.t_s < show_s
    text = f"{cycle.actuation}: {cycle.delay_s * 1e3:.3f} ms, {cycle.frequency_Hz:.1f} Hz"
    axes.plot(
        cycle.t_s[inside] * 1e3, cycle.v_m_s[inside] * 1e3, color=colour, ls=dash, marker=".", ms=4, lw=0.9, label=text
    )


def write_bus_figure(directory: Path, cycles: Sequence[BusCycle]) -> list[Path]:
    """The limit cycle through the bus: traces for each hardware, and frequency over delay with the loop without a bus."""
    names = list(dict.fromkeys(cycle.hardware for cycle in cycles))
    with figure(11, 3.4, 1, len(names) + 1) as (fig, axes):
        for place, name in zip(axes, names, strict=False):
            for i, cycle in enumerate(c for c in cycles if c.hardware == name):
                draw_bus_cycle(place, cycle, COLOURS[i], DASHES[i])
            place.legend(loc="upper right")
            low, high = place.get_ylim()
            place.set_ylim(low, high + 0.35 * (high - low))
            label(place, "time [ms]", r"$\hat v$ from TPDOs [mm/s]", name)
        last = axes[-1]
        tau = np.linspace(0, 1.2e-3, 100)
        last.plot(tau * 1e3, 1 / (4 * (1e-3 + tau)), color=BLACK, lw=0.9, label=r"$1/(4(T+\tau))$, no lag")
        for i, name in enumerate(names):
            of_hardware = [c for c in cycles if c.hardware == name]
            delay = [c.delay_s * 1e3 for c in of_hardware]
            last.plot(
                delay,
                [c.frequency_Hz for c in of_hardware],
                "o^"[i % 2],
                color=COLOURS[i],
                ms=7,
                label=f"{name}, from TPDOs",
            )
            last.plot(
                delay,
                [c.loop_frequency_Hz for c in of_hardware],
                "+x"[i % 2],
                color=BLACK,
                ms=9,
                label="the loop without a bus" if i == 0 else None,
            )
        last.set_ylim(0, 420)
        last.legend(loc="upper right")
        label(last, "delay from sampling to actuation [ms]", "frequency [Hz]", "limit cycle's frequency")
        return [*save(fig, directory, "through-the-bus")]


def draw_map(axes: Axes, chart: OscillationMap, title: str) -> Any:
    """Draw a map of two axes: share of the taps with oscillation; dark: oscillating."""
    (x_name, x), (y_name, y) = chart.axes.items()
    mesh = axes.pcolormesh(x, y, chart.share.T, shading="nearest", cmap="Blues", vmin=0, vmax=1.25, rasterized=True)
    if 0 < np.mean(chart.oscillates) < 1:
        axes.contour(x, y, chart.oscillates.T.astype(float), [0.5], colors=[BLACK], linewidths=1.0)
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.grid(False)
    label(axes, _name(x_name), _name(y_name), title)
    return mesh


def _name(field: str) -> str:
    units = {"_kg_m2": "kg m$^2$", "_Nms_rad": "Nms/rad", "_Nm_rad": "Nm/rad", "_Hz": "Hz", "_s": "s", "_Nm": "Nm"}
    for ending, unit in units.items():
        if field.endswith(ending):
            return f"{field.removesuffix(ending).replace('_', ' ')} [{unit}]"
    return field.replace("_", " ") + " [1]"


def write_map(directory: Path, chart: OscillationMap) -> list[Path]:
    """The map, one panel for each rate and delay: operator's inertia over its damping, with the lines of the bounds.

    Raises
    ------
    ValueError
        the map lacks one of these axes
    """
    plane = ("operator_inertia_kg_m2", "operator_damping_Nms_rad")
    if any(name not in chart.axes for name in plane):
        raise ValueError(f"the figure shows {plane[0]} against {plane[1]}: have both among the axes")
    rates = chart.axes.get("rate_Hz", np.array([chart.base.rate_Hz]))
    delays = chart.axes.get("delay_s", np.array([chart.base.delay_s]))
    others = {
        name: float(values[np.argmin(np.abs(values - getattr(chart.base, name)))])
        for name, values in chart.axes.items()
        if name not in (*plane, "rate_Hz", "delay_s")
    }
    with figure(
        2.7 * len(delays) + 1.2,
        2.5 * len(rates) + 0.8,
        len(rates),
        len(delays),
        sharex=True,
        sharey=True,
        squeeze=False,
    ) as (fig, axes):
        mesh: Any = None
        named: set[str] = set()
        for i, rate in enumerate(rates):
            for j, delay in enumerate(delays):
                part = at(
                    chart, **others, **{n: v for n, v in (("rate_Hz", rate), ("delay_s", delay)) if n in chart.axes}
                )
                place = axes[i, j]
                mesh = draw_map(place, part, f"{rate:g} Hz, delay {delay * 1e3:g} ms")
                base = part.base
                T, K = 1.0 / rate, base.K_p_Nm_rad
                quantised = 2 * base.coulomb_Nm / base.count_rad
                band = base.velocity_band_counts * base.count_rad * rate
                leave = base.F_d_Nm * base.friction_level / band if band else np.inf
                lines = (
                    (
                        K * T / 2,
                        "-",
                        f"Colgate; Abbott-Okamura ($2c/\\Delta$ = {quantised:.3g} Nm/rad > $K_p$): $b = K_pT/2$",
                    ),
                    (
                        K * (T / 2 + delay + base.motor_lag_s),
                        "--",
                        r"with delay and lag (Diolaiti): $b = K_p(T/2+\tau)$",
                    ),
                    (leave, ":", r"$b = F_d/\Delta v$: no torque can leave the stick band above it"),
                )
                for total, dash, text in lines:
                    y = chart.axes[plane[1]]
                    hand = total - base.viscous_Nms_rad
                    if y[0] <= hand <= y[-1]:
                        place.axhline(hand, color=VERMILION, ls=dash, lw=1.2, label=text if text not in named else None)
                        named.add(text)
                if i < len(rates) - 1:
                    place.set_xlabel("")
                if j:
                    place.set_ylabel("")
        bar = fig.colorbar(mesh, ax=axes, shrink=0.6, ticks=[0, 0.5, 1], boundaries=np.linspace(0, 1, 101))
        bar.set_label("share of taps after which it oscillates")
        fig.legend(loc="outside lower center", ncols=3)
        rest = ", ".join(f"{_name(name)} {value:g}" for name, value in others.items())
        fig.suptitle(
            f"Oscillating (blue) against quiet (white){'; ' + rest if rest else ''}", fontsize=10, x=0.01, ha="left"
        )
        return [*save(fig, directory, "map")]


def write_wall_plane(directory: Path, study: WallPlane) -> list[Path]:
    """Z-width: the stiffest stable wall over its damping; lines are predictions, dashed for a
    one-sided wall; points are runs through the bus.
    """
    with figure(5.5, 3.6) as (fig, axes):
        for mode, colour in (("active", VERMILION), ("hybrid", BLUE)):
            rows = [row for row in study.rows if row.mode == mode]
            B = [row.B_Nms_rad for row in rows]
            axes.plot(B, [row.predicted_Nm_rad for row in rows], color=colour, label=f"{mode}, both sides")
            axes.plot(B, [row.leaning_Nm_rad for row in rows], "--", color=colour, label=f"{mode}, one side")
            axes.plot(B, [row.bus_Nm_rad for row in rows], "o", color=colour, label=f"{mode}, through the bus")
        axes.legend(loc="best")
        label(axes, "damping B [Nms/rad]", "stiffness K [Nm/rad]", f"virtual wall, rig {study.rig}")
        return [*save(fig, directory, "z-width")]


def write_chatter(directory: Path, study: Chatter) -> list[Path]:
    """The quiet friction over the rate, for three encoders, and what each remedy buys."""
    from matplotlib.ticker import LogLocator

    with figure(10.5, 3.8, 1, 2) as (fig, axes):
        curves, remedies = axes
        for curve, colour, dashes in zip(study.curves, (VERMILION, BLUE, GREY), DASHES, strict=False):
            shown = np.isfinite(curve.friction_Nm) & (curve.friction_Nm > 0)
            curves.loglog(curve.rate_Hz[shown], curve.friction_Nm[shown], color=colour, ls=dashes, label=curve.name)
        if 0.0 < study.quiet.friction_Nm < np.inf:
            curves.plot(study.loop.rate_Hz, study.quiet.friction_Nm, "o", color=BLACK, label="this device")
        if study.brake_Nm:
            curves.axhline(study.brake_Nm, color=BLACK, ls=":", label=f"a brake of {study.brake_Nm:g} Nm")
        curves.set_xticks(study.curves[0].rate_Hz[::2])
        curves.minorticks_off()
        curves.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        for axis in (curves.xaxis, curves.yaxis):
            axis.set_major_formatter("{x:g}")
        curves.legend(loc="upper left", bbox_to_anchor=(0.0, 0.93))
        label(curves, "rate [Hz]", "friction [Nm]", "below: quiet by the motor alone; above: chatter")
        rows = [("this device", study.quiet), *study.remedies.items()][::-1]
        for what, height, colour, text in (
            ("friction_Nm", 0.2, VERMILION, "friction"),
            ("stiffness_Nm_rad", -0.2, BLUE, "stiffness of a wall"),
        ):
            now = getattr(study.quiet, what)
            gains = [getattr(quiet, what) / now if 0.0 < now < np.inf else np.nan for _, quiet in rows]
            remedies.barh([k + height for k in range(len(rows))], gains, 0.4, color=colour, label=text)
        remedies.set_yticks(range(len(rows)), [name for name, _ in rows])
        remedies.axvline(1.0, color=GREY, lw=0.8)
        remedies.legend(loc="lower right")
        label(remedies, "times as much", "", "what a remedy buys")
        return [*save(fig, directory, "chatter")]
