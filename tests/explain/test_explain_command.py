"""`coulombus explain`: the contract of --json, exit statuses, reports, EDS files and rigs."""

from __future__ import annotations

import json
import re

import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.recording.recorder import Recorder
from coulombus.rigs.rig import load_rig
from explain_log import machine
from places import EDS

KEYS = {"number", "status", "node", "axis", "kind", "title", "t_s", "end_s", "cause", "sure", "check", "frames"}


def candump(log, path):
    lines = []
    for frame in log.frames:
        data = int(frame["word"]).to_bytes(8, "little", signed=True)[: int(frame["length"])]
        lines.append(f"({frame['t_ns'] / 1e9:.6f}) can0 {int(frame['can_id']):03X}#{data.hex().upper()}\n")
    path.write_text("".join(lines))
    return str(path)


def call(*words):
    return CliRunner().invoke(main, ["explain", *words])


@pytest.fixture
def lost(tmp_path):
    """A candump log of two nodes, one of which falls silent."""
    log = machine(3, 4, until=2000).cycles(60, 2000, (3, 4), skip=lambda cycle, node: node == 4 and cycle > 400)
    log.rows = [row for row in log.rows if not (row[1] == 0x704 and row[0] > 850e6)]
    return candump(log, tmp_path / "lost.log")


@pytest.fixture
def well(tmp_path):
    return candump(machine(3, 4, until=2000).cycles(60, 2000, (3, 4)), tmp_path / "well.log")


def test_json_has_what_the_contract_says(lost):
    told = json.loads(call(lost, "--json").output)
    assert told["verdict"] == "unresolved"
    incident = told["incidents"][0]
    assert incident.keys() >= KEYS
    assert (incident["number"], incident["status"], incident["node"], incident["kind"]) == (
        1,
        "unresolved",
        4,
        "node_lost",
    )
    assert incident["end_s"] is None
    assert 0.8 < incident["t_s"] < 0.9
    assert len(incident["check"]) == 3
    assert incident["frames"][0]["can_id"] in (0x704, 0x184)
    assert [node["node"] for node in told["nodes"]] == [3, 4]


@pytest.mark.parametrize(("log", "status"), [("lost", 1), ("well", 0)])
def test_check_fails_where_something_is_unresolved(log, status, request):
    path = request.getfixturevalue(log)
    assert call(path, "--check").exit_code == status
    assert call(path).exit_code == 0


def test_the_screen_names_node_cause_and_first_step(lost):
    text = " ".join(call(lost).output.split())
    assert "1 UNRESOLVED" in text
    assert "node 4: a node fell silent" in text
    assert "check first: Look at plugs and cable" in text
    assert "well: node 3" in text
    assert f"next: coulombus explain {lost} 1" in text


def test_one_incident_shows_its_course_steps_and_frames(lost):
    text = call(lost, "1").output
    for line in ("what happened", "check first", "  1. ", "  3. ", "why it matters: ", "see: CiA 301", "frames"):
        assert line in text
    assert re.search(r"cause +node 4: nothing comes from it any more", text)
    assert re.search(r"consequence +node 4: no PDO 184h after SYNC", text)


def test_an_incident_that_is_not_there_is_a_wrong_argument(lost, well):
    assert (call(lost, "2").exit_code, call(well, "1").exit_code) == (2, 2)
    assert "it has none" in call(well, "1").output


def test_a_span_leaves_the_rest_out(lost):
    told = json.loads(call(lost, "--json", "--span", ":0.7").output)
    assert (told["verdict"], told["incidents"]) == ("ok", [])
    assert told["frames"] < 1300


def test_a_span_without_a_frame_is_refused_with_that_of_the_log(lost):
    result = call(lost, "--check", "--span", "50:60")
    assert result.exit_code == 2
    assert "there is no frame in the span: it goes from 0." in result.output


