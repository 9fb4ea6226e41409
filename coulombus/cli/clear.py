"""``coulombus clear``: end what ``coulombus inject`` has broken."""

from __future__ import annotations

import click

from coulombus.cli.common import json_option, verdict
from coulombus.cli.errors import EXIT_STATUS, errors, print_json
from coulombus.cli.fault_options import bus_of_faults, fault_bus_option, mark_host
from coulombus.cli.tables import echo

__all__ = ["clear"]


@click.command(epilog=EXIT_STATUS)
@click.argument("fault", required=False)
@click.option("--on", "where", metavar="NODE|bus", default=None, help="Only there.  [default: everywhere]")
@fault_bus_option
@json_option
def clear(fault: str | None, where: str | None, bus_name: str | None, as_json: bool) -> None:
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
