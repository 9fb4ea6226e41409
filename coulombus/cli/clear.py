"""``coulombus clear``: end what ``coulombus inject`` has broken."""

from __future__ import annotations

from typing import Annotated

import click

from coulombus.cli.errors import EXIT_STATUS, errors, print_json
from coulombus.cli.options import JsonOption, argument, option, with_options
from coulombus.cli.rig_options import FaultBusOption, bus_of_faults, mark_host
from coulombus.cli.tables import echo
from coulombus.system.exit import verdict

__all__ = ["clear"]


@click.command(epilog=EXIT_STATUS)
@with_options
def clear(
    fault: Annotated[str | None, argument(required=False)],
    where: Annotated[str | None, option("--on", "Only there.  [default: everywhere]", metavar="NODE|bus")],
    bus_name: FaultBusOption,
    as_json: JsonOption,
) -> None:
    """End the faults of a running `emulate` or `node`: FAULT, or all.

    A drive keeps its state FAULT until the fault reset. Ends with 4 where no such bus runs, with 5
    if the bus has no such node.

    \b
    Examples:
      coulombus clear
      coulombus clear noise
      coulombus clear --on motor --bus coulombus:bench
    """
    with errors():
        from coulombus.sim_bus.faults.live_faults import kind_of

        kind = "" if fault is None else kind_of(fault)
        bus = bus_of_faults(bus_name)
        texts = bus.clear(kind, where or "")
        mark_host(bus.address, texts)
        with verdict(0):
            if as_json:
                print_json({"bus": str(bus.address), "done": texts, "acting": bus.state()["acting"]})
            else:
                for text in texts or ["nothing acted"]:
                    echo(f"{bus.address}: {text}")
