"""Figures of the time domain: Fig. 10, the exact orbits, and the limit cycle over rate and delay."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from coulombus.analysis.theory.delay import DelayRow
from coulombus.analysis.theory.fig10 import Fig10, Run
from coulombus.analysis.theory.linear import sample
from coulombus.analysis.theory.operators import Floats
from coulombus.analysis.theory.orbits import Orbit, Orbits
from coulombus.analysis.theory.parameters import Parameters
from coulombus.recording.pictures.style import BLACK, BLUE, COLOURS, DASHES, VERMILION, figure, label, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = [
    "draw_delay",
    "draw_detail",
    "draw_force",
    "draw_orbit",
    "draw_velocity",
    "orbit_samples",
    "write_delay_figure",
    "write_fig10",
    "write_orbit_figure",
]

MARKERS = "os^Dv"
SHOWN_ORBITS = 4
DETAIL_S = 0.06


def draw_velocity(axes: Axes, run: Run, title: str) -> None:
    """Draw the true velocity at the samples; stick is shaded."""
    for begin, end in run.stick_intervals_s:
        axes.axvspan(begin, end, color="0.87", lw=0)
    axes.plot(run.t_s, run.v_m_s, color=BLUE, lw=0.8)
    label(axes, "", "velocity [m/s]", title)
    axes.margins(x=0)


def draw_force(axes: Axes, run: Run, f_h_N: Floats) -> None:
    """Draw the operator's force and the applied friction."""
    for begin, end in run.stick_intervals_s:
        axes.axvspan(begin, end, color="0.87", lw=0)
    axes.plot(run.t_s, run.force_N, color=VERMILION, lw=0.5, label=r"friction $\psi$")
    axes.plot(run.t_s, f_h_N, color=BLACK, lw=1.0, ls="--", label=r"operator $f_h$")
    label(axes, "time [s]", "force [N]")
    axes.margins(x=0)
    axes.legend(loc="upper right", ncols=2)
    axes.set_ylim(-52, 62)


def draw_detail(axes: Axes, run: Run, begin_s: float, title: str) -> None:
    """Draw a few hundredths of a second, sample by sample: a limit cycle, or stick."""
    inside = (run.t_s >= begin_s) & (run.t_s < begin_s + DETAIL_S)
    axes.plot(run.t_s[inside], run.v_m_s[inside] * 1e3, color=BLUE, marker=".", ms=4, lw=0.9)
    axes.set_ylim(-12, 12)
    label(axes, "time [s]", "velocity [mm/s]", title)
    twin = axes.twinx()
    twin.step(run.t_s[inside], run.force_N[inside], where="post", color=VERMILION, lw=0.8, ls="--")
    twin.set_ylim(-30, 30)
    twin.set_ylabel("friction [N] (dashed)")
    twin.grid(False)


def orbit_samples(orbit: Orbit, parameters: Parameters) -> tuple[Floats, Floats]:
    """Return v^_k and u_k of one period, by the discrete spectrum."""
    u = np.array([1.0 if sign == "+" else -1.0 for sign in orbit.pattern])
    z = np.exp(2j * np.pi * np.arange(len(u)) / len(u))
    v = -parameters.friction_N * np.fft.ifft(sample(parameters).response(z) * np.fft.fft(u)).real
    return v, u


def draw_orbit(axes: Axes, orbit: Orbit, parameters: Parameters) -> None:
    """Draw v^ of one orbit over 24 samples, the force's sign beneath."""
    v, u = orbit_samples(orbit, parameters)
    k = np.arange(25)
    axes.vlines(k, 0, np.resize(v, 25) * 1e3, color=BLUE, lw=1.2)
    axes.plot(k, np.resize(v, 25) * 1e3, "o", ms=3.5, color=BLUE)
    peak = max(orbit.velocity_peak_m_s * 1e3, 1e-9)
    axes.step(k, np.resize(u, 25) * peak * 0.35, where="post", color=VERMILION, ls="--", lw=1)
    share = "" if orbit.share is None else f", {orbit.share:.0%} of the starts"
    label(axes, "sample k", r"$\hat v_k$ [mm/s]", f"{orbit.pattern}  {orbit.frequency_Hz:.4g} Hz{share}")
    axes.axhline(0, color=BLACK, lw=0.6)


