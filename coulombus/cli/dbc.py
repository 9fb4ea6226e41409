"""``coulombus dbc``: the rig's PDOs and services as a DBC file."""

from __future__ import annotations

from pathlib import Path

import click

from coulombus.cli.common import force_option, printed, rig_option, set_option
from coulombus.cli.errors import EXIT_STATUS, errors
from coulombus.cli.option_types import OutputFile
from coulombus.cli.rig_options import one_channel_option
from coulombus.cli.tables import echo

__all__ = ["dbc"]


@click.command(epilog=EXIT_STATUS)
@rig_option
@set_option
@one_channel_option
@click.option(
    "-o",
    "--out",
    type=OutputFile(),
    metavar="F.dbc",
    help="Write the file there.  [default: stdout]",
)
@force_option
def dbc(rig_name: str, overrides: tuple[str, ...], channel: str | None, out: Path | None, overwrite: bool) -> None:
    """Write a DBC file of the rig's PDOs and services, for cantools, SavvyCAN, PlotJuggler.

    \b
    Examples:
      coulombus dbc --rig bench -o bench.dbc
      cantools monitor -i coulombus -c bench bench.dbc
      candump -L can0 | cantools decode bench.dbc
    """
    with errors():
        from coulombus.monitor.dbc import dbc_text
        from coulombus.recording.output_file import new_file
        from coulombus.rigs.buses import one_bus
        from coulombus.rigs.rig import load_rig

        text = dbc_text(one_bus(load_rig(rig_name, overrides), None, channel)[0])
        if out is None:
            with printed():
                echo(text, nl=False)
            return
        with new_file(out, force=overwrite) as path:
            path.write_text(text, encoding="cp1252", errors="replace")  # the encoding that DBC readers expect
