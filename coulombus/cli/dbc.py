"""``coulombus dbc``: PDOs and services as a DBC, KCD or SYM file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import click

from coulombus.cli.errors import EXIT_STATUS, errors
from coulombus.cli.option_types import OutputFile
from coulombus.cli.options import OverwriteOption, option, with_options
from coulombus.cli.rig_options import KnownBusOptions
from coulombus.cli.tables import echo
from coulombus.system.exit import printed

__all__ = ["dbc"]


@click.command(epilog=EXIT_STATUS)
@with_options
def dbc(
    bus_options: KnownBusOptions,
    out: Annotated[
        Path | None,
        option(
            "-o",
            "--out",
            "Write the file there: .dbc, .kcd or .sym.  [default: a DBC file, to stdout]",
            type=OutputFile(".dbc", ".kcd", ".sym"),
            metavar="F.dbc",
        ),
    ],
    overwrite: OverwriteOption,
) -> None:
    """Write a DBC file of a rig's PDOs and services, or of devices by their EDS files, for cantools,
    SavvyCAN, PlotJuggler.

    Of an EDS file the PDOs are those that the device has at its start, with raw values, as
    `coulombus decode --eds` prints them. With -o F.kcd or F.sym a KCD or SYM file.

    \b
    Examples:
      coulombus dbc --rig bench -o bench.dbc
      coulombus dbc --eds 5=drive.eds --eds 6=io.xdd -o cell.dbc
      cantools monitor -i coulombus -c bench bench.dbc
      candump -L can0 | cantools decode bench.dbc
    """
    with errors():
        from coulombus.monitor.dbc import database_text, file_encoding
        from coulombus.recording.output_file import new_file

        suffix = ".dbc" if out is None else out.suffix.lower()
        text = database_text(bus_options.known_bus()[0], suffix)
        if out is None:
            with printed():
                echo(text, nl=False)
            return
        with new_file(out, force=overwrite) as path:
            path.write_text(text, **file_encoding(suffix))
