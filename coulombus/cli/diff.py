"""``coulombus diff``: compare two recordings."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import click

from coulombus.cli.errors import EXIT_STATUS, errors, print_json, remark
from coulombus.cli.option_types import PICTURE
from coulombus.cli.options import JsonOption, OverwriteOption, RecordingArgument, option, with_options
from coulombus.cli.rig_options import LogOptions
from coulombus.cli.tables import echo, print_table, table_console
from coulombus.system.exit import verdict

if TYPE_CHECKING:
    from coulombus.recording.difference import Comparison, Difference

__all__ = ["diff"]


def _tolerances(ctx: click.Context, param: click.Parameter, texts: tuple[str, ...]) -> dict[str, float]:
    tolerances: dict[str, float] = {}
    for text in texts:
        name, _, number = text.rpartition("=")
        try:
            value = float(number)
        except ValueError:
            value = math.nan
        if not 0 <= value < math.inf or name in tolerances:
            reason = "twice" if name in tolerances else "expected V, SIGNAL=V or UNIT=V, as in Nm=0.05"
            raise click.BadParameter(f"{text!r}: {reason}")
        tolerances[name] = value
    return tolerances


@click.command("diff", epilog=EXIT_STATUS)
@with_options
def diff(
    a: RecordingArgument,
    b: RecordingArgument,
    tolerances: Annotated[
        dict[str, float],
        option(
            "--tolerance",
            "The largest difference that counts as equal; V alone: for every signal with a unit.  [default: 0 of all]",
            multiple=True,
            callback=_tolerances,
            metavar="[SIGNAL=|UNIT=]V",
        ),
    ],
    out: Annotated[
        Path | None, option("-o", "--out", "Draw both and their difference there.", type=PICTURE, metavar="F.png")
    ],
    log: LogOptions,
    overwrite: OverwriteOption,
    as_json: JsonOption,
) -> None:
    """Compare two recordings: two runs, or a simulated one and the rig's.

    They are aligned by their phases. Ends with 0 when they are equal, with 1 when not. Without
    --tolerance everything must be equal; with it the phases are compared, and those signals are
    judged that have a tolerance.

    \b
    Examples:
      coulombus diff monday.pcapng tuesday.pcapng
      coulombus diff sim.pcapng rig.pcapng --tolerance Nm=0.1 --tolerance motor.position_rad=0.02 -o diff.png
      coulombus diff before.log after.log --eds 5=drive.eds
    """
    with errors():
        from coulombus.recording.comparison import compare
        from coulombus.recording.output_file import new_file

        comparison = compare(a, b, tolerances=tolerances, rig=log.rig_name, channel=log.channels, eds=log.files())
        if out is not None:
            from coulombus.recording.pictures.differences import draw_differences
            from coulombus.recording.pictures.plot import save_picture

            with new_file(out, force=overwrite) as path:
                save_picture(draw_differences(comparison), path)
        with verdict(0 if comparison.equal else 1):
            remark(comparison.remarks)
            if as_json:
                print_json(_plain(comparison.as_dict()))
            else:
                _print_comparison(comparison)


def _plain(value: Any) -> Any:
    """Return a value for JSON: NaN and infinity become null."""
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list):
        return [_plain(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _print_comparison(comparison: Comparison) -> None:
    """Print the differences as text."""
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    table.add_column("signal", no_wrap=True)  # the name ends with its unit
    for name in ("max", "rms", "at [s]"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("in")
    table.add_column("verdict", no_wrap=True)
    for difference in comparison.signals:
        when = "" if difference.at_s is None else f"{difference.at_s:.3f}"
        table.add_row(
            difference.name,
            f"{difference.max:.4g}",
            f"{difference.rms:.4g}",
            when,
            difference.phase,
            _verdict(difference),
        )
    if comparison.signals:
        console = table_console(80)
        print_table(console, table)
    echo("the same bytes" if comparison.same_bytes else "equal" if comparison.equal else "not equal")


def _verdict(difference: Difference) -> str:
    if difference.tolerance is None:
        return "not judged"
    if difference.equal:
        return "equal"
    beyond = difference.max > difference.tolerance
    return "differs" if beyond else "count differs"  # one has more samples in a phase
