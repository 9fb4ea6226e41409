"""``coulombus law``: the friction laws, and a law along a given motion."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import click

from coulombus.cli.errors import EXIT_STATUS, errors, print_json
from coulombus.cli.option_types import PICTURE, SECONDS, OutputFile
from coulombus.cli.options import JsonOption, OverwriteOption, argument, option, with_options
from coulombus.cli.tables import echo, on_terminal, print_table, table_console
from coulombus.system.exit import printed, say

if TYPE_CHECKING:
    from coulombus.host.laws.along import Driven, GivenLaw
    from coulombus.host.laws.law import Declaration
    from coulombus.host.laws.path import MotionPath

__all__ = ["law_command"]


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


@dataclass(frozen=True)
class MotionOptions:
    """The motion along which a law is driven, its parameters, and the output files."""

    motion: Annotated[
        str | None,
        option(
            "Drive the law along it: a CSV file with the columns t_s,x_rad, a sine, or a constant speed.",
            metavar="F.csv|sine|ramp",
        ),
    ]
    overrides: Annotated[
        tuple[str, ...], option("--set", "Set a parameter of the law, as F_c_Nm=0.8.", metavar="KEY=V")
    ]
    amplitude: Annotated[float, option("Amplitude of the sine.", type=POSITIVE, default=0.1, metavar="RAD")]
    frequency: Annotated[float, option("Frequency of the sine.", type=POSITIVE, default=1.0, metavar="HZ")]
    speed: Annotated[float, option("Speed of the ramp.", type=_Finite(-1e9, 1e9), default=1.0, metavar="RAD/S")]
    seconds: Annotated[float, option("Length of sine or ramp.", type=SECONDS, default=2.0)]
    rate: Annotated[float, option("Samples per second of sine or ramp.", type=POSITIVE, default=1000.0, metavar="HZ")]
    csv: Annotated[Path | None, option("Write t_s,x_rad,v_rad_s,torque_Nm there.", type=OutputFile(), metavar="OUT")]
    plot: Annotated[
        Path | None, option("--picture", "--plot", "Draw motion, torque and loop there.", type=PICTURE, metavar="F.png")
    ]
    overwrite: OverwriteOption

    def check(self, name: str | None) -> None:
        """Refuse options of another use of the verb."""
        if name is None and (self.motion is not None or self.overrides):
            raise click.UsageError("--motion and --set are of one law: give its NAME, as in coulombus law lugre")
        if self.motion is None and (self.csv is not None or self.plot is not None):
            raise click.UsageError("--csv and --plot are of a motion: give --motion, too")

    def path(self, motion: str) -> MotionPath:
        """Return the angles of --motion over time."""
        from coulombus.host.laws.path import ramp, read_motion, sine
        from coulombus.rigs.errors import nearest

        if motion not in ("sine", "ramp"):
            if not (Path(motion).exists() or "." in motion or "/" in motion):
                hint = nearest(motion, ("sine", "ramp"))
                raise click.BadParameter(f"{motion!r}: expected a CSV file, sine or ramp{hint}", param_hint="--motion")
            return read_motion(Path(motion))
        if not 1 <= self.seconds * self.rate <= MOST_SAMPLES:
            raise click.UsageError(
                f"--seconds {self.seconds:g} at --rate {self.rate:g}: expected 1 to {MOST_SAMPLES} samples"
            )
        if motion == "ramp":
            return ramp(self.speed, self.seconds, self.rate)
        return sine(self.amplitude, self.frequency, self.seconds, self.rate)

    def write(self, law: GivenLaw, driven: Driven) -> None:
        """Write the requested files."""
        from coulombus.recording.output_file import new_file

        if self.csv is not None:
            names = ("t_s", "x_rad", "v_rad_s", "torque_Nm")
            with new_file(self.csv, force=self.overwrite) as path, path.open("w", encoding="ascii") as file:
                file.write(",".join(names) + "\n")
                columns = (driven.samples[name].tolist() for name in names)
                file.writelines(",".join(map(repr, row)) + "\n" for row in zip(*columns, strict=True))
        if self.plot is not None:
            from coulombus.analysis.figures.law import draw_law
            from coulombus.recording.pictures.plot import save_picture

            with new_file(self.plot, force=self.overwrite) as path:
                save_picture(draw_law(law, driven), path)


@click.command("law", epilog=EXIT_STATUS)
@with_options
def law_command(
    name: Annotated[str | None, argument(required=False)],
    options: MotionOptions,
    as_json: JsonOption,
) -> None:
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
        options.check(name)
        if name is None:
            _list(as_json)
            return
        from coulombus.host.laws.along import given_law
        from coulombus.host.laws.plane.plane_laws import PLANE_LAWS

        if name in PLANE_LAWS:
            if options.motion is not None or options.overrides:
                raise click.BadParameter(
                    f"{name} is a law in the plane, and --motion and --set are of one axis: `coulombus simulate --rig "
                    f"plane --law {name}`, or in Python as in docs/plane.md#laws",
                    param_hint="NAME",
                )
            _describe(name, PLANE_LAWS[name], as_json)
            return
        law = given_law(name, options.overrides)
        if options.motion is None:
            _describe(law.name, law.declaration, as_json)
            return
        driven = law.along(*options.path(options.motion))
        options.write(law, driven)
        with printed():
            _print_driven(law, driven, options, as_json)


def _print_driven(law: GivenLaw, driven: Driven, options: MotionOptions, as_json: bool) -> None:
    """Print the result."""
    samples, work_J = driven.samples, driven.work_J
    document = {
        "law": law.name,
        "parameters": law.parameters.model_dump(),
        "samples": len(samples),
        "seconds": float(samples["t_s"][-1] - samples["t_s"][0]),
        "peak_Nm": driven.peak_Nm,
        "work_J": float(work_J[-1]),
        "least_work_J": float(work_J.min()),
        "csv": None if options.csv is None else str(options.csv),
        "plot": None if options.plot is None else str(options.plot),
    }
    if as_json:
        print_json(document)
        return
    echo(f"law {law.name}: {document['samples']} samples in {document['seconds']:g} s")
    if law.declaration is None:
        values = ", ".join(law.parameter_texts)
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
