"""`coulombus init`: a rig file on stdout or in a new file, from EDS files or from a live bus; a
rehearsal's file and the real bus.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.rigs.rig import load_rig, load_rig_text
from eds_edit import edit, gone
from foreign_eds import geared
from places import ROOT

MOTOR = (ROOT / "eds" / "motor.eds").read_text(encoding="utf-8")
FOREIGN = edit(MOTOR, "1018sub1", DefaultValue="0x00000077")


def call(*arguments):
    return CliRunner().invoke(main, [str(a) for a in arguments])


@pytest.fixture
def folder(tmp_path, monkeypatch):
    (tmp_path / "eds").mkdir()
    (tmp_path / "eds" / "drive.eds").write_text(FOREIGN, encoding="utf-8")
    (tmp_path / "eds" / "position.eds").write_text(gone(FOREIGN, "6071"), encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_file_loads_from_anywhere(folder, monkeypatch):
    result = call("init", "--drive", "eds/drive.eds", "--brake", "bench", "--drive-id", 5, "-o", "my.toml")
    assert result.exit_code == 0, result.output
    assert "then: coulombus check --rig my.toml" in result.stderr
    monkeypatch.chdir("/")
    rig = load_rig(str(folder / "my.toml"))
    assert rig.one_axis().motor.eds == "eds/drive.eds"
    assert [node.node_id for node in rig.nodes] == [5, 2]


def test_without_a_file_it_is_printed(folder):
    result = call("init", "--drive", "eds/drive.eds", "--brake", "bench")
    assert result.exit_code == 0
    assert load_rig_text(result.stdout, "/nowhere/rig.toml").one_axis().motor.vendor_id == 0x77


def test_a_file_that_exists_is_never_replaced(folder):
    (folder / "my.toml").write_text("mine", encoding="utf-8")
    result = call("init", "--drive", "bench", "--brake", "bench", "-o", "my.toml")
    assert result.exit_code == 2
    assert "my.toml exists; choose another name" in result.output
    assert (folder / "my.toml").read_text(encoding="utf-8") == "mine"


def test_a_drive_without_a_set_point_is_refused_in_one_line(folder):
    result = call("init", "--drive", "eds/position.eds", "--brake", "bench", "-o", "my.toml")
    assert result.exit_code == 3
    assert len(result.stderr.splitlines()) == 1
    assert "no torque or current set-point that a PDO can carry" in result.stderr
    assert not (folder / "my.toml").exists()


@pytest.mark.parametrize(
    ("arguments", "status", "text"),
    [
        ((), 2, "give --drive and --brake, or --bus"),
        (("--drive", "bench"), 2, "give --drive and --brake, or --bus"),
        (("--drive", "bench", "--brake", "bench", "--drive-id", 2, "--brake-id", 2), 2, "a node id of its own"),
        (("--drive", "bench", "--brake", "bench", "--sensor-id", 2), 2, "more often than --sensor"),
        (("--drive", "none.eds", "--brake", "bench"), 3, "none.eds: cannot be read"),
        (("--drive", "bench", "--brake", "bench", "--like", "bnch"), 3, "did you mean 'bench'"),
        (("--bus", "coulombus:nobody", "--eds-folder", "eds"), 4, "no bus coulombus:nobody"),
    ],
)
@pytest.mark.usefixtures("private_sockets")
def test_mistakes(folder, arguments, status, text):
    result = call("init", *arguments)
    assert result.exit_code == status, result.output
    assert text in result.output
    assert "Traceback" not in result.output


def test_a_rehearsal_is_refused_on_a_real_bus_with_each_mark(folder):
    words = ("--rehearse", "--no-trials", "-o", "try.toml")
    result = call("init", "--drive", "eds/drive.eds", "--brake", "bench", *words)
    assert result.exit_code == 0, result.output
    lines = [
        number for number, line in enumerate(Path("try.toml").read_text().splitlines(), 1) if "# REHEARSAL" in line
    ]
    assert len(lines) >= 2
    refused = call("run", "--rig", "try.toml", "--bus", "socketcan:none9", "--seconds", 1, "--json")
    assert refused.exit_code == 3
    error = json.loads(refused.stdout)["error"].splitlines()
    assert [line.partition(": ")[0] for line in error] == [f"try.toml:{number}" for number in lines]
    assert "enter the value of the device on socketcan:none9" in error[0]


def test_a_guess_that_moves_the_hand_is_refused_on_a_real_bus_until_its_mark_is_gone(folder):
    call("init", "--drive", "eds/drive.eds", "--brake", "bench", "-o", "my.toml")
    refused = call("run", "--rig", "my.toml", "--bus", "socketcan:none9", "--seconds", 1, "--json")
    assert refused.exit_code == 3
    error = json.loads(refused.stdout)["error"]
    for key in ("motor.rated_torque_Nm", "motor.encoder_counts_rev", "mechanics.ratio"):
        assert f"{key} is marked '# CHECK'" in error
    assert "response_us" not in error  # it moves nobody
    text = Path("my.toml").read_text(encoding="utf-8")
    Path("my.toml").write_text(text.replace("# CHECK:", "#"), encoding="utf-8")
    proved = call("run", "--rig", "my.toml", "--bus", "socketcan:none9", "--seconds", 1, "--json")
    assert "CHECK" not in json.loads(proved.stdout)["error"]


def test_check_ends_with_the_guesses_that_are_left(folder):
    call("init", "--drive", "eds/drive.eds", "--brake", "bench", "-o", "my.toml")
    call_ = call("check", "--rig", "my.toml", "--json")
    document = json.loads(call_.stdout)
    lines = Path("my.toml").read_text(encoding="utf-8").splitlines()
    assert sum("# CHECK:" in line for line in lines) == len(document["guesses"]) >= 4
    for guess in document["guesses"]:
        assert guess["key"].rpartition(".")[2] in lines[guess["line"] - 1]
    assert {guess["key"] for guess in document["guesses"] if guess["moves_hand"]} == {
        "motor.rated_torque_Nm",
        "motor.encoder_counts_rev",
        "mechanics.ratio",
    }
    told = [line for line in call("check", "--rig", "my.toml").stdout.splitlines() if line.startswith("CHECK: ")]
    assert len(told) == len(document["guesses"])


def test_an_object_that_the_file_calls_unmappable_is_named_and_can_be_acknowledged(folder):
    (folder / "eds" / "drive.eds").write_text(edit(FOREIGN, "6071", PDOMapping=0), encoding="utf-8")
    words = ("init", "--drive", "eds/drive.eds", "--brake", "bench")
    refused = call(*words, "-o", "my.toml")
    assert refused.exit_code == 3
    for text in ('--accept "motor: 6071h can be mapped"', "host.accept", "motor.mode", "class D", "eds/drive.eds:"):
        assert text in refused.stderr
    made = call(*words, "--accept", "motor: 6071h can be mapped", "-o", "my.toml")
    assert made.exit_code == 0, made.output
    axis = load_rig("my.toml").one_axis()
    assert axis.host.accept == ("motor: 6071h can be mapped",)
    assert axis.allocation.bound["torque_setpoint"].entry.index == 0x6071
    text = Path("my.toml").read_text(encoding="utf-8").replace("motor: 6071h", "motor: 6072h")
    Path("other.toml").write_text(text, encoding="utf-8")
    checked = call("check", "--rig", "other.toml")
    assert checked.exit_code == 3
    assert 'host.accept = ["motor: 6071h can be mapped"]' in checked.stderr


def test_check_names_the_object_that_limits_the_drive(folder):
    (folder / "eds" / "drive.eds").write_text(gone(FOREIGN, "6072"), encoding="utf-8")
    call("init", "--drive", "eds/drive.eds", "--brake", "bench", "-o", "my.toml")
    out = call("check", "--rig", "my.toml").stdout
    assert "6072h = " not in out
    assert "drive torque limit" in out


@pytest.mark.real_time
@pytest.mark.usefixtures("private_sockets")
def test_check_holds_the_scale_of_the_live_drive_against_the_rig_file(folder):
    (folder / "eds" / "drive.eds").write_text(geared(FOREIGN), encoding="utf-8")
    made = call("init", "--drive", "eds/drive.eds", "--brake", "bench", "--drive-id", 9, "-o", "my.toml")
    assert made.exit_code == 0, made.output
    words = ["node", "eds/drive.eds", "--node-id", "9", "--bus", "coulombus:desk", "--json"]
    node = subprocess.Popen([sys.executable, "-m", "coulombus", *words], stdout=subprocess.PIPE, text=True)
    live = ("--bus", "coulombus:desk")
    try:
        node.stdout.readline()
        plain = call("check", "--rig", "my.toml")
        own = call("check", "--rig", "my.toml", *live)
        wrong = call("check", "--rig", "my.toml", *live, "--set", "motor.encoder_counts_rev=8192")
        absent = call("check", "--rig", "my.toml", *live, "--set", "motor.node_id=10")
    finally:
        node.terminate()
        node.communicate(timeout=60)
    assert (own.exit_code, own.stdout) == (plain.exit_code, plain.stdout)
    assert wrong.exit_code == 3
    assert "counts 360 in one turn" in wrong.stderr
    assert "the rig file says 8192" in wrong.stderr
    assert absent.exit_code == 5


@pytest.mark.real_time
@pytest.mark.usefixtures("private_sockets")
def test_live_devices_are_asked_and_found_by_their_identity(folder):
    words = ["node", "eds/drive.eds", "--node-id", "9", "--bus", "coulombus:desk", "--json"]
    node = subprocess.Popen([sys.executable, "-m", "coulombus", *words], stdout=subprocess.PIPE, text=True)
    try:
        node.stdout.readline()
        result = call("init", "--bus", "coulombus:desk", "--brake", "bench", "--eds-folder", "eds", "-o", "my.toml")
    finally:
        node.terminate()
        node.communicate(timeout=60)
    assert result.exit_code == 0, result.output
    assert "node 9: Coulombus motor drive" in result.stderr
    motor = load_rig(str(folder / "my.toml")).one_axis().motor
    assert (motor.node_id, motor.eds, motor.vendor_id) == (9, "eds/drive.eds", 0x77)
