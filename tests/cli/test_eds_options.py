"""Verbs that take a device's EDS file instead of a rig: of a log, and of nothing but the file."""

from __future__ import annotations

import json

import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from places import EDS

MOTOR, BRAKE = f"5={EDS / 'motor.eds'}", f"6={EDS / 'mr_brake.eds'}"
POSITION = "5.TPDO1.6064h:00"


@pytest.fixture
def log(tmp_path):
    """A log without a rig: TPDO1 of node 5, a position that counts."""
    rows = (f"({k / 1e3:.6f}) can0 185#3702{k.to_bytes(4, 'little').hex()}0500\n" for k in range(1, 101))
    (tmp_path / "bus.log").write_text("".join(rows))
    return tmp_path / "bus.log"


def run(*words, status=0):
    result = CliRunner().invoke(main, [str(word) for word in words])
    assert result.exit_code == status, result.output
    return result.stdout


def test_a_log_is_decoded_exported_drawn_and_timed(log, tmp_path):
    rows = [json.loads(line) for line in run("decode", log, "--eds", MOTOR, "--json").splitlines()]
    assert [row["6064h:00"] for row in rows] == list(range(1, 101))
    run("export", log, "--eds", MOTOR, "-o", tmp_path / "bus.csv")
    table = [line for line in (tmp_path / "bus.csv").read_text().splitlines() if not line.startswith("#")]
    column = table[0].split(",").index(POSITION)
    assert [int(line.split(",")[column]) for line in table[1:]] == list(range(1, 101))
    run("plot", log, "--eds", MOTOR, "--signals", POSITION, "-o", tmp_path / "bus.png")
    assert json.loads(run("hz", log, "--eds", MOTOR, "--json"))["identifiers"][0]["name"] == "5 TPDO1"


def test_the_pdos_of_a_log_are_drawn(log):
    pdos = json.loads(run("pdo", log, "--eds", MOTOR, "--json"))
    assert {pdo["pdo"] for pdo in pdos} >= {"TPDO1", "RPDO1"}
    assert "Position actual value" in run("pdo", log, "--eds", MOTOR)
    assert run("pdo", log) == ""
    run("pdo", log, "--bus", "coulombus:x", status=2)
    run("pdo", "--node", "5", status=2)


def test_the_page_of_a_log_has_a_plot_of_each_pdo(log):
    pytest.importorskip("tornado")
    from coulombus.eds.eds_folder import eds_files
    from coulombus.explain.explained import explain
    from coulombus.monitor.web.recording_page import RecordingPage
    from coulombus.recording.reading import read

    files = eds_files([MOTOR])
    document = RecordingPage(read(log, eds=files), explain(log, eds=files), "token").document()
    names = ["5.TPDO1.6041h:00", POSITION, "5.TPDO1.6077h:00"]
    assert document["plots"] == [{"title": "5 TPDO1", "unit": "", "signals": names}]
    assert document["rig"] == ""


def test_two_logs_without_a_rig_are_compared(log, tmp_path):
    other = tmp_path / "other.log"
    other.write_text(log.read_text().replace("0A000000", "0B000000").replace("0a000000", "0b000000"))
    assert "the same bytes" in run("diff", log, log, "--eds", MOTOR)
    lines = run("diff", log, other, "--eds", MOTOR, status=1).splitlines()
    assert next(line.split()[1] for line in lines if line.startswith(POSITION)) == "1"
    assert run("diff", log, other, status=3) == ""


def test_pdos_and_files_for_tools_need_the_files_alone(tmp_path):
    pdos = json.loads(run("pdo", "--eds", MOTOR, "--eds", BRAKE, "--json"))
    assert {(pdo["node"], pdo["pdo"]) for pdo in pdos} >= {("5", "TPDO1"), ("6", "RPDO1")}
    run("tools", tmp_path / "tools", "--eds", MOTOR)
    assert {path.suffix for path in (tmp_path / "tools").iterdir()} >= {".dbc", ".kcd", ".sym", ".lua"}
    assert "5.TPDO1" in (tmp_path / "tools" / "node5.lua").read_text()


@pytest.mark.parametrize("verb", ["dbc", "pdo"])
def test_a_file_without_a_node_a_rig_beside_it_and_overrides_are_refused(verb):
    for words in (("--eds", EDS), ("--eds", MOTOR, "--rig", "bench"), ("--eds", MOTOR, "--set", "bus.bitrate_bit_s=1")):
        assert run(verb, *words, status=2) == ""
    run(verb, "--eds", "5=absent.eds", status=3)


def test_a_pdo_that_cannot_be_read_is_left_out_and_told(tmp_path):
    text = (EDS / "motor.eds").read_text().replace("[1A00sub1]", "[1A00sub1]\nDefaultValue=0x99990010")
    (tmp_path / "odd.eds").write_text(text)
    result = CliRunner().invoke(main, ["dbc", "--eds", f"5={tmp_path / 'odd.eds'}"])
    assert result.exit_code == 0
    assert "node5_TPDO1" not in result.stdout
    assert "node5_RPDO1" in result.stdout
    assert "this PDO is left out" in result.stderr


def test_a_node_with_two_files_and_an_unknown_kind_of_database_are_refused(log, tmp_path):
    for verb in ("decode", "explain"):
        assert "node 5 has" in CliRunner().invoke(main, [verb, str(log), "--eds", MOTOR, "--eds", MOTOR]).output
    output = CliRunner().invoke(main, ["dbc", "--eds", MOTOR, "-o", str(tmp_path / "bus.xlsx")]).output
    assert "expected a name that ends in .dbc, .kcd, .sym" in output


def test_a_bus_in_the_place_of_a_file_names_the_option():
    result = CliRunner().invoke(main, ["explain", "coulombus:bench"])
    assert (result.exit_code, "--bus coulombus:bench" in result.output) == (3, True)
