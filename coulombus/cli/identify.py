"""`coulombus identify`: friction, a law or the brake's iron from a recording."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import click

from coulombus.cli.errors import EXIT_STATUS, errors, print_json, remark
from coulombus.cli.option_types import PICTURE
from coulombus.cli.options import (
    FileChannelOption,
    JsonOption,
    OverwriteOption,
    RecordingArgument,
    option,
    with_options,
)
from coulombus.cli.tables import echo, on_terminal
from coulombus.system.exit import printed, say

if TYPE_CHECKING:
    from coulombus.recording.signals import Source

__all__ = ["identify"]


@dataclass(frozen=True)
class IdentifyOptions:
    """A recording or a table, the model, and the form of the result."""

    file: RecordingArgument
    rig_name: Annotated[str | None, option("--rig", "Decode with this rig instead of the attached one.", metavar="R")]
    figure: Annotated[
        Path | None,
        option("--picture", "--figure", "Write the plot there (.png, .svg, .pdf).", type=PICTURE, metavar="F"),
    ]
    channels: FileChannelOption
    overwrite: OverwriteOption
    axis: Annotated[str | None, option("Axis of a rig with several.", metavar="A")]
    law: Annotated[str | None, option("Fit this law's parameters instead.", metavar="NAME")]
    columns: Annotated[
        tuple[str, ...], option("--column", "Of a table: t, angle, torque, brake or load.", metavar="C=NAME")
    ]
    units: Annotated[tuple[str, ...], option("--unit", "Of a table: the unit of a column.", metavar="C=UNIT")]
    ratio: Annotated[
        float | None, option("Of a table: motor turns for one of the angle; finds cogging.", type=float, metavar="N")
    ]
    iron: Annotated[bool, option("Fit the magnetic hysteresis of the brake instead.")]
    overrides: Annotated[tuple[str, ...], option("--set", "With --law: hold a parameter at a value.", metavar="KEY=V")]
    target: Annotated[
        str | None, option("--to", "Print a MuJoCo model of one hinge instead.", type=click.Choice(["mjcf"]))
    ]
    as_json: JsonOption

    def check(self, *, table: bool) -> None:
        """Refuse incompatible options, and those of the other kind of file.

        Raises
        ------
        click.UsageError
            It says which option, and why.
        """
        if self.target is not None:
            if self.iron or self.as_json or self.figure is not None:
                raise click.UsageError("--to goes with none of --iron, --json and --figure")
            if self.law not in (None, "lugre"):
                raise click.UsageError(f"MuJoCo has no law {self.law}: give --law lugre, or leave it out")
        of_recording = {"--rig": self.rig_name, "--axis": self.axis, "--channel": self.channels, "--iron": self.iron}
        of_table = {"--column": self.columns, "--unit": self.units, "--ratio": self.ratio}
        others = of_recording if table else of_table
        superfluous = [name for name, value in others.items() if value not in (None, (), False)]
        if superfluous:
            kinds = ("a table", "a recording") if table else ("a recording", "a table")
            raise click.UsageError(f"{self.file} is {kinds[0]}; {superfluous[0]} is for {kinds[1]}: leave it out")
        if self.iron and (self.figure is not None or self.law is not None or self.overrides):
            raise click.UsageError("--iron goes with none of --figure, --law and --set")
        if self.law is not None and self.figure is not None:
            raise click.UsageError("--figure is of the fit without --law")
        if self.law is None and self.overrides:
            raise click.UsageError("--set holds a parameter of a law: give --law NAME, too")

    @contextmanager
    def recorded_axis(self) -> Iterator[Source]:
        """Yield the axis of the recording; print the remarks on it at the end, be it an error."""
        from coulombus.recording.reading import blocks
        from coulombus.rigs.rig import load_rig

        rig = None if self.rig_name is None else load_rig(self.rig_name)
        axis = blocks(self.file, rig, self.channels).one_axis(self.axis)
        try:
            yield axis
        finally:
            remark(axis.remarks)

    def write_figure(self, fit: Any) -> None:
        """Draw a fit, if that is requested."""
        if self.figure is None:
            return
        from coulombus.analysis.figures.rig import write_identification
        from coulombus.recording.output_file import new_file

        with new_file(self.figure, force=self.overwrite) as path:
            write_identification(path, fit)
        say(f"figure: {self.figure}")

    def print_fit(self, fit: Any, lines: Iterable[str], mjcf: Callable[[], str]) -> None:
        """Print a fit as its lines, as JSON, or as a MuJoCo model."""
        with printed():
            if self.target is not None:
                echo(mjcf())
            elif self.as_json:
                print_json(fit.as_dict())
            else:
                for line in "\n".join(lines).split("\n"):
                    echo(on_terminal(line, 6 if line.startswith("note: ") else 23))


@click.command("identify", epilog=EXIT_STATUS)
@with_options
def identify(options: IdentifyOptions) -> None:
    """Identify friction from a recording by least squares: Coulomb, viscous, and Stribeck where the
    data carry it.

    What is felt at the handle comes first, the device's own friction (the motor's torque added)
    second, each with its 95 % confidence interval. The recording needs strokes, to and fro, best at
    several speeds and with the coil off.

    FILE may be a table, too: CSV, Parquet or MAT, with the columns t, angle, torque, and brake and load
    where there are any. A unit stands in the column's name (angle_deg, "torque [mNm]") or in --unit.

    With --law the parameters of that law are sought that give the hand's torque along the recorded
    angle, or along that of a table.

    With --iron the brake's magnetic hysteresis is sought, as [brake.iron] of the rig file takes it.
    The brake's set-point must change up and down while the handle slides.

    With --to mjcf the device's own friction is printed as MuJoCo's frictionloss, damping and armature,
    the law lugre as its dcmotor.

    \b
    Examples:
      coulombus simulate --mode active --record active.pcapng && coulombus identify active.pcapng
      coulombus identify strokes.pcapng --json
      coulombus identify strokes.pcapng --figure friction.png
      coulombus identify strokes.csv --law lugre --set sigma_2_Nms_rad=0
      coulombus identify bench.mat --column angle=phi --unit angle=deg
      coulombus identify damper.pcapng --iron
      coulombus identify strokes.csv --law lugre --to mjcf > joint.xml
    """
    with errors():
        from coulombus.recording.friction.columns import is_table

        table = is_table(options.file)
        options.check(table=table)
        if options.iron:
            _identify_iron(options)
        elif options.law is not None:
            _identify_law(options, options.law, table)
        elif table:
            _identify_table(options)
        else:
            _identify_recording(options)


def _identify_recording(options: IdentifyOptions) -> None:
    from coulombus.recording.friction import identify as friction
    from coulombus.recording.friction.mjcf import friction_mjcf

    with options.recorded_axis() as axis:
        fit = friction.identify(axis)
    options.write_figure(fit)
    options.print_fit(fit, friction.lines(fit), lambda: friction_mjcf(fit.device, options.file.name))


def _identify_table(options: IdentifyOptions) -> None:
    from coulombus.recording.friction.columns import read_table
    from coulombus.recording.friction.mjcf import friction_mjcf
    from coulombus.recording.friction.table_identify import identify_table, table_lines

    fit = identify_table(read_table(options.file, options.columns, options.units), options.ratio)
    options.write_figure(fit.identification)
    options.print_fit(fit, table_lines(fit), lambda: friction_mjcf(fit.identification.device, options.file.name))


def _identify_iron(options: IdentifyOptions) -> None:
    from coulombus.recording.friction.hysteresis_fit import identify_iron, iron_lines

    with options.recorded_axis() as axis:
        fit = identify_iron(axis)
    options.print_fit(fit, iron_lines(fit), lambda: "")


def _identify_law(options: IdentifyOptions, law: str, table: bool) -> None:
    from coulombus.analysis.rig.law_fit import Stretch, fit_law, lines, stretches_of
    from coulombus.recording.friction.columns import read_table
    from coulombus.recording.friction.mjcf import lugre_mjcf
    from coulombus.recording.friction.sliding import IdentifyError

    file = options.file
    data: tuple[Stretch, ...]
    if table:
        rows = read_table(file, options.columns, options.units)
        data = (Stretch(rows.t_s, rows.angle_rad, rows.torque_Nm),)
    else:
        with options.recorded_axis() as axis:
            data = stretches_of(axis)
    try:
        fit = fit_law(law, data, options.overrides, rig=None if table else True)
    except IdentifyError as error:
        raise IdentifyError(f"{file}: {error}".replace(f"{file}: {file}:", f"{file}:")) from error
    options.print_fit(fit, lines(fit), lambda: lugre_mjcf(fit.values, fit.estimates, fit.inertia_kg_m2, file.name))
