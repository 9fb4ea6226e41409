"""`eds convert` keeps all objects there and back, and prints what the other form cannot say."""

from __future__ import annotations

import configparser
import json
from dataclasses import replace

import canopen
import pytest
from click.testing import CliRunner
from hypothesis import given, settings
from hypothesis import strategies as st

from coulombus.cli.main import main
from coulombus.eds.convert import converted
from coulombus.eds.reader import parse_eds, read_eds
from eds_text import HEAD, variable
from places import CORPUS, EDS
from xdd_text import as_xdd, container

MAKERS = sorted(path for path in CORPUS.glob("*") if path.suffix.lower() in (".eds", ".dcf", ".xdd", ".xdc"))
FILES = [*sorted(EDS.glob("*.eds")), *MAKERS]
CONFIGURED = (".dcf", ".xdc")
WAYS = {
    ".eds": (".xdd", ".eds", ".xdd"),
    ".dcf": (".xdc", ".dcf", ".xdc"),
    ".xdd": (".eds", ".xdd"),
    ".xdc": (".dcf", ".xdc"),
}


def facts(description):
    """Everything that a description says of objects and of the device, without lines and words of diagnoses."""
    variables = {
        (index, sub): replace(entry, line=0, unreadable="unreadable" if entry.unreadable else "")
        for index, thing in description.objects.items()
        for sub, entry in thing.variables.items()
    }
    objects = {index: (entry.name, entry.object_type) for index, entry in description.objects.items()}
    return variables, objects, description.dummies, description.node_id, description.bit_rate


def there_and_back(path, folder):
    """Convert a file along its ways; hold each step against the first file."""
    before, source = facts(read_eds(path)), path
    for step, suffix in enumerate(WAYS[path.suffix.lower()]):
        text, left_out = converted(source, suffix)
        assert step == 0 or not [what for what in left_out if "RevisionNumber" not in what], left_out
        source = folder / f"step{step}{suffix}"
        source.write_text(text, encoding="utf-8")
        after = facts(read_eds(source))
        for mine, theirs in zip(before, after, strict=True):
            assert mine == theirs, (path.name, suffix)
    return source


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_a_file_is_the_same_there_and_back(path, tmp_path):
    there_and_back(path, tmp_path)


@pytest.mark.thorough
@pytest.mark.parametrize("path", [path for path in FILES if path.suffix.lower() == ".eds"], ids=lambda path: path.name)
def test_another_reader_reads_the_same_objects(path, tmp_path):
    try:
        expected = canopen.import_od(str(path), node_id=5)
    except (ValueError, KeyError, configparser.Error) as error:
        pytest.skip(f"canopen does not read it: {error}")
    (tmp_path / "x.xdd").write_text(converted(path, ".xdd")[0], encoding="utf-8")
    (tmp_path / "x.eds").write_text(converted(tmp_path / "x.xdd", ".eds")[0], encoding="utf-8")
    got = canopen.import_od(str(tmp_path / "x.eds"), node_id=5)
    ours = read_eds(path)
    for index, entry in ours.objects.items():
        if index not in expected or index < 0x1000:
            continue
        for sub in entry.variables:
            first, second = expected[index], got[index]
            if isinstance(first, canopen.objectdictionary.ODVariable) != isinstance(
                second, canopen.objectdictionary.ODVariable
            ):
                continue
            if not isinstance(first, canopen.objectdictionary.ODVariable):
                if sub not in first.subindices or sub not in second.subindices:
                    continue
                first, second = first[sub], second[sub]
            for key in ("data_type", "default", "min", "max", "access_type"):
                if first.default is not None or (key != "default" and sub):  # it does not read all notations
                    assert getattr(first, key) == getattr(second, key), (hex(index), sub, key)


@pytest.mark.thorough
@pytest.mark.parametrize("referred", [lambda variable: False, lambda variable: True], ids=["attributes", "parameters"])
@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_an_xdd_of_another_maker_is_the_same_there_and_back(path, referred, tmp_path):
    (tmp_path / "own.xdd").write_text(as_xdd(read_eds(path), referred), encoding="utf-8")
    there_and_back(tmp_path / "own.xdd", tmp_path)


NUMBERS = st.sampled_from(
    ["0", "1", "0x7F", "-1", "0xFF", "010", "12h", "true", "$NODEID+0x180", "0x80+$NODEID", "abc", "5 ; five"]
)
TEXTS = st.text(st.characters(codec="utf-8", exclude_categories=["Cc", "Cs", "Zl", "Zp"]), max_size=20)
TYPES = st.sampled_from(
    ["0x0001", "0x0002", "0x0005", "0x0007", "0x0008", "0x0009", "0x000A", "0x0010", "0x001B", "0x0011", "0x0040", ""]
)
ACCESS = st.sampled_from(["ro", "wo", "rw", "rwr", "rww", "const", "", "read"])


@settings(max_examples=60, deadline=None)
@given(data=st.data())
def test_any_objects_are_the_same_there_and_back(data, tmp_path_factory):
    text = HEAD
    for k in range(data.draw(st.integers(1, 6))):
        keys = {
            "DataType": data.draw(TYPES),
            "AccessType": data.draw(ACCESS),
            "DefaultValue": data.draw(NUMBERS),
            "LowLimit": data.draw(st.sampled_from(["", "0", "-5"])),
            "HighLimit": data.draw(st.sampled_from(["", "0", "100"])),
            "PDOMapping": data.draw(st.sampled_from(["0", "1"])),
            "Unit": data.draw(st.sampled_from(["", "rpm", "°C"])),
            "ParameterName": data.draw(TEXTS),
        }
        text += f"\n[{0x2000 + k:X}]\nObjectType=7\n" + "".join(f"{key}={value}\n" for key, value in keys.items())
    folder = tmp_path_factory.mktemp("any")
    (folder / "own.eds").write_text(text, encoding="utf-8")
    there_and_back(folder / "own.eds", folder)


