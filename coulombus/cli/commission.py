"""``coulombus commission``: replace the assumptions of a rig file by measured values."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import click

from coulombus.cli.errors import EXIT_STATUS, errors, print_json
from coulombus.cli.option_types import OutputFile
from coulombus.cli.options import (
    BusOption,
    JsonOption,
    OverwriteOption,
    SeedOption,
    SetOption,
    SharedMachineOption,
    option,
    with_options,
)
from coulombus.cli.rig_options import check_shared_machine, load
from coulombus.cli.tables import echo, progress, table_console
from coulombus.system.exit import say, verdict

if TYPE_CHECKING:
    from coulombus.host.commission.session import Runner, Session, StepEnd
    from coulombus.host.commission.step import Exercise, Finding, Risk, Step
    from coulombus.host.run.result import RunResult

__all__ = ["commission"]


@dataclass(frozen=True)
class Rehearsal:
    """The rig of a rehearsal, from the options."""

    virtual: Annotated[bool, option("Rehearse in virtual time, on the rig file's own [plant].")]
    truth: Annotated[
        Path | None,
        option(
            "With --virtual: the rig file of the simulated rig as it truly is.",
            type=click.Path(readable=False, path_type=Path, dir_okay=False),
            metavar="T.toml",
        ),
    ]
    seed: SeedOption

    def runner(self, axis: str | None) -> Runner:
        """Return a function that runs the steps in virtual time."""
        from coulombus.lab.commissioning import rehearsed

        true = None if self.truth is None else load(str(self.truth.resolve()), ()).alone(axis)
        return rehearsed(true, seed=self.seed)


@dataclass(frozen=True)
class CommissionedRig:
    """The rig file to write, and its bus, from the options."""

    rig_path: Annotated[
        Path | None,
        option(
            "--rig",
            "The rig file to commission; it is written.",
            type=click.Path(readable=False, path_type=Path, dir_okay=False),
            metavar="MY.toml",
        ),
    ]
    bus_name: BusOption
    axis: Annotated[str | None, option("Axis of a rig file with several.", metavar="NAME")]
    overrides: SetOption
    shared_machine: SharedMachineOption

    def path(self) -> Path:
        """Return the rig file.

        Raises
        ------
        click.UsageError
            None is named, or one that must not be written.
        """
        from coulombus.rigs.rig import known_rigs

        if self.rig_path is None:
            raise click.UsageError("give --rig MY.toml: what is found is written into it")
        if not self.rig_path.is_file() and str(self.rig_path) in known_rigs():
            raise click.UsageError(
                f"{self.rig_path} is a rig of the package, which is not written; make a file of your own: "
                "coulombus init --drive bench --brake bench --rehearse -o my-rig.toml"
            )
        return self.rig_path

    def all_overrides(self) -> tuple[str, ...]:
        """Return the overrides of the rig, preceded by the wider limits of a shared machine."""
        from coulombus.rigs.overrides import shared_machine
        from coulombus.rigs.rig import load_rig
        from coulombus.wire.address import parse_address

        if not self.shared_machine:
            return self.overrides
        check_shared_machine(() if self.bus_name is None else (parse_address(self.bus_name),))
        return (*shared_machine(load_rig(str(self.rig_path), self.overrides)), *self.overrides)


@dataclass(frozen=True)
class StepOptions:
    """Selection and settings of the steps, from the options."""

    names: Annotated[tuple[str, ...], option("--step", "Only this step; may be given several times.", metavar="NAME")]
    listed: Annotated[bool, option("--list", "Print the steps, and which are done; nothing moves.")]
    again: Annotated[bool, option("Repeat steps that are done.")]
    yes: Annotated[bool, option("Do not ask for confirmation. Nobody may touch the rig.")]


@dataclass(frozen=True)
class ManualMeasurements:
    """Manual measurements for a step, from the options."""

    weight_Nm: Annotated[
        float | None, option("Torque of a known weight at the handle, for the step weight.", type=float)
    ]
    marks_rad: Annotated[
        float | None, option("Angle between two marks at the handle, for the step encoder.", type=float)
    ]
    weight_reach_Nm: Annotated[
        float, option("Half of the 95 % interval of the weight's torque.", type=click.FloatRange(min=0.0), default=0.0)
    ]
    marks_reach_rad: Annotated[
        float,
        option(
            "Half of the 95 % interval of the marks' angle, as your hand sets it.",
            type=click.FloatRange(min=0.0),
            default=0.002,
        ),
    ]


@dataclass(frozen=True)
class Paper:
    """Where the report is written besides the folder of the commissioning, and its operator's name."""

    path: Path | None
    operator: str | None


