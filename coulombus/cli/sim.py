"""``coulombus sim`` and ``coulombus node``: the far side of the bus, in real time."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import click

from coulombus.cli.bundle import bundle, repeated
from coulombus.cli.common import MODES, faults_option, force_option, json_option, script_option, seed_option
from coulombus.cli.errors import EXIT_STATUS, errors
from coulombus.cli.option_types import CPU, SECONDS, OutputFile
from coulombus.cli.page_options import PageOptions, page_options
from coulombus.cli.rig_options import BusesOptions, buses_options
from coulombus.cli.tables import echo
from coulombus.system.exit import abandon_stdout

if TYPE_CHECKING:
    from coulombus.node.profile import Profile
    from coulombus.rigs.rig import Rig
    from coulombus.sim_bus.server.live_nodes import LiveNodes
    from coulombus.wire.address import BusAddress

__all__ = ["node_command", "sim"]


@dataclass(frozen=True)
class Simulated:
    """What a bus of ``sim`` does, as the options say it."""

    mode: str | None
    seed: int
    script: Path | None
    faults: Path | None
    unpaced: bool
    no_node_ids: bool

    def words(self) -> list[str]:
        """Return the options' words for the processes of several buses."""
        given = {"--mode": self.mode, "--seed": self.seed, "--script": self.script, "--faults": self.faults}
        words = [word for option, value in given.items() if value is not None for word in (option, str(value))]
        return [*words, *(["--unpaced"] if self.unpaced else []), *(["--no-node-ids"] if self.no_node_ids else [])]

    def of(self, rig: Rig) -> dict[str, Any]:
        """Return what a `SimServer` of each bus is told, by the bus; the files are read."""
        from coulombus.sim_bus.faults.file import read_faults
        from coulombus.sim_bus.network.script import read_script

        script = () if self.script is None else read_script(self.script, [node.name for node in rig.nodes])
        faults = None if self.faults is None else read_faults(self.faults)
        common = {"mode": self.mode or rig.modes[-1], "seed": self.seed, "script": script, "unpaced": self.unpaced}
        common |= {"numbered": not self.no_node_ids}
        plans = {name: None if faults is None else faults.on(name, rig.channels) for name in rig.channels}
        return {name: {**common, "faults": plan} for name, plan in plans.items()}


simulated_options = bundle(
    "simulated",
    Simulated,
    click.option(
        "--mode",
        type=click.Choice(MODES),
        default=None,
        help="Whose F_s sizes the operator's pushes.  [default: the last]",
    ),
    script_option,
    faults_option,
    seed_option,
    click.option("--unpaced", is_flag=True, help="Frames take no time: for measurements."),
    click.option(
        "--no-node-ids", is_flag=True, help="The devices have no node id yet: `coulombus lss` gives them theirs."
    ),
)


@dataclass(frozen=True)
class Realtime:
    """The scheduling of the bus, as the options say it."""

    priority: int
    cpu: int | None

    def words(self) -> list[str]:
        """Return the options' words for the processes of several buses."""
        return ["--priority", str(self.priority), *([] if self.cpu is None else ["--cpu", str(self.cpu)])]


realtime_options = bundle(
    "realtime",
    Realtime,
    click.option(
        "--priority", type=click.IntRange(0, 99), default=79, show_default=True, help="SCHED_FIFO; 0: ordinary."
    ),
    click.option("--cpu", type=CPU, default=None, help="Keep the bus on this CPU."),
)