@pytest.mark.parametrize("suffix", ["html", "md"])
def test_a_report_has_every_incident_and_takes_no_markup_from_names(lost, tmp_path, suffix):
    eds = tmp_path / "odd.eds"
    name = "<script>x</script>`*"
    eds.write_text(re.sub(r"ProductName=.*", f"ProductName={name}", (EDS / "motor.eds").read_text()))
    report = tmp_path / f"report.{suffix}"
    result = call(lost, "--eds", f"4={eds}", "--report", str(report))
    assert result.exit_code == 0, result.output
    text = report.read_text()
    assert "A PDO's length does not fit its map".lower() in text.lower().replace(
        "&#x27;", "'"
    )  # the file is not its own
    assert "Write the map again after each restart" in text
    assert "<script>" not in text
    assert call(lost, "--report", str(report)).exit_code == 2  # it exists
    assert call(lost, "--report", str(report), "--force").exit_code == 0


def test_eds_files_give_names_and_maps(lost, tmp_path):
    told = json.loads(call(lost, "--json", "--eds", f"3={EDS / 'motor.eds'}").output)
    node = told["nodes"][0]
    assert node["maps"] == "EDS"
    assert node["name"]


def test_a_folder_of_eds_files_is_matched_by_identity(tmp_path):
    log = machine(3).cycles(60, 3000, (3,), data=lambda cycle, node: cycle.to_bytes(8, "little"))
    log.ask(3, 20, "4018100100000000", "43181001c0040000").ask(3, 21, "4018100200000000", "4318100202040000")
    told = json.loads(call(candump(log, tmp_path / "x.log"), "--json", "--eds", str(EDS)).output)
    assert told["nodes"][0]["maps"] == "EDS"


@pytest.mark.parametrize("text", ["5", "200=x.eds", "5=none.eds", "none"])
def test_an_eds_that_is_none_is_a_configuration_error(well, text):
    assert call(well, "--eds", text).exit_code == 3


def test_a_file_of_two_buses_asks_which_is_meant(tmp_path):
    lines = (tmp_path / "a.log", tmp_path / "b.log", tmp_path / "both.log")
    candump(machine(3, 4), lines[0])
    candump(machine(3).add(1000, 0x083, bytes.fromhex("1042010000000000")), lines[1])
    lines[2].write_text(lines[0].read_text() + lines[1].read_text().replace("can0", "can1"))
    assert call(str(lines[2])).exit_code == 2
    verdicts = [
        json.loads(call(str(lines[2]), "--json", "--channel", bus).output)["verdict"] for bus in ("can0", "can1")
    ]
    assert verdicts == ["ok", "unresolved"]


def test_file_and_bus_exclude_each_other(well):
    assert call().exit_code == 2
    assert call(well, "--bus", "coulombus:x").exit_code == 2
    assert call(well, "--seconds", "1").exit_code == 2
    assert call("--bus", "coulombus:x", "--span", "1:2").exit_code == 2


def test_the_attached_rig_names_nodes_and_maps(tmp_path):
    path = tmp_path / "run.pcapng"
    log = machine(1, 2).cycles(60, 3000, (1, 2), data=lambda cycle, node: bytes(8 if node == 1 else 6))
    with Recorder(path, load_rig("bench"), "hybrid", 0) as recorder:
        recorder.write(log.frames)
    told = json.loads(call(str(path), "--json").output)
    assert [(node["name"], node["maps"]) for node in told["nodes"]] == [("motor", "rig"), ("brake", "rig")]


def test_a_rig_of_other_devices_names_no_node_of_the_log(tmp_path):
    log = (
        machine(1).ask(1, 20, "4018100100000000", "4318100199000000").ask(1, 21, "4018100200000000", "4318100202040000")
    )
    told = json.loads(call(candump(log, tmp_path / "x.log"), "--json", "--rig", "bench").output)
    assert told["nodes"][0]["name"] is None
    assert any("rig" in remark and "node 1" in remark for remark in told["remarks"])


def test_the_nodes_of_a_log_are_a_table(tmp_path):
    log = machine(3, 4, until=2000).ask(4, 500, "4018100100000000", "43181001c0040000")
    result = call(candump(log.ask(4, 510, "4000100000000000", "4300100092010200"), tmp_path / "a.log"), "--nodes")
    assert result.exit_code == 0
    identity, figures = result.output.split("\n\n")
    assert identity.splitlines()[2].split() == ["4", "-", "402", "4C0h", "-", "OPERATIONAL", "-"]
    assert "100 / 100 / 100" in figures
