"""``coulombus experiment``: a study with people, trial by trial."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import click

from coulombus.verbs.common import (
    EXIT_STATUS,
    bus_option,
    check_shared_machine,
    errors,
    json_option,
    print_json,
    say,
    shared_machine_option,
    verdict,
)

if TYPE_CHECKING:
    from coulombus.host.run.result import RunResult
    from coulombus.lab.experiment.observer import Observer
    from coulombus.lab.experiment.session import Display, People, Session
    from coulombus.lab.experiment.study import Study
    from coulombus.lab.experiment.trials import Trial
    from coulombus.wire.address import BusAddress

__all__ = ["experiment_command"]


@click.command("experiment", epilog=EXIT_STATUS)
@click.argument("file", type=click.Path(path_type=Path))
@click.option(
    "-o",
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    required=True,
    metavar="DIR",
    help="Keep the study there.",
)
@click.option("--subject", required=True, metavar="S", help="The subject, by letters and digits: S01.")
@click.option(
    "--observer",
    type=click.FloatRange(0, min_open=True),
    metavar="JND",
    help="A simulated observer of this just noticeable difference answers.",
)
@bus_option
@click.option("--virtual", is_flag=True, help="Display in virtual time, on the simulated rig.")
@shared_machine_option
@json_option
def experiment_command(
    file: Path,
    out: Path,
    subject: str,
    observer: float | None,
    bus_name: str | None,
    virtual: bool,
    shared_machine: bool,
    as_json: bool,
) -> None:
    """Show a study's trials to a subject, ask, and keep the answers.

    FILE says conditions, levels, method and order (docs/experiment.md). Every level of every
    condition is held against the rig's limits before anything moves. Each display is a run of its
    own, which arms and ends safely, and is recorded.

    Answers are typed, with Enter behind them; q ends the session. Given again, the same command
    goes on behind the last answer. `coulombus analyse study DIR` tells what came of it.

    \b
    Examples:
      coulombus experiment study.toml -o out/study --subject S01 --bus socketcan:can0
      coulombus experiment study.toml -o out/study --subject S01 --virtual --observer 0.15
    """
    with errors():
        from coulombus.lab.experiment.folder import SubjectFolder
        from coulombus.lab.experiment.observer import Observer as Simulated
        from coulombus.lab.experiment.session import run_session, virtual_display
        from coulombus.lab.experiment.study import read_study
        from coulombus.rigs.overrides import SHARED_MACHINE
        from coulombus.wire.address import default_address, parse_address

        if virtual and (bus_name is not None or shared_machine):
            raise click.UsageError("--virtual needs no bus and no wider limits; take --bus and --shared-machine out")
        study = read_study(file)
        meta = {"observer": "a person" if observer is None else f"simulated, JND {observer:g}"}
        show: Callable[[Display], RunResult] = virtual_display
        if virtual:
            meta["bus"] = "virtual time"
        else:
            if len(study.rig.channels) > 1:
                raise click.UsageError(f"the rig {study.rig.name} has several buses; a study runs on one")
            address = default_address(study.rig.name) if bus_name is None else parse_address(bus_name)
            if shared_machine:
                check_shared_machine([address])
            show, meta["bus"] = _on_bus(address, SHARED_MACHINE if shared_machine else (), subject), str(address)
        with SubjectFolder(study, out, subject, meta) as folder:
            if observer is None:
                people = _at_the_terminal(study)
            else:
                people = _simulated(Simulated(observer, study.file.seed, folder.number))
            session = run_session(folder, show, people)
        with verdict(session.exit_status):
            if not session.complete:
                words = ["coulombus", "experiment", str(file), "-o", str(out), "--subject", subject]
                words += [] if observer is None else ["--observer", f"{observer:g}"]
                words += ["--virtual"] if virtual else [] if bus_name is None else ["--bus", bus_name]
                words += ["--shared-machine"] if shared_machine else []
                say(f"coulombus: ended: {session.ended_by}; nothing is lost; to go on: {shlex.join(words)}")
            _tell(session, out, as_json)


def _tell(session: Session, out: Path, as_json: bool) -> None:
    if as_json:
        print_json(session.as_dict())
    else:
        left = "complete" if session.complete else "not complete"
        click.echo(f"{session.subject}: {session.trials} trials answered, {left}: {out}")


def _on_bus(address: BusAddress, more: tuple[str, ...], subject: str) -> Callable[[Display], RunResult]:
    from coulombus.host.run.outputs import Outputs
    from coulombus.host.run.real_run import real_run
    from coulombus.wire.stopping import Signals

    def show(display: Display) -> RunResult:
        meta = {"subject": subject, "trial": str(display.trial), "display": str(display.number)}
        outputs = Outputs(record=display.record, meta=meta, force=True)
        with Signals() as signals:
            return real_run(
                display.rig.variant(*more),
                display.mode,
                display.seconds,
                bus=address,
                outputs=outputs,
                signals=signals,
            )

    return show


def _simulated(observer: Observer) -> People:
    from coulombus.lab.experiment.session import People

    return People(tell=lambda text: None, ask=observer.answer, go_on=lambda text: True)


def _at_the_terminal(study: Study) -> People:
    """Ask on stderr, read from stdin: stdout has the result alone."""
    from coulombus.lab.experiment.session import People

    def line(text: str) -> str | None:
        click.echo(f"{text} ", err=True, nl=False)
        given = sys.stdin.readline()
        return given.strip() if given else None

    def go_on(text: str) -> bool:
        say(text)
        while True:
            given = line("Go on? y or q:")
            if given in ("y", "q", None):
                return given == "y"

    def ask(trial: Trial) -> str | None:
        wanted = "a number of 0 or more" if trial.reference is None else "1 or 2"
        while True:
            given = line(f"{study.file.question} ({wanted}; q: stop)")
            if given is None or given == "q":
                return None
            if _is_answer(given, trial.reference is None):
                return given

    return People(tell=say, ask=ask, go_on=go_on)


def _is_answer(text: str, magnitude: bool) -> bool:
    if not magnitude:
        return text in ("1", "2")
    try:
        return 0 <= float(text) < 1e9
    except ValueError:
        return False
