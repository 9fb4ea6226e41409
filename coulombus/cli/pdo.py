"""``coulombus pdo``: the content of PDOs, bit by bit."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import click

from coulombus.cli.device_options import open_link
from coulombus.cli.errors import EXIT_STATUS, errors, print_json
from coulombus.cli.option_types import SECONDS
from coulombus.cli.options import (
    ADAPTER,
    JsonOption,
    OptionalRecordingArgument,
    option,
    with_adapter_options,
    with_options,
)
from coulombus.cli.rig_options import KnownBusOptions
from coulombus.cli.tables import echo
from coulombus.system.exit import printed

if TYPE_CHECKING:
    from coulombus.monitor.live import PdoRow
    from coulombus.recording.maps.known_bus import KnownBus
    from coulombus.wire.address import BusAddress

__all__ = ["pdo"]


@click.command(epilog=EXIT_STATUS)
@with_options
def pdo(
    file: OptionalRecordingArgument,
    bus_options: KnownBusOptions,
    bus_name: Annotated[
        str | None,
        option(
            "--bus", "Fill in the values on this bus now; nothing is sent.", metavar="B", callback=with_adapter_options
        ),
        ADAPTER,
    ],
    seconds: Annotated[float, option("How long to listen to the bus.", type=SECONDS, default=1.0)],
    node_id: Annotated[
        int | None,
        option(
            "--node",
            "Of node N on the bus, as its PDOs are mapped now: it is asked by SDO.",
            type=click.IntRange(1, 127),
            metavar="N",
        ),
    ],
    as_json: JsonOption,
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
            bus = bus_options.of_file(file)
        elif node_id is None:
            bus, address = bus_options.known_bus(bus_name)
        else:
            bus, address = _of_node(bus_options, bus_name, node_id)
        now: dict[int, PdoRow] = {}
        if bus_name is not None:
            from coulombus.monitor.watch import look_once

            now = {row.can_id: row for row in look_once(bus, address, seconds).pdos}
        if as_json:
            print_json([as_dict(pdo, now.get(pdo.layout.cob_id)) for pdo in bus.pdos])
            return
        with printed():
            for pdo in bus.pdos:
                for line in as_lines(pdo, now.get(pdo.layout.cob_id)):
                    echo(line)


def _of_node(bus_options: KnownBusOptions, bus_name: str | None, node_id: int) -> tuple[KnownBus, BusAddress]:
    """Ask a node for its PDOs; return them, and the bus' address."""
    from coulombus.host.devices.dictionary_scan import pdo_objects
    from coulombus.host.sdo.sdo_client import SdoClient
    from coulombus.recording.maps.known_bus import KnownBus
    from coulombus.wire.address import WITH_ADAPTERS, parse_address

    if bus_name is None:
        raise click.UsageError("--node is a device on a bus: name it with --bus")
    if bus_options.rig_on_command_line or bus_options.overrides:
        raise click.UsageError("--node asks the device: leave --rig and --set out")
    files = bus_options.files()
    with open_link(bus_name, beside=True) as link:
        objects = pdo_objects(SdoClient(link, node_id))
    return KnownBus.of_device(node_id, objects, files), parse_address(bus_name, WITH_ADAPTERS)
