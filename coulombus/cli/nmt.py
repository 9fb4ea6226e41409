"""``coulombus nmt``: start, stop and reset nodes."""

from __future__ import annotations

from typing import Annotated, Any

import click

from coulombus.cli.device_options import BesideOption, DevicesBusOption, NodesRigOption, NodeType, open_link
from coulombus.cli.errors import EXIT_STATUS, errors, print_json
from coulombus.cli.option_types import SECONDS
from coulombus.cli.options import JsonOption, argument, option, with_options
from coulombus.cli.tables import echo
from coulombus.system.exit import say, verdict

__all__ = ["nmt"]

WORDS = ("start", "stop", "preop", "reset", "reset-communication")
MISSING = 5


class NodeOrAll(NodeType):
    """A node as in `NodeType`, or "all"."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> int:
        """Return the node id, 0 for all."""
        return 0 if value == "all" else super().convert(value, param, ctx)


@click.command(epilog=EXIT_STATUS)
@with_options
def nmt(
    word: Annotated[str, argument(type=click.Choice(WORDS), metavar="COMMAND")],
    node_id: Annotated[int, argument(type=NodeOrAll(), metavar="NODE|all")],
    bus_name: DevicesBusOption,
    rig_name: NodesRigOption,
    timeout_s: Annotated[
        float | None,
        option(
            "--timeout", "How long to wait for the heartbeat. [default: 2; for a boot-up 5]", type=SECONDS, metavar="S"
        ),
    ],
    beside: BesideOption,
    as_json: JsonOption,
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
