"""The options of the verbs of `coulombus analyse`, and their values."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, TypeVar

import click

from coulombus.cli.option_types import OutputDirectory

if TYPE_CHECKING:
    from coulombus.analysis.theory.parameters import Parameters
    from coulombus.rigs.rig import Rig

__all__ = ["figures_option", "loop_options", "parameters_of", "rig_of"]

F = TypeVar("F", bound=Callable[..., Any])

LOOP_OPTIONS = (
    click.option("--mass", default=0.1, show_default=True, metavar="KG", help="Mass m of the device."),
    click.option("--damping", default=0.5, show_default=True, metavar="NS/M", help="Damping b of the device."),
    click.option(
        "--operator",
        nargs=3,
        type=float,
        default=(1.287, 29.33, 178.0),
        show_default=True,
        metavar="KG NS/M N/M",
        help="Mass, damper and spring of Z_o = m_o s + b_o + k_o/s.",
    ),
    click.option(
        "--operator-rational",
        metavar="NUM/DEN",
        help="Any passive Z_o instead, as 1.287,29.33,178/1,0 (highest power first).",
    ),
    click.option("--friction", default=10.0, show_default=True, metavar="N", help="Coulomb friction c."),
    click.option("--sample-time", default=1e-3, show_default=True, metavar="S", help="Period T."),
    click.option("--delay", default=0.0, show_default=True, metavar="S", help="Delay from sampling to actuation."),
    click.option("--encoder", default=0.0, show_default=True, metavar="M", help="Resolution of the encoder; 0: none."),
    click.option("--window", default=10.0, show_default=True, metavar="S", help="Length of the simulation of Fig. 10."),
)
LOOP_NAMES = (
    "mass",
    "damping",
    "operator",
    "operator_rational",
    "friction",
    "sample_time",
    "delay",
    "encoder",
    "window",
)

figures_option = click.option(
    "--figures",
    type=OutputDirectory(),
    metavar="DIR",
    help="Draw the figures there, as PNG and SVG.",
)


def loop_options(function: F) -> F:
    """Add the loop's parameters as options."""
    for option in reversed(LOOP_OPTIONS):
        function = option(function)
    return function


def parameters_of(options: dict[str, Any]) -> Parameters:
    """Return the loop's parameters from a verb's options."""
    from coulombus.analysis.theory.parameters import Operator, Parameters

    o = {name: options.pop(name) for name in LOOP_NAMES}
    if o["operator_rational"]:
        operator = Operator.parse(o["operator_rational"])
    else:
        operator = Operator.mass_damper_spring(*o["operator"])
    return Parameters(
        o["mass"], o["damping"], operator, o["friction"], o["sample_time"], o["delay"], o["encoder"], o["window"]
    )


def rig_of(options: dict[str, Any]) -> Rig:
    """Return the rig, with its overrides, from a verb's options."""
    from coulombus.rigs.rig import load_rig

    return load_rig(options.pop("rig_name"), options.pop("overrides")).alone()
