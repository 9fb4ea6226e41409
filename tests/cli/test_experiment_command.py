"""``coulombus experiment`` as a user calls it: on the virtual bus, with typed answers."""

import json

import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.lab.study.study_folder import read_events
from coulombus.recording.reading import read
from study_text import TEXT

SHORT = TEXT.replace("levels = [1.6, 2.4]\nrepeats = 2", "levels = [1.6, 2.4]\nrepeats = 1")


@pytest.fixture
def call(tmp_path):
    (tmp_path / "study.toml").write_text('consent = "May we?"\n' + SHORT)

    def run(*words, folder="out", **more):
        told = [
            "experiment",
            str(tmp_path / "study.toml"),
            "-o",
            str(tmp_path / folder),
            "--subject",
            "S01",
            "--virtual",
        ]
        return CliRunner().invoke(main, [*told, *words], **more)

    return run


def test_answers_are_typed_and_the_session_goes_on(call, tmp_path):
    first = call(input="maybe\ny\n3\n1\nq\n")
    assert first.exit_code == 0, first.output
    assert "to continue: coulombus experiment" in first.stderr
    assert "level" not in first.stderr  # blinded
    second = call("--json", input="y\n2\n")
    assert json.loads(second.stdout) == {
        "subject": "S01",
        "trials": 2,
        "complete": True,
        "ended_by": None,
        "exit_status": 0,
    }
    own = tmp_path / "out" / "sub-S01"
    rows = read_events(own / "sub-S01_task-jnd_events.tsv")
    assert [row["answer"] for row in rows] == ["1", "2"]
    found = sorted(path.name for path in (own / "recordings").iterdir())
    assert found == [f"trial-000{trial}_display-{one}.pcapng" for trial in (1, 2) for one in (1, 2)]
    of_level = own / "recordings" / f"trial-0001_display-{rows[0]['first']}.pcapng"
    assert f"F_s_Nm = {rows[0]['level']}" in read(of_level).rig.effective()


def test_the_same_seed_gives_the_same_bytes(call, tmp_path):
    for folder in ("one", "two"):
        assert call("--observer", "0.1", folder=folder).exit_code == 0
    paths = sorted(path.relative_to(tmp_path / "one") for path in (tmp_path / "one").rglob("*") if path.is_file())
    assert len(paths) == 13
    for path in paths:
        assert (tmp_path / "one" / path).read_bytes() == (tmp_path / "two" / path).read_bytes(), path
