"""``coulombus explain``: find errors in a log or on a bus, their causes and first checks."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import click

from coulombus.cli.errors import EXIT_STATUS, errors, print_json
from coulombus.cli.option_types import SECONDS, OutputFile
from coulombus.cli.options import (
    ADAPTER,
    FileChannelOption,
    JsonOption,
    LogEdsOption,
    OptionalRecordingArgument,
    OverwriteOption,
    SpanOption,
    argument,
    option,
    with_adapter_options,
    with_options,
)
from coulombus.cli.rig_options import eds_files_of, load
from coulombus.cli.tables import PROSE, echo, on_terminal
from coulombus.system.exit import printed, say

if TYPE_CHECKING:
    from coulombus.eds.eds_folder import EdsFiles
    from coulombus.explain.explained import Explanation
    from coulombus.explain.incidents import Incident
    from coulombus.rigs.rig import Rig

__all__ = ["explain"]

FAILED = 1
COURSE = 29
"""Column of the text in a line of an incident's course."""


@dataclass(frozen=True)
class Knowledge:
    """Rig, EDS files and span for the explanation, from the options."""

    rig_name: Annotated[
        str | None, option("--rig", "Names and PDO maps of this rig.  [default: the attached one]", metavar="R")
    ]
    eds: LogEdsOption
    channels: FileChannelOption
    span: SpanOption

    def load(self) -> tuple[Rig | None, EdsFiles]:
        """Load rig and EDS files; report unreadable files of a folder."""
        return (None if self.rig_name is None else load(self.rig_name, ())), eds_files_of(self.eds)


@dataclass(frozen=True)
class ExplainOutputs:
    """Output of the explanation, from the options."""

    report: Annotated[
        Path | None, option("Write a report, HTML or Markdown.", type=OutputFile(".html", ".md"), metavar="F.html")
    ]
    overwrite: OverwriteOption
    as_json: JsonOption
    check: Annotated[bool, option("End with 1 if anything is unresolved.")]
    nodes: Annotated[bool, option("Print the nodes instead: identity, EDS file, figures.")]


@click.command(epilog=EXIT_STATUS)
@with_options
def explain(
    file: OptionalRecordingArgument,
    number: Annotated[int | None, argument(required=False, type=click.IntRange(1), metavar="[N]")],
    bus_name: Annotated[
        str | None,
        option(
            "--bus",
            "A live bus instead of FILE: coulombus:NAME, socketcan:IF or can:INTERFACE:CHANNEL.",
            metavar="B",
            callback=with_adapter_options,
        ),
        ADAPTER,
    ],
    seconds: Annotated[float | None, option("How long to listen to a bus.  [default: until Ctrl-C]", type=SECONDS)],
    knowledge: Knowledge,
    outputs: ExplainOutputs,
) -> None:
    """Say what went wrong on a CANopen bus, why, and what to check first.

    Of a recording or another tool's log FILE, which needs no rig: PDO maps come from the SDO
    configuration in it, from EDS files, or from CiA 402's defaults. With N, incident N in detail.
    With --bus, of a live bus, to which nothing is sent.

    \b
    Examples:
      coulombus explain candump.log
      coulombus explain run.pcapng 1
      coulombus explain candump.log --eds 5=drive.eds --report report.html
      coulombus explain candump.log --nodes --eds my-eds-files
      coulombus explain run.pcapng --check --json | jq .verdict
      coulombus explain --bus socketcan:can0
    """
    with errors():
        if (file is None) == (bus_name is None):
            raise click.UsageError("a FILE and --bus: give one of them")
        if bus_name is not None and knowledge.span != (None, None):
            raise click.UsageError("--span is of a FILE: leave it out, or give --seconds")
        if bus_name is None and seconds is not None:
            raise click.UsageError("--seconds is of a bus: leave it out, or give --span")
        rig, files = knowledge.load()
        if file is not None:
            from coulombus.explain.explained import explain as explain_file

            explanation = explain_file(file, rig=rig, eds=files, span=knowledge.span, channel=knowledge.channels)
            source = str(file)
        else:
            source = f"--bus {bus_name}"
            explanation = _listen(str(bus_name), rig, files, seconds, outputs.as_json)
        _show(explanation, source, number, outputs)
        if outputs.check and explanation.verdict == "unresolved":
            raise SystemExit(FAILED)


def _listen(bus_name: str, rig: Rig | None, files: EdsFiles, seconds: float | None, as_json: bool) -> Explanation:
    """Listen to a bus, and print each incident to stderr."""
    from coulombus.explain.explanation_text import news
    from coulombus.explain.live_bus import explain_bus
    from coulombus.recording.maps.known_bus import KnownBus
    from coulombus.wire.address import WITH_ADAPTERS, parse_address

    def print_news(explanation: Explanation, incident: Incident) -> None:
        if not as_json:
            say(news(explanation, incident))

    known_bus = KnownBus(rig, files)
    return explain_bus(parse_address(bus_name, WITH_ADAPTERS), print_news, known=known_bus, seconds=seconds)


def _show(explanation: Explanation, source: str, number: int | None, outputs: ExplainOutputs) -> None:
    """Print the screen, the incident or the JSON object, and write the report."""
    from coulombus.explain.explanation_text import as_dict, detail_lines, html_page, markdown, node_lines, screen
    from coulombus.recording.output_file import new_file

    incidents = {incident.number: incident for incident in explanation.incidents}
    if number is not None and number not in incidents:
        has = f"it has {len(incidents)}" if incidents else "it has none"
        raise click.BadParameter(f"{source} has no incident {number}: {has}", param_hint="N")
    if outputs.report is not None:
        page = html_page if outputs.report.suffix.lower() == ".html" else markdown
        with new_file(outputs.report, force=outputs.overwrite) as path:
            path.write_text(page(explanation, source), encoding="utf-8")
    if outputs.as_json:
        value: dict[str, Any] = as_dict(explanation)
        if number is not None:
            value["incidents"] = [row for row in value["incidents"] if row["number"] == number]
        print_json(value)
        return
    lines = screen(explanation, source) if number is None else detail_lines(explanation, incidents[number], source)
    if outputs.nodes:
        with printed():
            for line in node_lines(explanation):
                echo(line)
        return
    with printed():
        for line in lines:
            echo(on_terminal(line, COURSE if line.startswith("     ") else 3, piped=PROSE))
