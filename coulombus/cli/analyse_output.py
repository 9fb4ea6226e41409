"""Output of the verbs of `coulombus analyse`: results, the figures' files, progress."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from coulombus.cli.common import printed, say
from coulombus.cli.errors import print_json
from coulombus.cli.tables import echo, on_terminal

__all__ = ["bar", "steps", "tell", "tell_paths"]


def tell(as_json: bool, value: Callable[[], Any], lines: Callable[[], Any]) -> None:
    """Print a result: its value as JSON, or its text lines."""
    from coulombus.analysis.figures.report import plain

    with printed():
        if as_json:
            print_json(plain(value()))
            return
        for line in lines():
            echo(on_terminal(line, 22))


def tell_paths(paths: list[Path]) -> None:
    """Print the paths of the figures."""
    for path in paths:
        say(f"figure: {path}")


@contextmanager
def bar(title: str) -> Iterator[Callable[[float], None]]:
    """Show a bar on stderr if it is a terminal; call the yielded function with the finished share."""
    from rich.progress import Progress

    from coulombus.system.printable_console import PrintableConsole

    console = PrintableConsole(stderr=True)
    with Progress(console=console, disable=not console.is_terminal) as bars:
        task = bars.add_task(title, total=1.0)
        yield lambda share: bars.update(task, completed=share)


@contextmanager
def steps(count: int) -> Iterator[Callable[[str], None]]:
    """Show the present step; call the yielded function with its name."""
    from rich.progress import Progress

    from coulombus.system.printable_console import PrintableConsole

    console = PrintableConsole(stderr=True)
    with Progress(console=console, disable=not console.is_terminal, transient=True) as bars:
        task = bars.add_task("", total=count)
        done = iter(range(count + 1))
        yield lambda name: bars.update(task, description=name, completed=next(done, count))
