"""Signals of a display by the lab streaming layer; its library is a fake that keeps what it is given."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest

from bench_recording import CYCLES, record
from coulombus.lab.study.lsl import LslSignals
from coulombus.lab.study.session import SubjectSession
from coulombus.lab.study.study import read_study
from coulombus.lab.study.study_folder import SubjectFolder
from coulombus.recording.reading import read
from study_text import TEXT

NOW_S = 5000.0


class Described:
    def __init__(self):
        self.values, self.children = {}, []

    def append_child_value(self, name, value):
        self.values[name] = value

    def append_child(self, name):
        self.children.append(Described())
        return self.children[-1]


class Info:
    def __init__(self, *given):
        self.given, self.described = given, Described()

    def desc(self):
        return self.described


@pytest.fixture
def sent(monkeypatch):
    """Return what is sent: the stream's description, and (sample, stamp) of each sample."""
    found = SimpleNamespace(info=None, samples=[])

    def outlet(info):
        found.info = info
        return SimpleNamespace(push_sample=lambda sample, stamp: found.samples.append((sample, stamp)))

    library = SimpleNamespace(StreamInfo=Info, StreamOutlet=outlet, cf_double64=2, local_clock=lambda: NOW_S)
    monkeypatch.setitem(sys.modules, "pylsl", library)
    return found


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "study.toml").write_text(TEXT)
    with SubjectFolder(read_study(tmp_path / "study.toml"), tmp_path / "out", "S01", {}) as own:
        yield own


def test_each_period_of_a_display_is_a_sample_with_its_own_stamp(sent, folder, tmp_path):
    path = record(tmp_path / "r.pcapng")
    LslSignals(folder)(path)
    name, kind, count, rate, _, source = sent.info.given
    assert (name, kind, rate, source) == ("coulombus-signals", "Haptics", 1000.0, "coulombus-signals-jnd-S01")
    labels = [one.values["label"] for one in sent.info.described.children[0].children]
    assert len(labels) == count
    assert sent.info.described.values == {"study": "jnd", "subject": "S01"}
    stamps = np.array([stamp for _, stamp in sent.samples])
    assert len(stamps) == pytest.approx(CYCLES, abs=2)
    assert np.diff(stamps) == pytest.approx(0.001)
    assert stamps[-1] == pytest.approx(NOW_S)  # virtual time: it has ended now
    torque = read(path)["brake.handle_torque_Nm"]
    column = [sample[labels.index("brake.handle_torque_Nm")] for sample, _ in sent.samples]
    assert column[-1] in torque.values[-2:]
    assert column[CYCLES // 2] in torque.values[CYCLES // 2 - 2 : CYCLES // 2 + 2]


def test_a_session_hands_each_display_to_the_stream(folder, tmp_path):
    handed = []

    def show(display):
        return SimpleNamespace(exit_status=0, trip=None, stopped_by=None, recording=str(display.outputs.record))

    one = SubjectSession(folder, show, recorded=handed.append)
    one.show(1)
    one.show(2)
    assert handed == [folder.recording(one.trial, 1), folder.recording(one.trial, 2)]
