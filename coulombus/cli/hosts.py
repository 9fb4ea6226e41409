"""Select the host for ``stop``, ``status``, ``mark`` and ``set``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import click
from click.core import ParameterSource

if TYPE_CHECKING:
    from coulombus.wire.address import BusAddress

__all__ = ["host_addresses"]


def host_addresses(
    rig_name: str,
    bus_names: Sequence[str] = (),
    channel: str | None = None,
    *,
    every: bool | None = None,
    ended: bool = False,
) -> list[BusAddress]:
    """Return the buses of the selected hosts.

    They are those of ``--bus``, else those of a named rig, else that of the running host on this
    machine. If none runs, they are the buses of the default rig.

    Parameters
    ----------
    every : the option ``--all``; None: the verb has no such option
    ended : if none runs, the bus of the host that ended last counts before those of the default rig

    Raises
    ------
    click.UsageError
        several hosts run, none was named, and `every` was not given
    """
    from coulombus.host.run.control_socket import hosts_here
    from coulombus.host.run.last_word import newest_word
    from coulombus.rigs.buses import bus_addresses
    from coulombus.rigs.rig import load_rig
    from coulombus.wire.address import parse_address

    rig = load_rig(rig_name)
    if bus_names:
        return [parse_address(text.rpartition("=")[2]) for text in bus_names]
    default = click.get_current_context().get_parameter_source("rig_name") is ParameterSource.DEFAULT
    running = hosts_here() if default and channel is None else []
    if len(running) > 1 and not every:
        names = ", ".join(map(str, running))
        others = "" if every is None else ", or stop them with --all"
        raise click.UsageError(f"{len(running)} hosts run on this machine: {names}; name one with --bus{others}")
    if ended and default and channel is None and not running and (last := newest_word()):
        return [last[0]]
    return running or list(bus_addresses(rig, (), channel).values())
