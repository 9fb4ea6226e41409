"""``coulombus bridge``: two buses as one, with disturbances between them."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING

import click

from coulombus.cli.bundle import bundle
from coulombus.cli.common import printed, say, verdict
from coulombus.cli.errors import EXIT_STATUS, errors
from coulombus.cli.tables import echo

if TYPE_CHECKING:
    from coulombus.sim_bus.server.bridge import Between
    from coulombus.wire.address import BusAddress

__all__ = ["bridge"]


@dataclass(frozen=True)
class Disturbance:
    """Disturbances of a bridge, from the options."""

    delay_ms: float
    drop: float
    duplicate: float
    corrupt: float
    seed: int

    def of(self, direction: int) -> Between:
        """Return the disturbance of one direction, 0 or 1, each with its own random numbers."""
        from coulombus.sim_bus.server.bridge import faults

        return faults(self.delay_ms, self.drop, self.seed + direction, duplicate=self.duplicate, corrupt=self.corrupt)


disturbance_options = bundle(
    "disturbance",
    Disturbance,
    click.option("--delay-ms", type=click.FloatRange(0, 60_000), default=0.0, help="Delay every frame by this time."),
    click.option("--drop", metavar="RATE", type=click.FloatRange(0, 1), default=0.0, help="Share of frames to drop."),
    click.option("--duplicate", metavar="RATE", type=click.FloatRange(0, 1), default=0.0, help="Share to send twice."),
    click.option(
        "--corrupt",
        metavar="RATE",
        type=click.FloatRange(0, 1),
        default=0.0,
        help="Share to send with one data bit inverted.",
    ),
    click.option("--seed", default=0, show_default=True, help="Random seed."),
)


@click.command("bridge", epilog=EXIT_STATUS)
@click.argument("a")
@click.argument("b")
@click.option("--ids", "ids_text", metavar="IDS", help="Only these identifiers, hexadecimal: 181,200-27F,00000123x.")
@click.option("--one-way", is_flag=True, help="From A to B only.")
@disturbance_options
@click.option("--seconds", type=click.FloatRange(0, min_open=True), default=None, help="End after this many seconds.")
@click.option("--json", "as_json", is_flag=True, help="One JSON object a line: ready, then the result.")
def bridge(
    a: str,
    b: str,
    ids_text: str | None,
    one_way: bool,
    disturbance: Disturbance,
    seconds: float | None,
    as_json: bool,
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
            between=disturbance.of(0),
            back=disturbance.of(1),
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
