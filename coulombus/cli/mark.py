"""``coulombus mark``: add a marker to the recording of a running host."""

from __future__ import annotations

from typing import Annotated

import click

from coulombus.cli.errors import EXIT_STATUS, errors, print_json
from coulombus.cli.options import BusesOption, JsonOption, RigOption, argument, with_options
from coulombus.cli.rig_options import host_addresses
from coulombus.cli.tables import echo
from coulombus.system.exit import verdict

__all__ = ["mark"]


@click.command(epilog=EXIT_STATUS)
@with_options
def mark(
    text: Annotated[str, argument()],
    rig_name: RigOption,
    bus_names: BusesOption,
    as_json: JsonOption,
) -> None:
    """Mark the recording of the host that runs on a bus: now, with TEXT.

    The marker is `mark TEXT` in `Recording.markers`, and a comment of its frame in Wireshark. In
    the terminal of `coulombus run` the keys 1 to 9 set the markers `mark 1` to `mark 9`. Ends with
    4 where no host runs, with 2 where it does not record.

    \b
    Examples:
      coulombus mark "subject grasps"
      coulombus mark artefact --bus socketcan:can0
    """
    with errors():
        from coulombus.host.run.control_socket import ask_mark

        addresses = host_addresses(rig_name, bus_names)
        replies = [ask_mark(address, text) for address in addresses]
        with verdict(0):
            if as_json:
                print_json(replies[0] if len(replies) == 1 else replies)
            else:
                for reply in replies:
                    echo(f"{reply.get('recording')}: {reply.get('marker')}")
