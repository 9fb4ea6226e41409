"""``coulombus node``: simulate a device from any EDS file."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import click

from coulombus.cli.errors import EXIT_STATUS, errors
from coulombus.cli.option_types import SECONDS, UNCHECKED_PATH
from coulombus.cli.options import ADAPTER, BUS_VARIABLE, argument, option, with_adapter_options, with_options

if TYPE_CHECKING:
    from coulombus.node.profile import Profile
    from coulombus.sim_bus.rig.shaft_load import Load
    from coulombus.sim_bus.server.live_nodes import LiveNodes
else:
    Profile = Any  # of a field, whose annotation is read for --help: without importing the module

__all__ = ["node_command"]


class NodeId(click.IntRange):
    """A node id, or 255 for a device without one (CiA 305)."""

    def __init__(self) -> None:
        super().__init__(1, 255)

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        """Return the number; BadParameter names the valid ones."""
        number = super().convert(value, param, ctx)
        if 127 < number < 255:
            self.fail(f"{number} is not 1 to 127, and not 255 (none yet)", param, ctx)
        return number


class DeviceKind(click.ParamType):  # type: ignore[type-arg]  # generic to some versions' types only
    """A kind of device by its name in `node.kinds`, or "auto".

    Kinds are imported on use, so that the help starts without numba.
    """

    name = "kind"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> Profile | Literal["auto"]:
        """Return the profile; "auto" is unchanged."""
        from coulombus.node.kinds import named

        if value == "auto":
            return "auto"
        try:
            return named(value)
        except ValueError as error:
            self.fail(str(error), param, ctx)


class Switches(click.ParamType):  # type: ignore[type-arg]  # generic to some versions' types only
    """Places of a drive's switches: the negative limit, both ends of the home switch, the positive limit."""

    name = "switches"

    def convert(
        self, value: Any, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float, float, float, float]:
        """Return the places in counts; a switch that is missing is infinitely far away."""
        if isinstance(value, tuple):
            return value
        places = {"negative": (-math.inf, -math.inf), "home": (math.inf, math.inf), "positive": (math.inf, math.inf)}
        for part in value.split(","):
            switch, _, place = part.partition("=")
            first, colon, last = place.partition(":")
            try:
                ends = float(first), float(last) if colon else math.inf
            except ValueError:
                ends = math.nan, math.nan
            if switch not in places or not ends[0] <= ends[1] or (colon and switch != "home"):
                self.fail(f"{part!r} is not negative=PLACE, home=FROM:TO or positive=PLACE, in counts", param, ctx)
            places[switch] = ends
        return places["negative"][0], *places["home"], places["positive"][0]


@dataclass(frozen=True)
class Served:
    """Simulated nodes of the EDS files, from the options."""

    node_ids: Annotated[
        tuple[int, ...],
        option(
            "--node-id",
            "One for each EDS, in order; 255: none yet, `coulombus lss` gives it one.  [default: NodeID of a DCF]",
            type=NodeId(),
        ),
    ]
    kind: Annotated[
        Profile | Literal["auto"] | None,
        option(
            "What lives behind the objects: generic (nothing), drive (CiA 402), brake (our driver of CiA 404), "
            "io (CiA 401), io404 (CiA 404), auto: as the file's objects allow; what contradicts the real device is opened "
            "and told.",
            type=DeviceKind(),
            default="auto",
        ),
    ]
    store: Annotated[
        Path | None,
        option(
            "Keep what 1010h and LSS store there.  [default: in memory]",
            type=click.Path(readable=False, dir_okay=False, path_type=Path),
            metavar="FILE",
        ),
    ]
    processing_us: Annotated[
        float,
        option(
            "Time from a request until its answer is ready to be sent.", type=click.FloatRange(0, 1e6), default=20.0
        ),
    ]
    bitrate: Annotated[
        int | None,
        option(
            "Bit/s of the bus, where this command serves it.  [default: Baudrate of a DCF, else 1000000]",
            type=click.IntRange(1000, 100_000_000),
        ),
    ]
    io: Annotated[
        Path | None,
        option(
            "Put real hardware behind the one node: which object is which channel of a DAC, ADC, PWM or counter, or of a Python class "
            "(docs/own-device.md).",
            type=click.Path(readable=False, dir_okay=False, path_type=Path),
            metavar="FILE",
        ),
    ]
    switches: Annotated[
        tuple[float, float, float, float] | None,
        option(
            "Switches on a drive's axis, in counts from its power-on: negative=-20000,home=0:500,positive=20000 "
            "(docs/devices.md).  [default: limits 1 turn below and 20 above, home from 1/4 to 1/2 turn]",
            type=Switches(),
            metavar="PLACES",
        ),
    ]

    def nodes(self, eds: tuple[Path, ...], as_json: bool, load: Load) -> LiveNodes:
        """Return the nodes of these EDS files.

        Raises
        ------
        NodeError
            The numbers of node ids and files differ.
        """
        from coulombus.sim_bus.server.live_nodes import LiveNodes, NodeError

        if self.node_ids and len(self.node_ids) != len(eds):
            raise NodeError(
                f"{len(eds)} EDS files and {len(self.node_ids)} --node-id; give one --node-id for each file"
            )
        files = tuple(zip(eds, self.node_ids or (None,) * len(eds), strict=True))
        nodes = LiveNodes(files, self.kind, self.store, self.processing_us, as_json, self.bitrate or 0, self.io, load)
        if self.switches is not None:
            nodes.place_switches(self.switches)
        return nodes


