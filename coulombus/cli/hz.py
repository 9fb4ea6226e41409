"""``coulombus hz``: timing of frames."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from coulombus.cli.common import json_option, printed, say
from coulombus.cli.errors import EXIT_STATUS, errors, print_json, remark
from coulombus.cli.option_types import SECONDS, InputPath
from coulombus.cli.rig_options import WatchedBusOptions, watched_bus_options
from coulombus.cli.tables import echo

__all__ = ["hz"]


@click.command(epilog=EXIT_STATUS)
@click.argument("file", required=False, type=InputPath())
@watched_bus_options
@click.option("--seconds", type=SECONDS, default=5.0, show_default=True, help="How long to listen to a bus.")
@json_option
def hz(
    file: Path | None,
    chosen: WatchedBusOptions,
    seconds: float,
    as_json: bool,
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
            if chosen.bus_name is not None:
                raise click.UsageError("a file and --bus: give one of them")
            from coulombus.recording.maps.known_bus import KnownBus
            from coulombus.recording.reading import blocks, has_rig

            given = bool(chosen.overrides) or (chosen.names_rig and not chosen.eds)
            where, source, lost = str(file), "the recording's", None
            if given or (not chosen.eds and has_rig(file)):
                recording = blocks(file, chosen.load() if given else None, chosen.channel)
                rig = recording.rig
                by_bus = {
                    channel: (KnownBus(rig.on(channel)), stamps) for channel, stamps in recorded(recording).items()
                }
                remark(recording.remarks)
            else:
                remarks: list[str] = []
                by_bus = {"": recorded_bare(file, chosen.channel, KnownBus(eds=chosen.files()), remarks)}
                remark(remarks)
        else:
            known, address = chosen.known(chosen.bus_name)
            if sys.stderr.isatty():
                say(f"coulombus: listening to {address} for {seconds:g} s")
            stamps, lost = listen(address, seconds)
            by_bus = {"": (known, stamps)}
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
