"""``coulombus experiment``: a study with people, trial by trial."""

from __future__ import annotations

import os
import shlex
import sys
import termios
import time
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import click

from coulombus.cli.errors import EXIT_STATUS, errors, print_json
from coulombus.cli.option_types import OUTPUT_FOLDER, UNCHECKED_PATH
from coulombus.cli.options import BusOption, JsonOption, SharedMachineOption, argument, option, with_options, words
from coulombus.cli.page_options import tornado_needed
from coulombus.cli.rig_options import check_shared_machine
from coulombus.cli.tables import echo
from coulombus.system.exit import say, verdict
from coulombus.system.keyboard import in_foreground

if TYPE_CHECKING:
    from coulombus.lab.study.displays import Displays
    from coulombus.lab.study.lsl import LslMarkers, LslSignals
    from coulombus.lab.study.session import People, Session, SubjectSession
    from coulombus.lab.study.study import Study
    from coulombus.lab.study.study_folder import SubjectFolder
    from coulombus.lab.study.trials import Trial

__all__ = ["experiment_command"]

LAST_S = 0.5
"""Time limit for the page to fetch its last text."""


@dataclass(frozen=True)
class BusOfStudy:
    """The bus of a study's displays, from the options."""

    bus_name: BusOption
    virtual: Annotated[bool, option("Display in virtual time, on the simulated rig.")]
    shared_machine: SharedMachineOption


@dataclass(frozen=True)
class Answering:
    """Source, method and reporting of the answers, from the options."""

    observer: Annotated[
        float | None,
        option(
            "A simulated observer of this just noticeable difference answers.",
            type=click.FloatRange(0, min_open=True),
            metavar="JND",
        ),
    ]
    felt: Annotated[bool, option("The simulated observer judges the recorded torque; its JND is in Nm.")]
    page: Annotated[bool, option("Ask in a browser on this machine; its address is printed.")]
    port: Annotated[int | None, option("The page's port.  [default: a free one]", type=click.IntRange(0, 65535))]
    lsl: Annotated[bool, option("Send markers and signals by the lab streaming layer.")]


@click.command("experiment", epilog=EXIT_STATUS)
@with_options
def experiment_command(
    file: Annotated[Path, argument(type=UNCHECKED_PATH)],
    out: Annotated[
        Path,
        option(
            "-o",
            "--out",
            "Folder of the study.",
            type=OUTPUT_FOLDER,
            required=True,
            metavar="DIR",
        ),
    ],
    subject: Annotated[str, option("The subject, by letters and digits: S01.", required=True, metavar="S")],
    where: BusOfStudy,
    answering: Answering,
    as_json: JsonOption,
) -> None:
    """Show a study's trials to a subject, ask, and keep the answers.

    FILE says conditions, levels, method and order (docs/experiment.md). Every level of every
    condition is held against the rig's limits before anything moves. Each display is a run of its
    own, which arms and ends safely, and is recorded.

    Answers are keys of the terminal, or of a page in the browser (--page); q ends the session.
    The same command, given again, continues after the last answer. `coulombus analyse study DIR`
    computes the thresholds.

    \b
    Examples:
      coulombus experiment study.toml -o out/study --subject S01 --bus socketcan:can0
      coulombus experiment study.toml -o out/study --subject S01 --virtual --observer 0.15
    """
    with errors():
        from coulombus.lab.study.session import SubjectSession, run_session
        from coulombus.lab.study.study import read_study
        from coulombus.lab.study.study_folder import SubjectFolder

        if where.virtual and (where.bus_name is not None or where.shared_machine):
            raise click.UsageError("--virtual needs no bus and no wider limits; take --bus and --shared-machine out")
        if answering.observer is not None and answering.page:
            raise click.UsageError("--observer answers by itself; take --page out")
        if answering.felt and answering.observer is None:
            raise click.UsageError("--felt is how a simulated observer judges; add --observer JND")
        if answering.port is not None and not answering.page:
            raise click.UsageError("--port is the page's; add --page")
        study = read_study(file)
        observer = "a person"
        if answering.observer is not None:
            observer = f"simulated, JND {answering.observer:g}" + " Nm felt" * answering.felt
        meta = {"observer": observer}
        if answering.observer is None:
            meta["began"] = datetime.now(UTC).isoformat(timespec="seconds")
        displays, meta["bus"] = _displays(study, where)
        with SubjectFolder(study, out, subject, meta) as folder:
            session = SubjectSession(folder, displays, *_streams(folder, answering.lsl))
            with _people(session, answering) as people:
                came = run_session(session, people)
        with verdict(came.exit_status):
            if not came.complete:
                again = ["coulombus", "experiment", str(file), "-o", str(out), "--subject", subject]
                again += [*words(answering), *words(where)]
                say(f"coulombus: ended: {came.ended_by}; nothing is lost; to continue: {shlex.join(again)}")
            _print_session(came, out, as_json)


