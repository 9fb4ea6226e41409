"""``coulombus watch``: live view of a bus in a terminal, in a browser, or in another tool."""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import click

from coulombus.cli.errors import EXIT_STATUS, errors
from coulombus.cli.option_types import SECONDS, OutputFile
from coulombus.cli.options import (
    JsonLinesOption,
    OptionalRecordingArgument,
    OverwriteOption,
    listed,
    option,
    with_options,
)
from coulombus.cli.page_options import PageOptions, serve_last_page, serve_page, serve_recording_page
from coulombus.cli.rig_options import WatchedBusOptions
from coulombus.cli.tables import echo
from coulombus.system.exit import say

if TYPE_CHECKING:
    from coulombus.monitor.snapshot import HostLine
    from coulombus.rigs.rig import Rig
    from coulombus.wire.address import BusAddress

__all__ = ["host_line", "watch"]

COUNTED = {"missed_deadlines": "deadlines missed"}
"""Counters of the host that its line shows if they are not 0."""


def host_line(address: BusAddress) -> HostLine | None:
    """Return the state of the host on a bus, or the end of the last one, or None."""
    from coulombus.host.run.control_socket import NoHost, ask_status
    from coulombus.host.run.last_word import ending, last_word
    from coulombus.monitor.snapshot import HostLine

    try:
        state = ask_status(address)
    except NoHost:
        word = last_word(address)
        if word is None:
            return None
        counts = f"{word['lost_pdos']} PDOs lost, {word['missed_deadlines']} deadlines missed"
        return HostLine(f"no host; the last one ended {ending(word)}; {counts}", "tripped" if word["trip"] else "ended")
    text = f"host: mode {state['mode']}" if "mode" in state else f"host: {state.get('error')}"
    for axis in state.get("axes") or ():
        text += f"  {axis.get('axis') or 'phase'} {axis.get('phase')}"
    trip, counters = state.get("trip"), state.get("counters") or {}
    amiss = [f"{counters[name]} {words}" for name, words in COUNTED.items() if counters.get(name)]
    amiss += [f"{n} PDOs lost" for n in [sum(axis.get("lost_pdos") or 0 for axis in state.get("axes") or ())] if n]
    text += "".join(f"  {words}" for words in amiss)
    return HostLine(text + (f"  trip: {trip}" if trip else ""), "tripped" if trip else "runs")


def _signal_names(ctx: click.Context, param: click.Parameter, texts: tuple[str, ...]) -> tuple[str, ...]:
    return listed(texts) or ()


@dataclass(frozen=True)
class View:
    """View of a live bus, or tool to forward it to, from the options."""

    interval: Annotated[
        float | None,
        option("Refresh interval in s.  [default: 0.1 in a terminal, else 1]", type=click.FloatRange(0.02)),
    ]
    pcapng: Annotated[
        Path | None,
        option(
            "Show nothing; write the frames there as they come: - for stdout, a named pipe, or a file.",
            type=OutputFile(".pcapng", dash=True),
            metavar="F",
        ),
    ]
    overwrite: OverwriteOption
    scope: Annotated[
        tuple[str, ...],
        option(
            "Draw these signals over the last 10 s, in a terminal.",
            callback=_signal_names,
            metavar="A,B",
        ),
    ]
    foxglove: Annotated[
        int | None,
        option(
            "Show nothing; serve Foxglove at this port of the loopback; 0: a free one.  [default: 8765]",
            type=click.IntRange(0, 65535),
            is_flag=False,
            flag_value=8765,
            metavar="[PORT]",
        ),
    ]
    plotjuggler: Annotated[
        int | None,
        option(
            "Show nothing; send JSON by UDP to PlotJuggler at this port of the loopback.  [default: 9870]",
            type=click.IntRange(1, 65535),
            is_flag=False,
            flag_value=9870,
            metavar="[PORT]",
        ),
    ]
    last: Annotated[bool, option("With --web: the page as it was at the last trip.")]

    def check(self, page: PageOptions, as_json: bool, eds: bool = False) -> None:
        """Refuse incompatible options.

        Raises
        ------
        click.UsageError
            The text names the options, and those to omit.
        """
        ways = {
            "--web": page.web,
            "--pcapng": self.pcapng,
            "--foxglove": self.foxglove,
            "--plotjuggler": self.plotjuggler,
        }
        if self.last and not page.web:
            raise click.UsageError("--last is of the page: add --web; for text: coulombus status")
        ways_out = [option for option, value in ways.items() if value is not None and value is not False]
        if len(ways_out) > 1:
            raise click.UsageError(f"{ways_out[0]} and {ways_out[1]}: choose one of them")
        if self.scope and (ways_out or as_json or not sys.stdout.isatty()):
            raise click.UsageError(f"--scope draws in a terminal: leave {' and '.join(ways_out) or 'it'} out")
        if ways_out and self.interval is not None:
            raise click.UsageError(f"--interval is of the table in a terminal: leave it or {ways_out[0]} out")
        if self.pcapng is not None and as_json:
            raise click.UsageError("--pcapng shows nothing: leave --json out")
        if eds and (ways_out or self.scope):
            raise click.UsageError(f"--eds is of a bus without a rig: leave {(ways_out or ['--scope'])[0]} out")


