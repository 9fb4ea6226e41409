"""`coulombus analyse plane`: displayable friction of a rig in the plane."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from coulombus.cli.analyse_output import tell
from coulombus.cli.common import force_option, json_option, rig_option, say, set_option
from coulombus.cli.errors import EXIT_STATUS, errors
from coulombus.cli.option_types import PICTURE

if TYPE_CHECKING:
    from coulombus.analysis.rig.plane_display import PlaneDisplay
    from coulombus.analysis.rig.plane_motors import MotorsAlone
    from coulombus.rigs.rig import Rig

__all__ = ["plane"]


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
@rig_option
@set_option
@click.option(
    "--pose",
    "poses",
    type=_Pose(),
    multiple=True,
    metavar="Q1,Q2",
    help="Angles of the joints in degrees; several are possible.  [default: kinematics.start_rad]",
)
@click.option(
    "--grid",
    type=click.IntRange(2, 200),
    default=24,
    show_default=True,
    help="Angles of each joint on the map of the workspace.",
)
@click.option(
    "--friction",
    "friction_N",
    type=click.FloatRange(0.0, 1e4, min_open=True),
    metavar="N",
    help="Friction of picture; of circle and motors alone.  [default: the largest of hybrid; 3 N]",
)
@click.option(
    "--circle",
    "circle_Hz",
    type=click.FloatRange(0.05, 5.0),
    metavar="HZ",
    help="Simulate a hand that draws a circle about the start, without a bus, in each mode.",
)
@click.option("--picture", type=PICTURE, metavar="F.png", help="Draw the first pose there.")
@force_option
@json_option
def plane(**options: Any) -> None:
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

        rig = load_rig(options["rig_name"], options["overrides"])
        result = plane_display(rig, options["poses"], options["grid"])
        if options["picture"] is not None:
            _draw(result, options["friction_N"], options["picture"], overwrite=options["overwrite"])
        drawn = None
        if options["circle_Hz"] is not None:
            from coulombus.analysis.rig.plane_circle import circle_study

            drawn = circle_study(rig, options["circle_Hz"], options["friction_N"] or 3.0)
        motors = _motors_alone(rig, result, options["friction_N"] or 3.0)
        tell(
            options["as_json"],
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

    made = draw_plane(result, friction_N)
    with new_file(picture, force=overwrite) as path:
        save_picture(made, path)
    say(f"figure: {picture}")
