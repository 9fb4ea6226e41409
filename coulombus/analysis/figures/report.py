"""Compute the whole study, and report it as JSON, text and figures."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

from coulombus.analysis.figures.frequency import write_frequency_figures
from coulombus.analysis.figures.rig import (
    write_bus_figure,
    write_fig12,
    write_fig13,
    write_fig14,
    write_map,
    write_stick_figure,
)
from coulombus.analysis.figures.time import write_delay_figure, write_fig10, write_orbit_figure
from coulombus.analysis.rig.friction_study import FrictionStudy, friction_study
from coulombus.analysis.rig.hold import HoldStudy, hold_study
from coulombus.analysis.rig.maps import OscillationMap, oscillation_map
from coulombus.analysis.rig.through_bus import BENCH_HARDWARE, BusCycle, through_bus
from coulombus.analysis.theory.absolute import AbsoluteStability, absolute_stability
from coulombus.analysis.theory.crossings import Crossings, crossings
from coulombus.analysis.theory.delay import DelayRow, delay_table
from coulombus.analysis.theory.fig10 import Fig10, Run, figure_10
from coulombus.analysis.theory.linear import Disk, alias_weights, passive_disk
from coulombus.analysis.theory.orbits import Orbits, orbits
from coulombus.analysis.theory.parameters import Parameters
from coulombus.rigs.rig import Rig

__all__ = [
    "TheoryResults",
    "as_json",
    "delay_lines",
    "disk_of",
    "fig10_json",
    "lines",
    "nyquist_json",
    "orbits_json",
    "plain",
    "study",
    "weights_at",
    "write_all",
]


STARTS = 200
DISK_POINTS = 101

Step = Callable[[str], None]


@dataclass(frozen=True)
class TheoryResults:
    """All results of `coulombus analyse`, as dataclasses."""

    parameters: Parameters
    rig: Rig
    crossings: Crossings
    orbits: Orbits
    disk: Disk | None
    absolute: AbsoluteStability
    fig10: Fig10
    delays: tuple[DelayRow, ...]
    friction: FrictionStudy
    through_bus: tuple[BusCycle, ...]
    hold: HoldStudy
    map: OscillationMap


def disk_of(parameters: Parameters) -> Disk | None:
    """Return the passive set's disks from 0 to fs/2; None for b = 0, where they are half-planes."""
    if parameters.damping_Ns_m == 0:
        return None
    return passive_disk(np.linspace(0.0, parameters.nyquist_Hz, DISK_POINTS), parameters)


def study(parameters: Parameters, rig: Rig, *, seed: int = 0, step: Step = lambda name: None) -> TheoryResults:
    """Compute everything; `step` is called with the name of the next step.

    `parameters` are those of the theoretical loop; `rig` is the rig of friction identification,
    hold and stroke tests, and the map. The limit cycle through the bus is that of the rig "paper".
    """
    step("describing function")
    intersections = crossings(parameters)
    step("orbits")
    motions = orbits(parameters, starts=STARTS, seed=seed)
    step("absolute stability")
    absolute = absolute_stability(parameters, shown=motions)
    step("Fig. 10")
    runs = figure_10(parameters)
    step("delay table")
    rows = delay_table(parameters, seed=seed)
    step("friction")
    friction = friction_study(rig, seed=seed)
    step("through the bus")
    bus = through_bus()
    step("hold and stroke")
    held = hold_study(rig, seed=seed)
    step("map")
    oscillating = oscillation_map(base=rig)
    return TheoryResults(
        parameters,
        rig,
        intersections,
        motions,
        disk_of(parameters),
        absolute,
        runs,
        rows,
        friction,
        bus,
        held,
        oscillating,
    )


def plain(value: Any) -> Any:
    """Return `value` in types of JSON: dataclasses as objects, arrays as lists, NaN and infinity as
    null, complex as [re, im].
    """
    if is_dataclass(value) and not isinstance(value, type):
        as_dict = getattr(value, "as_dict", None)
        return plain(as_dict()) if callable(as_dict) else {f.name: plain(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, complex):
        return [plain(value.real), plain(value.imag)]
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, Path | Rig):
        return str(value if isinstance(value, Path) else value.name)
    return value