@dataclass(frozen=True)
class LoadOptions:
    """The load of the drives, from the options."""

    inertia: Annotated[
        float | None,
        option(
            "Inertia of motor and load, of a drive.  [default: rated torque x 3.18e-4 s2: 3000 rpm in 0.1 s]",
            type=click.FloatRange(0, 1e3, min_open=True),
            metavar="KG_M2",
        ),
    ]
    friction: Annotated[
        float | None,
        option(
            "Coulomb friction of the load.  [default: 2 % of the rated torque]",
            type=click.FloatRange(0, 1e3),
            metavar="NM",
        ),
    ]
    damping: Annotated[
        float | None,
        option(
            "Viscous friction of the load.  [default: 5 % of the rated torque at 3000 rpm]",
            type=click.FloatRange(0, 1e3),
            metavar="NM_S_RAD",
        ),
    ]
    rated_torque: Annotated[
        float | None,
        option(
            "Torque of the motor at 1000 per mille; it saturates at three times that.  [default: 6076h in mNm, else 1]",
            type=click.FloatRange(0, 1e4, min_open=True),
            metavar="NM",
        ),
    ]

    def load(self) -> Load:
        """Return the load."""
        from coulombus.sim_bus.rig.shaft_load import Load

        return Load(self.inertia, self.friction, self.damping, self.rated_torque)


@click.command("node", epilog=EXIT_STATUS)
@with_options
def node_command(
    eds: Annotated[
        tuple[Path, ...],
        argument(nargs=-1, required=True, metavar="EDS...", type=UNCHECKED_PATH),
    ],
    bus: Annotated[
        str,
        option(
            "coulombus:NAME (built in), socketcan:IF or can:INTERFACE:CHANNEL.",
            metavar="B",
            required=True,
            envvar=BUS_VARIABLE,
            callback=with_adapter_options,
        ),
        ADAPTER,
    ],
    served: Served,
    load: LoadOptions,
    seconds: Annotated[float | None, option("End after this many seconds.  [default: never]", type=SECONDS)],
    as_json: Annotated[
        bool, option("--json", "One JSON object a line to stdout: ready, duplicate, standstill, hardware, end.")
    ],
) -> None:
    """Serve any EDS description as a live node: a stand-in for a device that is not on the desk
    yet.

    All objects with their defaults, PDOs, SDO, NMT, heartbeat, EMCY and LSS; a DCF's with the
    values that it configures. A drive turns a shaft with inertia and friction; commanded without
    success, it says on stderr why it does not move. On coulombus:NAME it joins the bus that another process serves; where
    nobody does, it serves the bus itself, and others may join. Ends with 0 on Ctrl-C, SIGTERM,
    SIGHUP and SIGQUIT, with 4 when the bus goes away. With --io the outputs take their safe values
    at the end, after every fault, and when this process stands still or is killed.

    \b
    Examples:
      coulombus node vendor.eds --node-id 5 --bus coulombus:desk
      coulombus node drive.eds brake.eds --node-id 1 --node-id 2 --bus socketcan:vcan0 --json
      coulombus node drive.eds --node-id 5 --bus coulombus:desk --kind drive --inertia 1e-3 --friction 0.05
      coulombus node eds/servo.eds --node-id 5 --bus coulombus:desk --switches negative=-20000,positive=20000
      coulombus node configured.dcf --bus coulombus:desk
      coulombus node eds/mr_brake.eds --node-id 2 --bus socketcan:can0 --io brake-io.toml
    """
    with errors():
        from coulombus.sim_bus.server.live_nodes import run_nodes
        from coulombus.wire.address import WITH_ADAPTERS, parse_address

        run_nodes(served.nodes(eds, as_json, load.load()), parse_address(bus, WITH_ADAPTERS), seconds)
