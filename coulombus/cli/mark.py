"""``coulombus mark``: add a marker to the recording of a running host."""

from __future__ import annotations

import click

from coulombus.cli.common import buses_option, json_option, rig_option, verdict
from coulombus.cli.errors import EXIT_STATUS, errors, print_json
from coulombus.cli.hosts import host_addresses
from coulombus.cli.tables import echo

__all__ = ["mark"]


@click.command(epilog=EXIT_STATUS)
@click.argument("text")
@rig_option
@buses_option
@json_option
def mark(text: str, rig_name: str, bus_names: tuple[str, ...], as_json: bool) -> None:
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