@click.command(epilog=EXIT_STATUS)
@buses_options
@click.option("--seconds", type=SECONDS, default=None, help="End after this many seconds.  [default: never]")
@click.option(
    "--record",
    type=OutputFile(".pcapng"),
    metavar="F.pcapng",
    help="Record every frame there, at its end of frame in the bus's own time; `replay --virtual` checks it against virtual time.",
)
@force_option
@simulated_options
@realtime_options
@page_options
@json_option
def sim(
    chosen: BusesOptions,
    seconds: float | None,
    record: Path | None,
    overwrite: bool,
    simulated: Simulated,
    realtime: Realtime,
    page: PageOptions,
    as_json: bool,
) -> None:
    """Serve a bus with the simulated nodes and the rig on it, in real time.

    One process is bus, motor drive, MR brake, mechanics and the operator's hand. Clients attach
    with --bus (coulombus run, watch), as python-can interface "coulombus" (can_logger -i coulombus
    -c bench), or on the SocketCAN interface. Prints one line when the bus is ready; from
    then on Ctrl-C, SIGTERM, SIGHUP and SIGQUIT end it with 0.

    \b
    Examples:
      coulombus sim
      coulombus sim --rig my-rig.toml --bus socketcan:vcan0
      coulombus sim --bus coulombus:test --seconds 60 --script script.toml --json
    """
    with errors():
        from coulombus.rigs.rig import load_rig
        from coulombus.sim_bus.server.rig_server import SimServer
        from coulombus.sim_bus.server.sim_command import run_sim

        rig = load_rig(chosen.rig_name, chosen.overrides)
        addresses = chosen.addresses(rig)
        told = simulated.of(rig)
        virtual = next(iter(addresses.values())).is_virtual
        if record is not None and (simulated.unpaced or len(addresses) > 1 or not virtual):
            raise click.UsageError(
                "--record is of one virtual bus on which frames take their time; choose one with --channel"
            )
        if len(addresses) > 1:
            page.refuse_several()
            words = ["sim", "--rig", chosen.rig_name, *realtime.words(), *simulated.words()]
            words += [] if seconds is None else ["--seconds", str(seconds)]
            words += repeated("--set", chosen.overrides)
            sys.exit(_sim_buses([*words, "--json"] if as_json else words, addresses))
        if chosen.channel is not None:
            rig = rig.on(chosen.channel)
        (address,) = addresses.values()

        def make() -> SimServer:
            return SimServer(rig, address, record=record, force=overwrite, **told[rig.channels[0]])

        with page.beside(chosen, address):
            run_sim(make, seconds, priority=realtime.priority or None, cpu=realtime.cpu, as_json=as_json)


def _sim_buses(words: list[str], addresses: dict[str, BusAddress]) -> int:
    """Serve several buses, a process each; their lines are passed on as they come."""
    from coulombus.host.run.buses import supervise

    buses = supervise(
        list(addresses),
        lambda channel: [*words, "--channel", channel, "--bus", f"{channel}={addresses[channel]}"],
        lambda channel, line: _pass_on(line),
    )
    return max(bus.status for bus in buses)


def _pass_on(line: str) -> None:
    """Print a line of one bus; a reader that has gone, or a full disk, ends none of them."""
    try:
        echo(line)
    except OSError:
        abandon_stdout()


