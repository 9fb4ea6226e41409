"""A session is kept trial by trial, goes on after any end, and comes to the same bytes."""

import json
from dataclasses import dataclass

import pytest

from coulombus.lab.experiment.folder import FolderError, SubjectFolder, read_events
from coulombus.lab.experiment.observer import Observer
from coulombus.lab.experiment.session import People, run_session
from coulombus.lab.experiment.study import read_study
from study_text import TEXT

TWO = TEXT + '[[condition]]\nname = "b"\nmode = "passive"\n'


@dataclass
class Result:
    exit_status: int = 0
    trip: str | None = None
    stopped_by: str | None = None


class Show:
    """Displays nothing, and ends badly where it is told to."""

    def __init__(self, at=0, result=None):
        self.at, self.result, self.shown = at, result, []

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
        return run_session(own, show, people), own


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
    with pytest.raises(FolderError, match="holds another study"):
        session(read_study(tmp_path / "study.toml"), tmp_path / "out", Show())
    with SubjectFolder(study, tmp_path / "out", "S02", {}), pytest.raises(FolderError, match="another session"):
        session(study, tmp_path / "out", Show())
    text = own.events.read_text().splitlines()
    own.events.write_text("\n".join([text[0], text[2], text[1]]) + "\n")
    with pytest.raises(FolderError, match=r"events\.tsv:2: is not the trial"):
        session(study, tmp_path / "out", Show())
    with pytest.raises(FolderError, match="letters and digits"):
        session(study, tmp_path / "out", Show(), subject="../S01")


def test_what_is_kept_is_a_bids_folder(study, tmp_path):
    _, own = session(study, tmp_path / "out", Show())
    assert own.events.name == "sub-S01_task-jnd_events.tsv"
    told = json.loads(own.events.with_suffix(".json").read_text())
    assert set(read_events(own.events)[0]) < set(told)
    assert told["session"]["version"]
    assert json.loads((tmp_path / "out" / "dataset_description.json").read_text())["BIDSVersion"]
