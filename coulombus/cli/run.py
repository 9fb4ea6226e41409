"""``coulombus run``: the host on one bus or on several."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import click

from coulombus.cli.errors import EXIT_STATUS, errors, print_json
from coulombus.cli.option_types import CPU, PICTURE, SECONDS, SECONDS_OR_NONE, UNCHECKED_PATH, RecordingPlace
from coulombus.cli.options import (
    JsonOption,
    ModeOption,
    OverwriteOption,
    SharedMachineOption,
    option,
    with_options,
    words,
)
from coulombus.cli.page_options import PageOptions
from coulombus.cli.rig_options import BusesOptions, check_mode, check_shared_machine
from coulombus.cli.run_table import print_runs
from coulombus.cli.tables import progress
from coulombus.system.exit import say, verdict
from coulombus.system.foreign_text import printable

if TYPE_CHECKING:
    from coulombus.host.run.markers import BitMark
    from coulombus.host.run.run import Outputs
    from coulombus.rigs.rig import Rig
    from coulombus.wire.address import BusAddress

__all__ = ["run_command"]

PAGE_AFTER_TRIP_S = 60.0
SEGMENT = "100MB"
"""Default size at which a segment ends."""
ZSTD = "zstd"


@dataclass(frozen=True)
class DisplayOptions(BusesOptions):
    """A rig and its buses, a mode, and the duration of the display."""

    mode: ModeOption
    seconds: Annotated[float | None, option("Duration of the display.  [default: until it is stopped]", type=SECONDS)]


def _readable(parser: str) -> Callable[[click.Context, click.Parameter, str | None], str | None]:
    """Return an option callback that refuses a text which `recording.segments` cannot read, before a folder is made."""

    def check(context: click.Context, option: click.Parameter, text: str | None) -> str | None:
        from coulombus.recording import segments

        try:
            if text is not None:
                getattr(segments, parser)(text)
        except ValueError as error:
            raise click.BadParameter(str(error)) from None
        return text

    return check


@dataclass(frozen=True)
class OutputOptions:
    """The given options."""

    record: Annotated[
        Path | None,
        option(
            "Record every frame there: in a new file F.pcapng, or in segments in a folder.",
            type=RecordingPlace(),
            metavar="PLACE",
        ),
    ]
    rotate: Annotated[
        str | None,
        option(
            f"--record is a folder; a new segment after this size or time: 100MB, 1h.  [default of a folder: {SEGMENT}]",
            is_eager=True,
            callback=_readable("parse_rotation"),
            metavar="SIZE|TIME",
        ),
    ]
    keep: Annotated[
        str | None,
        option(
            "Keep this much in that folder, and remove the oldest segments: 20GB.  [default: all]",
            callback=_readable("parse_size"),
            metavar="SIZE",
        ),
    ]
    compress: Annotated[
        str | None,
        option(
            f"Compress finished segments, in a process of the lowest priority.  [default of a folder: {ZSTD}]",
            type=click.Choice([ZSTD, "none"]),
        ),
    ]
    status: Annotated[
        Path | None,
        option(
            "Make a socket there that sends the state, a JSON line every 100 ms, to each reader.",
            type=UNCHECKED_PATH,
            metavar="SOCKET",
        ),
    ]
    meta: Annotated[tuple[str, ...], option("Attach this to the recording: subject=S01.", metavar="KEY=VALUE")]
    mark_on: Annotated[
        tuple[str, ...],
        option(
            "Mark the recording when these bits of a signal become 1: motor.deadman:0x20000=pedal.",
            metavar="SIGNAL:MASK=TEXT",
        ),
    ]
    overwrite: OverwriteOption
    histogram: Annotated[
        Path | None, option("Draw wake-up and SYNC-to-RPDO times there.", type=PICTURE, metavar="F.png")
    ]

    @property
    def segmented(self) -> bool:
        """Whether the recording is a folder of segments."""
        return self.record is not None and self.record.is_dir()

    @property
    def files(self) -> dict[str, Path]:
        """Output files: option -> path."""
        places = {"--record": self.record, "--histogram": self.histogram, "--status": self.status}
        return {option: path for option, path in places.items() if path is not None}

    def refusable(self) -> Iterable[Path]:
        """Return the files that are refused if they exist: not folders or sockets."""
        return [
            path
            for option, path in self.files.items()
            if option != "--status" and not (self.segmented and option == "--record")
        ]

    def words(self) -> list[str]:
        """Return the command-line words of all options except the files."""
        values = self
        if self.segmented:
            values = replace(self, rotate=self.rotate or SEGMENT, compress=self.compress or ZSTD)
        return words(values, without=["record", "status", "histogram"])

    def outputs(self, rig: Rig) -> Outputs:
        """Return the outputs of the run on `rig`.

        Raises
        ------
        click.UsageError
            The options are incompatible.
        """
        from coulombus.host.run.run import Outputs
        from coulombus.recording.segments import parse_rotation, parse_size

        rotation = None if self.rotate is None else parse_rotation(self.rotate)
        keep = None if self.keep is None else parse_size(self.keep)
        if self.segmented:
            compress = self.compress in (None, ZSTD)
            rotation = replace(rotation or parse_rotation(SEGMENT), keep_bytes=keep, compress=compress)
            if keep is not None and keep < 2 * (rotation.most_bytes or 0):
                raise click.UsageError(
                    f"--keep {keep} bytes: expected at least two segments of {rotation.most_bytes} bytes"
                )
        elif rotation is not None or keep is not None or self.compress is not None:
            raise click.UsageError(
                "--rotate, --keep and --compress are of a folder: give one with --record, as in "
                "--record runs --rotate 1h"
            )
        return Outputs(
            record=self.record,
            rotation=rotation,
            meta=self._metadata(),
            mark_on=self._bits(rig),
            histogram=self.histogram,
            status=self.status,
            force=self.overwrite,
        )

    def _bits(self, rig: Rig) -> tuple[BitMark, ...]:
        """Return the bits named by --mark-on."""
        from coulombus.host.run.markers import bit_mark

        if self.mark_on and self.record is None:
            raise click.UsageError("--mark-on marks a recording: give --record, too")
        try:
            return tuple(bit_mark(text, rig) for text in self.mark_on)
        except ValueError as error:
            raise click.BadParameter(str(error), param_hint="--mark-on") from None

    def _metadata(self) -> dict[str, str]:
        """Return the pairs of --meta."""
        if self.meta and self.record is None:
            raise click.UsageError("--meta is of a recording: give --record, too")
        pairs: dict[str, str] = {}
        for text in self.meta:
            key, equals, value = text.partition("=")
            if not equals or not key.strip() or key in pairs:
                reason = "twice" if key in pairs else "expected KEY=VALUE, as in subject=S01"
                raise click.BadParameter(f"{text!r}: {reason}", param_hint="--meta")
            pairs[key] = value
        return pairs


@dataclass(frozen=True)
class HostOptions:
    """Limits, processor and world of the host."""

    shared_machine: SharedMachineOption
    cpu: Annotated[
        int | None, option("CPU for the cycle's process.  [default: the last isolated one, else the last]", type=CPU)
    ]
    world: Annotated[bool, option("Let another program say what the hand meets (docs/worlds.md).")]


@dataclass(frozen=True)
class HostPageOptions(PageOptions):
    """The page, and how long it stays after the host's end."""

    web_after: Annotated[
        float | None,
        option(
            f"Keep the page after the host's end.  [default: {PAGE_AFTER_TRIP_S:g} after a trip, else 0]",
            type=SECONDS_OR_NONE,
            metavar="S",
        ),
    ]

    def stays_s(self, trip: str | None) -> float:
        """Return for how long the page stays after a run."""
        return PAGE_AFTER_TRIP_S * bool(trip) if self.web_after is None else self.web_after


