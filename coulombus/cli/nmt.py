"""``coulombus nmt``: start, stop and reset nodes."""

from __future__ import annotations

from typing import Any

import click

from coulombus.cli.common import json_option, say, verdict
from coulombus.cli.device_options import (
    NodeArgument,
    beside_option,
    devices_bus_option,
    open_link,
    rig_option,
    waiting_option,
)
from coulombus.cli.errors import EXIT_STATUS, errors, print_json
from coulombus.cli.tables import echo

__all__ = ["nmt"]

WORDS = ("start", "stop", "preop", "reset", "reset-communication")
MISSING = 5


class NodeOrAll(NodeArgument):
    """A node as in `NodeArgument`, or "all"."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """Return the node id, 0 for all."""
        return 0 if value == "all" else super().convert(value, param, ctx)


@click.command(epilog=EXIT_STATUS)
@click.argument("word", type=click.Choice(WORDS), metavar="COMMAND")
@click.argument("node_id", type=NodeOrAll(), metavar="NODE|all")
@devices_bus_option
@rig_option
@waiting_option("How long to wait for the heartbeat. [default: 2; for a boot-up 5]")
@beside_option
@json_option
def nmt(
    word: str,
    node_id: int,
    bus_name: str,
    rig_name: str | None,  # NodeArgument reads it
    timeout_s: float | None,
    beside: bool,
    as_json: bool,
) -> None:
    """Send an NMT command: start, stop, preop, reset or reset-communication; to a node, or to all.

    Waits for the heartbeat or boot-up and prints the state that it reports. Ends with 5 when a node
    that has a heartbeat does not follow. Refused while a host is at work on the bus.

    \b
    Examples:
      coulombus nmt preop 5 --bus socketcan:can0
      coulombus nmt reset all --bus socketcan:can0
      coulombus nmt stop brake --rig my-rig.toml --bus socketcan:can0
    """
    with errors():
        from coulombus.host.devices.nmt import command

        with open_link(bus_name, beside=beside) as link:
            answers = command(link, word, node_id or None, timeout_s)
        with verdict(MISSING if any(answer.well is False for answer in answers) else 0):
            if as_json:
                states = [
                    (answer.node_id, None if answer.state is None else answer.state.name, answer.well)
                    for answer in answers
                ]
                print_json({"nodes": [{"node_id": n, "state": state, "followed": well} for n, state, well in states]})
            for answer in () if as_json else answers:
                echo(str(answer))
            if not answers:
                say("coulombus: sent to all; no heartbeat came in time (--timeout)")
