"""``coulombus pdo``: the content of PDOs, bit by bit."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from coulombus.cli.common import adapter_option, json_option, printed, with_adapter_options
from coulombus.cli.errors import EXIT_STATUS, errors, print_json
from coulombus.cli.option_types import SECONDS, InputPath
from coulombus.cli.rig_options import KnownBusOptions, known_bus_options
from coulombus.cli.tables import echo

if TYPE_CHECKING:
    from coulombus.monitor.live import PdoRow

__all__ = ["pdo"]


@click.command(epilog=EXIT_STATUS)
@click.argument("file", required=False, type=InputPath())
@known_bus_options
@click.option(
    "--bus",
    "bus_name",
    metavar="B",
    callback=with_adapter_options,
    help="Fill in the values on this bus now; nothing is sent.",
)
@adapter_option
@click.option("--seconds", type=SECONDS, default=1.0, show_default=True, help="How long to listen to the bus.")
@click.option(
    "--node",
    "node_id",
    type=click.IntRange(1, 127),
    metavar="N",
    help="Of node N on the bus, as its PDOs are mapped now: it is asked by SDO.",
)
@json_option
def pdo(
    file: Path | None, chosen: KnownBusOptions, bus_name: str | None, seconds: float, node_id: int | None, as_json: bool
) -> None:
    """Print what the PDOs of a rig, of devices by their EDS files, of a recording FILE or of a node on
    the bus carry: a diagram of the bits, and a table of objects and signals; with --bus the last
    bytes and values, too.

    \b
    Examples:
      coulombus pdo
      coulombus pdo --bus coulombus:bench
      coulombus pdo --rig my-rig.toml --json
      coulombus pdo --eds 5=drive.eds --bus socketcan:can0
      coulombus pdo candump.log --eds 5=drive.eds
      coulombus pdo --node 5 --bus socketcan:can0
    """
    with errors():
        from coulombus.monitor.pdo_text import as_dict, as_lines

        if file is not None:
            if bus_name is not None or node_id is not None:
                raise click.UsageError("a FILE and --bus or --node: give one of them")
            known = chosen.of_file(file)
        elif node_id is None:
            known, address = chosen.known(bus_name)
        else:
            known, address = chosen.of_node(bus_name, node_id)
        now: dict[int, PdoRow] = {}
        if bus_name is not None:
            from coulombus.monitor.watch import look_once

            now = {row.can_id: row for row in look_once(known, address, seconds).pdos}
        if as_json:
            print_json([as_dict(pdo, now.get(pdo.layout.cob_id)) for pdo in known.pdos])
            return
        with printed():
            for pdo in known.pdos:
                for line in as_lines(pdo, now.get(pdo.layout.cob_id)):
                    echo(line)
