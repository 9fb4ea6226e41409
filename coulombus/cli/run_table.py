"""Results of runs as a table."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

from coulombus.cli.tables import echo, table_console
from coulombus.system.wrap_text import folded

if TYPE_CHECKING:
    from coulombus.host.run.result import RunResult
    from coulombus.lab.demo.plane_demo import TipRun

__all__ = ["print_arms", "print_remark", "print_runs", "print_verdict"]

WIDTH = 80
"""Width of the table in a file or a pipe."""

ALWAYS = ("recording", "trip")
"""Rows that are shown even without a value."""


def _columns(results: dict[str, RunResult]) -> Iterator[tuple[str, RunResult]]:
    """Yield a column for each result, or for each axis of a rig with several."""
    from dataclasses import replace

    for title, result in results.items():
        if result.buses:
            yield from _columns({title + f", {bus}": replace(result, **values) for bus, values in result.buses.items()})
            continue
        if not result.axes:
            yield title, result
        for axis, values in (result.axes or {}).items():
            yield f"{title}, {axis}", replace(result, **values)


def print_runs(results: dict[str, RunResult]) -> None:
    """Print a column for each result, or for each axis of it."""
    from rich.table import Table

    rows: tuple[tuple[str, str, str], ...] = (
        ("cycles displayed", "cycles", ""),
        ("lost PDOs", "lost_pdos", ""),
        ("missed deadlines", "missed_deadlines", ""),
        ("hold: velocity RMS", "hold_velocity_rms_rad_s", "rad/s"),
        ("hold: encoder peak to peak", "hold_counts_p2p", "counts"),
        ("hold: torque sign changes", "torque_flips_per_s", "/s"),
        ("hold: spectral peak", "hold_peak_Hz", "Hz"),
        ("hold: largest push", "hold_push_Nm", "Nm"),
        ("dwells: velocity RMS", "stick_velocity_rms_rad_s", "rad/s"),
        ("full gain after", "full_gain_s", "s"),
        ("sign check", "sign_check", ""),
        ("recording", "recording", ""),
        ("stopped by", "stopped_by", ""),
        ("trip", "trip", ""),
        ("wake-up p50 / p99 / max", "wakeup_us", "us"),
        ("SYNC to RPDO p50 / p99 / max", "sync_to_rpdo_us", "us"),
        ("CPU a cycle", "cpu_us_per_cycle", "us"),
        ("dead man's switch", "deadman", ""),
    )
    if any(result.sync_skew_us for result in results.values()):
        rows += (("SYNC on all buses within p50 / p99 / max", "sync_skew_us", "us"),)
    remarks = {title: result.remarks for title, result in results.items()}
    arms = [_arm(title, result.plane) for title, result in results.items() if result.plane]
    results = dict(_columns(results))
    console = table_console(WIDTH)
    room = (console.width - max(len(label) for label, _, _ in rows)) // max(1, len(results)) - 1
    beneath: list[str] = []
    table = Table(box=None, pad_edge=False)
    table.add_column("")
    for mode in results:
        table.add_column(mode, justify="right", overflow="fold")
    for label, field, unit in rows:
        cells = []
        for result in results.values():
            value = getattr(result, field)
            if isinstance(value, dict):
                value = " / ".join(f"{part:.0f}" for part in value.values())
            text = "-" if value is None else f"{value:.4g}" if isinstance(value, float) else str(value)
            cells.append(f"{text} {unit}".strip() if value is not None else text)
        if any(
            isinstance(getattr(result, field), str) and len(cell) > room
            for result, cell in zip(results.values(), cells, strict=True)
        ):
            beneath += [f"{label}, {mode}: {cell}" for mode, cell in zip(results, cells, strict=True) if cell != "-"]
        elif field in ALWAYS or any(cell != "-" for cell in cells):
            table.add_row(label, *cells)
    console.print(table)
    for line in (*arms, *beneath):  # paths and sentences, not wrapped
        echo(folded(line, sys.stdout))
    for title, texts in remarks.items():
        for text in texts:
            print_remark(f"{title}: {text}")


def _arm(title: str, plane: dict[str, Any]) -> str:
    """Return the figures of an arm in the plane as a line."""
    works = ", ".join(f"{name} {work:.3g} J" for name, work in plane["motor_work_J"].items())
    text = f"net work of the motors: {works}, absorbed by all: {plane['absorbed_J']:.3g} J"
    off = plane.get("angle_error_deg", {})
    if off.get("median") is not None:
        felt = plane["felt"]["angle_error_deg"]
        angle = f"{off['median']:.2g} deg from the law's direction (95 %: {off['p95']:.2g})"
        text = (
            f"{angle}, {plane['force_ratio']:.3g} times its size; with the arm's inertia, as the hand feels it, "
            f"{felt['median']:.2g} deg (95 %: {felt['p95']:.2g}), {plane['felt']['force_ratio']:.3g} times; {text}"
        )
    return f"tip, {title}: {text}"


def print_arms(runs: Mapping[str, TipRun]) -> None:
    """Print a column for each mode of an arm in the plane."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    table.add_column("")
    for mode in runs:
        table.add_column(mode, justify="right", overflow="fold")

    def row(title: str, cell: Callable[[TipRun], str]) -> None:
        table.add_row(title, *(cell(run) for run in runs.values()))

    for joint in next(iter(runs.values())).hold_counts:
        row(f"hold: {joint} peak to peak", lambda run, joint=joint: f"{run.hold_counts[joint]} counts")  # type: ignore[misc]
    row("hold: speed of the tip, RMS", lambda run: f"{1e3 * run.hold_rms_m_s:.3g} mm/s")
    row("hold: largest push", lambda run: f"{run.hold_push_N:.3g} N")
    row("motion: off the law's direction", lambda run: _angle(run, "median"))
    row("    95th percentile", lambda run: _angle(run, "p95"))
    row("motion: size over the law's", lambda run: _figure(run, "force_ratio"))
    row("net work of the motors", lambda run: f"{sum((run.result.plane or {})['motor_work_J'].values()):.3f} J")
    row("absorbed by all", lambda run: f"{(run.result.plane or {})['absorbed_J']:.3f} J")
    row("trip", lambda run: run.result.trip or "-")
    table_console(WIDTH).print(table)


def _angle(run: TipRun, name: str) -> str:
    value = (run.result.plane or {}).get("angle_error_deg", {}).get(name)
    return "-" if value is None else f"{value:.1f} deg"


def _figure(run: TipRun, name: str) -> str:
    value = (run.result.plane or {}).get(name)
    return "-" if value is None else f"{value:.3f}"


def print_remark(text: str) -> None:
    """Print a line that begins with "remark"."""
    _print_marked("yellow", "remark", f" {text}")


def print_verdict(holds: bool | None, text: str) -> None:
    """Print whether a criterion holds (None: it could not be judged), and its text."""
    colour, mark = ("yellow", "?   ") if holds is None else ("green", "ok  ") if holds else ("red", "FAIL")
    _print_marked(colour, mark, f" {text}")


def _print_marked(colour: str, mark: str, text: str) -> None:
    from rich.markup import escape

    from coulombus.system.printable_console import PrintableConsole

    rest = folded(mark + text, sys.stdout, len(mark) + 1)[len(mark) :]
    PrintableConsole(highlight=False).print(f"[{colour}]{mark}[/]{escape(rest)}", soft_wrap=True)
