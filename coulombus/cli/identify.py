"""`coulombus identify`: friction, a law or the brake's iron from a recording."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import click

from coulombus.cli.common import file_channel_option, force_option, json_option, printed, say
from coulombus.cli.errors import EXIT_STATUS, errors, print_json, remark
from coulombus.cli.option_types import PICTURE, InputPath
from coulombus.cli.tables import echo, on_terminal

__all__ = ["identify"]


@click.command("identify", epilog=EXIT_STATUS)
@click.argument("file", type=InputPath())
@click.option("--rig", "rig_name", metavar="R", help="Decode with this rig instead of the attached one.")
@click.option(
    "--picture", "--figure", "figure", type=PICTURE, metavar="F", help="Write the plot there (.png, .svg, .pdf)."
)
@file_channel_option
@force_option
@click.option("--axis", metavar="A", help="Axis of a rig with several.")
@click.option("--law", "law", metavar="NAME", help="Fit this law's parameters instead.")
@click.option(
    "--column", "columns", multiple=True, metavar="C=NAME", help="Of a table: t, angle, torque, brake or load."
)
@click.option("--unit", "units", multiple=True, metavar="C=UNIT", help="Of a table: the unit of a column.")
@click.option("--ratio", type=float, metavar="N", help="Of a table: motor turns for one of the angle; finds cogging.")
@click.option("--iron", is_flag=True, help="Fit the magnetic hysteresis of the brake instead.")
@click.option("--set", "overrides", multiple=True, metavar="KEY=V", help="With --law: hold a parameter at a value.")
@click.option("--to", "target", type=click.Choice(["mjcf"]), help="Print a MuJoCo model of one hinge instead.")
@json_option
def identify(
    file: Path, rig_name: str | None, figure: Path | None, overwrite: bool, axis: str | None, **options: Any
) -> None:
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
    as_json = options["as_json"]
    if options["target"] is not None:
        if options["iron"] or as_json or figure is not None:
            raise click.UsageError("--to goes with none of --iron, --json and --figure")
        if options["law"] not in (None, "lugre"):
            raise click.UsageError(f"MuJoCo has no law {options['law']}: give --law lugre, or leave it out")
    table = _is_table(file)
    _check_kind(file, table, {"--rig": rig_name, "--axis": axis}, options)
    if options["iron"]:
        if figure is not None or options["law"] is not None or options["overrides"]:
            raise click.UsageError("--iron goes with none of --figure, --law and --set")
        with errors():
            _identify_iron(file, rig_name, axis, options["channels"], as_json=as_json)
        return
    if options["law"] is not None:
        if figure is not None:
            raise click.UsageError("--figure is of the fit without --law")
        with errors():
            _identify_law(file, table, rig_name, axis, options)
        return
    if options["overrides"]:
        raise click.UsageError("--set holds a parameter of a law: give --law NAME, too")
    if table:
        with errors():
            _identify_table(file, figure, overwrite, options)
        return
    with errors():
        from coulombus.recording.friction import identify as friction
        from coulombus.recording.output_file import new_file
        from coulombus.recording.reading import blocks
        from coulombus.rigs.rig import load_rig

        recording = blocks(file, None if rig_name is None else load_rig(rig_name), options["channels"])
        seen = recording.one_axis(axis)
        try:
            fit = friction.identify(seen)
        finally:
            remark(seen.remarks)
        if figure is not None:
            from coulombus.analysis.figures.rig import write_identification

            with new_file(figure, force=overwrite) as path:
                write_identification(path, fit)
            say(f"figure: {figure}")
        with printed():
            if options["target"] is not None:
                _print_mjcf(fit.device, file)
            elif as_json:
                print_json(fit.as_dict())
            else:
                _print(friction.lines(fit))


def _is_table(file: Path) -> bool:
    from coulombus.recording.friction.columns import is_table

    with errors():
        return is_table(file)


def _check_kind(file: Path, table: bool, of_recording: dict[str, Any], options: dict[str, Any]) -> None:
    """Refuse the options that the other kind of file has.

    Raises
    ------
    click.UsageError
        It says which option, and what the file is.
    """
    of_recording |= {"--channel": options["channels"], "--iron": options["iron"]}
    of_table = {"--column": options["columns"], "--unit": options["units"], "--ratio": options["ratio"]}
    given = [name for name, value in (of_recording if table else of_table).items() if value not in (None, (), False)]
    if given:
        kinds = ("a table", "a recording") if table else ("a recording", "a table")
        raise click.UsageError(f"{file} is {kinds[0]}; {given[0]} is for {kinds[1]}: leave it out")


def _identify_table(file: Path, figure: Path | None, overwrite: bool, options: dict[str, Any]) -> None:
    from coulombus.recording.friction.columns import read_table
    from coulombus.recording.friction.table_identify import identify_table, table_lines
    from coulombus.recording.output_file import new_file

    table = read_table(file, options["columns"], options["units"])
    fit = identify_table(table, options["ratio"])
    if figure is not None:
        from coulombus.analysis.figures.rig import write_identification

        with new_file(figure, force=overwrite) as path:
            write_identification(path, fit.identification)
        say(f"figure: {figure}")
    with printed():
        if options["target"] is not None:
            _print_mjcf(fit.identification.device, file)
        elif options["as_json"]:
            print_json(fit.as_dict())
        else:
            _print(table_lines(fit))


def _print_mjcf(fit: Any, file: Path) -> None:
    from coulombus.recording.friction.mjcf import friction_mjcf

    echo(friction_mjcf(fit, file.name))


def _print(lines: Iterable[str]) -> None:
    for line in "\n".join(lines).split("\n"):
        echo(on_terminal(line, 6 if line.startswith("note: ") else 23))


def _identify_iron(
    file: Path, rig_name: str | None, axis: str | None, channels: tuple[str, ...], *, as_json: bool
) -> None:
    from coulombus.recording.friction.hysteresis_fit import identify_iron, iron_lines
    from coulombus.recording.reading import blocks
    from coulombus.rigs.rig import load_rig

    seen = blocks(file, None if rig_name is None else load_rig(rig_name), channels).one_axis(axis)
    try:
        fit = identify_iron(seen)
    finally:
        remark(seen.remarks)
    with printed():
        if as_json:
            print_json(fit.as_dict())
        else:
            _print(iron_lines(fit))


def _identify_law(file: Path, table: bool, rig_name: str | None, axis: str | None, options: dict[str, Any]) -> None:
    from coulombus.analysis.rig.law_fit import Stretch, fit_law, lines, stretches_of
    from coulombus.recording.friction.columns import read_table
    from coulombus.recording.friction.sliding import IdentifyError
    from coulombus.recording.reading import blocks
    from coulombus.rigs.rig import load_rig

    data: tuple[Stretch, ...]
    if table:
        rows = read_table(file, options["columns"], options["units"])
        data = (Stretch(rows.t_s, rows.angle_rad, rows.torque_Nm),)
    else:
        recording = blocks(file, None if rig_name is None else load_rig(rig_name), options["channels"])
        seen = recording.one_axis(axis)
        try:
            data = stretches_of(seen)
        finally:
            remark(seen.remarks)
    try:
        fit = fit_law(options["law"], data, options["overrides"], rig=None if table else True)
    except IdentifyError as error:
        raise IdentifyError(f"{file}: {error}".replace(f"{file}: {file}:", f"{file}:")) from error
    with printed():
        if options["target"] is not None:
            from coulombus.recording.friction.mjcf import lugre_mjcf

            echo(lugre_mjcf(fit.values, fit.estimates, fit.inertia_kg_m2, file.name))
        elif options["as_json"]:
            print_json(fit.as_dict())
        else:
            _print(lines(fit))
