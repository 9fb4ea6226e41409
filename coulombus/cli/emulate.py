"""``coulombus emulate``: the far side of the bus, in real time."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import click

from coulombus.cli.errors import EXIT_STATUS, errors
from coulombus.cli.option_types import CPU, SECONDS, OutputFile
from coulombus.cli.options import (
    MODES,
    FaultsOption,
    JsonOption,
    OverwriteOption,
    ScriptOption,
    SeedOption,
    option,
    with_options,
    words,
)
from coulombus.cli.page_options import PageOptions
from coulombus.cli.rig_options import BusesOptions, RigOptions
from coulombus.cli.tables import echo
from coulombus.system.exit import abandon_stdout

if TYPE_CHECKING:
    from coulombus.rigs.rig import Rig
    from coulombus.wire.address import BusAddress

__all__ = ["emulate"]


@dataclass(frozen=True)
class Simulated:
    """Settings of a bus of ``emulate``, from the options."""

    mode: Annotated[
        str | None,
        option("Mode whose F_s scales the simulated hand's push.  [default: the last]", type=click.Choice(MODES)),
    ]
    script: ScriptOption
    faults: FaultsOption
    seed: SeedOption
    unpaced: Annotated[bool, option("Zero transmission time, for benchmarks only.")]
    no_node_ids: Annotated[bool, option("The devices have no node id yet: `coulombus lss` gives them theirs.")]

    def settings(self, rig: Rig) -> dict[str, Any]:
        """Read the files and return the settings of each bus' `SimServer`, by bus."""
        from coulombus.sim_bus.faults.fault_file import read_faults
        from coulombus.sim_bus.network.script import read_script

        script = () if self.script is None else read_script(self.script, [node.name for node in rig.nodes])
        faults = None if self.faults is None else read_faults(self.faults)
        common = {"mode": self.mode or rig.modes[-1], "seed": self.seed, "script": script, "unpaced": self.unpaced}
        common |= {"numbered": not self.no_node_ids}
        if rig.one_cycle:
            return {rig.channels[0]: {**common, "faults": None if faults is None else faults.on_one(rig.channels)}}
        plans = {name: None if faults is None else faults.on(name, rig.channels) for name in rig.channels}
        return {name: {**common, "faults": plan} for name, plan in plans.items()}


@dataclass(frozen=True)
class Realtime:
    """The scheduling of the bus, from the options."""

    priority: Annotated[int, option("SCHED_FIFO priority; 0: none.", type=click.IntRange(0, 99), default=79)]
    cpu: Annotated[int | None, option("Keep the bus on this CPU.", type=CPU)]


@click.command(epilog=EXIT_STATUS)
@with_options
def emulate(
    bus_options: BusesOptions,
    seconds: Annotated[float | None, option("End after this many seconds.  [default: never]", type=SECONDS)],
    record: Annotated[
        Path | None,
        option(
            "Record every frame there, at its end of frame in the bus's own time; `replay --virtual` checks it against virtual time.",
            type=OutputFile(".pcapng"),
            metavar="F.pcapng",
        ),
    ],
    overwrite: OverwriteOption,
    simulated: Simulated,
    realtime: Realtime,
    page: PageOptions,
    as_json: JsonOption,
) -> None:
    """Serve a bus with the simulated nodes and the rig on it, in real time.

    One process is bus, motor drive, MR brake, mechanics and the operator's hand. Clients attach
    with --bus (coulombus run, watch), as python-can interface "coulombus" (can_logger -i coulombus
    -c bench), or on the SocketCAN interface. Prints one line when the bus is ready; from
    then on Ctrl-C, SIGTERM, SIGHUP and SIGQUIT end it with 0.

    \b
    Examples:
      coulombus emulate
      coulombus emulate --rig my-rig.toml --bus socketcan:vcan0
      coulombus emulate --bus coulombus:test --seconds 60 --script script.toml --json
    """
    with errors():
        from coulombus.rigs.rig import load_rig
        from coulombus.sim_bus.server.rig_server import SimServer
        from coulombus.sim_bus.server.sim_command import run_sim

        rig = load_rig(bus_options.rig_name, bus_options.overrides)
        addresses = bus_options.addresses(rig)
        settings = simulated.settings(rig)
        virtual = next(iter(addresses.values())).is_virtual
        if bus_options.channel is not None:
            if rig.one_cycle and len(rig.channels) > 1:
                raise click.UsageError(f"--channel {bus_options.channel}: the joints of an arm are simulated together")
            rig = rig.on(bus_options.channel)
        if record is not None and (simulated.unpaced or not rig.one_cycle or not virtual):
            raise click.UsageError(
                "--record is of one virtual bus on which frames take their time; choose one with --channel"
            )
        if len(rig.channels) > 1:
            page.refuse_several()
        if not rig.one_cycle:
            child = ["emulate", *words(bus_options, RigOptions), *words(realtime), *words(simulated)]
            child += [] if seconds is None else ["--seconds", str(seconds)]
            sys.exit(_sim_buses([*child, "--json"] if as_json else child, addresses))
        address = next(iter(addresses.values()))

        def make() -> SimServer:
            return SimServer(
                rig, tuple(addresses.values()), record=record, force=overwrite, **settings[rig.channels[0]]
            )

        with page.beside(bus_options, address, "bus"):
            run_sim(make, seconds, priority=realtime.priority or None, cpu=realtime.cpu, as_json=as_json)


def _sim_buses(child: list[str], addresses: dict[str, BusAddress]) -> int:
    """Serve several buses, a process each; their output lines are forwarded."""
    from coulombus.host.run.buses import supervise

    buses = supervise(
        list(addresses),
        lambda channel: [*child, "--channel", channel, "--bus", f"{channel}={addresses[channel]}"],
        lambda channel, line: _pass_on(line),
    )
    return max(bus.status for bus in buses)


def _pass_on(line: str) -> None:
    """Print a line of one bus; a closed reader or a full disk does not end the processes."""
    try:
        echo(line)
    except OSError:
        abandon_stdout()
