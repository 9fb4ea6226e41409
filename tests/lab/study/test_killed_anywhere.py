"""kill -9 of a session at any place: in a display, a break, a question, and while it writes."""

import json
import os
import subprocess
import sys

import pytest

from places import ROOT
from study_text import TEXT

PROGRAM = r"""
import json, os, shutil, signal, sys
from pathlib import Path
from types import SimpleNamespace
from coulombus.lab.study import study_folder, session
from coulombus.lab.study.study_folder import SubjectFolder, read_events
from coulombus.lab.study.observer import Observer
from coulombus.lab.study.session import People, SubjectSession, run_session
from coulombus.lab.study.study import Study, read_study
from coulombus.rigs import rewrite

os.fsync = lambda fd: None  # a killed process loses nothing that it wrote, and the disk is slow
place, every = Path(sys.argv[1]), int(sys.argv[2])
study = read_study(place / "study.toml")
Study.variant = lambda self, condition, level: self.rig  # what is shown does not matter, and costs
LOOKED_AT = {one.__file__ for one in (study_folder, session, rewrite)}


class Show:
    # A display of some steps, each of which may be the last
    def __call__(self, display):
        tell("display")
        display.outputs.record.write_bytes(b"begun")
        return SimpleNamespace(exit_status=0, trip=None, stopped_by=None, recording=None)

    def stop(self):
        pass


def carry_out(where):
    with SubjectFolder(study, where, "S01", {"bus": "none"}) as own:
        observer = Observer(0.15, 3, own.number)

        def ask(trial):
            tell("question")
            answer = observer.answer(trial)
            tell("answered")
            return answer

        def go_on(text):
            tell("break" if "break" in text else "consent")
            return True

        one = SubjectSession(own, Show())
        keep = one.folder.keep

        def kept(*given):
            tell("writing")
            keep(*given)
            tell("kept")

        one.folder.keep = kept
        return run_session(one, People(lambda text: None, ask, go_on)), own.events


def killed(where, at):
    # Return what a session had told when it was killed at its event number `at`; None: it came to its end
    global tell
    ours, its = os.pipe()
    child = os.fork()
    if child == 0:
        count = 0

        def look(frame, event, arg):
            nonlocal count
            if frame.f_code.co_filename in LOOKED_AT or frame.f_code.co_name == "__call__":
                count += 1
                if count == at:
                    os.kill(os.getpid(), signal.SIGKILL)

        tell = lambda text: os.write(its, (text + "\n").encode())
        sys.setprofile(look)
        carry_out(where)
        os._exit(0)
    os.close(its)
    with os.fdopen(ours) as file:
        told = file.read().split()
    return None if os.waitpid(child, 0)[1] == 0 else told


tell = lambda text: None
_, events = carry_out(place / "whole")
whole = events.read_bytes()
found, at = [], 1
while (told := killed(place / "parts", at)) is not None:
    events = place / "parts" / "sub-S01" / events.name
    rows = read_events(events) if events.exists() else []
    came, _ = carry_out(place / "parts")
    same = all(
        (place / "parts" / name).read_bytes() == (place / "whole" / name).read_bytes()
        for name in ("participants.tsv", "participants.json", "study.toml", "dataset_description.json")
    )
    left = sorted(path.name for path in (place / "parts").rglob(".*") if path.name not in (".lock", ".bidsignore"))
    found.append({"at": at, "left": left, "told": told, "rows": len(rows), "complete": came.complete, "same": same,
                  "bytes": events.read_bytes() == whole})
    shutil.rmtree(place / "parts")
    at += every
print(json.dumps(found))
"""


@pytest.mark.thorough
def test_killed_at_any_place_a_session_goes_on_and_comes_to_the_same_bytes(tmp_path):
    (tmp_path / "study.toml").write_text('consent = "May we?"\nbreak_after = 2\n' + TEXT)
    ran = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", PROGRAM, str(tmp_path), "11"],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
        cwd=ROOT,
        env={**os.environ, "NUMBA_DISABLE_JIT": "1"},
    )
    assert ran.returncode == 0, ran.stderr
    found = json.loads(ran.stdout)
    assert len(found) > 50
    for one in found:
        assert one["complete"], one
        assert one["same"], one
        assert one["bytes"], one
        assert one["left"] == [], one  # no half of a file that was to be replaced
        assert one["rows"] >= one["told"].count("kept"), one  # what was kept is not lost
        assert one["rows"] >= one["told"].count("answered") - 1, one  # and one answer at most
    last = {one["told"][-1] if one["told"] else "begin" for one in found}
    assert last >= {"begin", "consent", "display", "writing", "kept", "break"}
    assert any(one["rows"] == 0 for one in found)
    assert any(one["rows"] == 4 for one in found)
