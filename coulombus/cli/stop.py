"""``coulombus stop``: stop a running host safely."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any

import click

from coulombus.cli.errors import EXIT_STATUS, errors
from coulombus.cli.options import BusesOption, RigOption, option, with_options
from coulombus.cli.rig_options import host_addresses
from coulombus.cli.tables import echo
from coulombus.system.exit import say, verdict

if TYPE_CHECKING:
    from coulombus.wire.address import BusAddress

__all__ = ["stop"]


@click.command(epilog=EXIT_STATUS)
@with_options
def stop(
    rig_name: RigOption,
    bus_names: BusesOption,
    every: Annotated[bool, option("--all", "Stop every host that runs on this machine.")],
) -> None:
    """Stop the running host safely: motor torque 0, brake ramped off, drive disabled.

    Waits for its end. Without --bus and --rig it is the one host that runs on this machine, on
    whatever bus. Where several run, they are listed (2): name one with --bus, or stop --all.

    Ends with 0 when each host that was asked has taken the request and ended, tripped or not. Ends
    with 4 when none runs there, or it cannot be reached, refuses, or does not end in time: then the
    rig may still be armed.

    \b
    Examples:
      coulombus stop
      coulombus stop --bus socketcan:can0
      coulombus stop --all
    """
    with errors():
        from coulombus.host.run.control_socket import NoHost, StopRequest

        addresses = host_addresses(rig_name, bus_names, every=every, ended=True)
        requests = [StopRequest(address) for address in addresses]  # request all before waiting for the first
        failures, sentences = [], []
        for request in requests:
            try:
                sentences.append(_what_came(request.address, request.result()))
            except NoHost as failure:
                failures.append(f"{failure}{_last_end(request.address)}")
        for text in sentences if failures else ():
            say(text)
        if failures:
            raise NoHost("; ".join(failures))
        with verdict(0):
            for text in sentences:
                echo(text)


def _last_end(address: BusAddress) -> str:
    """Return the end of the last host on a bus, as a clause; empty if one runs, or none has left its word."""
    from coulombus.host.run.control_socket import host_runs
    from coulombus.host.run.last_word import ending, last_word

    word = None if host_runs(address) else last_word(address)
    return f"; the last one ended {ending(word)}" if word else ""


def _what_came(address: BusAddress, result: Mapping[str, Any]) -> str:
    """Return a host's response to a stop request, as a sentence."""
    if not result:
        return f"the host on {address} took the request and ended without a word"
    if result["trip"]:
        return f"the host on {address} had tripped: {result['trip']}"
    return f"the host on {address} stopped safely after {result['cycles']} cycles in mode {result['mode']}"
