"""``coulombus doctor``: find problems of a rig's PC, and their fixes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import click

from coulombus.cli.errors import EXIT_STATUS, errors, print_json
from coulombus.cli.option_types import CPU, SECONDS
from coulombus.cli.options import BusesOption, JsonOption, RigOption, SetOption, option, with_options
from coulombus.cli.rig_options import load
from coulombus.cli.tables import echo, progress, table_console
from coulombus.system.exit import say, verdict

if TYPE_CHECKING:
    from collections.abc import Sequence

    from coulombus.host.doctor.checks import CheckResult
    from coulombus.host.doctor.examination import RigDemands
    from coulombus.host.doctor.latency import Latency

__all__ = ["doctor"]

WIDTH, INDENT = 80, 8


@click.command(epilog=EXIT_STATUS)
@with_options
def doctor(
    rig_name: RigOption,
    bus_names: BusesOption,
    overrides: SetOption,
    latency_s: Annotated[
        float | None,
        option(
            "--latency",
            "Also measure for this time how late the cycle would wake while every CPU is busy.",
            type=SECONDS,
            metavar="SECONDS",
        ),
    ],
    cpu: Annotated[int | None, option("CPU for the cycle.  [default: the one that run takes]", type=CPU)],
    fix: Annotated[bool, option("Print only a shell script with the fixes; nothing is run.")],
    as_json: JsonOption,
) -> None:
    """Check this PC for a rig: kernel, processors, rights, CAN card, disk, software; nothing is
    changed.

    Each finding that has to be mended comes with the command that mends it, and the exit status is
    1. What cannot be read counts as not ok.

    \b
    Examples:
      coulombus doctor
      coulombus doctor --rig my-rig.toml --bus socketcan:can0 --latency 60
      coulombus doctor --bus socketcan:can0 --fix > mend.sh
    """
    if fix and as_json:
        raise click.UsageError("--fix prints a script, and --json a document: give one of them")
    with errors():
        from coulombus.host.doctor.checks import script
        from coulombus.host.doctor.examination import RigDemands, examination
        from coulombus.rigs.buses import bus_addresses
        from coulombus.system.realtime import default_cpu

        cpu = default_cpu() if cpu is None else cpu
        rig = load(rig_name, overrides)
        needs = RigDemands.from_rig(rig)
        addresses = bus_addresses(rig, bus_names)
        findings = examination(needs, addresses, given_cpu=cpu)
        measured = None
        if latency_s is not None:
            measured, finding = _latency(latency_s, needs, cpu, quiet=as_json or fix)
            findings.append(finding)
        with verdict(0 if all(finding.ok for finding in findings) else 1):
            if fix:
                echo(script(findings), nl=False)
            elif as_json:
                print_json([finding.as_dict() for finding in findings])
            else:
                _print_findings(findings)
                if measured is not None:
                    _draw(measured)


def _latency(seconds: float, needs: RigDemands, cpu: int | None, *, quiet: bool) -> tuple[Latency | None, CheckResult]:
    from coulombus.host.doctor.checks import CheckResult
    from coulombus.host.doctor.latency import LatencyError, judge, measure_latency

    with progress(not quiet, "measured") as report:
        try:
            measured = measure_latency(
                seconds,
                needs,
                cpu=cpu,
                progress=lambda t: report("latency", t, seconds),
            )
        except LatencyError as error:
            return None, CheckResult("latency", False, f"the test did not run: {error}", "# see what stands above")
    return measured, judge(measured, needs)


def _print_findings(findings: Sequence[CheckResult]) -> None:
    import textwrap

    width = max(len(finding.check) for finding in findings)
    for finding in findings:
        head = f"{'ok' if finding.ok else 'FIX':<6}{finding.check:<{width}}  "
        text = finding.found
        echo(textwrap.fill(text, WIDTH, initial_indent=head, subsequent_indent=" " * len(head)))
        for line in finding.fix.splitlines():
            echo(" " * INDENT + line)  # to be copied: not wrapped
    bad = sum(not finding.ok for finding in findings)
    if bad:
        echo(f"{bad} of {len(findings)} to fix; `coulombus doctor --fix` prints all commands as a script")
    else:
        echo("ok")


def _draw(measured: Latency) -> None:
    from rich.table import Table

    from coulombus.host.doctor.latency import bars

    table = Table(box=None, header_style="", pad_edge=False)
    table.add_column("woke late by")
    for name in ("the cycle", *(["cyclictest"] if measured.cyclictest is not None else [])):
        table.add_column(name, justify="right")
        table.add_column("")
    for late, count, bar, other, beside in bars(measured):
        table.add_row(late, str(count), bar, *([] if other is None else [str(other), beside]))
    table_console(WIDTH).print(table)
    if measured.reason:
        say(f"coulombus: {measured.reason}: there is no reference to compare with")
