"""The verbs of `coulombus analyse` on a rig: through its bus in virtual time, and on an arm in the plane."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import click

from coulombus.cli.analyse_shared import AnalysedRigOptions, FiguresOption, bar, print_figures, print_result
from coulombus.cli.errors import EXIT_STATUS, errors
from coulombus.cli.option_types import PICTURE
from coulombus.cli.options import JsonOption, OverwriteOption, SeedOption, option, with_options
from coulombus.cli.rig_options import RigOptions
from coulombus.system.exit import say

if TYPE_CHECKING:
    from coulombus.analysis.rig.plane_display import PlaneDisplay
    from coulombus.analysis.rig.plane_motors import MotorsAlone
    from coulombus.rigs.rig import Rig

__all__ = ["felt", "hold", "map_command", "plane", "z_width"]


@click.command(epilog=EXIT_STATUS)
@with_options
def hold(
    options: AnalysedRigOptions,
    figures: FiguresOption,
    as_json: JsonOption,
) -> None:
    """Hold and stroke tests for active and hybrid display on the rig (Fig. 14), and hybrid's
    dependence on stick entry.
    """
    with errors():
        from coulombus.analysis.figures.report import hold_lines
        from coulombus.analysis.rig.hold import hold_study

        rig = options.axis()
        with bar("hold") as report:
            result = hold_study(rig, progress=report)
        print_result(as_json, lambda: result, lambda: hold_lines(result))
        if figures:
            from coulombus.analysis.figures.rig import write_fig12, write_fig14, write_stick_figure

            print_figures(write_fig12(figures) + write_fig14(figures, result) + write_stick_figure(figures, result))


@click.command(epilog=EXIT_STATUS, short_help="Errors of the display, and what they depend on.")
@with_options
def felt(
    options: AnalysedRigOptions,
    seed: SeedOption,
    as_json: JsonOption,
) -> None:
    """Measure break-away and sliding friction at the hand against F_s and F_d, with the law's level as
    the brake's set-point and with law.level = "felt", and the error budget.
    """
    with errors():
        from coulombus.analysis.rig.display_errors import felt_study

        rig = options.axis()
        with bar("felt") as report:
            result = felt_study(rig, seed=seed, progress=report)
        print_result(as_json, lambda: result, result.lines)


@click.command("z-width", epilog=EXIT_STATUS, short_help="Largest stiffness of a virtual wall, active and hybrid.")
@with_options
def z_width(
    options: AnalysedRigOptions,
    seed: SeedOption,
    figures: FiguresOption,
    as_json: JsonOption,
) -> None:
    """The stiffest stable virtual wall over its damping, predicted and through the bus: all by the
    motor (active), or stiffness by the motor and damping by the brake (hybrid).

    \b
    Examples:
      coulombus analyse z-width --figures out/figures
      coulombus analyse z-width --set bus.delay_cycles=3 --json
    """
    with errors():
        from coulombus.analysis.rig.wall_plane import wall_plane

        rig = options.axis()
        with bar("z-width") as report:
            result = wall_plane(rig, seed=seed, progress=report)
        print_result(as_json, result.as_dict, result.lines)
        if figures:
            from coulombus.analysis.figures.rig import write_wall_plane

            print_figures(write_wall_plane(figures, result))


@click.command("map", epilog=EXIT_STATUS)
@with_options
def map_command(
    options: AnalysedRigOptions,
    axes: Annotated[
        tuple[str, ...],
        option("--axis", "An axis and its values; several give every combination.", metavar="NAME=V1,V2,..."),
    ],
    dask: Annotated[
        str | None,
        option("Compute on a dask.distributed cluster, as tcp://127.0.0.1:8786 (extra [cluster]).", metavar="ADDRESS"),
    ],
    workers: Annotated[int | None, option("Threads.  [default: one for each processor]", type=click.IntRange(1))],
    figures: FiguresOption,
    as_json: JsonOption,
) -> None:
    """Map where the active display oscillates and where it is quiet, with the bounds from the
    literature beside it.

    \b
    Examples:
      coulombus analyse map
      coulombus analyse map --axis rate_Hz=500,1000,2000 --axis friction_level=0.2,0.5,1
      coulombus analyse map --dask tcp://127.0.0.1:8786 --json
    """
    with errors():
        from coulombus.analysis.figures.report import map_lines
        from coulombus.analysis.rig.maps import oscillation_map

        rig = options.axis()
        values_of: dict[str, Any] = {}
        for axis in axes:
            name, _, values = axis.partition("=")
            try:
                values_of[name] = [float(value) for value in values.split(",")]
            except ValueError:
                raise click.BadParameter(f"{axis!r}: expected NAME=V1,V2,...", param_hint="--axis") from None
        try:
            with bar("map") as report:
                result = oscillation_map(values_of or None, base=rig, dask=dask, workers=workers, progress=report)
        except (ValueError, ImportError) as error:
            raise click.UsageError(str(error)) from error
        print_result(as_json, lambda: result, lambda: map_lines(result))
        if figures:
            from coulombus.analysis.figures.rig import write_map

            try:
                print_figures(write_map(figures, result))
            except ValueError as error:
                raise click.UsageError(str(error)) from error


class _Pose(click.ParamType):  # type: ignore[type-arg]  # generic to some versions' types only
    """The joints' angles in degrees, as 30,90; the value is in rad."""

    name = "pose"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, float]:
        if isinstance(value, tuple):
            return value
        try:
            angles = [float(part) for part in str(value).split(",")]
        except ValueError:
            angles = []
        if len(angles) != 2 or not all(abs(angle) <= 1e6 for angle in angles):
            self.fail(f"{value!r}: expected two angles in degrees, as 30,90", param, ctx)
        return math.radians(angles[0]), math.radians(angles[1])


