"""`commission` and `experiment`: one call from Python each."""

from __future__ import annotations

import pytest

from coulombus import commission, experiment, load_rig
from coulombus.host.commission.step import CommissionError
from coulombus.lab import Faults, Given, study_report
from coulombus.rigs.arguments import WrongCall
from study_text import TEXT

pytestmark = pytest.mark.slow


@pytest.fixture
def rig_path(tmp_path):
    path = tmp_path / "my.toml"
    path.write_text(load_rig("bench").text)
    return path


def test_a_commissioning_writes_rig_file_and_report(rig_path):
    truth = load_rig("bench", ("role.handle_torque.scale_Nm=0.00092", "plant.transducer_noise_Nm=0.002"))
    done = commission(rig_path, truth, steps=("weight", "zero"), given=Given(weight_Nm=1.5), seed=3)
    assert [step.step for step in done.steps] == ["zero", "weight"]
    finding = done.findings["role.handle_torque.scale_Nm"]
    assert abs(finding.new - 0.00092) <= 2 * finding.uncertainty
    assert load_rig(str(rig_path)).one_axis().role.handle_torque.scale_Nm == finding.new
    assert done.report.parent.parent == rig_path.parent
    assert "<h2>" in done.report.read_text()
    assert done.as_dict()["steps"][1]["step"] == "weight"


def test_a_step_that_lacks_something_is_named_and_nothing_is_written(rig_path):
    before = rig_path.read_text()
    done = commission(rig_path, steps=("weight",))
    assert [(step.what, bool(step.why)) for step in done.steps] == [("lacking", True)]
    assert rig_path.read_text() == before
    assert not done.report.exists()


def test_an_unknown_step_is_refused_before_anything_moves(rig_path):
    with pytest.raises(CommissionError, match=r"steps='wieght': expected one of zero, weight"):
        commission(rig_path, steps=("zero", "wieght"))
    with pytest.raises(WrongCall):
        commission(7)
    assert list(rig_path.parent.iterdir()) == [rig_path]


@pytest.fixture
def study_path(tmp_path):
    path = tmp_path / "study.toml"
    path.write_text(TEXT)
    return path


def answers(folder, subject):
    (path,) = (folder / f"sub-{subject}").rglob("*_events.tsv")
    head, *rows = (line.split("\t") for line in path.read_text().splitlines())
    return [row[head.index("answer")] for row in rows]


def test_an_experiment_is_answered_and_reported(study_path, tmp_path):
    session = experiment(study_path, tmp_path / "out", "S01", 0.01)
    assert (session.complete, session.trials) == (True, 4)
    assert experiment(study_path, tmp_path / "out", "S01", 0.01).trials == 4  # nothing is left
    assert list(study_report(tmp_path / "out")["subjects"]) == ["S01"]


@pytest.mark.thorough
def test_the_faults_of_an_observer_change_its_answers(study_path, tmp_path):
    experiment(study_path, tmp_path / "fair", "S01", 0.01)
    experiment(study_path, tmp_path / "biased", "S01", 0.01, faults=Faults(bias=5.0))
    assert set(answers(tmp_path / "fair", "S01")) == {"1", "2"}
    assert set(answers(tmp_path / "biased", "S01")) == {"2"}
