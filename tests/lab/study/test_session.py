"""A session is kept trial by trial, goes on after any end, and comes to the same bytes."""

import errno
import json
import os
from dataclasses import dataclass

import pytest

from coulombus.lab.study.observer import Observer
from coulombus.lab.study.session import Ended, People, SubjectSession, WrongStep, run_session
from coulombus.lab.study.study import read_study
from coulombus.lab.study.study_folder import StudyFolderError, SubjectFolder, read_events
from study_text import TEXT

TWO = TEXT + '[[condition]]\nname = "b"\nmode = "passive"\n'


@dataclass
class Result:
    exit_status: int = 0
    trip: str | None = None
    stopped_by: str | None = None
    recording: str | None = None


class Show:
    """Displays nothing, and ends badly where it is told to."""

    def __init__(self, at=0, result=None):
        self.at, self.result, self.shown = at, result, []

    def stop(self):
        self.stopped = True

    def __call__(self, display):
        self.shown.append(display)
        return self.result if self.at == len(self.shown) else Result()


@pytest.fixture
def study(tmp_path):
    (tmp_path / "study.toml").write_text(TWO)
    return read_study(tmp_path / "study.toml")


def session(study, folder, show, subject="S01", stop=lambda trial: False, consent=True):
    with SubjectFolder(study, folder, subject, {}) as own:
        observer = Observer(0.15, 3, own.number)
        people = People(
            tell=lambda text: None,
            ask=lambda trial: None if stop(trial) else observer.answer(trial),
            go_on=lambda text: consent,
        )
        return run_session(SubjectSession(own, show), people), own


def test_a_session_that_ended_anywhere_comes_to_the_same_bytes(study, tmp_path):
    whole, kept = session(study, tmp_path / "whole", Show())
    assert (whole.trials, whole.complete) == (8, True)
    tripped, own = session(study, tmp_path / "parts", Show(at=4, result=Result(7, "TPDO_LOST")))
    assert (tripped.trials, tripped.complete, tripped.exit_status) == (1, False, 7)
    assert tripped.ended_by == "trial 2: TPDO_LOST"
    assert session(study, tmp_path / "parts", Show(at=3, result=Result(stopped_by="coulombus stop")))[0].trials == 2
    assert session(study, tmp_path / "parts", Show(), stop=lambda trial: trial.number == 5)[0].trials == 4
    with own.events.open("a") as file:
        file.write("24\t0.1\t5\t1\ta")  # a crash in the midst of a row
    assert len(read_events(own.events)) == 4
    last, _ = session(study, tmp_path / "parts", Show())
    assert last == whole
    assert own.events.read_bytes() == kept.events.read_bytes()
    assert session(study, tmp_path / "parts", Show(at=1))[0] == whole  # nothing is left to be shown


def test_who_does_not_consent_sees_nothing(tmp_path):
    (tmp_path / "study.toml").write_text('consent = "May we?"\n' + TWO)
    show = Show()
    came, _ = session(read_study(tmp_path / "study.toml"), tmp_path / "out", show, consent=False)
    assert (came.trials, came.ended_by, show.shown) == (0, "stopped by the subject", [])
    _, own = session(read_study(tmp_path / "study.toml"), tmp_path / "out", Show())
    told = json.loads(own.events.with_suffix(".json").read_text())["sessions"]
    assert [one["consent"] for one in told] == ["refused", "given"]


def test_subjects_meet_the_conditions_in_counter_balanced_order(study, tmp_path):
    orders = []
    for subject in ("S01", "S02"):
        _, own = session(study, tmp_path / "out", Show(), subject)
        orders.append([row["condition"] for row in read_events(own.events)])
    assert orders == [["a"] * 4 + ["b"] * 4, ["b"] * 4 + ["a"] * 4]
    told = (tmp_path / "out" / "participants.tsv").read_text()
    assert told == "participant_id\tnumber\nsub-S01\t0\nsub-S02\t1\n"


def test_another_study_a_changed_row_and_a_second_session_are_refused(study, tmp_path):
    _, own = session(study, tmp_path / "out", Show())
    (tmp_path / "study.toml").write_text(TWO.replace("seed = 3", "seed = 4"))
    with pytest.raises(StudyFolderError, match="holds another study"):
        session(read_study(tmp_path / "study.toml"), tmp_path / "out", Show())
    with SubjectFolder(study, tmp_path / "out", "S02", {}), pytest.raises(StudyFolderError, match="another session"):
        session(study, tmp_path / "out", Show())
    text = own.events.read_text().splitlines()
    own.events.write_text("\n".join([text[0], text[2], text[1]]) + "\n")
    with pytest.raises(StudyFolderError, match=r"events\.tsv:2: is not the trial"):
        session(study, tmp_path / "out", Show())
    with pytest.raises(StudyFolderError, match="letters and digits"):
        session(study, tmp_path / "out", Show(), subject="../S01")


def test_what_is_kept_is_a_bids_folder(study, tmp_path):
    _, own = session(study, tmp_path / "out", Show())
    assert own.events.name == "sub-S01_task-jnd_events.tsv"
    told = json.loads(own.events.with_suffix(".json").read_text())
    assert set(read_events(own.events)[0]) < set(told)
    assert told["sessions"][0]["version"]
    assert json.loads((tmp_path / "out" / "dataset_description.json").read_text())["BIDSVersion"]


