"""``coulombus tools``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import click

from coulombus.cli.errors import EXIT_STATUS, errors, print_json
from coulombus.cli.option_types import OutputDirectory
from coulombus.cli.options import JsonOption, OverwriteOption, argument, with_options
from coulombus.cli.rig_options import KnownBusOptions
from coulombus.cli.tables import echo
from coulombus.system.exit import printed

__all__ = ["tools"]


@click.command(epilog=EXIT_STATUS)
@with_options
def tools(
    folder: Annotated[Path, argument(metavar="DIR", type=OutputDirectory())],
    bus_options: KnownBusOptions,
    overwrite: OverwriteOption,
    as_json: JsonOption,
) -> None:
    """Write files that describe the rig, or devices by their EDS files, to other tools into the
    folder DIR.

    DBC, KCD and SYM files; a Wireshark dissector and profile; layouts of PlotJuggler and Foxglove;
    README.md says how each is used.

    \b
    Examples:
      coulombus tools out/tools
      coulombus tools out/tools --rig my-rig.toml --overwrite
      coulombus tools out/tools --eds 5=drive.eds
      tshark -X lua_script:out/tools/bench.lua -r run.pcapng -Y 'coulombus.motor.position > 1'
    """
    with errors():
        from coulombus.monitor.dbc import file_encoding
        from coulombus.monitor.tools.tool_files import tool_files
        from coulombus.recording.output_file import new_file, reason_against

        bus, _ = bus_options.known_bus()
        files = {folder / name: text for name, text in tool_files(bus).items()}
        for path in files:
            path.parent.mkdir(parents=True, exist_ok=True)
            reason = reason_against(
                path, force=overwrite, remedy="choose another folder, or replace it with --overwrite"
            )
            if reason is not None:
                raise click.UsageError(reason)
        for path, text in files.items():
            with new_file(path, force=overwrite) as place:
                place.write_text(text, **file_encoding(path.suffix))
        if as_json:
            print_json({"rig": bus.name, "files": [str(path) for path in files]})
            return
        with printed():
            for path in files:
                echo(path)
