"""``coulombus plot``: plot a recording."""

from __future__ import annotations

from pathlib import Path

import click

from coulombus.cli.common import file_channel_option, force_option, recording_argument, say, signals_option, verdict
from coulombus.cli.errors import EXIT_STATUS, errors, remark
from coulombus.cli.option_types import PICTURE

__all__ = ["plot_command"]


def _span(ctx: click.Context, param: click.Parameter, text: str | None) -> tuple[float | None, float | None]:
    from coulombus.recording.span import parse_span

    try:
        return (None, None) if text is None else parse_span(text)
    except ValueError as error:
        raise click.BadParameter(str(error)) from None


@click.command("plot", epilog=EXIT_STATUS)
@recording_argument
@signals_option
@click.option("--span", callback=_span, metavar="A:B", help="From A to B, in s, as 3:5, 2.5: or :10.  [default: all]")
@click.option("-o", "--out", type=PICTURE, metavar="F.png", help="A .png, .svg or .pdf.  [default: FILE, as .png]")
@click.option("--rig", "rig_name", metavar="R", help="Decode with this rig instead of the attached one.")
@file_channel_option
@force_option
def plot_command(
    file: Path,
    signals: tuple[str, ...] | None,
    span: tuple[float | None, float | None],
    out: Path | None,
    rig_name: str | None,
    channels: tuple[str, ...],
    overwrite: bool,
) -> None:
    """Draw a recording's signals over time, a panel for each unit, with the markers.

    Where there are more samples than room, the least and the largest value are drawn. Without
    --signals words of bits are left out.

    \b
    Examples:
      coulombus plot run.pcapng
      coulombus plot run.pcapng --signals motor.position_rad,brake.handle_torque_Nm --span 3:5 -o hold.svg
    """
    with errors():
        from coulombus.recording.output_file import new_file, reason_against
        from coulombus.recording.pictures.plot import plot, save_picture
        from coulombus.recording.reading import blocks

        place = out or (Path(f"{file}.png") if file.is_dir() else file.with_suffix(".png"))
        reason = reason_against(
            place, force=overwrite, remedy="choose another name by -o, or replace it with --overwrite"
        )
        if reason is not None:
            raise click.UsageError(reason)
        source = blocks(file, rig_name, channels)
        made = plot(source, signals, span)
        with new_file(place, force=overwrite) as path:
            save_picture(made, path)
        with verdict(0):
            remark(source.remarks)
            say(f"{place}: drawn")
