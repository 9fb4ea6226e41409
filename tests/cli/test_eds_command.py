"""`coulombus eds check`: lines, JSON, exit status."""

from __future__ import annotations

import json
import re

import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from eds_text import HEAD, variable
from places import ROOT

PDO = (
    "[1400]\nParameterName=R\nObjectType=9\nSubNumber=1\n[1400sub0]\nParameterName=N\nDataType=5\nAccessType=const\nDefaultValue=0\n"
    "[1600]\nParameterName=M\nObjectType=9\nSubNumber=2\n[1600sub0]\nParameterName=N\nDataType=5\nAccessType=rw\nDefaultValue=1\n"
    "[1600sub1]\nParameterName=E\nDataType=7\nAccessType=rw\nDefaultValue=0x20000010\n"
)


@pytest.fixture
def run(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "good.eds").write_text(HEAD + variable(PDOMapping="1"))
    (tmp_path / "odd.eds").write_text(HEAD + variable(DefaultValue="007"))
    (tmp_path / "pdo.eds").write_text(HEAD + PDO + variable(PDOMapping="1"))
    (tmp_path / "bad.eds").write_text(HEAD + PDO + variable(DataType="0x0004"))
    (tmp_path / "empty.eds").write_text("")

    def invoke(*arguments):
        result = CliRunner().invoke(main, ["eds", "check", *arguments])
        assert result.exception is None or isinstance(result.exception, SystemExit)
        return result.exit_code, result.stdout

    return invoke


def test_a_good_file(run):
    assert run("good.eds") == (0, "good.eds: readable: 4 objects, 0 PDOs, 0 errors, 0 warnings\n")


def test_a_warning_does_not_refuse(run):
    line = (HEAD + variable(DefaultValue="007")).split("\n").index("DefaultValue=007") + 1
    assert run("odd.eds") == (
        0,
        f"odd.eds:{line}: warning: [2000] DefaultValue=007 is zero-padded; assumed 7\n"
        "odd.eds: readable: 4 objects, 0 PDOs, 0 errors, 1 warning\n",
    )


def test_a_map_that_cannot_be_read_right_is_refused_and_the_rest_of_the_file_is_not(run):
    status, out = run("bad.eds")
    line = (HEAD + PDO).split("\n").index("[1600sub1]") + 1
    assert status == 0
    assert f"bad.eds:{line}: refused: 1600h:1 maps 2000h:0 in 16 bits, but INTEGER32 has 32; expected" in out
    assert "; the PDO is not valid at start\n" in out
    assert out.endswith("bad.eds: readable but for 1 PDO: 6 objects, 0 PDOs, 0 errors, 4 warnings\n")


@pytest.mark.parametrize(
    ("name", "why"),
    [("empty.eds", ":1: refused: describes no object"), ("none.eds", ": refused: cannot be read (No such")],
)
def test_what_is_no_eds_file_is_refused(run, name, why):
    status, out = run(name)
    assert (status, out.split("\n")[1]) == (3, f"{name}: refused: 0 objects, 0 PDOs, 0 errors, 0 warnings")
    assert out.startswith(f"{name}{why}")


def test_one_refused_file_of_several_decides(run):
    status, out = run("good.eds", "empty.eds", "odd.eds")
    assert status == 3
    assert [line.split(":")[0] for line in out.splitlines()] == [
        "good.eds",
        "empty.eds",
        "empty.eds",
        "odd.eds",
        "odd.eds",
    ]


def test_without_a_file_it_is_a_wrong_usage(run):
    assert run()[0] == 2
    assert run("good.eds", "--node-id", "128")[0] == 2


def test_pdos_are_drawn(run):
    status, out = run("pdo.eds", "--pdos", "--node-id", "5")
    assert status == 0
    assert "RPDO1, 205h, transmission type 255:\n\nbit  15" in out
    assert "| 2000:00" in out
    assert "2000:00" not in run("pdo.eds")[1]


def test_json(run):
    status, out = run("odd.eds", "bad.eds", "none.eds", "--json")
    odd, bad, none = json.loads(out)
    assert status == 3
    assert odd | {"diagnoses": 0} == {
        "file": "odd.eds",
        "readable": True,
        "objects": 4,
        "pdos": 0,
        "diagnoses": 0,
        "refused": [],
    }
    (diagnosis,) = odd["diagnoses"]
    line = (HEAD + variable(DefaultValue="007")).split("\n").index("DefaultValue=007") + 1
    assert diagnosis == {
        "line": line,
        "severity": "warning",
        "text": "[2000] DefaultValue=007 is zero-padded",
        "assumed": "7",
    }
    assert (bad["readable"], bad["refused"][0]["text"][:7]) == (True, "1600h:1")
    assert (none["readable"], none["refused"][0]["line"]) == (False, None)


def test_a_mandatory_object_that_is_missing_is_told(run, tmp_path):
    (tmp_path / "bare.eds").write_text(HEAD.replace("[1018]", "[2018]").replace("[1018sub", "[2018sub") + variable())
    status, out = run("bare.eds")
    assert status == 0
    assert (
        "bare.eds:1: warning: 1018h is not described, which every CANopen device has; assumed a device without it\n"
        in out
    )


def test_sarif(run):
    status, out = run("--sarif", "good.eds", "odd.eds", "bad.eds", "a missing.eds")
    log = json.loads(out)
    assert (status, log["version"]) == (3, "2.1.0")
    (ran,) = log["runs"]
    rules = [rule["id"] for rule in ran["tool"]["driver"]["rules"]]
    assert {result["ruleId"] for result in ran["results"]} <= set(rules)
    places = [result["locations"][0]["physicalLocation"] for result in ran["results"]]
    uris = [place["artifactLocation"]["uri"] for place in places]
    assert "good.eds" not in uris
    assert (uris[0], uris[-1]) == ("odd.eds", "a%20missing.eds")
    first, last, refused = ran["results"][0], ran["results"][-1], ran["results"][-2]
    line = (HEAD + variable(DefaultValue="007")).split("\n").index("DefaultValue=007") + 1
    assert places[0]["region"] == {"startLine": line}
    assert (first["level"], first["message"]["text"]) == (
        "warning",
        "[2000] DefaultValue=007 is zero-padded; assumed 7",
    )
    assert (refused["ruleId"], refused["level"], uris[-2]) == ("refused", "error", "bad.eds")
    assert (last["ruleId"], "region" in places[-1]) == ("refused", False)


def test_one_form_of_output(run):
    status, out = run("--sarif", "--json", "good.eds")
    assert (status, "choose one form" in out) == (2, True)


def test_hook_of_pre_commit():
    entries = dict(re.findall(r"^[- ] (\w+): (.*)$", (ROOT / ".pre-commit-hooks.yaml").read_text(), re.M))
    matches = [bool(re.search(entries["files"], name)) for name in ("a.eds", "b/DRIVE.XDD", "c.dcf", "d.xdc", "eds.py")]
    assert matches == [True] * 4 + [False]
    result = CliRunner().invoke(main, [*entries["entry"].split()[1:], str(ROOT / "examples/ci/drive.eds")])
    assert result.exit_code == 0