@click.command("run", epilog=EXIT_STATUS)
@with_options
def run_command(
    display: DisplayOptions, outputs: OutputOptions, host: HostOptions, page: HostPageOptions, as_json: JsonOption
) -> None:
    """Run the host alone, in real time, on a bus where the nodes are: simulated ones
    (`coulombus emulate`) or a rig.

    Ends safely when the time is over, by q or Escape in its terminal (exit status 0), on Ctrl-C
    (130), SIGTERM (143), when the terminal is closed (129), on Ctrl-Backslash (131), `coulombus stop`
    (0), or a trip (7). After a trip nothing re-arms by itself. Real-time rights are asked for; what is
    refused is told with the command that grants it.

    \b
    Examples:
      coulombus emulate                     # in a terminal of its own; then:
      coulombus run --mode hybrid --seconds 13 --record run.pcapng
      coulombus run --bus socketcan:can0 --rig my-rig.toml --mode active --json
      coulombus run --record runs --rotate 1h --keep 20GB --meta subject=S01
    """
    if page.web_after is not None and not page.web:
        raise click.UsageError("--web-after is of the page: give --web, too")
    with errors():
        from coulombus.host.run.buses import path_on
        from coulombus.host.run.real_run import real_run
        from coulombus.host.run.run import OUTSIDE, Run
        from coulombus.host.run.runbook import advice  # before the run: at its end files can no longer be opened
        from coulombus.recording.output_file import check as check_output
        from coulombus.rigs.overrides import shared_machine as wider
        from coulombus.rigs.rig import load_rig
        from coulombus.system.keyboard import in_foreground
        from coulombus.system.stop_signals import Signals

        mode = display.mode
        rig = display.load(*(wider(load_rig(display.rig_name, display.overrides)) if host.shared_machine else ()))
        addresses = display.addresses(rig)
        if host.shared_machine:
            check_shared_machine(addresses.values())
        check_mode(rig, display.rig_name, mode)
        out = outputs.outputs(rig)
        if display.channel is not None:
            if rig.one_cycle and len(rig.channels) > 1:
                raise click.UsageError(
                    f"--channel {display.channel}: one host serves both joints of an arm, on all its buses"
                )
            rig = rig.on(display.channel)
        if len(rig.channels) > 1:
            page.refuse_several()
        if not rig.one_cycle:
            child = ["run", "--json", *words(display, without=["bus_names", "channel"]), *words(host), *outputs.words()]
            for path in (path_on(path, channel) for path in outputs.refusable() for channel in addresses):
                check_output(path, force=outputs.overwrite)  # for all buses before the first one starts
            _run_buses(child, addresses, outputs.files, mode, as_json)
        address = next(iter(addresses.values()))
        if not as_json and in_foreground():
            say("q or Escape stops safely; 1 to 9 mark the recording")
        with page.beside(display, address) as stay:
            with Signals() as signals, progress(not as_json, width=10) as report:
                result = real_run(
                    Run(rig, mode, display.seconds, world=OUTSIDE if host.world else None, outputs=out, virtual=False),
                    bus=tuple(addresses.values()),
                    signals=signals,
                    progress=lambda t, axes: report(mode, t, display.seconds, _state(axes)),
                    cpu=host.cpu,
                )
            with verdict(result.exit_status, f"trip: {printable(result.trip)}" if result.trip else ""):
                _say_what_to_do(result.trip, advice, host.shared_machine)
                if as_json:
                    print_json(result.as_dict())
                else:
                    print_runs({mode: result})
                sys.stdout.flush()
                stay(page.stays_s(result.trip))


