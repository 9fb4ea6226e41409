"""``coulombus law``: the friction laws, and a law along a given motion."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from coulombus.cli.common import force_option, json_option, printed, say
from coulombus.cli.errors import EXIT_STATUS, errors, print_json
from coulombus.cli.option_types import PICTURE, SECONDS, OutputFile
from coulombus.cli.tables import echo, on_terminal, print_table, table_console

if TYPE_CHECKING:
    from coulombus.host.laws.along import Driven, GivenLaw
    from coulombus.host.laws.law import Declaration
    from coulombus.host.laws.path import MotionPath

__all__ = ["law"]


class _Finite(click.FloatRange):
    """A number within a range; NaN is refused."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Return the number."""
        number = float(super().convert(value, param, ctx))
        if number != number:
            self.fail(f"{value} is not a number", param, ctx)
        return number


POSITIVE = _Finite(0, 1e9, min_open=True)
MOST_SAMPLES = 10_000_000


@click.command("law", epilog=EXIT_STATUS)
@click.argument("name", required=False)
@click.option(
    "--motion",
    metavar="F.csv|sine|ramp",
    help="Drive the law along it: a CSV file with the columns t_s,x_rad, a sine, or a constant speed.",
)
@click.option("--set", "overrides", multiple=True, metavar="KEY=V", help="Set a parameter of the law, as F_c_Nm=0.8.")
@click.option(
    "--amplitude", type=POSITIVE, default=0.1, show_default=True, metavar="RAD", help="Amplitude of the sine."
)
@click.option("--frequency", type=POSITIVE, default=1.0, show_default=True, metavar="HZ", help="Frequency of the sine.")
@click.option(
    "--speed", type=_Finite(-1e9, 1e9), default=1.0, show_default=True, metavar="RAD/S", help="Speed of the ramp."
)
@click.option("--seconds", type=SECONDS, default=2.0, show_default=True, help="Length of sine or ramp.")
@click.option(
    "--rate", type=POSITIVE, default=1000.0, show_default=True, metavar="HZ", help="Samples per second of sine or ramp."
)
@click.option("--csv", "csv", type=OutputFile(), metavar="OUT", help="Write t_s,x_rad,v_rad_s,torque_Nm there.")
@click.option("--picture", "--plot", "plot", type=PICTURE, metavar="F.png", help="Draw motion, torque and loop there.")
@force_option
@json_option
def law(name: str | None, motion: str | None, overrides: tuple[str, ...], **options: Any) -> None:
    """List the friction laws, describe one, or drive it along a motion.

    Without NAME the laws are listed. NAME is one of them, FILE.py:FUNCTION or MODULE:FUNCTION;
    without --motion its parameters are listed. Laws in the plane, of a rig with [kinematics], are
    listed and described, too; docs/plane.md drives them along a motion. The torque is positive against a positive speed;
    the speed of a sample is the slope of the interval that ends there, 0 at the first.

    \b
    Examples:
      coulombus law
      coulombus law lugre
      coulombus law plane_karnopp
      coulombus law dahl --motion sine --amplitude 0.05 --plot loop.png
      coulombus law lugre --motion my-motion.csv --set F_s_Nm=1.5 --csv torque.csv
    """
    with errors():
        as_json = options["as_json"]
        _refuse_alone(name, motion, overrides, options)
        if name is None:
            _list(as_json)
            return
        from coulombus.host.laws.along import given_law
        from coulombus.host.laws.plane.plane_laws import PLANE_LAWS
        from coulombus.rigs.errors import nearest

        if name in PLANE_LAWS:
            if motion is not None or overrides:
                raise click.BadParameter(
                    f"{name} is a law in the plane, and --motion and --set are of one axis: `coulombus simulate --rig "
                    f"plane --law {name}`, or in Python as in docs/plane.md#laws",
                    param_hint="NAME",
                )
            _describe(name, PLANE_LAWS[name], as_json)
            return
        given = given_law(name, overrides)
        if motion is None:
            _describe(given.name, given.declaration, as_json)
            return
        if motion in ("sine", "ramp") or Path(motion).exists() or "." in motion or "/" in motion:
            path = _path(motion, options)
        else:
            hint = nearest(motion, ("sine", "ramp"))
            raise click.BadParameter(f"{motion!r}: expected a CSV file, sine or ramp{hint}", param_hint="--motion")
        driven = given.along(*path)
        _write(given, driven, options)
        with printed():
            _tell(given, driven, options)


def _refuse_alone(name: str | None, motion: str | None, overrides: tuple[str, ...], options: dict[str, Any]) -> None:
    """Refuse options of another use of the verb."""
    if name is None and (motion is not None or overrides):
        raise click.UsageError("--motion and --set are of one law: give its NAME, as in coulombus law lugre")
    if motion is None and (options["csv"] is not None or options["plot"] is not None):
        raise click.UsageError("--csv and --plot are of a motion: give --motion, too")


