"""The folder of a study is what BIDS expects."""

import json
import re
import shutil
import subprocess

import pytest

from coulombus.lab.study.observer import Observer
from coulombus.lab.study.session import People, SubjectSession, run_session
from coulombus.lab.study.study import read_study
from coulombus.lab.study.study_folder import SubjectFolder, task_label
from study_text import TEXT

VALIDATOR = shutil.which("bids-validator-deno")


class Recorded:
    exit_status, trip, stopped_by, recording = 0, None, None, None


class Displays:
    def __call__(self, display):
        display.outputs.record.write_bytes(b"a recording")
        return Recorded()

    def stop(self):
        pass


@pytest.fixture
def kept(tmp_path):
    (tmp_path / "study.toml").write_text(TEXT.replace('name = "jnd"', 'name = "friction-jnd_2.0"'))
    study = read_study(tmp_path / "study.toml")
    for number in (1, 2):
        with SubjectFolder(study, tmp_path / "out", f"S{number:02d}", {}) as folder:
            observer = Observer(0.15, 3, folder.number)
            people = People(tell=lambda text: None, ask=observer.answer, go_on=lambda text: True)
            assert run_session(SubjectSession(folder, Displays()), people).complete
    return tmp_path / "out"


def test_a_task_label_has_letters_and_digits_and_the_sidecar_the_whole_name(kept):
    assert task_label("friction-jnd_2.0") == "frictionjnd20"
    events = sorted((kept / "sub-S01").glob("*_events.tsv"))
    assert [path.name for path in events] == ["sub-S01_task-frictionjnd20_events.tsv"]
    sidecar = json.loads(events[0].with_suffix(".json").read_text())
    assert sidecar["TaskName"] == "friction-jnd_2.0"
    assert sidecar["onset"]["Units"] == "s"


def test_every_file_has_a_name_of_bids_or_is_ignored(kept):
    ignored = (kept / ".bidsignore").read_text().split()
    assert ignored == ["study.toml", "**/recordings"]
    known = r"dataset_description\.json|README|participants\.(tsv|json)|sub-\w+/sub-\w+_task-[0-9A-Za-z]+_events\.(tsv|json)"
    others = [
        path.relative_to(kept).as_posix()
        for path in kept.rglob("*")
        if path.is_file()
        and not path.name.startswith(".")
        and not re.fullmatch(known, path.relative_to(kept).as_posix())
    ]
    assert any("recordings" in name for name in others)
    assert all(name == "study.toml" or name.split("/")[1] == "recordings" for name in others)


@pytest.mark.skipif(VALIDATOR is None, reason="bids-validator-deno is not installed: pip install bids-validator-deno")
def test_the_validator_of_bids_finds_no_error(kept):
    came = subprocess.run([VALIDATOR, "--json", str(kept)], capture_output=True, text=True, timeout=120)
    issues = json.loads(came.stdout)["issues"]["issues"]
    assert [issue for issue in issues if issue["severity"] == "error"] == []
    assert came.returncode == 0
