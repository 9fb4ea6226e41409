"""``coulombus warm-up``: compile in advance what every other verb needs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Annotated

import click

from coulombus.cli.errors import EXIT_STATUS, errors, print_json
from coulombus.cli.options import JsonOption, option, with_options
from coulombus.cli.tables import echo, running
from coulombus.kernels.kernel_cache import SCOPES
from coulombus.system.exit import say

__all__ = ["warm_up_command"]


@click.command("warm-up", epilog=EXIT_STATUS)
@with_options
def warm_up_command(
    scope: Annotated[
        str,
        option(
            "--for",
            "run: a bus and a host in real time; simulate: also in virtual time; arm: also an arm in the plane, all.",
            type=click.Choice(SCOPES),
            default=SCOPES[-1],
        ),
    ],
    as_json: JsonOption,
) -> None:
    """Compile the code of run, emulate, simulate and sweep in advance, with two processes.

    It is kept, for every rig, mode and law of the project, until the program or Numba is updated. A
    second call compiles nothing. Verbs that start meanwhile wait for its end.

    \b
    Examples:
      coulombus warm-up
      coulombus warm-up --for run --json
    """
    with errors():
        from coulombus.lab.warm_up import warm_up

        with _progress() as report:
            result = warm_up(report, scope=scope)
        if as_json:
            print_json(result.as_dict())
        elif result.directory is None:
            echo("NUMBA_DISABLE_JIT=1: nothing is compiled")
        elif result.compiled:
            echo(f"{result.compiled} functions compiled in {result.seconds:.0f} s, kept in {result.directory}")
        else:
            echo(f"nothing to compile: all is kept in {result.directory}")


@contextmanager
def _progress() -> Iterator[Callable[[int, int], None]]:
    """Show a bar on stderr, or print a line for each step if that is not a terminal."""
    from coulombus.system.printable_console import PrintableConsole

    console = PrintableConsole(stderr=True)
    if not console.is_terminal:
        yield lambda done, of: say(f"compiling: step {done} of {of}")
        return
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

    bars = Progress(
        TextColumn("compiling, once"), BarColumn(40), MofNCompleteColumn(), TimeElapsedColumn(), console=console
    )
    task = bars.add_task("", total=None)
    with running(bars) as shown:

        def report(done: int, of: int) -> None:
            with shown:
                bars.update(task, completed=done, total=of)

        yield report
