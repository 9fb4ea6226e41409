"""``coulombus hz`` and ``pdo``: when frames come, and what is in them."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click
from click.core import ParameterSource

from coulombus.cli.common import json_option, load, printed, rig_option, say, set_option
from coulombus.cli.errors import EXIT_STATUS, errors, print_json, remark
from coulombus.cli.option_types import SECONDS, InputPath
from coulombus.cli.rig_options import OneBusOptions, one_bus_options, one_channel_option
from coulombus.cli.tables import echo

if TYPE_CHECKING:
    from coulombus.monitor.live import PdoRow

__all__ = ["hz", "pdo"]


@click.command(epilog=EXIT_STATUS)
@click.argument("file", required=False, type=InputPath())
@one_bus_options
@click.option("--seconds", type=SECONDS, default=5.0, show_default=True, help="How long to listen to a bus.")
@json_option
def hz(
    file: Path | None,
    chosen: OneBusOptions,
    seconds: float,
    as_json: bool,
) -> None:
    """Measure rate and jitter of each identifier, and how long after SYNC the PDOs come.

    Of a bus, to which nothing is sent, or of a recording FILE. Jitter is how far the time between
    two frames is from its median.

    \b
    Examples:
      coulombus hz --bus socketcan:can0 --seconds 10
      coulombus hz run.pcapng
      coulombus hz candump.log --rig bench --json
    """
    with errors():
        from coulombus.monitor.timing import as_dict, as_lines, listen, recorded, timing

        if file is not None:
            if chosen.bus_name is not None:
                raise click.UsageError("a file and --bus: give one of them")
            from coulombus.recording.reading import blocks

            given = click.get_current_context().get_parameter_source("rig_name") is not ParameterSource.DEFAULT
            recording = blocks(file, rig=chosen.load() if given or chosen.overrides else None)
            rig, stamps, lost = recording.rig, recorded(recording), None
            where, source = str(file), "the recording's"
            remark(recording.remarks)
        else:
            rig, address = chosen.found()
            if sys.stderr.isatty():
                say(f"coulombus: listening to {address} for {seconds:g} s")
            stamps, lost = listen(address, seconds)
            where, source = str(address), address.stamps
        rows = timing(rig, stamps)
        if as_json:
            print_json({"of": where, "stamps": source, "lost": lost, "identifiers": [as_dict(row) for row in rows]})
            return
        with printed():
            echo(f"{where}\nstamps: {source}" + ("" if lost is None else f"\nlost {lost}"))
            for line in as_lines(rows):
                echo(line)


@click.command(epilog=EXIT_STATUS)
@rig_option
@set_option
@click.option("--bus", "bus_name", metavar="B", help="Fill it with what this bus carries now; nothing is sent.")
@click.option("--seconds", type=SECONDS, default=1.0, show_default=True, help="How long to listen to the bus.")
@one_channel_option
@json_option
def pdo(
    rig_name: str,
    overrides: tuple[str, ...],
    bus_name: str | None,
    seconds: float,
    channel: str | None,
    as_json: bool,
) -> None:
    """Print what the rig's PDOs carry: a diagram of the bits, and a table of objects and signals;
    with --bus the last bytes and values, too.

    \b
    Examples:
      coulombus pdo
      coulombus pdo --bus coulombus:bench
      coulombus pdo --rig my-rig.toml --json
    """
    with errors():
        from coulombus.monitor.pdo_table import as_dict, as_lines
        from coulombus.rigs.buses import one_bus

        rig, address = one_bus(load(rig_name, overrides), bus_name, channel)
        now: dict[int, PdoRow] = {}
        if bus_name is not None:
            from coulombus.monitor.watch import look_once

            now = {row.can_id: row for row in look_once(rig, address, seconds).pdos}
        if as_json:
            print_json([as_dict(one, now.get(one.layout.cob_id)) for one in rig.pdos()])
            return
        with printed():
            for one in rig.pdos():
                for line in as_lines(one, now.get(one.layout.cob_id)):
                    echo(line)
