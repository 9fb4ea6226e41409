"""The mistakes that people make at the command line: what each is told, and its exit status."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from click.testing import CliRunner

from coulombus.eds.regular_file import mode_of
from coulombus.recording.pcapng_writer import PcapngWriter
from coulombus.rigs.mistakes import nearest, number_hint
from coulombus.verbs.main import main
from coulombus.wire.frame import FRAME, new_records

ROOT = Path(__file__).resolve().parent.parent.parent
MISSING = "cannot be read (No such file or directory"

USUAL = [
    # a file that is not there: one status, whatever it is
    ("check --rig my-rgi.toml", 3, f"my-rgi.toml: {MISSING}; did you mean 'my-rig.toml'?"),
    ("simulate --rig rigs/my-rig.toml", 3, f"{MISSING}; there is no folder rigs"),
    (
        "simulate --rig C:\\\\rigs\\\\bench.toml",
        3,
        "a path of Windows: write / between the folders, under WSL /mnt/c/rigs/",
    ),
    ("decode runn.pcapng", 3, f"runn.pcapng: {MISSING}; did you mean 'run.pcapng'?"),
    ("decode runs\\\\run.pcapng", 3, "it reads as a path of Windows: write / between the folders)"),
    ("plot out/run.pcapng", 3, f"{MISSING}; there is no folder out)"),
    ("diff run.pcapng none.pcapng", 3, f"none.pcapng: {MISSING}"),
    ("export none.pcapng --to csv", 3, f"none.pcapng: {MISSING}"),
    ("replay none.pcapng --host", 3, f"none.pcapng: {MISSING}"),
    ("identify none.pcapng", 3, f"none.pcapng: {MISSING}"),
    ("hz none.pcapng", 3, f"none.pcapng: {MISSING}"),
    ("eds check *.edz", 3, f"{MISSING}; no file fits this pattern"),
    ("eds check none.eds", 3, f"none.eds:1: refused: {MISSING}"),
    ("init --drive none.eds --brake bench", 3, f"none.eds:1: {MISSING}"),
    ("init --drive bench --brake bench --eds-folder none", 3, f"none: {MISSING}"),
    ("law dahl --motion none.csv", 3, f"none.csv: {MISSING}"),
    ("law none.py:f --motion sine", 3, "there is no file none.py"),
    ("simulate --law none.py:f", 3, "there is no file "),
    ("simulate --faults none.toml", 3, "none.toml: the fault file " + MISSING),
    ("sweep none.toml -o out", 3, "none.toml: the sweep file " + MISSING),
    # a number with its unit, or with a comma
    ("check --set mode.active.F_s_Nm=3.5Nm", 3, "; leave the unit off: 3.5"),
    ("check --set bus.period_s=1ms", 3, "; leave the unit off: 0.001"),
    ("check --set bus.bitrate_bit_s=500k", 3, "; leave the unit off: 500000"),
    ("check --set mode.active.F_s_Nm=3,5", 3, "; write 3.5, with a decimal point"),
    ("law dahl --motion sine --set sigma_Nm_rad=30Nm", 3, "; leave the unit off: the number is in Nm/rad"),
    (
        "law dahl --motion sine --set sigma=30",
        3,
        "law.dahl.sigma: unknown key; expected one of the keys of [law.dahl]: ",
    ),
    ("law dahl --motion sine --set sigma=30", 3, "; did you mean 'sigma_Nm_rad'?"),
    ("set F_s=2,0 --bus coulombus:none", 2, "'F_s=2,0': '2,0' is no number; write 2.0, with a decimal point"),
    ("set F_s=2Nm --bus coulombus:none", 2, "'2Nm' is no number; leave the unit off"),
    ("set F_s --bus coulombus:none", 2, "expected NAME=VALUE, as in F_s=2.0"),
    ("plan --bitrate fast", 2, "'fast': expected a bit rate from 10k to 20M, such as 1000000, 500k or 1M"),
    ("plan --bitrate 1G", 2, "expected a bit rate"),
    ("simulate --seconds 3.5s", 2, "expected a number above 0, at most 31557600 (a year), in s"),
    # an option that was forgotten, or a word that was misspelt
    ("simulate my-rig.toml", 2, "did you mean --rig my-rig.toml?"),
    ("simulate bench", 2, "did you mean --rig bench?"),
    ("simulate hybrid", 2, "did you mean --mode hybrid?"),
    ("run coulombus:bench", 2, "did you mean --bus coulombus:bench?"),
    ("simulate new.pcapng", 2, "did you mean --record new.pcapng?"),
    ("simulat", 2, "Did you mean one of"),
    ("simulate --mode hybird", 2, "'hybird' is not one of 'active', 'passive', 'hybrid'"),
    ("law dahll --motion sine", 3, "did you mean 'dahl'?"),
    ("run --bus can0", 2, "write coulombus:can0 for a virtual bus or socketcan:can0 for a SocketCAN interface"),
    ("check --set mode.active.F_s=2", 3, "did you mean 'F_s_Nm'?"),
    ("run --cpu 99999 --bus coulombus:none", 2, "this process may use the CPUs "),
    # a place that takes no file
    ("tools my-rig.toml", 2, "my-rig.toml: expected a folder, and this is the name of a rig file: --rig my-rig.toml"),
    ("tools run.pcapng", 2, "run.pcapng"),
    ("law dahl --motion sine --csv /dev/full", 2, "/dev/full: No space left on device"),
    ("simulate --record run.csv", 2, "run.csv: expected a name that ends in .pcapng"),
    ("simulate --record nowhere/run.pcapng", 2, "nowhere/run.pcapng: there is no directory "),
]


@pytest.fixture
def folder(tmp_path, monkeypatch, private_sockets):
    """Work in a folder with a rig file and a recording."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my-rig.toml").write_text((ROOT / "rigs" / "bench.toml").read_text())
    with PcapngWriter(tmp_path / "run.pcapng", attachments={}) as writer:
        writer.write(new_records(FRAME, 3))
    return tmp_path