def _displays(study: Study, where: BusOfStudy) -> tuple[Displays, str]:
    from coulombus.lab.study.displays import BusDisplays, VirtualDisplays
    from coulombus.rigs.overrides import shared_machine
    from coulombus.wire.address import default_address, parse_address

    if where.virtual:
        return VirtualDisplays(), "virtual time"
    if len(study.rig.channels) > 1:
        raise click.UsageError(f"the rig {study.rig.name} has several buses; a study runs on one")
    address = default_address(study.rig.name) if where.bus_name is None else parse_address(where.bus_name)
    if where.shared_machine:
        check_shared_machine([address])
    return BusDisplays(address, shared_machine(study.rig) if where.shared_machine else ()), str(address)


def _streams(folder: SubjectFolder, lsl: bool) -> tuple[()] | tuple[LslMarkers, LslSignals]:
    if not lsl:
        return ()
    from coulombus.lab.study.lsl import LslMarkers, LslSignals

    return LslMarkers(folder), LslSignals(folder)


@contextmanager
def _people(session: SubjectSession, answering: Answering) -> Iterator[People]:
    from coulombus.lab.study.displays import VirtualDisplays
    from coulombus.lab.study.felt_torque import felt_of
    from coulombus.lab.study.observer import Observer, levels
    from coulombus.lab.study.session import People

    study = session.study
    if answering.observer is not None:
        judged = partial(felt_of, session.folder) if answering.felt else levels
        observer = Observer(answering.observer, study.file.seed, session.folder.number, judged)
        yield People.simulated(observer.answer)
    elif answering.page:
        with tornado_needed():
            from coulombus.lab.study.page import AnswerPage

        with AnswerPage(study.file.question, session.stop, answering.port or 0) as asking:
            say(f"coulombus: the page: {asking.url}")
            yield People(asking.show, asking.ask, asking.go_on, time.monotonic)
            asking.over("The study is over. Thank you." if session.trial is None else "The session has ended.")
            time.sleep(LAST_S)
    else:
        if not isinstance(session.displays, VirtualDisplays):
            say("q or Escape ends a display at once, and the session with it")
        yield _at_the_terminal(study)


def _print_session(session: Session, out: Path, as_json: bool) -> None:
    if as_json:
        print_json(session.as_dict())
    else:
        left = "complete" if session.complete else "not complete"
        echo(f"{session.subject}: {session.trials} trials answered, {left}: {out}")


def _at_the_terminal(study: Study) -> People:
    """Ask on stderr and read from stdin: stdout has only the result."""
    from coulombus.lab.study.session import People
    from coulombus.lab.study.trials import is_answer

    def go_on(text: str) -> bool:
        say(text)
        while True:
            answer = _key("Continue? y or q:", "yq")
            if answer in ("y", "q", None):
                return answer == "y"

    def ask(trial: Trial) -> str | None:
        expected = "a number of 0 or more" if trial.reference is None else "1 or 2"
        while True:
            answer = _key(f"{study.file.question} ({expected}; q: stop)", "" if trial.reference is None else "12q")
            if answer is None or answer == "q":
                return None
            if is_answer(answer, trial):
                return answer

    return People(tell=say, ask=ask, go_on=go_on, clock=time.monotonic)


def _key(text: str, keys: str) -> str | None:
    """Return the input: one of `keys` pressed at a terminal, else a line; None at the end of the
    input. Keys pressed before the question are discarded.
    """
    echo(f"{text} ", err=True, nl=False)
    if not (keys and in_foreground()):
        answer = sys.stdin.readline()
        return answer.strip() if answer else None
    fd = sys.stdin.fileno()
    before = termios.tcgetattr(fd)
    try:
        tty.setcbreak(fd, termios.TCSAFLUSH)
        while True:
            struck = os.read(fd, 1).decode("ascii", "replace")
            if struck in ("", "\x04"):
                return None
            if struck in keys:
                echo(struck, err=True)
                return struck
    finally:
        termios.tcsetattr(fd, termios.TCSADRAIN, before)