@click.command(epilog=EXIT_STATUS)
@with_options
def watch(
    file: OptionalRecordingArgument,
    bus_options: WatchedBusOptions,
    seconds: Annotated[float | None, option("End after this time.", type=SECONDS)],
    view: View,
    page: PageOptions,
    beside: Annotated[
        str | None,
        option(
            "Another verb began this page, which opens with this view, and ends it.",
            type=click.Choice(("plots", "bus")),
            hidden=True,
        ),
    ],
    as_json: JsonLinesOption,
) -> None:
    """Show a bus live: PDOs by name in SI units with rate and age, states of the nodes,
    emergencies, losses.

    Nothing is sent. Without --rig it is rig bench, until the bus turns out to be another one's:
    then nodes are numbers, and PDOs have their objects as far as SDO configuration seen, an EDS
    file or CiA 402 tells their maps. A live table in a terminal (p holds the picture, b shows raw bytes, those that
    changed stand out, w names the bits of status- and controlwords, 1 to 9 open an incident of
    `coulombus explain`, q ends it), else lines; with
    --web a page in a browser, whose STOP does what `coulombus stop` does. With a recording FILE and
    --web, its page: plots, cursor, incidents; with --last, the page at the last trip. Ends with 0 on Ctrl-C, SIGTERM, SIGHUP or SIGQUIT,
    with 4 when the bus goes away.

    \b
    Examples:
      coulombus watch --bus coulombus:bench
      coulombus watch --bus socketcan:can0 --rig my-rig.toml
      coulombus watch --bus socketcan:can0 --eds 5=drive.eds
      coulombus watch --json --seconds 5 | jq .signals
      coulombus watch --pcapng - | wireshark -k -i -
      coulombus watch --bus coulombus:bench --scope motor.position_rad
      coulombus watch --bus coulombus:bench --web
      coulombus watch --web --last
      coulombus watch run.pcapng --web
      coulombus watch --bus coulombus:bench --foxglove
    """
    with errors():
        from coulombus.monitor.watch import LiveView
        from coulombus.monitor.watch import watch as run

        view.check(page, as_json, eds=bool(bus_options.eds) and file is None)
        if view.last and file is not None:
            raise click.UsageError(f"{file} and --last: choose one of them")
        if view.last:
            from coulombus.wire.address import parse_address

            serve_last_page(
                *(None if bus_options.bus_name is None else parse_address(bus_options.bus_name), page),
                seconds=seconds,
                as_json=as_json,
            )
            return
        if file is not None:
            _open(file, bus_options, page, seconds=seconds, as_json=as_json)
            return
        bus, address = bus_options.known_bus(bus_options.bus_name)
        rig = bus.rig
        if rig is not None and (view.foxglove is not None or view.plotjuggler is not None):
            _forward(rig, address, view, seconds=seconds, as_json=as_json)
        elif rig is not None and page.web:
            serve_page(
                *(rig, address, page),
                rig_name=bus_options.rig_name,
                seconds=seconds,
                as_json=as_json,
                beside=beside,
            )
        elif rig is not None and view.pcapng is not None:
            from coulombus.recording.stream import stream

            stream(
                *(rig, address, str(view.pcapng)),
                seconds=seconds,
                say=lambda text: say(f"coulombus: {text}"),
                force=view.overwrite,
            )
        else:
            named = bus_options.names_rig
            assumed = not (named or view.scope or bus_options.overrides)
            run(
                bus,
                address,
                LiveView(as_json, view.interval, named, view.scope, assumed),
                seconds=seconds,
                host=None if address.is_adapter else lambda: host_line(address),
            )


def _open(
    file: Path, bus_options: WatchedBusOptions, page: PageOptions, *, seconds: float | None, as_json: bool
) -> None:
    """Serve a recording's page until a signal.

    Raises
    ------
    click.UsageError
        No page is requested, or a bus is also given.
    """
    if not page.web:
        raise click.UsageError(f"watch {file} needs --web; for text: coulombus decode {file}, coulombus explain {file}")
    if bus_options.bus_name is not None:
        raise click.UsageError("a FILE and --bus: choose one of them")
    serve_recording_page(
        *(file, page, bus_options.files()),
        rig_name=bus_options.rig_name if bus_options.names_rig and not bus_options.eds else None,
        channel=bus_options.channel,
        seconds=seconds,
        as_json=as_json,
    )


def _forward(rig: Rig, address: BusAddress, view: View, *, seconds: float | None, as_json: bool) -> None:
    """Forward to Foxglove or PlotJuggler until a signal; print the address, and the amount at the end."""
    from coulombus.monitor.forward import Foxglove, PlotJuggler, Sink, forward

    def ready(url: str) -> None:
        if as_json:
            echo(json.dumps({"event": "ready", "url": url}))
        else:
            say(f"{address} at {url}; Ctrl-C ends it")

    sink: Sink = Foxglove(rig, view.foxglove) if view.foxglove is not None else PlotJuggler(view.plotjuggler or 0)
    try:
        counts = forward(rig, address, sink, seconds=seconds, ready=ready)
    finally:
        sink.close()
    if as_json:
        echo(json.dumps({"event": "end", **counts}))
    else:
        say(f"{counts['pdos']} PDOs handed on, {counts['unheard']} unheard, {counts['lost']} lost")