@pytest.mark.parametrize(("words", "status", "told"), USUAL, ids=[f"{words}" for words, _, _ in USUAL])
def test_a_usual_mistake_is_told_with_what_to_do(folder, words, status, told):
    before = {path.name for path in folder.iterdir()}
    result = CliRunner().invoke(main, words.replace("\\\\", "\\").split(), terminal_width=200)
    assert result.exit_code == status, result.output
    assert "Traceback" not in result.output
    assert told in re.sub(r"\s+", " ", result.output)
    assert {path.name for path in folder.iterdir()} == before


def test_what_is_missing_is_told_as_json_too(folder):
    result = CliRunner().invoke(main, ["identify", "none.pcapng", "--json"])
    assert json.loads(result.stdout)["exit_status"] == result.exit_code == 3


@pytest.mark.parametrize(
    ("given", "unit", "told"),
    [
        ("3.5Nm", "Nm", "; leave the unit off: 3.5"),
        ("3.5 Nm", "Nm", "; leave the unit off: 3.5"),
        ("250mNm", "Nm", "; leave the unit off: 0.25"),
        ("-1e-3 s", "s", "; leave the unit off: -1e-3"),
        ("20 us", "s", "; leave the unit off: 2e-05"),
        ("1 Mbit/s", "bit/s", "; leave the unit off: 1000000"),
        ("1M", "bit/s", "; leave the unit off: 1000000"),
        ("30 deg", "rad", "; leave the unit off: the number is in rad"),
        ("3 rows", "", "; leave the unit off"),
        ("3,5", "Nm", "; write 3.5, with a decimal point"),
        ("fast", "Nm", ""),
        ("1.2.3", "Nm", ""),
        ("", "Nm", ""),
    ],
)
def test_how_to_write_a_number(given, unit, told):
    assert number_hint(given, unit) == told


def test_a_name_without_its_unit_is_near():
    assert nearest("sigma", ["alpha", "sigma_Nm_rad"]) == "; did you mean 'sigma_Nm_rad'?"
    assert nearest("s", ["sigma_Nm_rad"]) == ""


def test_what_may_have_been_meant_is_looked_for_in_the_files_own_folder(tmp_path):
    (tmp_path / "motor.eds").write_text("")
    with pytest.raises(FileNotFoundError, match=re.escape(f"did you mean '{tmp_path}/motor.eds'?")):
        mode_of(tmp_path / "motro.eds")
    with pytest.raises(FileNotFoundError, match="directory: ") as found:
        mode_of(tmp_path / "unlike")
    assert found.value.filename == str(tmp_path / "unlike")