def nyquist_json(intersections: Crossings, disk: Disk | None, absolute: AbsoluteStability) -> dict[str, Any]:
    """Return the frequency domain's part of the contract."""
    disks = None
    if disk is not None:
        disks = {
            "frequency_Hz": plain(disk.frequency_Hz),
            "center_re": plain(disk.center.real),
            "center_im": plain(disk.center.imag),
            "radius": plain(disk.radius),
        }
    return {
        "crossings": plain(intersections.found),
        "crossings_text": intersections.text,
        "passive_disk": disks,
        "certified_slope_Ns_m": {
            "passive_set": absolute.passive_set,
            "tsypkin": absolute.tsypkin,
            "zames_falb": absolute.zames_falb,
        },
        "zames_falb_proved": absolute.certificate is not None and absolute.certificate.proved,
        "nyquist_slope_Ns_m": absolute.nyquist,
        "ideal_coulomb": {"verdict": absolute.ideal.value, "text": absolute.text},
    }


def weights_at(frequency_Hz: float, parameters: Parameters, orders: int = 3) -> dict[str, Any]:
    """Return the weights of the aliases in eq. (12)'s sum at a crossing, by their order."""
    weights = alias_weights(np.array([frequency_Hz]), parameters, orders)[0]
    return {
        "frequency_Hz": frequency_Hz,
        "weights": {str(k): float(w) for k, w in zip(range(-orders, orders + 1), weights, strict=True)},
    }


def orbits_json(motions: Orbits) -> dict[str, Any]:
    """Return the orbits' part of the contract."""
    return {"orbits": plain(motions.found), "orbits_elsewhere_share": motions.elsewhere}


def _run_json(run: Run) -> dict[str, Any]:
    figures = {
        f.name: plain(getattr(run, f.name)) for f in fields(run) if f.name not in ("t_s", "x_m", "v_m_s", "force_N")
    }
    trace = {name: plain(getattr(run, name)) for name in ("t_s", "x_m", "v_m_s", "force_N")}
    return {**figures, "trace": trace}


def fig10_json(runs: Fig10) -> dict[str, Any]:
    """Return Fig. 10's part of the contract."""
    return {"fig10": {"passive": _run_json(runs.passive), "active": _run_json(runs.active)}}


def as_json(results: TheoryResults) -> dict[str, Any]:
    """Return the machine-readable contract of `coulombus analyse --json`."""
    friction = results.friction
    traces = ("t_s", "v_m_s", "force_N")
    return {
        "parameters": plain(results.parameters),
        **nyquist_json(results.crossings, results.disk, results.absolute),
        **orbits_json(results.orbits),
        **fig10_json(results.fig10),
        "delay_table": plain(results.delays),
        "friction": {
            "coulomb_before_Nm": plain(friction.coulomb_before_Nm),
            "coulomb_after_Nm": plain(friction.coulomb_after_Nm),
            "viscous_Nms_rad": plain(friction.viscous_Nms_rad),
        },
        **{
            key: [
                {f.name: plain(getattr(row, f.name)) for f in fields(row) if f.name not in traces}
                for row in results.through_bus
                if (row.hardware == BENCH_HARDWARE) == bench
            ]
            for key, bench in (("through_bus", False), ("through_bus_bench_hardware", True))
        },
        "hold": plain(results.hold),
        "map": {
            "points": results.map.share.size,
            "oscillating": float(np.mean(results.map.oscillates)),
            "simulated_s": results.map.simulated_s,
        },
    }


def nyquist_lines(intersections: Crossings, absolute: AbsoluteStability) -> Iterable[str]:
    """Yield the frequency domain's results as text."""

    def slope(value: float | None) -> str:
        return "every slope" if value is None else f"{value:.5g} Ns/m"

    yield f"describing function   {intersections.text}"
    yield f"ideal friction        {absolute.text}"
    yield f"certified slopes      any passive operator: {slope(absolute.passive_set)} (Tsypkin)"
    yield f"                      this operator: {slope(absolute.tsypkin)} (Tsypkin)"
    if absolute.certificate is not None:
        c = absolute.certificate
        how = "proved at every frequency" if c.proved else f"verified at {c.points} frequencies"
        multiplier = f"Zames-Falb, {len(c.taps)} taps, {how}"
        yield f"                      this operator: {slope(absolute.zames_falb)} ({multiplier})"
    yield f"                      limit of a linear damper (Nyquist): {slope(absolute.nyquist)}"
    yield f"                      with the brake (circle criterion): {slope(absolute.passive_brake)}"