def _state(axes: list[dict[str, Any]]) -> str:
    """Return the present display as text, at most 80 columns wide."""
    shown = ", ".join(
        f"{axis['axis']} {axis['phase']}: brake {axis['brake_torque_Nm']:.2f}, handle {axis['handle_torque_Nm']:.2f} Nm".lstrip()
        for axis in axes
    )
    return f"{shown}, lost {sum(axis['lost_pdos'] for axis in axes)}"


def _say_what_to_do(trip: str | None, advice: Callable[[str], str | None], shared_machine: bool) -> None:
    """After a trip, print the command that explains it (`advice`); for missing TPDOs, suggest --shared-machine first."""
    if trip is None:
        return
    if "TPDO_LOST" in trip and not shared_machine:
        text = "a busy machine may have stalled for that long: --shared-machine widens the limits"
        say(f"coulombus: {text} (docs/realtime.md)")
    if command := advice(trip):
        say(f"coulombus: likely causes, and what to do: {command}")


def _run_buses(
    child: list[str], addresses: dict[str, BusAddress], files: dict[str, Path], mode: str, as_json: bool
) -> None:
    """Run the host on several buses, a process each, and exit with their combined status."""
    from coulombus.host.run.buses import merged, path_on, supervise
    from coulombus.host.run.result import RunResult
    from coulombus.host.run.runbook import advice

    def arguments(channel: str) -> list[str]:
        places = ((option, path_on(path, channel)) for option, path in files.items())
        file_words = [word for option, path in places for word in (option, str(path))]
        return [*child, *file_words, "--channel", channel, "--bus", f"{channel}={addresses[channel]}"]

    buses = supervise(list(addresses), arguments)
    whole = merged({b.channel: b.result for b in buses}, {b.channel: b.status for b in buses})
    with verdict(whole["exit_status"]):
        _say_what_to_do(whole.get("trip"), advice, "--shared-machine" in child)
        if as_json:
            print_json(whole)
        elif "mode" in whole:
            print_runs({mode: RunResult(**whole)})
