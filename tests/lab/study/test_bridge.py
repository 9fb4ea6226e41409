"""A study as a PsychoPy script shows it: in virtual time, and on with `coulombus experiment`."""

import json

import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.lab.study.bridge import Ended, StudyError, StudyFolderError, open_session
from coulombus.lab.study.study_folder import read_events
from coulombus.recording.reading import read
from study_text import TEXT


@pytest.fixture
def study(tmp_path):
    path = tmp_path / "study.toml"
    path.write_text(TEXT)
    return path


def test_a_script_shows_and_answers_and_the_verb_goes_on(study, tmp_path):
    with open_session(study, tmp_path / "out", "S01") as session:
        for trial in session:
            for number in range(1, len(trial.levels) + 1):
                result = session.show(number)
                assert result.trip is None
                level = trial.levels[number - 1]
                assert read(result.recording).rig.one_axis().mode["hybrid"].F_s_Nm == level
            session.answer("2", seconds=0.5)
            if trial.number == 2:
                break
        assert session.answered == 2
    words = [
        "experiment",
        str(study),
        "-o",
        str(tmp_path / "out"),
        "--subject",
        "S01",
        "--virtual",
        "--observer",
        "0.1",
    ]
    result = CliRunner().invoke(main, [*words, "--json"])
    assert json.loads(result.stdout)["trials"] == 4
    rows = read_events(tmp_path / "out" / "sub-S01" / "sub-S01_task-jnd_events.tsv")
    assert [row["response_time"] for row in rows] == ["0.500", "0.500", "n/a", "n/a"]
    told = json.loads((tmp_path / "out" / "sub-S01" / "sub-S01_task-jnd_events.json").read_text())
    assert [one["observer"] for one in told["sessions"]] == ["a program", "simulated, JND 0.1"]


def test_a_session_that_is_left_lets_no_display_begin(study, tmp_path):
    with open_session(study, tmp_path / "out", "S01") as session:
        pass
    with pytest.raises(Ended, match="stopped by the subject"):
        session.show(1)


def test_a_wrong_study_and_a_folder_in_use_are_refused(study, tmp_path):
    with (
        open_session(study, tmp_path / "out", "S01"),
        pytest.raises(StudyFolderError, match="another session"),
        open_session(study, tmp_path / "out", "S02"),
    ):
        pass
    study.write_text(TEXT.replace("repeats = 2", "repeats = 0"))
    wrong = pytest.raises(StudyError, match=r"study\.toml:12: method\.repeats")
    with wrong, open_session(study, tmp_path / "out", "S01"):
        pass
