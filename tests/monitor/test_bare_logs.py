"""`decode` and `hz` of logs without a rig: services, maps seen in the log, EDS files, assumed maps."""

from __future__ import annotations

import json

import numpy as np
import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.recording.pcapng_writer import PcapngWriter
from coulombus.wire.frame import FRAME
from explain_log import machine
from places import EDS

TYPE_402 = "4300100092010200"


def call(*words):
    result = CliRunner().invoke(main, words)
    assert result.exit_code == 0, result.output
    return result


def rows(path, *words):
    return [json.loads(line) for line in call("decode", path, "--json", *words).stdout.splitlines()]


def candump(log, path, bus="can0"):
    lines = []
    for frame in log.frames:
        data = int(frame["word"]).to_bytes(8, "little", signed=True)[: int(frame["length"])]
        lines.append(f"({frame['t_ns'] / 1e9:.6f}) {bus} {int(frame['can_id']):03X}#{data.hex().upper()}\n")
    path.write_text("".join(lines))
    return str(path)


@pytest.fixture
def log():
    log = (
        machine(3, until=500)
        .ask(3, 20, "4000100000000000", TYPE_402)
        .add(300, 0x083, bytes.fromhex("1042010000000000"))
    )
    return log.cycles(60, 500, (3,), data=lambda cycle, node: bytes.fromhex("3706feffffff0000"))


def test_every_service_of_a_log_without_a_rig_is_named(log, tmp_path):
    found = rows(candump(log, tmp_path / "x.log"))
    assert len(found) == len(log.rows)
    services = {row["service"].split()[0] for row in found}
    assert services == {"heartbeat", "nmt", "sync", "SDO", "emcy", "pdo"}
    assert {row["node"] for row in found} == {"3", "all", None}
    assert "0x4210" in next(row["text"] for row in found if row["service"] == "emcy")


def test_a_drive_without_maps_has_those_of_cia_402_called_assumed(log, tmp_path):
    pdo = next(row for row in rows(candump(log, tmp_path / "x.log")) if row["can_id"] == 0x183)
    assert (pdo["pdo"], pdo["map"], pdo["6041h:00"]) == ("TPDO1", "assumed", 0x0637)
    assert "6064h:00" not in pdo


def test_a_map_in_the_log_comes_before_the_assumed_one(log, tmp_path):
    for ms, word in ((21, "23001a0110004160"), (22, "23001a0220006460"), (23, "2f001a0002000000")):
        log.ask(3, ms, word, "60" + word[2:8] + "00000000")
    pdo = next(row for row in rows(candump(log, tmp_path / "x.log")) if row["can_id"] == 0x183)
    assert (pdo["6041h:00"], pdo["6064h:00"], "map" in pdo) == (0x0637, -2, False)


def test_an_eds_file_gives_the_map(tmp_path):
    log = machine(3, until=500).cycles(60, 500, (3,), data=lambda cycle, node: bytes.fromhex("3706feffffff0500"))
    pdo = next(row for row in rows(candump(log, tmp_path / "x.log"), "--eds", f"3={EDS / 'motor.eds'}") if row["pdo"])
    assert (pdo["6041h:00"], pdo["6064h:00"], pdo["6077h:00"]) == (0x0637, -2, 5)


def test_rig_and_eds_exclude_each_other(log, tmp_path):
    path = candump(log, tmp_path / "x.log")
    result = CliRunner().invoke(main, ["decode", path, "--rig", "bench", "--eds", f"3={EDS / 'motor.eds'}"])
    assert result.exit_code == 2


def test_hz_names_pdos_and_measures_them_from_sync(log, tmp_path):
    told = json.loads(call("hz", candump(log, tmp_path / "x.log"), "--json").stdout)
    pdo = next(row for row in told["identifiers"] if row["can_id"] == 0x183)
    assert (pdo["name"], pdo["period_ms"]) == ("3 TPDO1", 2.0)
    assert pdo["from_sync"]["p50_us"] == pytest.approx(200.0, abs=1.0)


def test_one_bus_of_several_must_be_named(log, tmp_path):
    both = tmp_path / "both.log"
    both.write_text((tmp_path / candump(log, tmp_path / "a.log")).read_text())
    with both.open("a") as file:
        file.write("(9.000000) can1 705#05\n")
    assert CliRunner().invoke(main, ["decode", str(both)]).exit_code == 2
    assert [row["node"] for row in rows(str(both), "--channel", "can1")] == ["5"]


def packed(log, path):
    """Write a log as a pcapng file."""
    with PcapngWriter(path, attachments={}) as writer:
        writer.write(np.array([tuple(frame)[:5] for frame in log.frames], FRAME).view(np.recarray))
    return path


@pytest.mark.parametrize("verb", ["decode", "hz", "explain"])
def test_a_torn_end_is_told_and_what_stands_before_it_is_shown(log, tmp_path, verb):
    path = packed(log, tmp_path / "a.pcapng")
    path.write_bytes(path.read_bytes()[:-10])
    result = call(verb, str(path))
    assert "the last block is unfinished: 38 bytes were left out" in " ".join(result.output.split())
    assert "083" in result.stdout or verb == "explain"


@pytest.mark.parametrize("kept", [20, 60, 100, None])
@pytest.mark.parametrize("verb", ["decode", "hz", "explain"])
def test_a_recording_without_a_frame_is_refused(tmp_path, verb, kept):
    path = tmp_path / "a.pcapng"
    PcapngWriter(path, attachments={"notes.txt": bytes(100)}).close()
    path.write_bytes(path.read_bytes()[:kept])
    result = CliRunner().invoke(main, [verb, str(path)])
    assert result.exit_code == 2
    assert "it has no frame" in result.output
