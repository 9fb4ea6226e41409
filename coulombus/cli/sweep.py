"""``coulombus sweep``: many rigs and hands, simulated and counted."""

from __future__ import annotations

import shlex
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import click

from coulombus.cli.errors import EXIT_STATUS, errors, print_json
from coulombus.cli.option_types import OUTPUT_FOLDER, UNCHECKED_PATH
from coulombus.cli.options import JsonOption, OverwriteOption, argument, option, with_options
from coulombus.cli.tables import echo, running
from coulombus.system.exit import say, verdict
from coulombus.system.quoting import shell

if TYPE_CHECKING:
    from coulombus.lab.sweep.sweep import SweepResult

__all__ = ["sweep_command"]

TOLD_EVERY_S = 10.0
"""Interval of progress lines if stderr is not a terminal."""


@click.command("sweep", epilog=EXIT_STATUS)
@with_options
def sweep_command(
    file: Annotated[Path, argument(type=UNCHECKED_PATH)],
    out: Annotated[
        Path,
        option(
            "-o",
            "--out",
            "Folder of the runs.",
            type=OUTPUT_FOLDER,
            required=True,
            metavar="DIR",
        ),
    ],
    processes: Annotated[
        int | None,
        option(
            "Number of processes on this machine.  [default: one for each CPU]",
            type=click.IntRange(1, 1024),
            metavar="N",
        ),
    ],
    dask: Annotated[
        str | None, option("Run on a dask.distributed cluster: tcp://HOST:8786. The same numbers.", metavar="ADDRESS")
    ],
    keep: Annotated[
        Any,
        option(
            "--keep-recordings",
            "Keep recordings of the runs that trip or miss a rate, or of all.",
            type=click.Choice(("none", "failing", "all")),
            default="none",
        ),
    ],
    overwrite: OverwriteOption,
    as_json: JsonOption,
) -> None:
    """Simulate many rigs and hands, and count how often they fail.

    FILE says what is varied - a grid, a Latin hypercube, a Sobol sequence, at random - and which
    rates are counted (docs/sweep.md). The table is DIR/runs.parquet, a row for each run with its rig.
    Rates have intervals of 95 % confidence (Clopper-Pearson). For each rate the mildest failing rig
    is searched for and kept as a rig file, and a map is drawn.

    The same command, given again, continues where it was interrupted. The table needs
    pyarrow, a cluster needs dask: pip install -e '.[export,cluster]' in the clone.

    \b
    Examples:
      coulombus sweep sweep.toml -o out/sweep
      coulombus sweep sweep.toml -o out/sweep --processes 8 --keep-recordings failing
      coulombus sweep sweep.toml -o out/sweep --dask tcp://cluster:8786 --json
    """
    with errors():
        from coulombus.lab.sweep.sweep import run_sweep
        from coulombus.lab.sweep.sweep_file import read_sweep

        if dask is not None and processes is not None:
            raise click.UsageError("--processes is of this machine, --dask of a cluster; give one of them")
        sweep = read_sweep(file)
        reached = [0]
        with _progress() as report:

            def progress(what: str, done: int, of: int, failed: int) -> None:
                if what == "runs":
                    reached[0] = done
                report(what, done, of, failed)

            try:
                result = run_sweep(
                    sweep, out, processes=processes, dask=dask, keep=keep, force=overwrite, progress=progress
                )
            except KeyboardInterrupt:
                again = shlex.join(["coulombus", "sweep", str(file), "-o", str(out)])
                say(f"coulombus: {reached[0]} of {sweep.runs} runs are done and kept; to continue: {again}")
                raise
        with verdict(0):
            if as_json:
                print_json(result.as_dict())
            else:
                _print_result(result, sweep.seconds)


def _print_result(result: SweepResult, seconds: float | None) -> None:
    """Print the result of a sweep."""
    for rate in result.rates.values():
        echo(rate.text)
    echo(f"{result.runs} runs, {result.failed} of them failed (column error)")
    if result.simulated_s_per_core_s is not None:
        echo(f"{result.simulated_s_per_core_s:.0f} s displayed for each second of one core")
    for name, mildest in result.worst.items():
        values = ", ".join(
            f"{key} = {value:.4g}" if isinstance(value, float) else f"{key} = {value}"
            for key, value in mildest["values"].items()
        )
        length = "" if seconds is None else f" --seconds {seconds:g}"
        call = f"coulombus simulate --rig {shell(mildest['file'])} --mode {mildest['mode']}{length} --seed {mildest['seed']}"
        echo(f"mildest rig that misses {name}: {values or 'the rig itself'} (of run {mildest['run']})\n  {call}")
    for path in (result.table, *result.maps.values()):
        echo(str(path))


@contextmanager
def _progress() -> Iterator[Callable[[str, int, int, int], None]]:
    """Show a bar on stderr, or print a line at intervals if that is not a terminal."""
    from coulombus.system.printable_console import PrintableConsole

    console = PrintableConsole(stderr=True)
    if not console.is_terminal:
        yield _lines()
        return
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TextColumn,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    columns = (
        TextColumn("{task.description}"),
        BarColumn(40),
        MofNCompleteColumn(),
        TextColumn("{task.fields[told]}"),
        *(TimeElapsedColumn(), TimeRemainingColumn()),
    )
    bars = Progress(*columns, console=console)
    tasks: dict[str, Any] = {}
    with running(bars) as shown:

        def report(what: str, done: int, of: int, failed: int) -> None:
            with shown:
                if what not in tasks:
                    tasks[what] = bars.add_task(what, total=of or None, told="")
                bars.update(tasks[what], completed=done, told=f"{failed} failed" if failed else "")

        yield report


def _lines() -> Callable[[str, int, int, int], None]:
    told_s = time.monotonic()

    def report(what: str, done: int, of: int, failed: int) -> None:
        nonlocal told_s
        if time.monotonic() - told_s >= TOLD_EVERY_S:
            told_s = time.monotonic()
            whole = f" of {of}" if of else ""
            say(f"{what}: {done}{whole}" + (f", {failed} failed" if failed else ""))

    return report