def test_a_value_given_twice_stays_refused(tmp_path):
    text = HEAD + "\n[1800]\nParameterName=P\nObjectType=9\nSubNumber=2\n"
    text += "[1800sub0]\nParameterName=n\nObjectType=7\nDataType=5\nAccessType=ro\nDefaultValue=1\n"
    text += "[1800sub1]\nParameterName=id\nObjectType=7\nDataType=7\nAccessType=rw\nDefaultValue=0x185\nDefaultValue=0x285\n"
    (tmp_path / "own.eds").write_text(text)
    assert read_eds(there_and_back(tmp_path / "own.eds", tmp_path)).variable(0x1800, 1).unreadable


def test_units_descriptions_and_one_way_access_of_an_xdd_come_back(tmp_path):
    parameters = (
        '<parameter uniqueID="P1"><label lang="en">Speed</label><description lang="en">of the\n shaft</description>'
        '<INT/><unit multiplier="1" unitURI=""><label lang="en">rpm</label></unit>'
        '<defaultValue value="-5"/><allowedValues><value value="1"/></allowedValues></parameter>'
        '<parameter uniqueID="P2" access="readWriteOutput"><label lang="en">Set</label><UDINT/></parameter>'
    )
    rows = '<CANopenObject index="2000" name="x" objectType="7" uniqueIDRef="P1"/>'
    rows += '<CANopenObject index="2001" name="y" objectType="7" accessType="rw" PDOmapping="no" uniqueIDRef="P2"/>'
    (tmp_path / "a.xdd").write_text(container(rows, parameters=parameters))
    text, left_out = converted(tmp_path / "a.xdd", ".eds")
    assert "Unit=rpm\n" in text
    assert "Description=of the shaft\n" in text
    assert "AccessType=ro\n" in text
    assert left_out == ("lists of allowed values",)
    speed, other = (parse_eds(text.encode(), "b.eds").variable(index, 0) for index in (0x2000, 0x2001))
    assert (speed.default, speed.access, speed.unit, other.access) == (-5, "ro", "rpm", "rww")
    (tmp_path / "b.eds").write_text(text)
    again = converted(tmp_path / "b.eds", ".xdd")[0]
    assert '<label lang="en">rpm</label>' in again
    assert ">of the shaft</description>" in again
    assert facts(parse_eds(again.encode(), "c.xdd")) == facts(read_eds(tmp_path / "a.xdd"))


def test_a_configuration_is_left_out_of_an_eds_and_told(tmp_path):
    text = HEAD + variable(ParameterValue="7") + "\n[DeviceComissioning]\nNodeID=5\nBaudrate=500\n"
    (tmp_path / "a.dcf").write_text(text)
    plain, left_out = converted(tmp_path / "a.dcf", ".eds")
    assert "ParameterValue" not in plain
    assert "NodeID" not in plain
    assert [what.partition(":")[0] for what in left_out] == ["ParameterValue", "[DeviceComissioning]"]
    description = parse_eds(converted(tmp_path / "a.dcf", ".xdc")[0].encode(), "a.xdc")
    assert (description.node_id, description.bit_rate) == (5, 500_000)


def test_compact_sub_objects_become_objects_of_their_own(tmp_path):
    text = (
        HEAD + "\n[2000]\nParameterName=A\nObjectType=8\nDataType=6\nAccessType=rw\nDefaultValue=3\nCompactSubObj=3\n"
    )
    text += "[2000Name]\nNrOfEntries=1\n2=second\n[2000Value]\nNrOfEntries=1\n3=9\n"
    (tmp_path / "a.dcf").write_text(text)
    there_and_back(tmp_path / "a.dcf", tmp_path)


def test_commands_convert_compare_and_refuse(tmp_path):
    def run(*words):
        result = CliRunner().invoke(main, ["eds", *map(str, words)])
        return result.exit_code, result.output

    assert run("convert", EDS / "motor.eds", tmp_path / "m.xdd")[0] == 0
    assert run("diff", EDS / "motor.eds", tmp_path / "m.xdd") == (0, "the same\n")
    assert run("convert", EDS / "motor.eds", tmp_path / "m.xdd")[0] == 2
    assert run("convert", EDS / "motor.eds", tmp_path / "m.txt")[0] == 2
    assert run("convert", tmp_path / "none.eds", tmp_path / "n.xdd")[0] == 3
    text = (
        (EDS / "motor.eds")
        .read_text()
        .replace("[1017]", "[1017]\nLowLimit=3")
        .replace("DefaultValue=0x00020192", "DefaultValue=1")
    )
    (tmp_path / "other.eds").write_text(text)
    code, output = run("diff", EDS / "motor.eds", tmp_path / "other.eds")
    assert code == 1
    assert "1000h:00 default: 0x20192 -> 0x1" in output
    assert "1017h:00 lowest: none -> 0x3" in output
    code, output = run("diff", EDS / "motor.eds", EDS / "mr_brake.eds", "--json")
    assert code == 1
    assert {"place", "subject", "a", "b"} == json.loads(output)[0].keys()
