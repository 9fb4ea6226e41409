"""The mistakes that people make at the command line: what each is told, and its exit status."""

from __future__ import annotations

import json
import re

import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.eds.regular_file import mode_of
from coulombus.kernels.records import new_records
from coulombus.recording.pcapng_writer import PcapngWriter
from coulombus.rigs.errors import nearest, number_hint
from coulombus.wire.frame import Frame
from places import RIGS, ROOT

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
    ("eds check none.eds", 3, f"none.eds: refused: {MISSING}"),
    ("init --drive none.eds --brake bench", 3, f"none.eds: {MISSING}"),
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
    ("set F_s=2,0 --bus coulombus:none", 2, "'F_s=2,0': '2,0' is not a number; write 2.0, with a decimal point"),
    ("set F_s=2Nm --bus coulombus:none", 2, "'2Nm' is not a number; leave the unit off"),
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
    # a file of another kind, or one that an editor saved in another way
    ("check --rig folder", 3, "folder: no rig of this name; "),
    ("check --rig folder", 3, "; folder is a folder"),
    ("check --rig motor.eds", 3, "coulombus init --drive motor.eds --brake bench -o my-rig.toml"),
    ("check --rig run.pcapng", 3, "this is the name of a recording, and its rig is attached to it"),
    ("check --rig bnech", 3, "did you mean 'bench'?"),
    ("check --rig utf16.toml", 3, "utf16.toml:1: the file is UTF-16; save it as UTF-8"),
    ("check --rig latin1.toml", 3, "latin1.toml:1: the byte 0xF6 is not UTF-8; save the file as UTF-8"),
    ("check --rig twice.toml", 3, "bus.period_s: is in line "),
    ("check --rig empty.toml", 3, "empty.toml:1: bus: the section is missing"),
    ("check --rig unclosed.toml", 3, "unclosed.toml:1: '[bus' cannot be read; expected [section]"),
    (
        "check --set motor.eds=my-rig.toml",
        3,
        "describes no object; expected sections such as [1000], is it an EDS file?",
    ),
    ("check --set motor.eds=folder", 3, "folder: is a directory, not a regular file"),
    ("init --drive my-rig.toml --brake bench", 3, "my-rig.toml:1: describes no object"),
    ("eds check folder", 3, "folder: refused: is a directory"),
    ("eds check my-rig.toml", 3, "is it an EDS file?"),
    ("decode empty.pcapng", 2, "empty.pcapng: the file is empty: nothing was recorded"),
    ("decode my-rig.toml", 2, "is no line of a log format that is known; the nearest is"),
    ("decode folder", 2, "folder: there is no recording in this folder"),
    ("diff my-rig.toml run.pcapng", 2, "is no line of a log format that is known"),
    ("simulate --faults run.pcapng", 3, "is not UTF-8; save the file as UTF-8"),
    ("simulate --script run.pcapng", 3, "is not UTF-8; save the file as UTF-8"),
    ("simulate --law broken.py:f", 3, "broken.py, line 1"),
    ("simulate --law raises.py:f", 3, "raises.py cannot be imported: RuntimeError: no board (raises.py, line 2)"),
    ("simulate --law one.py:f", 3, "a law takes three arguments, (motion, law, state); this one takes (x)"),
    ("simulate --law one.py:g", 3, "one.py has no function 'g'; it has f"),
    ("law dahl --motion empty.toml", 3, "empty.toml:1: the file is empty"),
    ("law dahl --motion semicolons.csv", 3, "got 't_s;x_rad', expected a header with the columns t_s,x_rad"),
    ("analyse study folder", 2, "folder: holds no study (participants.tsv)"),
    (
        "sweep my-rig.toml -o out",
        3,
        "my-rig.toml: this is a rig file (--rig FILE); expected a sweep (coulombus sweep FILE)",
    ),
    ("export run.pcapng --to csv -o run.pcapng --force", 2, "that is the recording itself"),
    # a value of another kind
    ("check --set host.accept=everything", 3, "got '\"everything\"', expected a list of texts"),
    ("check --set mode.active=3", 3, "got '3', expected a section"),
    ("check --set bus.period_s=nan", 3, "got 'nan', expected a number from 0.0001 to 1, in s"),
    ("check --set motor.node_id=128", 3, "expected an integer from 1 to 127"),
    ("check --set motor.eds=3", 3, "expected a text in double quotes"),
    ("check --set bus.period_s=", 3, "expected SECTION.KEY=VALUE"),
    ('check --set phase=[{kind="strok"}]', 3, '--set phase=[{kind="strok"}]: phase.0.kind: got \'"strok"\''),
    ('check --set phase=[{kind="strok"}]', 3, "did you mean 'stroke'?"),
    ("simulate --seconds -1", 2, "'-1': expected a number above 0"),
    ("simulate --seconds nan", 2, "'nan': expected a number above 0"),
    ("simulate --seconds inf", 2, "'inf': expected a number above 0"),
    ("simulate --seconds 1e99", 2, "'1e99': expected a number above 0, at most 31557600 (a year)"),
    ("simulate --seed 1.5", 2, "'1.5' is not a valid integer"),
    ("plot run.pcapng --span 5:1", 2, "expected A:B in s, as in 3:5, 2.5: or :10, and B after A"),
    ("plot run.pcapng -o x.txt", 2, "x.txt: expected a name that ends in .png, .svg, .pdf"),
    ("export run.pcapng --to excel", 2, "'excel' is not one of 'csv', 'parquet'"),
    ("nmt begin 1 --bus coulombus:none", 2, "'begin' is not one of 'start', 'stop', 'preop'"),
    ("nmt start 300 --bus coulombus:none", 2, "'300': expected a node id, 1 to 127, or a node's name"),
    ("node motor.eds --node-id 200 --bus coulombus:none", 2, "200 is not 1 to 127, and not 255 (none yet)"),
    ("conformance --bus coulombus:none --node 1 --eds motor.eds --case 99", 2, "--case 99: there is no such case"),
    ("run_command", 2, "Did you mean 'run'?"),
    ("version", 2, "Did you mean '--version'?"),
    ("simulate --mode HYBRID", 2, "Invalid value for '--mode': 'HYBRID' is not one of"),
    ("simulate --mode HYBRID", 2, "Did you mean 'hybrid'?"),
    ("simulate --set motor.peak 2.5", 2, "did you mean --set motor.peak=2.5?"),
    ("simulate --mod hybrid", 2, "No such option '--mod'. Did you mean '--mode'?"),
    ("sdo get 1 1000h", 2, "No virtual bus is served; `coulombus emulate` serves one. A CAN interface is --bus"),
    (
        "law text.txt:f --motion sine",
        3,
        "text.txt cannot be imported: there is no module of that name; expected FILE.py:FUNCTION",
    ),
    ("simulate --modus hybrid", 2, "Did you mean '--mode'?"),
    ("simulate --seconds 1,5", 2, "did you mean 1.5?"),
    ("law dahl --motion sine --amplitude 0,5", 2, "Did you mean 0.5?"),
    ("simulate --mode hybri", 2, "Did you mean 'hybrid'?"),
    (
        "sdo get motor 1008h --bus coulombus:none",
        2,
        "'motor': expected a node id, 1 to 127, or a node's name and its rig, as --rig bench",
    ),
    ("sdo get motr 1008h --bus coulombus:none --rig bench", 2, "'motr': the rig bench has the nodes motor, brake"),
    ("sdo get motor 1008h --bus coulombus:none --rig bench", 4, "no bus coulombus:none"),
    ("sdo gett 1 1008h --bus coulombus:none", 2, "Did you mean 'get'?"),
    ("nmt start 200 --bus coulombus:none", 2, "'200': expected a node id, 1 to 127"),
    ("nmt stop", 2, "a node id, 1 to 127; or a node's name and its rig, as motor --rig bench"),
    ("run --web --web-after -1", 2, "'-1': expected a number of 0 or more"),
    ("watch --last", 2, "--last is of the page: add --web; for text: coulombus status"),
    ("watch run.pcapng --web --last", 2, "run.pcapng and --last: choose one of them"),
    ("watch --web --last", 4, "no host of this user on this machine has left a word of its end"),
    ("help exits", 2, "did you mean 'exit'?"),
    ("help simulat", 2, "Did you mean one of: 'emulate', 'simulate'?"),
    ("help analyse simulate", 2, "No such command 'simulate'."),
    ("help run exit", 2, "run has no commands; got 'exit'."),
    ("SIMULATE", 2, "No such command 'SIMULATE'. Did you mean 'simulate'?"),
    ("simulate --seed -1", 2, "'--seed': -1 is not in the range x>=0"),
    ("eds chek motor.eds", 2, "Did you mean 'check'?"),
    ("law dahl --motion sin", 2, "did you mean 'sine'?"),
    ("commission --rig my-rig.toml --virtual --step frition", 2, "did you mean 'friction'?"),
    ("commission --rig bench --virtual", 2, "coulombus init --drive bench --brake bench --rehearse -o my-rig.toml"),
    ("eds check motr.eds", 3, f"motr.eds: refused: {MISSING}; did you mean 'motor.eds'?)"),
    ("simulate --set F_s=3", 3, "did you mean 'mode.active.F_s_Nm', 'mode.passive.F_s_Nm' or 'mode.hybrid.F_s_Nm'?"),
    ("simulate --set host.period_ms=2", 3, "did you mean 'bus.period_s'?"),
    ("simulate --set peroid_s=0.002", 3, "did you mean 'bus.period_s'?"),
    ("simulate --law law.py", 3, "--law law.py: name the function: law.py:NAME"),
    ("law law.py", 3, "law 'law.py': name the function: law.py:NAME"),
    (
        "simulate --law broken.py:f",
        3,
        "--law broken.py:f: law.function: law 'broken.py:f': broken.py cannot be imported",
    ),
    ("explain motor.eds", 2, "it is a device description: `coulombus eds check motor.eds` reads it"),
    ("emulate --eds motor.eds", 2, "No such option '--eds'. `coulombus node FILE` simulates the device"),
    ("decode run.pcapng --dbc a.dbc", 2, "--eds takes the devices' EDS files; `coulombus dbc` writes"),
    # a bus that is not there
    ("scan --bus coulombus:none", 4, "start one in another terminal with `coulombus emulate --bus coulombus:none`"),
    ("run --bus pcan:PCAN_USBBUS1", 2, "unknown kind of bus 'pcan'; expected coulombus:NAME"),
    ("run --bus coulombus:a/b", 2, "bus name 'a/b': expected letters, digits"),
    ("stop --bus coulombus:none", 4, "no host runs on bus coulombus:none"),
    ("bridge coulombus:a coulombus:a", 2, "a bridge joins two buses"),
    ("run --bus socketcan:none0", 7, "names no dead man's switch"),
    ("replay run.pcapng --host --virtual", 2, "give one of --bus B (play it there), --host and --virtual (check it)"),
]

