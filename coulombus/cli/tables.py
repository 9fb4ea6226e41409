"""Output of the verbs: tables as wide as the terminal, wrapped lines, progress."""

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
    """Callback with a bar's label, the time reached, the total time, and a text."""

    def __call__(self, label: str, t: float, total: float | None, text: str = ..., /) -> None: ...


PROSE = 100
"""Columns of prose in a file or a pipe."""


def echo(text: object = "", *, nl: bool = True, err: bool = False) -> None:
    """Print a text on stdout, or stderr, without control characters (`system.foreign_text`).

    All output of a verb uses this, or `system.exit.say` and `table_console`.
    """
    click.echo(printable(str(text)), nl=nl, err=err)


def print_table(console: Console, table: Table) -> None:
    """Print a table without markup in its cells; rich itself would end the verb if the reader has closed."""
    with console.capture() as text:
        console.print(table, markup=False)
    click.echo(text.get(), nl=False)


def table_console(width: int) -> Console:
    """Return the console for a table on stdout: the terminal, or a fixed width in a file or a pipe."""
    from coulombus.system.printable_console import PrintableConsole

    console = PrintableConsole()
    return console if console.is_terminal else PrintableConsole(width=width)


def print_fitting(console: Console, build: Callable[[Collection[str]], Table], leave: Sequence[str]) -> None:
    """Print the table of ``build(omitted)``, omitting as few columns of `leave` as the console's
    width requires, in their order: no cell is truncated as long as that helps.
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
    """Return a line for stdout: wrapped by `hanging` on a terminal; whole in a file or a pipe, or
    wrapped at `piped` columns.
    """
    columns = columns_of(sys.stdout) or piped
    return line if columns is None else hanging(line, columns, indent)


@contextmanager
def progress(enabled: bool, done: str = "displayed", width: int = 40) -> Iterator[ShowProgress]:
    """Show live bars of `width` columns on stderr; call the yielded function with a label, the time
    reached, the total time (None: unknown), and a text instead of `done`.
    """
    from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeElapsedColumn

    from coulombus.system.printable_console import PrintableConsole

    console = PrintableConsole(stderr=True)
    if not enabled or not console.is_terminal:
        yield lambda label, t, total, text=done: None
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

        def report(label: str, t: float, total: float | None, text: str = done) -> None:
            with shown:
                if label not in tasks:
                    bars.update(starting, visible=False)
                    tasks[label] = bars.add_task(label, total=total, told="")
                t = t if total is None else min(t, total)
                whole = "" if total is None else f" of {total:.0f}"
                bars.update(tasks[label], completed=t, told=f"{t:5.1f}{whole} s {text}")

        try:
            yield report
        finally:
            with shown:
                bars.update(starting, visible=False)


@contextmanager
def running(bars: Progress) -> Iterator[AbstractContextManager[None]]:
    """Show bars during the block; yield a context manager that wraps each update. A closed terminal is ignored."""
    shown = suppress(OSError)
    with shown:
        bars.start()
    try:
        yield shown
    finally:
        with shown:
            bars.stop()
