"""How a verb shows something: tables as wide as the terminal, lines that fit, progress."""

from __future__ import annotations

import sys
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from typing import TYPE_CHECKING, Protocol

import click

from coulombus.system.foreign_text import printable
from coulombus.system.wrap_text import columns_of, hanging

if TYPE_CHECKING:
    from rich.console import Console
    from rich.progress import Progress
    from rich.table import Table

__all__ = [
    "PROSE",
    "echo",
    "on_terminal",
    "print_fitting",
    "print_table",
    "progress",
    "running",
    "table_console",
]


class ShowProgress(Protocol):
    """Takes a bar's label, the time reached, the whole time, and what is said of it."""

    def __call__(self, label: str, t: float, total: float | None, told: str = ..., /) -> None: ...


PROSE = 100
"""Columns of what is read in a file or a pipe."""


def echo(text: object = "", *, nl: bool = True, err: bool = False) -> None:
    """Print a text on stdout, or stderr, without control characters (`system.foreign_text`).

    Whatever a verb prints goes this way, or by `system.exit.say` and `table_console`.
    """
    click.echo(printable(str(text)), nl=nl, err=err)


def print_table(console: Console, table: Table) -> None:
    """Print a table whose cells have no markup; rich itself would end the verb where the reader
    has gone.
    """
    with console.capture() as text:
        console.print(table, markup=False)
    click.echo(text.get(), nl=False)


def table_console(width: int) -> Console:
    """Return the console for a table on stdout: the terminal, or so many columns of a file or a
    pipe.
    """
    from coulombus.system.printable_console import PrintableConsole

    console = PrintableConsole()
    return console if console.is_terminal else PrintableConsole(width=width)


def print_fitting(console: Console, build: Callable[[Collection[str]], Table], leave: Sequence[str]) -> None:
    """Print the table that ``build(left out)`` makes with as few of the columns `leave`, the first
    first, left out as the console's width asks for: no cell of it is cut as long as that helps.
    """
    from rich.measure import Measurement

    left: list[str] = []
    wide = console.options.update(max_width=10_000)
    for name in (None, *leave):
        left += [] if name is None else [name]
        table = build(left)
        if Measurement.get(console, wide, table).maximum <= console.width:
            break
    console.print(table)


def on_terminal(line: str, indent: int, piped: int | None = None) -> str:
    """Return a line of stdout: broken as `hanging` does where a terminal ends; whole in a file or a
    pipe, or broken behind `piped` columns.
    """
    columns = columns_of(sys.stdout) or piped
    return line if columns is None else hanging(line, columns, indent)


@contextmanager
def progress(enabled: bool, done: str = "displayed", width: int = 40) -> Iterator[ShowProgress]:
    """Show live bars of `width` columns on stderr: call what is yielded with a label, the time
    reached, the whole time (None: nobody knows), and what is said of it instead of `done`.
    """
    from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

    from coulombus.system.printable_console import PrintableConsole

    console = PrintableConsole(stderr=True)
    if not enabled or not console.is_terminal:
        yield lambda label, t, total, told=done: None
        return
    columns = (
        TextColumn("{task.description:<8}"),
        BarColumn(width),
        TextColumn("{task.fields[told]}"),
        TimeElapsedColumn(),
    )
    bars = Progress(*columns, console=console)
    starting = bars.add_task("starting", total=None, told="")
    tasks: dict[str, TaskID] = {}
    with running(bars) as shown:

        def report(label: str, t: float, total: float | None, told: str = done) -> None:
            with shown:
                if label not in tasks:
                    bars.update(starting, visible=False)
                    tasks[label] = bars.add_task(label, total=total, told="")
                t = t if total is None else min(t, total)
                whole = "" if total is None else f" of {total:.0f}"
                bars.update(tasks[label], completed=t, told=f"{t:5.1f}{whole} s {told}")

        try:
            yield report
        finally:
            with shown:
                bars.update(starting, visible=False)


@contextmanager
def running(bars: Progress) -> Iterator[AbstractContextManager[None]]:
    """Show bars as long as the block runs; yield what a change of them is to stand in: a terminal
    that was closed takes nothing more, and what is shown there goes on without it.
    """
    shown = suppress(OSError)
    with shown:
        bars.start()
    try:
        yield shown
    finally:
        with shown:
            bars.stop()