def cut_at_each_byte(study, whole, folder):
    """Yield folders as a power cut leaves them, at some bytes of the answers."""
    content = whole.events.read_bytes()
    for size in (*range(0, len(content), 37), content.index(b"\n"), len(content) - 1):
        own = folder / str(size)
        session(study, own, Show(at=1, result=Result(stopped_by="coulombus stop")))
        (own / "sub-S01" / whole.events.name).write_bytes(content[:size])
        yield own


def test_a_power_cut_at_any_byte_of_the_answers_costs_one_answer_at_most(study, tmp_path):
    _, kept = session(study, tmp_path / "whole", Show())
    for folder in cut_at_each_byte(study, kept, tmp_path / "cut"):
        before = (folder / "sub-S01" / kept.events.name).read_bytes().count(b"\n")
        show = Show()
        came, own = session(study, folder, show)
        assert came.complete
        assert own.events.read_bytes() == kept.events.read_bytes()
        assert len(show.shown) == 2 * (8 - max(before - 1, 0))


@pytest.mark.parametrize(
    "missing", [(), ("dataset_description.json",), ("dataset_description.json", "participants.tsv")]
)
def test_a_folder_that_was_cut_off_while_it_was_made_is_made_whole(study, tmp_path, missing):
    session(study, tmp_path, Show(at=1, result=Result(stopped_by="coulombus stop")))
    for name in ("sub-S01/sub-S01_task-jnd_events.tsv", *missing):
        (tmp_path / name).unlink()
    if missing:
        for path in sorted((tmp_path / "sub-S01").rglob("*"), reverse=True):
            path.unlink() if path.is_file() else path.rmdir()
        (tmp_path / "sub-S01").rmdir()
    assert session(study, tmp_path, Show())[0].complete


def test_a_folder_with_another_study_file_is_left_alone(study, tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "study.toml").write_text("mine = 1")
    with pytest.raises(StudyFolderError, match="holds something else"):
        session(study, tmp_path / "out", Show())
    assert (tmp_path / "out" / "study.toml").read_text() == "mine = 1"


def test_a_full_disk_ends_the_session_and_keeps_the_answers_before(study, tmp_path, monkeypatch):
    _, kept = session(study, tmp_path / "whole", Show())

    def full(fd):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    asked = []

    def stop(trial):
        asked.append(trial)
        if trial.number == 3:
            monkeypatch.setattr(os, "fsync", full)
        return False

    with pytest.raises(StudyFolderError, match=r"No space left on device.*make room"):
        session(study, tmp_path / "full", Show(), stop=stop)
    monkeypatch.undo()
    own = tmp_path / "full" / "sub-S01" / kept.events.name
    assert kept.events.read_bytes().startswith(own.read_bytes())
    assert own.read_bytes().count(b"\n") == 3  # the head and two answers
    assert session(study, tmp_path / "full", Show())[0].complete
    assert own.read_bytes() == kept.events.read_bytes()


def test_a_program_shows_and_answers_step_by_step(study, tmp_path):
    marks = []
    with SubjectFolder(study, tmp_path / "out", "S01", {}) as own:
        one = SubjectSession(own, Show(), marks.append)
        with pytest.raises(WrongStep, match="not every display"):
            one.answer("1")
        one.show(1)
        with pytest.raises(WrongStep, match="not every display"):
            one.answer("1")
        with pytest.raises(WrongStep, match="2 displays; expected 1 to 2"):
            one.show(3)
        one.show(2)
        for wrong in ("3", "", "n/a", "1.0"):
            with pytest.raises(WrongStep, match="expected 1 or 2"):
                one.answer(wrong)
        with pytest.raises(WrongStep, match="seconds"):
            one.answer("1", seconds=-1.0)
        one.answer("1", seconds=0.75)
        assert marks == [
            "trial 1",
            "display 1 begins",
            "display 1 ends",
            "display 2 begins",
            "display 2 ends",
            "answer 1",
        ]
        with pytest.raises(WrongStep, match="trial 2 has no answer"):
            list(one)
        one.stop()
        with pytest.raises(Ended, match="stopped by the subject"):
            one.show(1)
    assert read_events(own.events)[0]["response_time"] == "0.750"
    with SubjectFolder(study, tmp_path / "out", "S01", {}) as own:
        assert SubjectSession(own, Show()).trial.number == 2


def test_a_stop_in_a_display_ends_the_session_without_an_answer(study, tmp_path):
    class Stopping(Show):
        def __call__(self, display):
            one.stop()
            return super().__call__(display)

    with SubjectFolder(study, tmp_path / "out", "S01", {}) as own:
        show = Stopping()
        one = SubjectSession(own, show)
        people = People(tell=lambda text: None, ask=lambda trial: "1", go_on=lambda text: True)
        came = run_session(one, people)
    assert (came.trials, came.ended_by, len(show.shown), show.stopped) == (0, "stopped by the subject", 1, True)


def test_answers_of_people_are_timed(study, tmp_path):
    now = iter(range(100))
    with SubjectFolder(study, tmp_path / "out", "S01", {}) as own:
        people = People(lambda text: None, lambda trial: "1", lambda text: True, clock=lambda: float(next(now)))
        run_session(SubjectSession(own, Show()), people)
    assert {row["response_time"] for row in read_events(own.events)} == {"1.000"}
    assert session(study, tmp_path / "out", Show())[0].complete  # a time is no contradiction
