"""``coulombus plot``: plot a recording."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import click

from coulombus.cli.errors import EXIT_STATUS, errors, remark
from coulombus.cli.option_types import PICTURE, output_named_after
from coulombus.cli.options import OverwriteOption, RecordingArgument, SignalsOption, SpanOption, option, with_options
from coulombus.cli.rig_options import LogOptions
from coulombus.system.exit import say, verdict

if TYPE_CHECKING:
    from coulombus.recording.pictures.plot import Plot

__all__ = ["plot_command"]

SIZES_CM = (2.0, 100.0)
"""The least and the largest width and height of a picture."""


def _size(ctx: click.Context, param: click.Parameter, text: str | None) -> tuple[float, float] | None:
    if text is None:
        return None
    try:
        width, height = (float(part) for part in text.lower().split("x"))
    except ValueError:
        width = height = 0.0
    if not (SIZES_CM[0] <= width <= SIZES_CM[1] and SIZES_CM[0] <= height <= SIZES_CM[1]):
        limits = f"{SIZES_CM[0]:g} to {SIZES_CM[1]:g} cm each"
        raise click.BadParameter(f"{text!r}: expected WIDTHxHEIGHT in cm, as 16x9, {limits}")
    return width, height


@dataclass(frozen=True)
class LookOptions:
    """The options of a picture's look as they are given."""

    title: Annotated[str | None, option("Title of the picture.  [default: the file's name]", metavar="TEXT")]
    size_cm: Annotated[
        tuple[float, float] | None, option("--size", "Width and height in cm, as 16x9.", callback=_size, metavar="WxH")
    ]
    dpi: Annotated[
        float | None, option("Resolution of a .png.  [default: 140]", type=click.FloatRange(30, 1200), metavar="N")
    ]


def _not_visible(data: Plot) -> list[str]:
    """Return a line on the curves that others cover, and one on the signals that are not drawn."""
    from coulombus.recording.pictures.plot import hidden

    covered = [f"{name} under {other}" for name, other in hidden(data)]
    lines = [f"drawn wide, because another curve covers it: {', '.join(covered)}"] if covered else []
    if data.left_out:
        lines.append(f"not drawn: {', '.join(data.left_out)} (no unit; name them with --signals)")
    return lines


@click.command("plot", epilog=EXIT_STATUS)
@with_options
def plot_command(
    file: RecordingArgument,
    signals: SignalsOption,
    span: SpanOption,
    out: Annotated[
        Path | None,
        option("-o", "--out", "A .png, .svg or .pdf.  [default: FILE, as .png]", type=PICTURE, metavar="F.png"),
    ],
    log: LogOptions,
    overwrite: OverwriteOption,
    look: LookOptions,
) -> None:
    """Draw a recording's signals over time, a panel for each unit, with the markers.

    Where there are more samples than room, the least and the largest value are drawn. Without
    --signals words of bits are left out. The output names them, and each curve under another one.

    \b
    Examples:
      coulombus plot run.pcapng
      coulombus plot run.pcapng --signals motor.position_rad,brake.handle_torque_Nm --span 3:5 -o hold.svg
      coulombus plot candump.log --eds 5=drive.eds --signals 5.TPDO1.6064h:00
      coulombus plot run.pcapng --title "Subject 3, hybrid" --size 16x9 --dpi 300
    """
    with errors():
        from coulombus.recording.output_file import new_file
        from coulombus.recording.pictures.plot import Look, figure_of, save_picture, traces_of
        from coulombus.recording.reading import blocks

        place = out or output_named_after(file, ".png", overwrite)
        source = blocks(file, log.rig_name, log.channels, eds=log.files())
        data = traces_of(source, signals, span)
        figure = figure_of(data, Look(look.title, look.size_cm, look.dpi))
        with new_file(place, force=overwrite) as path:
            save_picture(figure, path, look.dpi)
        with verdict(0):
            remark(source.remarks)
            say(f"{place}: drawn")
            for line in _not_visible(data):
                say(line)
