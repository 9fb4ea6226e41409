"""Markers of a session by the lab streaming layer, as another program receives them."""

import os
import subprocess
import sys

import pytest

from coulombus.lab.study.lsl import LslMarkers, LslMissing
from study_text import TEXT

pytest.importorskip("pylsl")

PROGRAM = """
import sys
import pylsl
from pathlib import Path
from coulombus.lab.study.study_folder import SubjectFolder
from coulombus.lab.study.lsl import LslMarkers
from coulombus.lab.study.study import read_study

with SubjectFolder(read_study(Path(sys.argv[1])), Path(sys.argv[2]), "S01", {}) as own:
    mark = LslMarkers(own)
    found = pylsl.resolve_byprop("source_id", "coulombus-jnd-S01", timeout=30)
    inlet = pylsl.StreamInlet(found[0])
    inlet.open_stream(timeout=30)
    for text in ("trial 1", "display 1 begins", "answer 2"):
        mark(text)
    info = inlet.info(timeout=30)
    print(info.name(), info.type(), info.desc().child_value("study"), info.desc().child_value("subject"))
    before = -1.0
    for _ in range(3):
        sample, stamp = inlet.pull_sample(timeout=30)
        assert stamp >= before
        before = stamp
        print(sample[0])
"""


@pytest.mark.thorough
@pytest.mark.slow
def test_markers_come_to_another_program_in_their_order(tmp_path):
    (tmp_path / "study.toml").write_text(TEXT)
    (tmp_path / "lsl.cfg").write_text("[multicast]\nResolveScope = machine\n[log]\nlevel = -2\n")
    ran = subprocess.run(
        [sys.executable, "-c", PROGRAM, str(tmp_path / "study.toml"), str(tmp_path / "out")],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
        env={**os.environ, "LSLAPICFG": str(tmp_path / "lsl.cfg")},
    )
    assert ran.returncode == 0, ran.stderr
    assert ran.stdout.splitlines() == ["coulombus Markers jnd S01", "trial 1", "display 1 begins", "answer 2"]


def test_without_pylsl_it_is_said_how_to_get_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "pylsl", None)
    with pytest.raises(LslMissing, match=r"pip install -e '\.\[lsl\]'"):
        LslMarkers(None)
