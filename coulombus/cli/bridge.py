"""``coulombus bridge``: two buses as one, with disturbances between them."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

import click

from coulombus.cli.errors import EXIT_STATUS, errors
from coulombus.cli.options import IdsOption, argument, option, with_options
from coulombus.cli.tables import echo
from coulombus.system.exit import printed, say, verdict

if TYPE_CHECKING:
    from coulombus.sim_bus.server.bridge import Between
    from coulombus.wire.address import BusAddress

__all__ = ["bridge"]


@dataclass(frozen=True)
class Disturbance:
    """Disturbances of a bridge, from the options."""

    delay_ms: Annotated[
        float,
        option("Delay every frame by this time.", type=click.FloatRange(0, 60_000), default=0.0, show_default=False),
    ]
    drop: Annotated[
        float,
        option(
            "Share of frames to drop.", metavar="RATE", type=click.FloatRange(0, 1), default=0.0, show_default=False
        ),
    ]
    duplicate: Annotated[
        float,
        option("Share to send twice.", metavar="RATE", type=click.FloatRange(0, 1), default=0.0, show_default=False),
    ]
    corrupt: Annotated[
        float,
        option(
            "Share to send with one data bit inverted.",
            metavar="RATE",
            type=click.FloatRange(0, 1),
            default=0.0,
            show_default=False,
        ),
    ]
    seed: Annotated[int, option("Random seed.", default=0)]

    def between(self, direction: int) -> Between:
        """Return the disturbance of one direction, 0 or 1, each with its own random numbers."""
        from coulombus.sim_bus.server.bridge import faults

        return faults(self.delay_ms, self.drop, self.seed + direction, duplicate=self.duplicate, corrupt=self.corrupt)


@click.command("bridge", epilog=EXIT_STATUS)
@with_options
def bridge(
    a: Annotated[str, argument()],
    b: Annotated[str, argument()],
    ids_text: IdsOption,
    one_way: Annotated[bool, option("From A to B only.")],
    disturbance: Disturbance,
    seconds: Annotated[float | None, option("End after this many seconds.", type=click.FloatRange(0, min_open=True))],
    as_json: Annotated[bool, option("--json", "One JSON object a line: ready, then the result.")],
) -> None:
    """Join two buses, coulombus:NAME, socketcan:IF or can:INTERFACE:CHANNEL: what one carries is sent
    on the other.

    An end socketcand:HOST:PORT serves the other end to programs that speak socketcand's protocol: python-can,
    SavvyCAN, and others on this machine, or elsewhere if HOST is no loopback: there is no password.
    Options of an adapter follow its name: can:slcan:/dev/ttyACM0?bitrate=500000.

    Ends with 0 on Ctrl-C, SIGTERM, SIGHUP, SIGQUIT or after --seconds, with 4 when a bus goes away.

    \b
    Examples:
      coulombus bridge coulombus:bench socketcan:vcan0
      coulombus bridge coulombus:bench socketcan:can0 --ids 181,182,281 --one-way
      coulombus bridge coulombus:a coulombus:b --delay-ms 2 --drop 0.01 --seed 7
      coulombus bridge coulombus:bench socketcand:127.0.0.1:29536
    """
    with errors():
        from coulombus.sim_bus.server.bridge import bridge as join
        from coulombus.wire.address import parse_address
        from coulombus.wire.identifiers import parse_identifiers

        ends = parse_address(a, ("can", "socketcand")), parse_address(b, ("can", "socketcand"))
        ranges = () if ids_text is None else parse_identifiers(ids_text)

        def ready(left: BusAddress, right: BusAddress) -> None:
            text = f"{left} and {right} are joined; Ctrl-C ends it"
            with printed():  # the buses are joined even if the reader of stdout has gone
                echo(json.dumps({"event": "ready", "a": str(left), "b": str(right)}) if as_json else text)

        result = join(
            *ends,
            between=disturbance.between(0),
            back=disturbance.between(1),
            ranges=ranges,
            one_way=one_way,
            seconds=seconds,
            ready=ready,
            say=lambda text: say(f"coulombus: {text}"),
        )
        if result.gone:
            say(f"coulombus: {result.gone}")
        with verdict(result.exit_status):
            if as_json:
                echo(json.dumps({"event": "end", **result.as_dict()}))
            else:
                for way, counts in result.as_dict()["ways"].items():
                    rest = ", ".join(
                        f"{n} {name}" for name, n in counts.items() if n and name not in ("received", "forwarded")
                    )
                    echo(
                        f"{way}: {counts['received']} received, {counts['forwarded']} forwarded"
                        + (f", {rest}" if rest else "")
                    )
