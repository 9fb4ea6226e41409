"""Shared by the verbs of `coulombus analyse`: options of the loop, rig and figures, and the printed results."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from coulombus.cli.errors import print_json
from coulombus.cli.option_types import OutputDirectory
from coulombus.cli.options import option
from coulombus.cli.rig_options import RigOptions
from coulombus.cli.tables import echo, on_terminal
from coulombus.system.exit import printed, say

if TYPE_CHECKING:
    from coulombus.analysis.theory.parameters import Parameters
    from coulombus.rigs.rig import Rig

__all__ = ["AnalysedRigOptions", "FiguresOption", "LoopOptions", "bar", "print_figures", "print_result", "steps"]

FiguresOption = Annotated[
    Path | None, option("--figures", "Draw the figures there, as PNG and SVG.", type=OutputDirectory(), metavar="DIR")
]


@dataclass(frozen=True)
class LoopOptions:
    """The sampled loop of the paper."""

    mass: Annotated[float, option("Mass m of the device.", default=0.1, metavar="KG")]
    damping: Annotated[float, option("Damping b of the device.", default=0.5, metavar="NS/M")]
    operator: Annotated[
        tuple[float, float, float],
        option(
            "Mass, damper and spring of Z_o = m_o s + b_o + k_o/s.",
            nargs=3,
            type=float,
            default=(1.287, 29.33, 178.0),
            metavar="KG NS/M N/M",
        ),
    ]
    operator_rational: Annotated[
        str | None, option("Any passive Z_o instead, as 1.287,29.33,178/1,0 (highest power first).", metavar="NUM/DEN")
    ]
    friction: Annotated[float, option("Coulomb friction c.", default=10.0, metavar="N")]
    sample_time: Annotated[float, option("Period T.", default=1e-3, metavar="S")]
    delay: Annotated[float, option("Delay from sampling to actuation.", default=0.0, metavar="S")]
    encoder: Annotated[float, option("Resolution of the encoder; 0: none.", default=0.0, metavar="M")]
    window: Annotated[float, option("Length of the simulation of Fig. 10.", default=10.0, metavar="S")]

    def parameters(self) -> Parameters:
        """Return the loop's parameters."""
        from coulombus.analysis.theory.parameters import Operator, Parameters

        if self.operator_rational:
            operator = Operator.parse(self.operator_rational)
        else:
            operator = Operator.mass_damper_spring(*self.operator)
        return Parameters(
            *(self.mass, self.damping, operator, self.friction),
            *(self.sample_time, self.delay, self.encoder, self.window),
        )


@dataclass(frozen=True)
class AnalysedRigOptions(RigOptions):
    """A rig of one axis, or that axis of several which alone is meant."""

    def axis(self) -> Rig:
        """Load the rig's one axis."""
        from coulombus.rigs.rig import load_rig

        return load_rig(self.rig_name, self.overrides).alone()


def print_result(as_json: bool, value: Callable[[], Any], lines: Callable[[], Any]) -> None:
    """Print a result: its value as JSON, or its text lines."""
    from coulombus.analysis.figures.report import plain

    with printed():
        if as_json:
            print_json(plain(value()))
            return
        for line in lines():
            echo(on_terminal(line, 22))


def print_figures(paths: list[Path]) -> None:
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