@click.command("plane", epilog=EXIT_STATUS, short_help="What two coupled joints can display in the plane.")
@with_options
def plane(
    options: RigOptions,
    poses: Annotated[
        tuple[tuple[float, float], ...],
        option(
            "--pose",
            "Angles of the joints in degrees; several are possible.  [default: kinematics.start_rad]",
            type=_Pose(),
            metavar="Q1,Q2",
        ),
    ],
    grid: Annotated[
        int, option("Angles of each joint on the map of the workspace.", type=click.IntRange(2, 200), default=24)
    ],
    friction_N: Annotated[
        float | None,
        option(
            "--friction",
            "Friction of picture; of circle and motors alone.  [default: the largest of hybrid; 3 N]",
            type=click.FloatRange(0.0, 1e4, min_open=True),
            metavar="N",
        ),
    ],
    circle_Hz: Annotated[
        float | None,
        option(
            "--circle",
            "Simulate a hand that draws a circle about the start, without a bus, in each mode.",
            type=click.FloatRange(0.05, 5.0),
            metavar="HZ",
        ),
    ],
    picture: Annotated[Path | None, option("Draw the first pose there.", type=PICTURE, metavar="F.png")],
    overwrite: OverwriteOption,
    as_json: JsonOption,
) -> None:
    """Analyse friction in the plane: where brakes alone are wrong, what the motors must give, the
    largest friction, and the limit cycle of motors alone, in poses and over the workspace.

    \b
    Examples:
      coulombus analyse plane --rig plane
      coulombus analyse plane --rig plane --pose 0,90 --pose 0,60 --json
      coulombus analyse plane --rig plane --pose 0,60 --picture plane.png
      coulombus analyse plane --rig plane --circle 0.5
    """
    with errors():
        from coulombus.analysis.rig.plane_display import plane_display
        from coulombus.rigs.rig import load_rig

        rig = load_rig(options.rig_name, options.overrides)
        result = plane_display(rig, poses, grid)
        if picture is not None:
            _draw(result, friction_N, picture, overwrite=overwrite)
        drawn = None
        if circle_Hz is not None:
            from coulombus.analysis.rig.plane_circle import circle_study

            drawn = circle_study(rig, circle_Hz, friction_N or 3.0)
        motors = _motors_alone(rig, result, friction_N or 3.0)
        print_result(
            as_json,
            lambda: result.as_dict() | {"motors_alone": [row and row.as_dict() for row in motors], "circle": drawn},
            lambda: (
                result.lines()
                + [line for row in motors if row is not None for line in row.lines()]
                + ([] if drawn is None else drawn.lines())
            ),
        )


def _motors_alone(rig: Rig, result: PlaneDisplay, friction_N: float) -> list[MotorsAlone | None]:
    """Return the limit cycle of motors alone in each pose; None where the arm cannot be simulated or armed."""
    from coulombus.analysis.rig.plane_motors import motors_alone
    from coulombus.rigs.errors import RigError

    rows: list[MotorsAlone | None] = []
    for pose in result.poses:
        try:
            rows.append(motors_alone(rig, pose.q_rad, friction_N) if pose.allowed else None)
        except RigError:
            rows.append(None)
    return rows


def _draw(result: Any, friction_N: float | None, picture: Path, *, overwrite: bool) -> None:
    from coulombus.analysis.figures.plane import draw_plane
    from coulombus.recording.output_file import new_file
    from coulombus.recording.pictures.plot import save_picture

    figure = draw_plane(result, friction_N)
    with new_file(picture, force=overwrite) as path:
        save_picture(figure, path)
    say(f"figure: {picture}")