def fig10_lines(runs: Fig10) -> Iterable[str]:
    """Yield Fig. 10's results as text."""
    for name, run in (("active", runs.active), ("passive", runs.passive)):
        chatter = "no chatter" if run.chatter_Hz is None else f"chatter at {run.chatter_Hz:.3g} Hz"
        above = ", ".join(
            f"{value:.3g} m/s above {f} Hz"
            for f, value in ((20, run.velocity_rms_above_20Hz_m_s), (100, run.velocity_rms_above_100Hz_m_s))
            if value is not None
        )
        yield (
            f"Fig. 10 {name:<13} {len(run.stick_intervals_s)} stick intervals, {run.force_flips_per_s:.3g} force flips/s, "
            f"velocity RMS {above}, {chatter}"
        )


def delay_lines(rows: Iterable[DelayRow]) -> Iterable[str]:
    """Yield the delay table as text."""
    yield "rate [Hz]  delay [ms]   frequency [Hz]          amplitude [mm/s]"
    yield "                       predicted  simulated    predicted  simulated"
    for r in rows:
        p = "none" if r.predicted_Hz is None else f"{r.predicted_Hz:.1f}"
        a = "none" if r.predicted_amplitude_m_s is None else f"{r.predicted_amplitude_m_s * 1e3:.3f}"
        yield (
            f"{r.sample_rate_Hz:9g}  {r.delay_s * 1e3:10g}  {p:>9}  {r.simulated_Hz:9.1f}    {a:>9}  {r.simulated_amplitude_m_s * 1e3:9.3f}"
        )


def hold_lines(study: HoldStudy) -> Iterable[str]:
    """Yield the hold and stroke tests as text."""
    yield f"rig {study.rig}; velocity RMS in rad/s while it should be still; breakaway under a push within 1 s and 50 ms, as a share of F_s"
    yield "mode     stick entry  brake   K_p      hold      dwells    slow    fast    hold's peak"
    for row in study.rows:
        still = [
            f"{v:8.2g}" if v is not None else f"{'-':>8}"
            for v in (row.hold_velocity_rms_rad_s, row.stick_velocity_rms_rad_s)
        ]
        away = [f"{'-' if push is None else push.verdict('.0%'):>6}" for push in (row.slow, row.fast)]
        peak = "-" if row.hold_peak_Hz is None else f"{row.hold_peak_Hz:.3g} Hz"
        yield (
            f"{row.mode:<8} {row.stick_entry:<12} {row.brake_stick:<7} {row.K_p_Nm_rad:<7g} {still[0]}  {still[1]}  {away[0]}  {away[1]}  {peak}"
        )
    yield from (f"note: {remark}" for remark in study.remarks)


def map_lines(chart: OscillationMap) -> Iterable[str]:
    """Yield a map's figures as text."""
    axes = " x ".join(f"{name} ({len(values)})" for name, values in chart.axes.items())
    yield f"map of {chart.share.size} points: {axes}"
    yield (
        f"{np.mean(chart.oscillates):.0%} of them oscillate; {chart.simulated_s:.3g} s simulated in {chart.elapsed_s:.3g} s, "
        f"{chart.speed:.3g} s a second"
    )


def lines(results: TheoryResults) -> Iterable[str]:
    """Yield all results as text."""
    yield from nyquist_lines(results.crossings, results.absolute)
    yield f"exact orbits          {results.orbits.text}"
    yield from fig10_lines(results.fig10)
    yield ""
    yield from delay_lines(results.delays)
    yield ""
    for row in results.through_bus:
        yield f"through the bus       {row.hardware}, {row.actuation}: {row.frequency_Hz:.1f} Hz with {row.delay_s * 1e3:.3f} ms of delay"
    yield from hold_lines(results.hold)
    yield from map_lines(results.map)
    f = results.friction
    yield (
        f"friction ({results.rig.name})      {f.coulomb_before_Nm:.4f} Nm identified, {f.coulomb_after_Nm:.4f} Nm after compensation, "
        f"viscous {f.viscous_Nms_rad:.4f} Nms/rad"
    )


def write_all(directory: Path, results: TheoryResults) -> list[Path]:
    """Write every figure of `results` as PNG and SVG; return the paths."""
    paths = write_frequency_figures(directory, results.parameters, results.crossings, results.absolute)
    paths += write_fig10(directory, results.fig10)
    paths += write_orbit_figure(directory, results.parameters, results.orbits)
    paths += write_delay_figure(directory, results.delays)
    paths += write_fig12(directory)
    paths += write_fig13(directory, results.friction)
    paths += write_fig14(directory, results.hold)
    paths += write_stick_figure(directory, results.hold)
    paths += write_bus_figure(directory, results.through_bus)
    paths += write_map(directory, results.map)
    return paths
