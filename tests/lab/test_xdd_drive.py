"""A drive whose maker gives an XDD only: drafted, checked, simulated, recorded and replayed as with
its EDS.
"""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.eds.reader import parse_eds, read_eds
from coulombus.host.sdo.sdo_client import SdoClient
from coulombus.lab.replay.host_replay import host_replay
from coulombus.lab.simulate import simulate
from coulombus.recording.reading import read
from coulombus.rigs.rig import load_rig
from desk import BUS, put_on_desk
from devices_bench import DevicesLink, eds
from eds_edit import edit
from foreign_rigs import QUICK
from places import EDS
from xdd_text import as_xdd

SECONDS = 0.3


def call(*arguments):
    result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert result.exit_code == 0, result.output
    return result


def xdd_of(path):
    """The file's description as an XDD, half of whose objects leave their values to parameters."""
    return as_xdd(read_eds(path), lambda variable: variable.index % 2 == 1)


@pytest.fixture
def folder(tmp_path, monkeypatch):
    motor = edit((EDS / "motor.eds").read_text(encoding="utf-8"), "1018sub1", DefaultValue="0x00000077")
    (tmp_path / "drive.eds").write_text(motor, encoding="utf-8")
    (tmp_path / "drive.xdd").write_text(xdd_of(tmp_path / "drive.eds"), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.thorough
def test_the_draft_of_an_xdd_runs_frame_for_frame_as_that_of_the_eds(folder):
    recordings = []
    for kind in ("eds", "xdd"):
        call("init", "--drive", f"drive.{kind}", "--brake", "bench", "--rehearse", "-o", f"{kind}.toml")
        call("check", "--rig", f"{kind}.toml")
        result = simulate(f"{kind}.toml", "hybrid", SECONDS, record=f"{kind}.pcapng", overrides=QUICK)
        assert result.trip is None
        assert result.cycles >= SECONDS * 1000 - 2
        recordings.append(read(f"{kind}.pcapng"))
    assert load_rig("xdd.toml").one_axis().motor.eds == "drive.xdd"
    first, second = (recording.frames for recording in recordings)
    assert len(first) == len(second) > 1000
    assert (first == second).all()


@pytest.mark.thorough
def test_a_recording_keeps_the_xdd_and_needs_no_file(folder):
    call("init", "--drive", "drive.xdd", "--brake", "bench", "--rehearse", "-o", "rig.toml")
    simulate("rig.toml", "hybrid", SECONDS, record="run.pcapng", overrides=QUICK)
    text = (folder / "drive.xdd").read_text(encoding="utf-8")
    for name in ("drive.xdd", "drive.eds", "rig.toml"):
        (folder / name).unlink()
    rig = read("run.pcapng").rig
    assert rig.eds_texts["drive.xdd"] == text
    assert host_replay("run.pcapng").difference is None


@pytest.fixture
def motor(folder, monkeypatch, private_sockets):
    (folder / "motor.xdd").write_text(xdd_of(EDS / "motor.eds"), encoding="utf-8")
    put_on_desk(monkeypatch).add(eds("motor"), 1)


@pytest.mark.usefixtures("motor")
def test_sdo_names_objects_by_the_xdd_and_dumps_a_dcf():
    printed = json.loads(call("sdo", "get", 1, "Producer heartbeat time", *BUS, "--eds", "motor.xdd", "--json").stdout)
    assert printed
    call("sdo", "dump", 1, "motor.dcf", *BUS, "--eds", "motor.xdd")
    report = json.loads(call("eds", "check", "--json", "motor.dcf").stdout)[0]
    assert report["readable"]
    assert report["objects"] == len(read_eds("motor.xdd").objects)
    assert [line["text"] for line in report["diagnoses"] if "configured value" not in line["text"]] == []
    call("sdo", "restore", 1, "motor.dcf", *BUS, "--yes", "--json")


def test_eds_check_names_the_line_of_a_hostile_file(folder):
    (folder / "evil.xdd").write_text(
        '<?xml version="1.0"?>\n<!DOCTYPE a [<!ENTITY b "c">]>\n<a>&b;</a>', encoding="utf-8"
    )
    result = CliRunner().invoke(main, ["eds", "check", "evil.xdd"])
    assert result.exit_code == 3
    assert result.stdout.startswith("evil.xdd:2: refused: declares a DTD or entities")
    drafted = CliRunner().invoke(main, ["init", "--drive", "evil.xdd", "--brake", "bench"])
    assert drafted.exit_code == 3
    assert "evil.xdd:2: declares a DTD or entities" in drafted.output


def test_a_simulated_device_keeps_an_eds_in_1021h(folder):
    link = DevicesLink()
    link.add(read_eds("drive.xdd"), 5)
    stored = SdoClient(link, 5, 1.0).upload(0x1021, 0)
    assert stored.startswith(b"[FileInfo]")
    assert parse_eds(stored, "1021h.eds").objects.keys() == read_eds("drive.xdd").objects.keys()