class NodeId(click.IntRange):
    """A node id, or 255: the device has none yet (CiA 305)."""

    def __init__(self) -> None:
        super().__init__(1, 255)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the number; BadParameter says which there are."""
        number = super().convert(value, param, ctx)
        if 127 < number < 255:
            self.fail(f"{number} is not 1 to 127, and not 255 (none yet)", param, ctx)
        return number


class Kind(click.ParamType):  # type: ignore[type-arg]  # generic to some versions' types only
    """A kind of device by its name in `node.kinds`, or "auto".

    They are imported when one is given: the help starts without numba.
    """

    name = "kind"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> Profile | Literal["auto"]:
        """Return the profile; "auto" stays what it is."""
        from coulombus.node.kinds import named

        if value == "auto":
            return "auto"
        try:
            return named(value)
        except ValueError as error:
            self.fail(str(error), param, ctx)


@dataclass(frozen=True)
class Served:
    """What ``node`` makes of the EDS files, as the options say it."""

    node_ids: tuple[int, ...]
    kind: Profile | Literal["auto"] | None
    store: Path | None
    processing_us: float
    bitrate: int | None
    io: Path | None

    def of(self, eds: tuple[Path, ...], as_json: bool) -> LiveNodes:
        """Return the nodes of these EDS files.

        Raises
        ------
        NodeError
            There are not as many node ids as files.
        """
        from coulombus.sim_bus.server.live_nodes import LiveNodes, NodeError

        if self.node_ids and len(self.node_ids) != len(eds):
            raise NodeError(
                f"{len(eds)} EDS files and {len(self.node_ids)} --node-id; give one --node-id for each file"
            )
        files = tuple(zip(eds, self.node_ids or (None,) * len(eds), strict=True))
        return LiveNodes(files, self.kind, self.store, self.processing_us, as_json, self.bitrate or 0, self.io)


served_options = bundle(
    "served",
    Served,
    click.option(
        "--node-id",
        "node_ids",
        type=NodeId(),
        multiple=True,
        help="One for each EDS, in order; 255: none yet, `coulombus lss` gives it one.  [default: NodeID of a DCF]",
    ),
    click.option(
        "--kind",
        type=Kind(),
        default=None,
        help="What lives behind the objects: generic (nothing), drive (CiA 402), brake (our driver of CiA 404), "
        "io (CiA 401), io404 (CiA 404), auto: as the file's objects allow; what contradicts the real device is opened "
        "and told.  [default: our own devices' files as what they describe, else generic]",
    ),
    click.option(
        "--store",
        type=click.Path(readable=False, dir_okay=False, path_type=Path),
        metavar="FILE",
        help="Keep what 1010h and LSS store there.  [default: in memory]",
    ),
    click.option(
        "--processing-us",
        type=click.FloatRange(0, 1e6),
        default=20.0,
        show_default=True,
        help="Time from a request until its answer is ready to be sent.",
    ),
    click.option(
        "--bitrate",
        type=click.IntRange(1000, 100_000_000),
        default=None,
        help="Bit/s of the bus, where this command serves it.  [default: Baudrate of a DCF, else 1000000]",
    ),
    click.option(
        "--io",
        type=click.Path(readable=False, dir_okay=False, path_type=Path),
        metavar="FILE",
        help="Put real hardware behind the one node: which object is which channel of a DAC, ADC, PWM or counter, or of a Python class "
        "(docs/own-device.md).",
    ),
)


@click.command("node", epilog=EXIT_STATUS)
@click.argument("eds", nargs=-1, required=True, metavar="EDS...", type=click.Path(readable=False, path_type=Path))
@click.option("--bus", metavar="B", required=True, help="coulombus:NAME (built in) or socketcan:IF.")
@served_options
@click.option("--seconds", type=SECONDS, default=None, help="End after this many seconds.  [default: never]")
@click.option(
    "--json", "as_json", is_flag=True, help="One JSON object a line to stdout: ready, duplicate, hardware, end."
)
def node_command(
    eds: tuple[Path, ...],
    bus: str,
    served: Served,
    seconds: float | None,
    as_json: bool,
) -> None:
    """Serve any EDS description as a live node: a stand-in for a device that is not on the desk
    yet.

    All objects with their defaults, PDOs, SDO, NMT, heartbeat, EMCY and LSS; a DCF's with the
    values that it configures. On coulombus:NAME it joins the bus that another process serves; where
    nobody does, it serves the bus itself, and others may join. Ends with 0 on Ctrl-C, SIGTERM,
    SIGHUP and SIGQUIT, with 4 when the bus goes away. With --io the outputs take their safe values
    at the end, after every fault, and when this process stands still or is killed.

    \b
    Examples:
      coulombus node vendor.eds --node-id 5 --bus coulombus:desk --kind auto
      coulombus node drive.eds brake.eds --node-id 1 --node-id 2 --bus socketcan:vcan0 --json
      coulombus node configured.dcf --bus coulombus:desk
      coulombus node eds/mr_brake.eds --node-id 2 --bus socketcan:can0 --io brake-io.toml
    """
    with errors():
        from coulombus.sim_bus.server.live_nodes import run_nodes
        from coulombus.wire.address import parse_address

        run_nodes(served.of(eds, as_json), parse_address(bus), seconds)