def draw_delay(frequency: Axes, amplitude: Axes, rows: Sequence[DelayRow]) -> None:
    """Draw frequency and amplitude over delay, with colour, dash and marker by rate: lines
    predicted, markers simulated.
    """
    rates = sorted({row.sample_rate_Hz for row in rows})
    for i, rate in enumerate(rates):
        mine = sorted((row for row in rows if row.sample_rate_Hz == rate), key=lambda row: row.delay_s)
        delay = [row.delay_s * 1e3 for row in mine]
        colour, dash = COLOURS[i % len(COLOURS)], DASHES[i % len(DASHES)]
        marker = MARKERS[i % len(MARKERS)]
        for axes, predicted, simulated, scale in (
            (frequency, [r.predicted_Hz for r in mine], [r.simulated_Hz for r in mine], 1.0),
            (amplitude, [r.predicted_amplitude_m_s for r in mine], [r.simulated_amplitude_m_s for r in mine], 1e3),
        ):
            line = [np.nan if value is None else value * scale for value in predicted]
            axes.plot(delay, line, color=colour, ls=dash)
            axes.plot(
                delay,
                [value * scale for value in simulated],
                marker,
                color=colour,
                mec=BLACK,
                mew=0.5,
                ms=6,
                ls="",
                label=f"{rate:g} Hz",
            )
        spread = [(r.simulated_Hz - r.slowest_Hz, r.fastest_Hz - r.simulated_Hz) for r in mine]
        frequency.errorbar(
            delay,
            [r.simulated_Hz for r in mine],
            yerr=np.array(spread).T,
            fmt="none",
            ecolor=colour,
            elinewidth=0.8,
            capsize=2,
        )
    for axes, quantity in ((frequency, "limit cycle's frequency [Hz]"), (amplitude, r"amplitude of $\hat v$ [mm/s]")):
        axes.set_yscale("log")
        low, high = axes.get_ylim()
        ticks = [digit * 10.0**power for power in range(-3, 6) for digit in (1, 2, 5)]
        axes.set_yticks([tick for tick in ticks if low <= tick <= high], minor=False)
        axes.yaxis.set_major_formatter("{x:g}")
        axes.yaxis.set_minor_formatter("")
        label(axes, "delay from sampling to actuation [ms]", quantity)
    frequency.set_title("Lines: describing function. Markers: simulated, median of 21 starts")
    amplitude.legend(title="sampling rate", loc="lower right", ncols=2)


def write_fig10(directory: str | os.PathLike[str], runs: Fig10) -> list[Path]:
    """Write fig10-active-passive as PNG and SVG; return the paths."""
    with figure(10.4, 7.6, 3, 2, sharey="row") as (fig, axes):
        pairs = ((runs.active, "(a) active force feedback"), (runs.passive, "(b) passive force feedback"))
        for column, (run, title) in enumerate(pairs):
            draw_velocity(axes[0, column], run, f"Fig. 10 {title}; stick shaded")
            draw_force(axes[1, column], run, runs.f_h_N)
            begin = runs.passive.stick_intervals_s[1][0] if len(runs.passive.stick_intervals_s) > 1 else 0.01
            draw_detail(axes[2, column], run, begin - 0.01, f"{DETAIL_S:g} s around a stop, sample by sample")
        return list(save(fig, directory, "fig10-active-passive"))


def write_orbit_figure(directory: str | os.PathLike[str], parameters: Parameters, motions: Orbits) -> list[Path]:
    """Write limit-cycle as PNG and SVG; return the paths; empty without an orbit."""
    shown = motions.found[:SHOWN_ORBITS]
    if not shown:
        return []
    rows = (len(shown) + 1) // 2
    with figure(10.4, 2.2 * rows + 0.4, rows, 2, squeeze=False) as (fig, axes):
        for place, orbit in zip(axes.flat, shown, strict=False):
            draw_orbit(place, orbit, parameters)
        for place in list(axes.flat)[len(shown) :]:
            place.set_visible(False)
        fig.suptitle(
            r"Exact periodic motions of the sampled relay loop: $\hat v_k$ (stems) and the force's sign (dashed)",
            fontsize=10,
        )
        return list(save(fig, directory, "limit-cycle"))


def write_delay_figure(directory: Path, rows: Sequence[DelayRow]) -> list[Path]:
    """Write delay as PNG and SVG; return the paths."""
    with figure(10.4, 4.2, 1, 2) as (fig, axes):
        draw_delay(axes[0], axes[1], rows)
        return list(save(fig, directory, "delay"))
