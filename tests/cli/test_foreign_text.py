"""Names of an EDS file, a rig file and a device that would command the terminal: every verb that
prints them, and every file that carries them, has them without control characters.
"""

from __future__ import annotations

import ast
import json
import os
import re
from xml.etree import ElementTree

import cantools
import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.eds.reader import parse_eds
from coulombus.kernels.decorator import JIT_DISABLED
from coulombus.rigs.rig import RigError, load_rig_text, packaged_rig
from desk import BUS, put_on_desk
from devices_bench import EDS
from places import ROOT

EVIL = "\x1b]52;c;UA==\x07\x00\x9b\u202e"
IN_A_PATH = EVIL.replace("\0", "")
CONTROL = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u202a-\u202e\u2066-\u2069]")


def clean(text):
    return not CONTROL.search(text)


def call(*words, statuses=(0,)):
    result = CliRunner().invoke(main, [str(word) for word in words])
    assert result.exception is None or isinstance(result.exception, SystemExit), (words, result.exception)
    assert result.exit_code in statuses, (words, result.output)
    for text in (result.stdout, result.stderr):
        assert clean(text), (words, ascii(text))
    return result


def hostile(name):
    """Return one of our EDS files with a hostile end of every name and every text."""
    text = (EDS / f"{name}.eds").read_text()
    text = re.sub(r"(?m)^(ParameterName=.{4}).*$", lambda found: found[1] + EVIL, text)
    text = re.sub(r"(?m)^((?:ProductName|VendorName|Description|CreatedBy)=).*$", lambda found: found[1] + EVIL, text)
    text = re.sub(r"(DataType=0x0009\nAccessType=const\nDefaultValue=).*", lambda found: found[1] + EVIL, text)
    return text + f"\n[{EVIL}]\n{EVIL}={EVIL}\n[6064sub{EVIL}]\nParameterName={EVIL}\n"


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A hostile EDS file, and a rig that uses it, both in files of hostile names."""
    folder = tmp_path_factory.mktemp("hostile")
    eds, rig = folder / f"motor{IN_A_PATH}.eds", folder / f"rig{IN_A_PATH}.toml"
    eds.write_text(hostile("motor"))
    text = packaged_rig("bench").read_text().replace('eds = "motor.eds"', f"eds = {json.dumps(eds.name)}")
    text = text.replace("sdo_timeout_s = 0.5", f"sdo_timeout_s = 0.5\naccept = [{json.dumps(EVIL)}]")
    rig.write_text(text)
    return eds, rig


VERBS = [
    "eds check EDS",
    "eds check --pdos EDS",
    "eds check --pdos --json EDS",
    "pdo --rig RIG",
    "pdo --rig RIG --json",
    "check --rig RIG",
    "check --rig RIG --steps",
    "check --rig RIG --json",
    "plan --rig RIG",
    "dbc --rig RIG",
    "tools DIR/tools --rig RIG",
    "systemd --rig RIG -o DIR/units",
    "systemd --rig RIG --user -o DIR/user",
    "init --drive EDS --brake bench",
    "init --drive EDS --brake bench -o DIR/new.toml",
    "doctor --rig RIG",
    "doctor --rig RIG --fix",
    "stop --rig RIG",
    "status --rig RIG",
    "run --rig RIG",
    "watch --rig RIG",
    "conformance --bus coulombus:none --node 1 --eds EDS",
    "pdo --rig RIG --set motor.eds=EVIL",
    "pdo --rig EVIL",
    "check --rig RIG --set EVIL=1",
    "EVIL",
    "--EVIL",
    "pdo --EVIL",
    "eds check EVIL",
    "decode EVIL",
    "sdo get 1 EVIL --bus coulombus:none --eds EDS",
]


@pytest.mark.usefixtures("private_sockets")
@pytest.mark.parametrize("words", VERBS)
def test_no_verb_prints_a_control_character_of_a_file(files, tmp_path, monkeypatch, words):
    monkeypatch.chdir(tmp_path)
    given = {"EDS": str(files[0]), "RIG": str(files[1])}
    call(
        *(given.get(word, word).replace("DIR", str(tmp_path)).replace("EVIL", IN_A_PATH) for word in words.split()),
        statuses=range(8),
    )


def test_the_names_are_shown_in_another_spelling(files):
    told = call("eds", "check", "--pdos", files[0], statuses=(0, 3)).stdout
    assert r"\x1b]52;c;" in told
    assert r"\x9b\u202e" in told


@pytest.mark.usefixtures("private_sockets")
@pytest.mark.parametrize(
    "words",
    [
        "scan --eds .",
        "sdo get 1 1008h",
        "sdo dump 1 out.dcf --eds EDS",
        "sdo 1 --eds EDS",
        "sdo set 1 1017h 5 --eds EDS",
        "lss",
    ],
)
def test_no_verb_prints_a_control_character_of_a_device(files, tmp_path, monkeypatch, words):
    link = put_on_desk(monkeypatch)
    link.add(parse_eds(hostile("motor").encode(), "motor.eds"), 1)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a.eds").write_text(hostile("motor"))
    words = [str(files[0]) if word == "EDS" else word for word in words.split()]
    told = call(*words, *BUS, statuses=range(8))
    assert "Usage:" not in told.output, told.output
    for made in tmp_path.glob("*.dcf"):
        assert "sub" in made.read_text()


@pytest.mark.usefixtures("private_sockets")
def test_the_files_for_other_tools_can_be_read(files, tmp_path):
    call("tools", tmp_path / "tools", "--rig", files[1])
    made = [path for path in (tmp_path / "tools").rglob("*") if path.is_file()]
    for path in made:
        assert clean(path.read_bytes().decode("cp1252" if path.suffix == ".dbc" else "utf-8")), path
        if path.suffix in (".kcd", ".xml"):
            ElementTree.parse(path)
        if path.suffix in (".dbc", ".kcd", ".sym"):
            assert cantools.database.load_file(path).messages
    assert {path.suffix for path in made} >= {".kcd", ".dbc", ".sym", ".lua", ".xml", ".json"}
    call("systemd", "--rig", files[1], "--bus", "socketcan:can0", "-o", tmp_path / "units")
    for path in (tmp_path / "units").iterdir():
        assert clean(path.read_text()), path


@pytest.mark.slow
@pytest.mark.usefixtures("private_sockets")
@pytest.mark.skipif(JIT_DISABLED, reason="plain Python is slow")
def test_a_recording_of_hostile_devices_is_read(files, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    call("simulate", "--rig", files[1], "--seconds", "0.05", "--record", "run.pcapng")
    for words in (
        "decode run.pcapng",
        "plot run.pcapng -o a.png",
        "export run.pcapng --to csv -o a.csv",
        "hz run.pcapng",
    ):
        call(*words.split())
    assert clean((tmp_path / "a.csv").read_text())


@pytest.mark.parametrize("key", ["name", "description"])
@pytest.mark.parametrize("character", ["\x1b", "\x07", "\0", "\x7f", "\x9b", "\u202e", "\n", "\t"])
def test_a_rigs_name_and_description_have_no_control_character(tmp_path, key, character):
    text = re.sub(
        rf"(?m)^{key} = .*$",
        lambda _: f"{key} = {json.dumps(f'a{character}b')}",
        packaged_rig("bench").read_text(),
        count=1,
    )
    line = next(number for number, row in enumerate(text.splitlines(), 1) if row.startswith(f"{key} = "))
    with pytest.raises(RigError) as caught:
        load_rig_text(text, "mine.toml")
    (told,) = caught.value.errors
    assert told.startswith(f"mine.toml:{line}: rig.{key}: got ")
    assert "without control characters" in told
    assert clean(told)
    (tmp_path / "mine.toml").write_text(text)
    call("simulate", "--rig", tmp_path / "mine.toml", "--record", tmp_path / "a.pcapng", statuses=(3,))
    assert os.listdir(tmp_path) == ["mine.toml"]


def test_verbs_print_by_what_leaves_control_characters_out():
    """Others would be forgotten."""
    for path in sorted((ROOT / "coulombus" / "cli").glob("*.py")):
        if path.name == "tables.py":
            continue
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.Call):
                name = ast.unparse(node.func)
                assert name not in ("click.echo", "click.secho", "print", "Console", "sys.stdout.write"), (
                    f"{path}:{node.lineno}"
                )
