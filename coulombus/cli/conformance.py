"""`coulombus conformance`. It imports its dependencies only when it runs."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import click

from coulombus.cli.device_options import DevicesBusOption
from coulombus.cli.errors import EXIT_STATUS, errors, print_json
from coulombus.cli.option_types import UNCHECKED_PATH, OutputFile
from coulombus.cli.options import JsonOption, option, with_options
from coulombus.system.exit import printed, say

if TYPE_CHECKING:
    from coulombus.conformance.catalogue import Case
    from coulombus.conformance.runner import Report

__all__ = ["conformance"]

LONGEST_TIMEOUT_S = 60.0


@dataclass(frozen=True)
class Tested:
    """The device and the settings of its test, from the options."""

    bus_name: DevicesBusOption
    node_id: Annotated[
        int, option("--node", "The device's node id.", required=True, type=click.IntRange(1, 127), metavar="N")
    ]
    eds_path: Annotated[
        Path,
        option(
            "--eds",
            "EDS, DCF, XDD or XDC file of the device.",
            required=True,
            type=UNCHECKED_PATH,
            metavar="E",
        ),
    ]
    timeout: Annotated[float, option("Time limit for an answer.", default=1.0, metavar="S")]
    seed: Annotated[int, option("Random seed.", default=0)]
    force: Annotated[
        bool, option("Also on a device in NMT OPERATIONAL, a drive in Operation Enabled, or one that is not the EDS's.")
    ]


@dataclass(frozen=True)
class Reports:
    """Output files of ``conformance``, from the options."""

    overwrite: Annotated[bool, option("Overwrite existing reports. --force is about the device.", is_eager=True)]
    junit: Annotated[Path | None, option("Write JUnit XML there.", type=OutputFile(), metavar="F.xml")]
    report_path: Annotated[
        Path | None,
        option(
            "--report",
            "Write a readable report there, with the frames of each failure.",
            type=OutputFile(),
            metavar="F.md|F.html",
        ),
    ]

    def write(self, report: Report) -> None:
        """Write the requested files."""
        from coulombus.conformance.report import write_junit, write_report
        from coulombus.recording.output_file import new_file

        for place, write in ((self.junit, write_junit), (self.report_path, write_report)):
            if place is not None:
                with new_file(place, force=self.overwrite) as path:
                    write(report, path)


@click.command("conformance", epilog=EXIT_STATUS)
@with_options
def conformance(
    tested: Tested,
    numbers: Annotated[
        tuple[str, ...], option("--case", "Only this case, as 2.10. May be given several times.", metavar="ID")
    ],
    reports: Reports,
    as_json: JsonOption,
) -> None:
    """Test a CANopen device against its EDS and CiA 301, 305 and 402, over its bus alone.

    127 cases of a conformance test plan and cases of our own (ids that begin with a letter): pass,
    fail, or not applicable with the reason. The run resets the device and changes its objects. It
    begins from the device's defaults, stores parameters and ends with the defaults; a device that
    cannot load them (no 1011h) is not stored to. Nothing is moved: target torque stays 0.
    Ends with 1 when a case fails, or the tester itself fails in one. An interrupted run writes the
    results that it has.

    \b
    Examples:
      coulombus conformance --bus coulombus:bench --node 1 --eds eds/motor.eds
      coulombus conformance --bus socketcan:can0 --node 5 --eds drive.eds --report drive.html
      coulombus conformance --bus coulombus:bench --node 2 --eds eds/mr_brake.eds --case 2.10
    """
    with errors():
        from coulombus.conformance.report import as_dict
        from coulombus.conformance.runner import check_before, run, select
        from coulombus.conformance.tester.storage import intention
        from coulombus.conformance.tester.unit import Timing, Unit
        from coulombus.eds.reader import read_eds
        from coulombus.wire.address import WITH_ADAPTERS, parse_address
        from coulombus.wire.bus_link import BusLink

        if not 0.01 <= tested.timeout <= LONGEST_TIMEOUT_S:
            raise click.BadParameter(
                f"{tested.timeout}: expected 0.01 to {LONGEST_TIMEOUT_S:.0f} s", param_hint="--timeout"
            )
        cases = select(numbers)
        address = parse_address(tested.bus_name, WITH_ADAPTERS)
        description = read_eds(tested.eds_path)
        with BusLink(address) as link:
            unit = Unit(link, description, tested.node_id, Timing.from_timeout(tested.timeout), tested.seed)
            check_before(unit, force=tested.force)
            unit.learn_abilities()
            text = intention(unit, {case.id for case in cases})
            say(f"node {tested.node_id} on {address} is reset and changed now; {text}")
            with _progress(len(cases), not as_json) as progress:
                report = run(unit, cases, progress)
        failed = bool(report.count("fail") + report.count("error"))
        with printed(1 if failed or report.ended_by is not None else 0):
            if as_json:
                print_json(as_dict(report))
            else:
                _print(report)
        reports.write(report)
        if report.ended_by is not None:
            raise report.ended_by
        sys.exit(1 if failed else 0)


@contextmanager
def _progress(total: int, enabled: bool) -> Iterator[Callable[[int, Case], None]]:
    """Show a bar on stderr, where that is a terminal."""
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    from coulombus.system.printable_console import PrintableConsole

    console = PrintableConsole(stderr=True)
    if not enabled or not console.is_terminal:
        yield lambda number, case: None
        return
    columns = (
        BarColumn(30),
        TextColumn("{task.completed:.0f} of {task.total:.0f}  {task.description}"),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console, transient=True) as bars:
        task = bars.add_task("", total=total)

        def report(number: int, case: Case) -> None:
            bars.update(task, completed=number, description=f"{case.id} {case.name}")

        yield report


def _print(report: Report) -> None:
    from rich.markup import escape
    from rich.table import Table

    from coulombus.conformance.report import WORDS, causes, heading, reasons, summary
    from coulombus.system.printable_console import PrintableConsole

    console = PrintableConsole()
    blocks = [(heading(number, cause), cause.frames) for number, cause in enumerate(causes(report), 1)]
    blocks += [
        (f"{outcome.case.id} {outcome.reason}", outcome.frames)
        for outcome in report.outcomes
        if outcome.result == "error"
    ]
    for head, frames in blocks:
        console.print(f"[bold]{escape(head)}[/]", highlight=False)
        for line in frames:
            console.print(f"  {escape(line)}", highlight=False)
        console.print()
    table = Table(box=None, pad_edge=False)
    for head in ("case", "", "result", "reason"):
        table.add_column(head, overflow="fold")
    colour = {"pass": "green", "fail": "bold red", "not_applicable": "dim", "error": "bold magenta"}
    for outcome, reason in zip(report.outcomes, reasons(report), strict=True):
        result = f"[{colour[outcome.result]}]{WORDS[outcome.result]}[/]"
        table.add_row(outcome.case.id, escape(outcome.case.name), result, escape(reason))
    console.print(table)
    for remark in report.remarks:
        console.print(f"\n{escape(remark)}", highlight=False)
    console.print(f"\n{summary(report)}")