@click.command(epilog=EXIT_STATUS)
@with_options
def commission(
    rig: CommissionedRig,
    doing: StepOptions,
    rehearsal: Rehearsal,
    weighed: ManualMeasurements,
    report: Annotated[Path | None, option("Write the report there, too.", type=OutputFile(".html"), metavar="F.html")],
    operator: Annotated[str | None, option("Your name, for the report.  [default: the user's]", metavar="NAME")],
    overwrite: OverwriteOption,
    as_json: JsonOption,
) -> None:
    """Measure the rig step by step, and write what is found into its rig file.

    Before a step moves anything it says what will move, and at most how far, and asks. Ctrl-C stops
    it safely. The findings are written with their date; a copy of the old file is kept. Completed
    steps are skipped, so an interrupted session continues where it stopped.

    \b
    Examples:
      coulombus commission --list
      coulombus commission --rig my.toml --bus socketcan:can0
      coulombus commission --rig my.toml --bus socketcan:can0 --step friction
      coulombus commission --rig two.toml --axis left --bus socketcan:can0
      coulombus commission --rig my.toml --virtual --truth truth.toml --yes --json
    """
    with errors():
        from coulombus.host.commission.session import STEPS, Session, results
        from coulombus.host.commission.step import Given

        steps = _selected(STEPS, doing.names)
        if doing.listed:
            _print_list(steps, rig.rig_path, rig.axis, as_json)
        path = rig.path()
        if rehearsal.truth is not None and not rehearsal.virtual:
            raise click.UsageError("--truth is for --virtual")
        if rehearsal.virtual and rig.bus_name is not None:
            raise click.UsageError("--virtual has a bus of its own; leave out --bus")
        overrides = rig.all_overrides()
        if not doing.yes and not _somebody():
            raise click.UsageError("no terminal to ask on: give --yes")
        load(str(path.resolve()), overrides)
        run = rehearsal.runner(rig.axis) if rehearsal.virtual else _real(rig.bus_name, as_json)
        values = Given(weighed.weight_Nm, weighed.marks_rad, weighed.marks_reach_rad, weighed.weight_reach_Nm)
        session = Session(path, run, values, overrides, rig.axis)
        done = _commission(session, steps, doing, Paper(report, operator))
        asked_for_what_lacks = bool(doing.names) and any(result.what == "lacking" for result in done)
        with verdict(1 if asked_for_what_lacks else 0):
            if as_json:
                print_json(results(done))
            elif any(result.outcome for result in done):
                _print_findings(done)


def _selected(steps: tuple[Step, ...], names: tuple[str, ...]) -> tuple[Step, ...]:
    names_of_steps = [step.name for step in steps]
    for name in names:
        if name not in names_of_steps:
            from coulombus.rigs.errors import nearest

            raise click.BadParameter(
                f"{name!r}: expected one of {', '.join(names_of_steps)}{nearest(name, names_of_steps)}",
                param_hint="--step",
            )
    return tuple(step for step in steps if not names or step.name in names)


