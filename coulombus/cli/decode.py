"""``coulombus decode``: a recording, frame by frame."""

from __future__ import annotations

import sys
from dataclasses import replace

import click

from coulombus.cli.errors import EXIT_STATUS, errors, remark
from coulombus.cli.options import JsonLinesOption, RecordingArgument, with_options
from coulombus.cli.rig_options import LogOptions
from coulombus.system.foreign_text import printable
from coulombus.system.wrap_text import columns_of

__all__ = ["decode"]


@click.command(epilog=EXIT_STATUS)
@with_options
def decode(
    file: RecordingArgument,
    log: LogOptions,
    as_json: JsonLinesOption,
) -> None:
    """Print a recording frame by frame, PDOs by name in SI units.

    Takes pcapng and other tools' logs (docs/recording.md lists their formats). Without a rig,
    attached or given, nodes are numbers, and PDOs have their objects as far as the log's SDO
    configuration, an EDS file or CiA 402 tells their maps.

    \b
    Examples:
      coulombus decode out/demo/hybrid.pcapng | less
      coulombus decode candump.log --eds 5=drive.eds
      coulombus decode both.log --rig bench --channel can1
      coulombus decode run.pcapng --json | jq 'select(.node == "motor")'
    """
    with errors():
        from coulombus.monitor.decode import as_json as as_json_line
        from coulombus.monitor.decode import as_text, bare_rows, fitted, rows, text_lines
        from coulombus.recording.maps.known_bus import KnownBus
        from coulombus.recording.reading import blocks, has_rig
        from coulombus.rigs.rig import load_rig

        files = log.files()
        bare = log.rig_name is None and (bool(log.eds) or not has_rig(file))
        recording = None
        if not bare:
            rig = None if log.rig_name is None else load_rig(log.rig_name)
            recording = replace(blocks(file, rig, log.channels), inside=())  # the host's telemetry was on no bus
        remarks: list[str] = []
        out = sys.stdout
        width = columns_of(out)

        def written(text: str) -> str:
            return text + "\n" if as_json or width is None else fitted(text, width) + "\n"

        if recording is not None and not as_json:
            for lines in text_lines(recording):
                out.writelines(map(written, lines))
        else:
            for row in (
                bare_rows(file, log.channels, KnownBus(eds=files), remarks) if recording is None else rows(recording)
            ):
                out.write(written(as_json_line(row) if as_json else printable(as_text(row))))
        out.flush()
        remark(remarks if recording is None else recording.remarks)
