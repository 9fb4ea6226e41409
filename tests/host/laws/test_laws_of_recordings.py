"""A law, or a mechanism, that only a recording names is a stranger's program: it is never loaded, on
one axis, in the plane, and in a replay.
"""

from __future__ import annotations

import pytest

from coulombus.host.cycle.controllers import Controllers
from coulombus.lab.replay.virtual_replay import virtual_replay
from coulombus.lab.simulate import simulate
from coulombus.recording.pcapng_reader import read_pcapng
from coulombus.recording.pcapng_writer import PcapngWriter
from coulombus.rigs.rig import RigError, load_rig, load_rig_text

STRANGERS = "import pathlib\npathlib.Path('ran').touch()\n\ndef law(motion, law, state):\n    return 0.0\n"
MODES = {"bench": "hybrid", "plane": "hybrid"}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "evil.py").write_text(STRANGERS)
    return tmp_path


def attached(name, said="", instead=""):
    rig = load_rig(name)
    assert said in rig.effective()
    return load_rig_text(rig.effective().replace(said, instead), "run.pcapng", rig.eds_texts, attached=True)


@pytest.mark.parametrize(
    ("name", "said"), [("bench", '"karnopp"'), ("plane", '"plane_karnopp"'), ("plane", '"serial_2r"')]
)
def test_a_strangers_program_is_not_run(folder, name, said):
    rig = attached(name, said, '"evil.py:law"')
    assert rig.law_of_recording
    with pytest.raises(RigError, match=r"is not run"):
        Controllers(rig, MODES[name])
    assert not (folder / "ran").exists()


@pytest.mark.parametrize("name", MODES)
def test_a_built_in_law_of_a_recording_is_run(name):
    rig = attached(name)
    assert rig.law_of_recording
    Controllers(rig, MODES[name])


def test_a_law_that_the_user_names_is_no_strangers(folder):
    rig = attached("bench", '"karnopp"', '"other.py:law"').with_law("evil.py:law")
    assert not rig.law_of_recording
    Controllers(rig, "hybrid")
    assert (folder / "ran").exists()
    assert not load_rig("bench").law_of_recording


def test_a_replay_of_a_strangers_law_replays_the_frames_alone(folder):
    simulate("bench", "hybrid", 0.2, record="own.pcapng")
    capture = read_pcapng("own.pcapng")
    rig = capture.attachments["rig.toml"].decode()
    assert '"karnopp"' in rig
    attachments = {**capture.attachments, "rig.toml": rig.replace('"karnopp"', '"evil.py:law"').encode()}
    with PcapngWriter(folder / "strange.pcapng", attachments=attachments) as writer:
        writer.write(capture.frames, dict(capture.comments))
    assert virtual_replay(folder / "strange.pcapng").exit_status == 0
    assert not (folder / "ran").exists()
