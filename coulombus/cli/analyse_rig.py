"""The verbs of `coulombus analyse` that run a rig through its bus in virtual time."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from coulombus.cli.analyse_options import figures_option, rig_of
from coulombus.cli.analyse_output import bar, tell, tell_paths
from coulombus.cli.common import json_option, rig_option, seed_option, set_option
from coulombus.cli.errors import EXIT_STATUS, errors

if TYPE_CHECKING:
    from coulombus.rigs.rig import Rig

__all__ = ["felt", "hold", "map_command", "z_width"]


@click.command(epilog=EXIT_STATUS)
@rig_option
@set_option
@figures_option
@json_option
def hold(**options: Any) -> None:
    """Hold and stroke tests for active and hybrid display on the rig (Fig. 14), and hybrid's
    dependence on stick entry.
    """
    with errors():
        _hold(rig_of(options), options["figures"], options["as_json"])


def _hold(rig: Rig, figures: Path | None, as_json: bool) -> None:
    from coulombus.analysis.figures.report import hold_lines
    from coulombus.analysis.rig.hold import hold_study

    with bar("hold") as report:
        result = hold_study(rig, progress=report)
    tell(as_json, lambda: result, lambda: hold_lines(result))
    if figures:
        from coulombus.analysis.figures.rig import write_fig12, write_fig14, write_stick_figure

        tell_paths(write_fig12(figures) + write_fig14(figures, result) + write_stick_figure(figures, result))


@click.command(epilog=EXIT_STATUS, short_help="Errors of the display, and what they depend on.")
@rig_option
@set_option
@seed_option
@json_option
def felt(**options: Any) -> None:
    """Measure break-away and sliding friction at the hand against F_s and F_d, with the law's level as
    the brake's set-point and with law.level = "felt", and the error budget.
    """
    with errors():
        _felt(rig_of(options), options["seed"], options["as_json"])


def _felt(rig: Rig, seed: int, as_json: bool) -> None:
    from coulombus.analysis.rig.display_errors import felt_study

    with bar("felt") as report:
        result = felt_study(rig, seed=seed, progress=report)
    tell(as_json, lambda: result, result.lines)


@click.command("z-width", epilog=EXIT_STATUS, short_help="Largest stiffness of a virtual wall, active and hybrid.")
@rig_option
@set_option
@seed_option
@figures_option
@json_option
def z_width(**options: Any) -> None:
    """The stiffest stable virtual wall over its damping, predicted and through the bus: all by the
    motor (active), or stiffness by the motor and damping by the brake (hybrid).

    \b
    Examples:
      coulombus analyse z-width --figures out/figures
      coulombus analyse z-width --set bus.delay_cycles=3 --json
    """
    with errors():
        _z_width(rig_of(options), options)


def _z_width(rig: Rig, options: dict[str, Any]) -> None:
    from coulombus.analysis.rig.wall_plane import wall_plane

    with bar("z-width") as report:
        result = wall_plane(rig, seed=options["seed"], progress=report)
    tell(options["as_json"], result.as_dict, result.lines)
    if options["figures"]:
        from coulombus.analysis.figures.rig import write_wall_plane

        tell_paths(write_wall_plane(options["figures"], result))


@click.command("map", epilog=EXIT_STATUS)
@rig_option
@set_option
@click.option(
    "--axis",
    "axes",
    multiple=True,
    metavar="NAME=V1,V2,...",
    help="An axis and its values; several give every combination.",
)
@click.option(
    "--dask",
    metavar="ADDRESS",
    help="Compute on a dask.distributed cluster, as tcp://127.0.0.1:8786 (extra [cluster]).",
)
@click.option("--workers", type=click.IntRange(1), default=None, help="Threads.  [default: one for each processor]")
@figures_option
@json_option
def map_command(**options: Any) -> None:
    """Map where the active display oscillates and where it is quiet, with the bounds from the
    literature beside it.

    \b
    Examples:
      coulombus analyse map
      coulombus analyse map --axis rate_Hz=500,1000,2000 --axis friction_level=0.2,0.5,1
      coulombus analyse map --dask tcp://127.0.0.1:8786 --json
    """
    with errors():
        _map(rig_of(options), options)


def _map(rig: Rig, options: dict[str, Any]) -> None:
    from coulombus.analysis.figures.report import map_lines
    from coulombus.analysis.rig.maps import oscillation_map

    axes: dict[str, Any] = {}
    for given in options["axes"]:
        name, _, values = given.partition("=")
        try:
            axes[name] = [float(value) for value in values.split(",")]
        except ValueError:
            raise click.BadParameter(f"{given!r}: expected NAME=V1,V2,...", param_hint="--axis") from None
    try:
        with bar("map") as report:
            result = oscillation_map(
                axes or None, base=rig, dask=options["dask"], workers=options["workers"], progress=report
            )
    except (ValueError, ImportError) as error:
        raise click.UsageError(str(error)) from error

    tell(options["as_json"], lambda: result, lambda: map_lines(result))
    if options["figures"]:
        from coulombus.analysis.figures.rig import write_map

        try:
            tell_paths(write_map(options["figures"], result))
        except ValueError as error:
            raise click.UsageError(str(error)) from error
