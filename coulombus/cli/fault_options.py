"""The bus of ``inject`` and ``clear``, and the marker that both set in a host's recording."""

from __future__ import annotations

from contextlib import suppress
from typing import TYPE_CHECKING

import click

from coulombus.cli.common import BUS_VARIABLE

if TYPE_CHECKING:
    from coulombus.sim_bus.server.fault_socket import BusFaults
    from coulombus.wire.address import BusAddress

__all__ = ["bus_of_faults", "fault_bus_option", "mark_host"]

fault_bus_option = click.option(
    "--bus",
    "bus_name",
    envvar=BUS_VARIABLE,
    metavar="B",
    help="coulombus:NAME.  [default: the one on which `emulate` or `node` runs]",
)


def bus_of_faults(bus_name: str | None) -> BusFaults:
    """Return the faults of the bus of ``--bus``, else of the only one with simulated nodes.

    Raises
    ------
    click.UsageError
        there are several, and none was named
    coulombus.wire.address.BusUnavailable
        there is none
    """
    from coulombus.sim_bus.server.fault_socket import BusFaults, fault_buses
    from coulombus.wire.address import BusUnavailable, parse_address

    if bus_name is not None:
        return BusFaults(parse_address(bus_name))
    buses = fault_buses()
    if len(buses) > 1:
        raise click.UsageError(
            f"{len(buses)} buses have simulated nodes: {', '.join(map(str, buses))}; name one with --bus"
        )
    if not buses:
        raise BusUnavailable("no bus with simulated nodes: start one in another terminal with `coulombus emulate`")
    return BusFaults(buses[0])


def mark_host(address: BusAddress, texts: list[str]) -> None:
    """Mark the recording of the host on a bus, if one runs there and records."""
    from coulombus.host.errors import HostError
    from coulombus.host.run.control_socket import ask_mark, host_runs

    if host_runs(address):
        for text in texts:
            with suppress(HostError):
                ask_mark(address, text)
