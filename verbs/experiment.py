"""``coulombus experiment``: a study with people, trial by trial."""

from __future__ import annotations

import os
import shlex
import sys
import termios
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
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
from coulombus.wire.keys import in_foreground

if TYPE_CHECKING:
    from coulombus.lab.experiment.displays import Displays
    from coulombus.lab.experiment.folder import SubjectFolder
    from coulombus.lab.experiment.observer import Observer
    from coulombus.lab.experiment.session import People, Session, SubjectSession
    from coulombus.lab.experiment.study import Study
    from coulombus.lab.experiment.trials import Trial

__all__ = ["experiment_command"]

LAST_S = 0.5
"""So long the page may take to fetch its last text."""


@click.command("experiment", epilog=EXIT_STATUS, short_help="Show a study to a subject, trial by trial")
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
@click.option("--page", is_flag=True, help="Ask in a browser on this machine; its address is printed.")
@click.option("--port", type=click.IntRange(0, 65535), help="The page's port.  [default: a free one]")
@click.option("--lsl", is_flag=True, help="Send markers by the lab streaming layer.")
@shared_machine_option
@json_option
def experiment_command(
    file: Path,
    out: Path,
    subject: str,
    observer: float | None,
    bus_name: str | None,
    virtual: bool,
    page: bool,
    port: int | None,
    lsl: bool,
    shared_machine: bool,
    as_json: bool,
) -> None:
    """Show a study's trials to a subject, ask, and keep the answers.

    FILE says conditions, levels, method and order (docs/experiment.md). Every level of every
    condition is held against the rig's limits before anything moves. Each display is a run of its
    own, which arms and ends safely, and is recorded.

    Answers are keys of the terminal, or of a page in the browser (--page); q ends the session.
    Given again, the same command goes on behind the last answer. `coulombus analyse study DIR`
    tells what came of it.

    \b
    Examples:
      coulombus experiment study.toml -o out/study --subject S01 --bus socketcan:can0
      coulombus experiment study.toml -o out/study --subject S01 --virtual --observer 0.15
    """
    with errors():
        from coulombus.lab.experiment.folder import SubjectFolder
        from coulombus.lab.experiment.session import SubjectSession, run_session
        from coulombus.lab.experiment.study import read_study

        if virtual and (bus_name is not None or shared_machine):
            raise click.UsageError("--virtual needs no bus and no wider limits; take --bus and --shared-machine out")
        if observer is not None and page:
            raise click.UsageError("--observer answers by itself; take --page out")
        if port is not None and not page:
            raise click.UsageError("--port is the page's; add --page")
        study = read_study(file)
        meta = {"observer": "a person" if observer is None else f"simulated, JND {observer:g}"}
        if observer is None:
            meta["began"] = datetime.now(UTC).isoformat(timespec="seconds")
        displays, meta["bus"] = _displays(study, bus_name, virtual, shared_machine)
        with SubjectFolder(study, out, subject, meta) as folder:
            session = SubjectSession(folder, displays, *_marks(folder, lsl))
            with _people(session, observer, page, port or 0) as people:
                came = run_session(session, people)
        with verdict(came.exit_status):
            if not came.complete:
                words = ["coulombus", "experiment", str(file), "-o", str(out), "--subject", subject]
                words += [] if observer is None else ["--observer", f"{observer:g}"]
                words += ["--virtual"] if virtual else [] if bus_name is None else ["--bus", bus_name]
                words += ["--page"] * page + (["--port", str(port)] if port else []) + ["--lsl"] * lsl
                words += ["--shared-machine"] if shared_machine else []
                say(f"coulombus: ended: {came.ended_by}; nothing is lost; to go on: {shlex.join(words)}")
            _tell(came, out, as_json)


def _displays(study: Study, bus_name: str | None, virtual: bool, shared_machine: bool) -> tuple[Displays, str]:
    from coulombus.lab.experiment.displays import BusDisplays, VirtualDisplays
    from coulombus.rigs.overrides import SHARED_MACHINE
    from coulombus.wire.address import default_address, parse_address

    if virtual:
        return VirtualDisplays(), "virtual time"
    if len(study.rig.channels) > 1:
        raise click.UsageError(f"the rig {study.rig.name} has several buses; a study runs on one")
    address = default_address(study.rig.name) if bus_name is None else parse_address(bus_name)
    if shared_machine:
        check_shared_machine([address])
    return BusDisplays(address, SHARED_MACHINE if shared_machine else ()), str(address)


def _marks(folder: SubjectFolder, lsl: bool) -> list[Callable[[str], None]]:
    if not lsl:
        return []
    from coulombus.lab.experiment.lsl import LslMarkers

    return [LslMarkers(folder)]


@contextmanager
def _people(session: SubjectSession, observer: float | None, page: bool, port: int) -> Iterator[People]:
    from coulombus.lab.experiment.observer import Observer
    from coulombus.lab.experiment.session import People

    study = session.study
    if observer is not None:
        yield _simulated(Observer(observer, study.file.seed, session.folder.number))
    elif page:
        from coulombus.lab.experiment.page import AnswerPage

        with AnswerPage(study.file.question, session.stop, port) as asking:
            say(f"coulombus: the page: {asking.url}")
            yield People(asking.tell, asking.ask, asking.go_on, time.monotonic)
            asking.over("The study is over. Thank you." if session.trial is None else "The session has ended.")
            time.sleep(LAST_S)
    else:
        yield _at_the_terminal(study)


def _tell(session: Session, out: Path, as_json: bool) -> None:
    if as_json:
        print_json(session.as_dict())
    else:
        left = "complete" if session.complete else "not complete"
        click.echo(f"{session.subject}: {session.trials} trials answered, {left}: {out}")


def _simulated(observer: Observer) -> People:
    from coulombus.lab.experiment.session import People

    return People(tell=lambda text: None, ask=observer.answer, go_on=lambda text: True)


def _at_the_terminal(study: Study) -> People:
    """Ask on stderr, read from stdin: stdout has the result alone."""
    from coulombus.lab.experiment.session import People
    from coulombus.lab.experiment.trials import is_answer

    def go_on(text: str) -> bool:
        say(text)
        while True:
            given = _key("Go on? y or q:", "yq")
            if given in ("y", "q", None):
                return given == "y"

    def ask(trial: Trial) -> str | None:
        wanted = "a number of 0 or more" if trial.reference is None else "1 or 2"
        while True:
            given = _key(f"{study.file.question} ({wanted}; q: stop)", "" if trial.reference is None else "12q")
            if given is None or given == "q":
                return None
            if is_answer(given, trial):
                return given

    return People(tell=say, ask=ask, go_on=go_on, clock=time.monotonic)


def _key(text: str, keys: str) -> str | None:
    """Return what is typed: one of `keys` as it is struck at a terminal, else a line; None at the end
    of the input. What was struck before the question is no answer to it.
    """
    click.echo(f"{text} ", err=True, nl=False)
    if not (keys and in_foreground()):
        given = sys.stdin.readline()
        return given.strip() if given else None
    fd = sys.stdin.fileno()
    before = termios.tcgetattr(fd)
    try:
        tty.setcbreak(fd, termios.TCSAFLUSH)
        while True:
            struck = os.read(fd, 1).decode("ascii", "replace")
            if struck in ("", "\x04"):
                return None
            if struck in keys:
                click.echo(struck, err=True)
                return struck
    finally:
        termios.tcsetattr(fd, termios.TCSADRAIN, before)