def _path(motion: str, options: dict[str, Any]) -> MotionPath:
    from coulombus.host.laws.path import ramp, read_motion, sine

    if motion not in ("sine", "ramp"):
        return read_motion(Path(motion))
    seconds, rate = options["seconds"], options["rate"]
    if not 1 <= seconds * rate <= MOST_SAMPLES:
        raise click.UsageError(f"--seconds {seconds:g} at --rate {rate:g}: expected 1 to {MOST_SAMPLES} samples")
    if motion == "ramp":
        return ramp(options["speed"], seconds, rate)
    return sine(options["amplitude"], options["frequency"], seconds, rate)


def _write(given: GivenLaw, driven: Driven, options: dict[str, Any]) -> None:
    from coulombus.recording.output_file import new_file

    if options["csv"] is not None:
        names = ("t_s", "x_rad", "v_rad_s", "torque_Nm")
        with new_file(options["csv"], force=options["overwrite"]) as path, path.open("w", encoding="ascii") as file:
            file.write(",".join(names) + "\n")
            columns = (driven.samples[name].tolist() for name in names)
            file.writelines(",".join(map(repr, row)) + "\n" for row in zip(*columns, strict=True))
    if options["plot"] is not None:
        from coulombus.analysis.figures.law import draw_law
        from coulombus.recording.pictures.plot import save_picture

        with new_file(options["plot"], force=options["overwrite"]) as path:
            save_picture(draw_law(given, driven), path)


def _tell(given: GivenLaw, driven: Driven, options: dict[str, Any]) -> None:
    """Print the result."""
    samples, work_J = driven.samples, driven.work_J
    document = {
        "law": given.name,
        "parameters": given.parameters.model_dump(),
        "samples": len(samples),
        "seconds": float(samples["t_s"][-1] - samples["t_s"][0]),
        "peak_Nm": driven.peak_Nm,
        "work_J": float(work_J[-1]),
        "least_work_J": float(work_J.min()),
        "csv": None if options["csv"] is None else str(options["csv"]),
        "plot": None if options["plot"] is None else str(options["plot"]),
    }
    if options["as_json"]:
        print_json(document)
        return
    echo(f"law {given.name}: {document['samples']} samples in {document['seconds']:g} s")
    if given.declaration is None:
        values = ", ".join(given.parameter_texts)
        echo(on_terminal(f"parameters      {values}, as in [mode.*] of a rig file; --set changes them", 16))
    echo(f"largest torque  {document['peak_Nm']:.6g} Nm")
    echo(f"work taken up   {document['work_J']:.6g} J, at least {document['least_work_J']:.6g} J on the way")
    for key in ("csv", "plot"):
        if document[key] is not None:
            say(f"{key}: {document[key]}")


def _as_dict(name: str, declared: Declaration | None) -> dict[str, Any]:
    from coulombus.host.laws.law import described

    return {"law": name, **({} if declared is None else described(declared))}


def _list(as_json: bool) -> None:
    from coulombus.host.laws.laws import BUILTIN_LAWS
    from coulombus.host.laws.plane.plane_laws import PLANE_LAWS

    laws, plane_laws = (
        [_as_dict(name, declared) for name, declared in listed.items()] for listed in (BUILTIN_LAWS, PLANE_LAWS)
    )
    with printed():
        if as_json:
            print_json({"laws": laws, "plane_laws": plane_laws})
            return
        width = max(len(entry["law"]) for entry in (*laws, *plane_laws))
        for entry in laws:
            echo(on_terminal(f"{entry['law']:<{width}}  {entry['title']}", width + 2))
        echo("\nin the plane, of a rig with [kinematics] (docs/plane.md):")
        for entry in plane_laws:
            echo(on_terminal(f"{entry['law']:<{width}}  {entry['title']}", width + 2))
        echo()
        echo("`coulombus law NAME` lists a law's parameters; docs/laws.md#equations has the equations")


def _describe(name: str, declared: Declaration | None, as_json: bool) -> None:
    from coulombus.host.laws.laws import BUILTIN_LAWS
    from coulombus.host.laws.plane.plane_laws import PLANE_LAWS

    entry = _as_dict(name, declared)
    with printed():
        if as_json:
            print_json(entry)
            return
        echo(f"{name}: {entry.get('title') or 'a law without named parameters'}")
        for doi in entry.get("doi", ()):
            echo(f"doi:{doi}")
        if name in BUILTIN_LAWS:
            echo(f"equation: docs/laws.md#{name}")
        elif name in PLANE_LAWS:
            echo("docs/plane.md#laws; what a rig can display: `coulombus analyse plane`")
        if entry.get("parameters"):
            _print_parameters(entry["parameters"])


def _print_parameters(parameters: list[dict[str, Any]]) -> None:
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for title in ("parameter", "default", "unit", "accepted", "meaning"):
        table.add_column(title, no_wrap=title in ("parameter", "unit"))
    for parameter in parameters:
        table.add_row(
            parameter["name"], str(parameter["default"]), parameter["unit"], parameter["accepted"], parameter["meaning"]
        )
    console = table_console(100)
    print_table(console, table)
