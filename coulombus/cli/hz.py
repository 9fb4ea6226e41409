"""``coulombus hz``: timing of frames."""

from __future__ import annotations

import sys
from typing import Annotated

import click

from coulombus.cli.errors import EXIT_STATUS, errors, print_json, remark
from coulombus.cli.option_types import SECONDS
from coulombus.cli.options import JsonOption, OptionalRecordingArgument, option, with_options
from coulombus.cli.rig_options import WatchedBusOptions
from coulombus.cli.tables import echo
from coulombus.system.exit import printed, say

__all__ = ["hz"]


@click.command(epilog=EXIT_STATUS)
@with_options
def hz(
    file: OptionalRecordingArgument,
    bus_options: WatchedBusOptions,
    seconds: Annotated[float, option("How long to listen to a bus.", type=SECONDS, default=5.0)],
    as_json: JsonOption,
) -> None:
    """Measure rate and jitter of each identifier, and how long after SYNC the PDOs come.

    Of a bus, to which nothing is sent, or of a recording FILE, which needs no rig. Jitter is how far the time between
    two frames is from its median.

    \b
    Examples:
      coulombus hz --bus socketcan:can0 --seconds 10
      coulombus hz run.pcapng
      coulombus hz --bus socketcan:can0 --eds 5=drive.eds
      coulombus hz candump.log --json
    """
    with errors():
        from coulombus.monitor.timing import as_dict, as_lines, listen, recorded, recorded_bare, timing

        if file is not None:
            if bus_options.bus_name is not None:
                raise click.UsageError("a file and --bus: give one of them")
            from coulombus.recording.maps.known_bus import KnownBus
            from coulombus.recording.reading import blocks, has_rig

            with_rig = bool(bus_options.overrides) or (bus_options.names_rig and not bus_options.eds)
            where, source, lost = str(file), "the recording's", None
            if with_rig or (not bus_options.eds and has_rig(file)):
                recording = blocks(file, bus_options.load() if with_rig else None, bus_options.channel)
                rig = recording.rig
                by_bus = {
                    channel: (KnownBus(rig.on(channel)), stamps) for channel, stamps in recorded(recording).items()
                }
                remark(recording.remarks)
            else:
                remarks: list[str] = []
                by_bus = {"": recorded_bare(file, bus_options.channel, KnownBus(eds=bus_options.files()), remarks)}
                remark(remarks)
        else:
            known_bus, address = bus_options.known_bus(bus_options.bus_name)
            if sys.stderr.isatty():
                say(f"coulombus: listening to {address} for {seconds:g} s")
            stamps, lost = listen(address, seconds)
            by_bus = {"": (known_bus, stamps)}
            where, source = str(address), stamps.source
        rows = {bus: timing(*of_bus) for bus, of_bus in by_bus.items()}
        if as_json:
            identifiers = [
                as_dict(row) | ({"bus": bus} if len(rows) > 1 else {})
                for bus, timings in rows.items()
                for row in timings
            ]
            print_json({"of": where, "stamps": source, "lost": lost, "identifiers": identifiers})
            return
        with printed():
            echo(f"{where}\nstamps: {source}" + ("" if lost is None else f"\nlost {lost}"))
            for bus, timings in rows.items():
                if len(rows) > 1:
                    echo(f"\nbus {bus}")
                for line in as_lines(timings):
                    echo(line)
