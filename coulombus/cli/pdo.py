"""``coulombus pdo``: the content of the rig's PDOs, bit by bit."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from coulombus.cli.common import (
    adapter_option,
    json_option,
    load,
    printed,
    rig_option,
    set_option,
    with_adapter_options,
)
from coulombus.cli.errors import EXIT_STATUS, errors, print_json
from coulombus.cli.option_types import SECONDS
from coulombus.cli.rig_options import one_channel_option
from coulombus.cli.tables import echo

if TYPE_CHECKING:
    from coulombus.monitor.live import PdoRow

__all__ = ["pdo"]


@click.command(epilog=EXIT_STATUS)
@rig_option
@set_option
@click.option(
    "--bus",
    "bus_name",
    metavar="B",
    callback=with_adapter_options,
    help="Fill in the values on this bus now; nothing is sent.",
)
@adapter_option
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
        from coulombus.monitor.pdo_text import as_dict, as_lines
        from coulombus.rigs.buses import one_bus
        from coulombus.wire.address import WITH_ADAPTERS

        rig, address = one_bus(load(rig_name, overrides), bus_name, channel, WITH_ADAPTERS)
        now: dict[int, PdoRow] = {}
        if bus_name is not None:
            from coulombus.monitor.watch import look_once

            now = {row.can_id: row for row in look_once(rig, address, seconds).pdos}
        if as_json:
            print_json([as_dict(pdo, now.get(pdo.layout.cob_id)) for pdo in rig.pdos()])
            return
        with printed():
            for pdo in rig.pdos():
                for line in as_lines(pdo, now.get(pdo.layout.cob_id)):
                    echo(line)