def _print_list(steps: tuple[Step, ...], rig_path: Path | None, axis: str | None, as_json: bool) -> None:
    """Print the steps, and end."""
    from coulombus.host.commission.session import Progress, folder_of

    done = Progress.load(folder_of(rig_path, axis)).steps if rig_path is not None else {}
    rows = [{"step": step.name, "title": step.title, "done": done.get(step.name, {}).get("at")} for step in steps]
    with verdict(0):
        if as_json:
            print_json({"steps": rows})
        else:
            for row in rows:
                echo(f"{row['step']:<12}{row['title']:<52}{row['done'] or '-'}")


def _commission(session: Session, steps: tuple[Step, ...], doing: StepOptions, paper: Paper) -> list[StepEnd]:
    """Execute the steps, and return their results."""
    done: list[StepEnd] = []
    for step in steps:
        if step.name in session.state.steps and not (doing.again or doing.names):
            say(f"{step.name}: done at {session.state.steps[step.name]['at']} (--again: once more)")
            continue
        result = session.do(step, lambda step, risk: _agree(step, risk, doing.yes))
        done.append(result)
        _print_end(result)
        if result.what == "done":
            _report(session, paper)
    return done


def _real(bus_name: str | None, as_json: bool) -> Runner:
    from coulombus.host.run.real_run import real_run
    from coulombus.host.run.run import Outputs, Run
    from coulombus.system.stop_signals import Signals
    from coulombus.wire.address import parse_address

    address = None if bus_name is None else parse_address(bus_name)

    def run(exercise: Exercise, path: Path) -> RunResult:
        with Signals() as signals, progress(not as_json) as bar:
            outputs = Outputs(record=path, force=True)
            return real_run(
                Run(exercise.rig, exercise.mode, exercise.seconds, outputs=outputs, virtual=False),
                bus=address,
                signals=signals,
                progress=lambda t, _: bar(exercise.name, t, exercise.seconds),
            )

    return run


def _somebody() -> bool:
    """Return whether a terminal is available for questions."""
    return sys.stdin.isatty()


def _agree(step: Step, risk: Risk, yes: bool) -> bool:
    say(f"\nstep {step.name}: {step.title}")
    for line in risk.lines():
        say(f"  {line}")
    if yes:
        return True
    try:
        return click.confirm("  begin?", err=True)
    except click.Abort:  # Ctrl-C, or the terminal has closed
        raise KeyboardInterrupt from None


def _print_end(result: StepEnd) -> None:
    if result.what != "done":
        say(f"{result.step}: {result.what}{': ' + result.why if result.why else ''}")
        return
    say(f"{result.step}: done{', written: ' + ', '.join(result.written) if result.written else ', nothing to change'}")
    for text in result.outcome.remarks if result.outcome else ():
        say(f"  note: {text}")


def _report(session: Session, paper: Paper) -> None:
    """Write the report after each step, so that results are kept if a later step fails."""
    from coulombus.host.commission.report import write_report
    from coulombus.system.unfinished_file import write_whole

    page = write_report(session, paper.operator).read_bytes()
    if paper.path is not None:
        write_whole(paper.path, page)


def _print_findings(done: list[StepEnd]) -> None:
    from rich.table import Table

    from coulombus.host.commission.report import value_texts

    table = Table(box=None, pad_edge=False)
    for name, justify in (("finding", "left"), ("was", "right"), ("is", "right"), ("+-", "right"), ("unit", "left")):
        table.add_column(name, justify=justify)  # type: ignore[arg-type]
    for result in done:
        for finding in result.outcome.findings if result.outcome else ():
            new, reach = value_texts(finding.new, finding.uncertainty)
            new = new if isinstance(finding.new, float) else _figure(finding.new)
            table.add_row(finding.key or finding.name, _figure(finding.old), new, reach, finding.unit)
    table_console(80).print(table)


def _figure(value: Finding | object) -> str:
    if isinstance(value, list | tuple):
        return f"{len(value)} points"
    return "-" if value is None else f"{value:.5g}" if isinstance(value, float) else str(value)