WRONG_FILES = (
    ("empty.toml", ""),
    ("empty.pcapng", ""),
    ("unclosed.toml", "[bus\nperiod_s = 0.001\n"),
    ("broken.py", "def f(motion, law, state) return 0.0\n"),
    ("raises.py", "import math\nraise RuntimeError('no board')\n"),
    ("one.py", "def f(x):\n    return 0.0\n"),
    ("semicolons.csv", "t_s;x_rad\n0;0\n1;0,1\n"),
)


@pytest.fixture
def folder(tmp_path, monkeypatch, private_sockets):
    """Work in a folder with a rig file, a recording, and files that are wrong."""
    folder = tmp_path / "desk"  # beside it, a private folder of sockets
    folder.mkdir()
    monkeypatch.chdir(folder)
    rig = (RIGS / "bench.toml").read_text()
    for name, text in (("my-rig.toml", rig), *WRONG_FILES):
        (folder / name).write_text(text)
    (folder / "twice.toml").write_text(rig.replace("[bus]", "[bus]\nperiod_s = 0.001", 1))
    (folder / "utf16.toml").write_text(rig, encoding="utf-16")
    (folder / "latin1.toml").write_text("# Größe\n" + rig, encoding="latin-1")
    (folder / "motor.eds").write_text((ROOT / "eds" / "motor.eds").read_text())
    (folder / "folder").mkdir()
    with PcapngWriter(folder / "run.pcapng", attachments={}) as writer:
        writer.write(new_records(Frame, 3))
    return folder


@pytest.mark.parametrize(("words", "status", "told"), USUAL, ids=[f"{words}" for words, _, _ in USUAL])
def test_a_usual_mistake_is_told_with_what_to_do(folder, words, status, told):
    before = {path.name for path in folder.iterdir()}
    result = CliRunner().invoke(main, words.replace("\\\\", "\\").split(), terminal_width=200)
    assert result.exit_code == status, result.output
    assert "Traceback" not in result.output
    assert told in re.sub(r"\s+", " ", result.output)
    after = {path.name for path in folder.iterdir()} - {"__pycache__"}  # Python's own, of a law's file
    assert after == before


def test_a_wrong_option_is_told_in_two_lines():
    result = CliRunner().invoke(main, ["decode", "--foo"])
    assert result.stderr.splitlines() == ["Try 'main decode --help' for help.", "Error: No such option '--foo'."]


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


def test_how_to_write_a_number_of_many_digits_is_told_too():
    """Each digit was tried as the last one: this took an hour."""
    assert number_hint("9" * 200_000 + "x", "s") == "; leave the unit off: the number is in s"
    assert number_hint("9" * 200_000, "s") == ""


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
