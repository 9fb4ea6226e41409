"""The EDS reader: one quirk at a time in a few lines of EDS, then every file of the corpus of real
ones.
"""

import logging
import math
import os
import random
import re
import socket
from dataclasses import replace

import pytest

from coulombus.eds.cia301 import ABORT_TEXT, DATA_TYPES, EMCY_TEXT, Abort, Emcy, NmtState, abort_text, emcy_text
from coulombus.eds.pdo import layouts
from coulombus.eds.reader import EdsError, read_eds
from eds_text import HEAD, complaints, record, variable
from places import CORPUS, ROOT, beside

CORPUS_FILES = sorted(CORPUS.glob("*.eds")) + sorted(CORPUS.glob("*.dcf"))


@pytest.fixture
def read(tmp_path):
    def read_text(text, head=HEAD, encoding="utf-8"):
        path = tmp_path / "device.eds"
        path.write_bytes((head + text).encode(encoding))
        return read_eds(path)

    return read_text


def test_a_clean_file_has_no_diagnosis(read):
    d = read(variable(DefaultValue="-5", LowLimit="-10", HighLimit="10", PDOMapping="1", AccessType="rww"))
    x = d.variable(0x2000, 0)
    assert complaints(d) == []
    assert (x.name, x.data_type, x.bits, x.access) == ("X", 3, 16, "rww")
    assert (x.default, x.low, x.high, x.pdo_mappable, x.node_relative) == (-5, -10, 10, True, False)
    assert x.line == HEAD.count("\n") + 1
    assert d.info["VendorName"] == "Nobody"
    assert d.objects[0x2000].object_type == 7
    assert d.default(0x1000, 0, 1) == 0x00020192


def test_what_is_not_there_is_said_with_the_file_s_name(read):
    d = read(variable())
    assert [d.has(0x2000), d.has(0x2000, 0), d.has(0x2000, 1), d.has(0x2001)] == [True, True, False, False]
    with pytest.raises(KeyError, match=r"device\.eds describes no object 6041h"):
        d.variable(0x6041, 0)
    with pytest.raises(KeyError, match=r"device\.eds: object 2000h \(X\) has no sub-index 3"):
        d.variable(0x2000, 3)
    assert d.default(0x2000, 0, 1) is None


@pytest.mark.parametrize(
    ("code", "written", "expected"),
    [
        ("0x0002", "0xFD", -3),
        ("0x0003", "0xFFFF", -1),
        ("0x0003", "0x8000", -32768),
        ("0x0003", "0x7FFF", 32767),
        ("0x0004", "0x80000000", -(2**31)),
        ("0x0010", "0x800000", -(2**23)),
        ("0x0012", "0xFFFFFFFFFE", -2),
        ("0x0013", "0xFFFFFFFFFFFD", -3),
        ("0x0014", "0x80000000000000", -(2**55)),
        ("0x0015", "0xFFFFFFFFFFFFFFFF", -1),
        ("0x0015", "-9223372036854775808", -(2**63)),
        ("0x001B", "0xFFFFFFFFFFFFFFFF", 2**64 - 1),
        ("0x0007", "4294967295", 2**32 - 1),
        ("0x0005", "+7", 7),
        ("0x0001", "1", 1),
        ("0x0008", "1.5", 1.5),
        ("0x0008", "-2e3", -2000.0),
        ("0x0011", "3", 3.0),
        ("0x0009", "text; with # marks", "text; with # marks"),
        ("0x000A", "01 02 fF", b"\x01\x02\xff"),
        ("0x000A", "0x0102", b"\x01\x02"),
        ("0x000F", "", None),
        ("0x0003", "", None),
    ],
)
def test_defaults_by_data_type(read, code, written, expected):
    d = read(variable(DataType=code, DefaultValue=written))
    assert d.variable(0x2000, 0).default == expected
    assert type(d.variable(0x2000, 0).default) is type(expected)
    assert complaints(d) == []


@pytest.mark.parametrize(
    ("code", "written", "expected", "complaint"),
    [
        ("0x0005", "007", 7, "zero-padded; assumed 7"),
        ("0x0005", "009", 9, "zero-padded; assumed 9"),
        ("0x0006", "0200", 200, "zero-padded, which may mean octal; assumed 200"),
        ("0x0006", "1Fh", 31, "'h' instead of 0x; assumed 31"),
        ("0x0006", "1F", 31, "hexadecimal digits without 0x; assumed 31"),
        ("0x0006", "0x10 ; sixteen", 16, "comment after the value; assumed 0x10"),
        ("0x0006", "12 # twelve", 12, "comment after the value; assumed 12"),
        ("0x0003", "65535", -1, "does not fit into INTEGER16; assumed two's complement, -1"),
        ("0x0005", "-1", 255, "does not fit into UNSIGNED8; assumed two's complement, 255"),
        ("0x0003", "70000", None, "does not fit into INTEGER16; assumed no value"),
        ("0x0005", "0x100", None, "does not fit into UNSIGNED8; assumed no value"),
        ("0x0005", "many", None, "is not a number; assumed no value"),
        ("0x0001", "TRUE", 1, "is not a number; assumed 1"),
        ("0x0008", "1,5", 1.5, "decimal comma; assumed 1.5"),
        ("0x0008", "0x3FC00000", 1.5, "is hexadecimal; assumed an IEEE 754 pattern"),
        ("0x0008", "0x123456789", None, "does not fit into REAL32; assumed no value"),
        ("0x0008", "-0x1", None, "is not a number; assumed no value"),
        ("0x0008", "nan", None, "is not finite; assumed no value"),
        ("0x000A", "odd", b"odd", "not a row of hexadecimal octets; assumed its characters"),
        ("0x0007", "$NODEID+$NODEID", None, "has the node id more than once; assumed no value"),
        ("0x0007", "$NODEID-1", None, "is not a number; assumed no value"),
    ],
)
def test_odd_defaults_are_told(read, code, written, expected, complaint):
    d = read(variable(DataType=code, DefaultValue=written))
    x = d.variable(0x2000, 0)
    assert x.default == expected
    assert [c for c in complaints(d) if complaint in c], complaints(d)
    assert bool(x.unreadable) == (expected is None)
    line = (HEAD + variable(DataType=code, DefaultValue=written)).split("\n").index(f"DefaultValue={written}") + 1
    assert [diagnosis.line for diagnosis in d.diagnoses] == [line] * len(d.diagnoses)


@pytest.mark.parametrize(
    ("written", "constant", "default"),
    [
        ("$NODEID+0x180", 0x180, False),
        ("$NODEID + 384", 0x180, False),
        ("$NodeId+0x80000180", 0x80000180, False),
        ("$NODEID", 0, False),
        ("0x180+$NODEID", 0x180, True),
        ("384 + $nodeid", 0x180, True),
        ("($NODEID+0x180)", 0x180, False),
        ("$NODEID+0x40000000+0x180", 0x40000180, False),
    ],
)
def test_the_node_id_is_added(read, written, constant, default):
    d = read(variable(DataType="0x0007", DefaultValue=written))
    x = d.variable(0x2000, 0)
    assert (x.default, x.node_relative) == (constant, True)
    assert d.default(0x2000, 0, 5) == constant + 5
    assert bool(complaints(d)) == default


@pytest.mark.parametrize(
    ("keys", "limits", "complaint"),
    [
        ({"LowLimit": "0x8000", "HighLimit": "0x7FFF"}, (-32768, 32767), ""),
        ({"LowLimit": "", "HighLimit": "5"}, (None, 5), ""),
        ({"DataType": "0x0010", "LowLimit": "0xFFFFF6", "HighLimit": "10"}, (-10, 10), ""),
        ({"DataType": "0x0008", "LowLimit": "-0.5", "HighLimit": "0.5"}, (-0.5, 0.5), ""),
        ({"LowLimit": "0", "HighLimit": "0xFFFF"}, (None, None), "LowLimit 0 is above HighLimit -1; assumed no limits"),
        ({"LowLimit": "$NODEID+1"}, (None, None), "depends on the node id; assumed no limit"),
        ({"HighLimit": "much"}, (None, None), "is not a number; assumed no value"),
        ({"HighLimit": "5", "DefaultValue": "9"}, (None, 5), "DefaultValue=9 is outside its limits; assumed 9"),
    ],
)
def test_limits(read, keys, limits, complaint):
    d = read(variable(**keys))
    assert (d.variable(0x2000, 0).low, d.variable(0x2000, 0).high) == limits
    assert [complaint in c for c in complaints(d)] == ([True] if complaint else [])


@pytest.mark.parametrize(
    ("keys", "attribute", "expected", "complaint"),
    [
        ({"ParameterName": None}, "name", "Object 2000h", "has no ParameterName; assumed 'Object 2000h'"),
        ({"AccessType": None}, "access", "rw", "AccessType is missing; assumed rw"),
        ({"AccessType": "any"}, "access", "rw", "AccessType=any is unknown; assumed rw"),
        ({"AccessType": "RO ; read only"}, "access", "ro", "comment after the value; assumed RO"),
        ({"AccessType": "R/W"}, "access", "rw", ""),
        ({"DataType": None}, "data_type", 0, "error: [2000] DataType is missing; assumed a type of unknown width"),
        ({"DataType": "0x0099"}, "data_type", 0x99, "not defined in CiA 301; assumed a type of unknown width"),
        ({"DataType": "0010"}, "data_type", 0, "can be read in two ways; assumed a type of unknown width"),
        ({"DataType": "3"}, "data_type", 3, ""),
        ({"PDOMapping": None}, "pdo_mappable", False, ""),
        ({"PDOMapping": "1"}, "pdo_mappable", True, ""),
        ({"ObjectType": "VAR"}, "data_type", 3, "ObjectType=VAR is not a number; assumed 0x7"),
        ({"ObjectType": ""}, "data_type", 3, ""),
        ({"ObjectType": "something"}, "data_type", 3, "is not a number; assumed 7"),
    ],
)
def test_missing_and_odd_keys(read, keys, attribute, expected, complaint):
    d = read(variable(**keys))
    assert getattr(d.variable(0x2000, 0), attribute) == expected
    assert not complaint or [c for c in complaints(d) if complaint in c], complaints(d)
    assert bool(complaint) == bool(complaints(d))


def test_a_default_of_an_unknown_type_is_kept_as_it_stands(read):
    assert read(variable(DataType="0x0099", DefaultValue="0x12")).variable(0x2000, 0).default == 0x12
    d = read(variable(DataType="0x0099", DefaultValue="blue"))
    assert d.variable(0x2000, 0).default == "blue"
    assert d.variable(0x2000, 0).bits == 0


def test_keys_and_sections_in_any_case_and_spacing(read):
    text = "[ 2000 ]\n  parametername = X \n DATATYPE= 0x3\nAccesstype =RO\ndefaultVALUE =0xFFFE\n"
    d = read(text)
    assert complaints(d) == []
    assert (d.variable(0x2000, 0).access, d.variable(0x2000, 0).default) == ("ro", -2)


@pytest.mark.parametrize(
    ("encoding", "complaint"),
    [("utf-8", ""), ("utf-8-sig", ""), ("cp1252", "neither ASCII nor UTF-8"), ("utf-16", "is UTF-16")],
)
def test_encodings(read, encoding, complaint):
    d = read(variable(ParameterName="Übertemperatur °C"), encoding=encoding)
    assert d.variable(0x2000, 0).name == "Übertemperatur °C"
    assert bool(complaints(d)) == bool(complaint)
    assert complaint in "".join(complaints(d))


def test_the_line_of_the_first_foreign_byte_is_named(read):
    text = HEAD + variable(ParameterName="Grüße")
    d = read(variable(ParameterName="Grüße"), encoding="latin-1")
    assert d.diagnoses[0].line == text[: text.index("ü")].count("\n") + 1


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r", "\r\r\n"])
def test_line_ends(read, end):
    d = read(variable(DefaultValue="zz").replace("\n", end), head=HEAD.replace("\n", end))
    assert d.diagnoses[-1].line == (HEAD + variable(DefaultValue="zz")).split("\n").index("DefaultValue=zz") + 1


def test_noise_between_the_sections(read):
    text = "; comment\n# comment\nno key\n=5\n[2000\n" + variable().split("\n", 1)[1] + "\x1a\n"
    d = read(text)
    line = HEAD.count("\n")
    assert complaints(d) == [
        f"{line + 3}: warning: 'no key' is not key=value; assumed a comment",
        f"{line + 4}: warning: '=5' is not key=value; assumed a comment",
        f"{line + 5}: warning: the section head '[2000' has no ']'; assumed [2000]",
    ]


def test_text_before_the_first_section_and_behind_a_head(read):
    d = read(variable().replace("[2000]", "[2000] the x ; really"), head="free text\n" + HEAD)
    assert "1: warning: 'free text' comes before the first section; assumed a comment" in complaints(d)
    assert [c for c in complaints(d) if "'the x ; really' follows the section head [2000]" in c]
    assert complaints(read(variable().replace("[2000]", "[2000] ; the x"))) == []


def test_doubled_keys(read):
    d = read(variable(DefaultValue="5") + "defaultvalue=0x5\nAccessType=ro\nDefaultValue=6\n")
    assert d.variable(0x2000, 0).default == 5
    assert d.variable(0x2000, 0).access == "rw"
    text = "\n".join(complaints(d))
    assert "warning: [2000] defaultvalue is in line" in text
    assert "error: [2000] DefaultValue=6, but line" in text
    assert "warning: [2000] AccessType=ro, but line" in text
    assert "assumed the first, 5" in text


def test_doubled_sections_are_one_and_the_first_value_counts(read):
    d = read(variable(DefaultValue="5", ParameterName=None) + variable(DefaultValue="6", ParameterName="Y"))
    x = d.variable(0x2000, 0)
    assert (x.default, x.name) == (5, "Y")
    assert [c for c in complaints(d) if "the section [2000] is in line" in c]
    assert [c for c in complaints(d) if "error: [2000] DefaultValue=6" in c]


def test_a_doubled_section_in_another_spelling_is_seen(read):
    d = read(record("[2000sub1]") + "[2000SUB01]\nDefaultValue=9\n")
    assert d.variable(0x2000, 1).default == 4
    assert [c for c in complaints(d) if "the section [2000SUB01] is in line" in c]


@pytest.mark.parametrize("key", ["DefaultValue", "DataType"])
def test_a_pdo_parameter_with_two_values_has_none(read, key):
    number = {"DefaultValue": "0x60410010", "DataType": "0x0007", "AccessType": "rw", "ParameterName": "X"}
    other = {"DefaultValue": "0x60400010", "DataType": "0x0006"}[key]
    body = "".join(f"{k}={v}\n" for k, v in number.items())
    d = read(f"[1A00]\nParameterName=Map\nObjectType=9\n[1A00sub1]\n{body}{key}={other}\n")
    assert d.variable(0x1A00, 1).default is None
    assert d.variable(0x1A00, 1).unreadable == f"[1A00sub1] {key} is given twice with different values"


def test_a_zero_padded_pdo_parameter_is_not_guessed(read):
    d = read("[1400]\nObjectType=9\nParameterName=R\n[1400sub1]\nParameterName=C\nDataType=7\nDefaultValue=0400\n")
    assert d.variable(0x1400, 1).default is None
    assert "may mean octal" in d.variable(0x1400, 1).unreadable
    d = read("[1400]\nObjectType=9\nParameterName=R\n[1400sub2]\nParameterName=C\nDataType=5\nDefaultValue=001\n")
    assert d.variable(0x1400, 2).default == 1


def test_pdo_parameters_without_data_type_have_cia_301_s(read):
    subs = "".join(f"[1800sub{k}]\nParameterName=P\nAccessType=rw\n" for k in (0, 1, 2, 3, 5, 6))
    d = read("[1800]\nParameterName=T\nObjectType=9\n" + subs)
    assert [d.variable(0x1800, k).bits for k in (0, 1, 2, 3, 5, 6)] == [8, 32, 8, 16, 16, 8]
    assert {x.severity for x in d.diagnoses} == {"warning"}


def test_records_and_their_sub_indices(read):
    d = read(record("[2000sub0]", "[2000subA]", "[2000Sub1F]", said=3))
    assert list(d.objects[0x2000].variables) == [0, 10, 31]
    assert d.objects[0x2000].name == "Whole"
    assert complaints(d) == []


@pytest.mark.parametrize(
    ("text", "kind", "subs", "complaint"),
    [
        (record("[2000sub0]", "[2000sub1]", said=5), 9, [0, 1], "SubNumber=5, 2 are described; assumed 2"),
        (record("[2000sub0]", kind="0x7"), 9, [0], "is ObjectType 0x7 but has sub-indices; assumed 0x9"),
        (record(), 9, [], "array or record without sub-indices; assumed an empty object"),
        (record("[2000sub1]").partition("[2000sub1]")[2].join(["[2000sub1]", ""]), 9, [1], "has no section [2000]"),
        (record("[2000sub0]", kind="ARRAY"), 8, [0], "ObjectType=ARRAY is not a number; assumed 0x8"),
        (variable(ObjectType="0x2", DataType=None), 2, [0], ""),
        (variable(ObjectType="DOMAIN", DataType=None), 2, [0], "ObjectType=DOMAIN is not a number"),
    ],
)
def test_object_types(read, text, kind, subs, complaint):
    d = read(text)
    assert d.objects[0x2000].object_type == kind
    assert list(d.objects[0x2000].variables) == subs
    assert not complaint or [c for c in complaints(d) if complaint in c], complaints(d)


def test_sub_indices_without_names_are_named_after_the_object(read):
    d = read("[2000]\nParameterName=Whole\nObjectType=8\n[2000sub1]\nDataType=5\nAccessType=ro\n")
    assert d.variable(0x2000, 1).name == "Whole 1"


def test_compact_sub_objects_expand_to_all_entries(read):
    text = (
        "[2000]\nParameterName=Limit\nObjectType=0x8\nDataType=0x0003\nAccessType=rw\nDefaultValue=0xFFF6\nPDOMapping=1\n"
        "LowLimit=-20\nCompactSubObj=12\n[2000Name]\nNrOfEntries=2\n1=Lower\n12=Upper\n"
    )
    d = read(text)
    assert complaints(d) == []
    assert list(d.objects[0x2000].variables) == list(range(13))
    assert (d.variable(0x2000, 0).default, d.variable(0x2000, 0).bits, d.variable(0x2000, 0).access) == (12, 8, "ro")
    for k in range(1, 13):
        x = d.variable(0x2000, k)
        assert (x.subindex, x.data_type, x.default, x.low, x.pdo_mappable) == (k, 3, -10, -20, True)
        assert x.name == {1: "Lower", 12: "Upper"}.get(k, f"Limit {k}")


def test_compact_sub_objects_with_one_described_and_with_an_odd_number(read):
    body = "ParameterName=L\nObjectType=8\nDataType=5\nAccessType=rw\nDefaultValue=1\n"
    d = read(f"[2000]\n{body}CompactSubObj=3\n[2000sub2]\nParameterName=M\nDataType=5\nAccessType=ro\nDefaultValue=7\n")
    assert [d.variable(0x2000, k).default for k in range(4)] == [3, 1, 7, 1]
    d = read(f"[2000]\n{body}CompactSubObj=300\n")
    assert [c for c in complaints(d) if "CompactSubObj=300 is not 0 to 254; assumed 0" in c]


def test_canfestival_s_indirect_data_types(read):
    described = "[A0]\nParameterName=T\nObjectType=0x6\n[A0sub1]\nParameterName=Type\nDataType=5\nAccessType=ro\n"
    d = read(variable(DataType="0x00A0", DefaultValue="0xFFFF") + described + "DefaultValue=0x3\n")
    assert (d.variable(0x2000, 0).data_type, d.variable(0x2000, 0).default) == (3, -1)
    assert [c for c in complaints(d) if "DataType=0x00A0 is described in [A0]; assumed INTEGER16" in c]


def test_dummies_with_gaps(read):
    d = read("[DummyUsage]\nDummy0001=0\nDummy0005=1\nDummy0007=0x1\n" + variable())
    assert d.dummies == {5, 7}
    assert complaints(d) == []


def test_lists_of_objects_are_compared_with_the_sections(read):
    head = HEAD.replace("1=0x2000", "1=0x2001\n2=0x2002")
    text = "\n".join(complaints(read(variable(), head=head)))
    assert "[ManufacturerObjects] lists 2, not 1; assumed 2" in text
    assert "lists 2001h, which is not described; assumed no such object" in text
    assert "[2000] is in no list of objects; assumed an object like the others" in text


def test_missing_sections_and_padded_numbers_of_the_device(read):
    only = "[1000]\nParameterName=Device type\nDataType=7\nAccessType=ro\n"
    text = "\n".join(complaints(read(only, head="")))
    for section in ("FileInfo", "DeviceInfo", "MandatoryObjects", "OptionalObjects", "ManufacturerObjects"):
        assert f"[{section}] is missing" in text
    d = read(variable(), head=HEAD.replace("VendorName=Nobody", "VendorNumber=001\nProductNumber=\nRevisionNumber=x"))
    text = "\n".join(complaints(d))
    assert "[DeviceInfo] VendorNumber=001 is zero-padded; assumed 1" in text
    assert "[DeviceInfo] RevisionNumber=x is not a number" in text
    assert d.info["VendorNumber"] == "001"


def bind(path):
    with socket.socket(socket.AF_UNIX) as client:
        client.bind(path)


def longer_than(path, size):
    with path.open("wb") as file:
        file.truncate(size)


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda path: None, r"none\.eds: cannot be read \(No such file or directory\); expected an EDS"),
        (lambda path: path.mkdir(), r"none\.eds: is a directory, not a regular file; expected an EDS"),
        (lambda path: path.symlink_to("/dev/zero"), r"none\.eds: is a device, not a regular file; expected an EDS"),
        (lambda path: os.mkfifo(path), r"none\.eds: is a FIFO, not a regular file; expected an EDS"),
        (lambda path: bind("none.eds"), r"none\.eds: is a socket, not a regular file; expected an EDS"),
        (lambda path: longer_than(path, (64 << 20) + 1), r"none\.eds: has more than 64 MiB; expected an EDS"),
        (lambda path: path.write_bytes(b""), r"none\.eds:1: describes no object; expected sections such as \[1000\]"),
        (lambda path: path.write_bytes(b"\x00\xff" * 999), r"none\.eds:1: describes no object"),
        (lambda path: path.write_text("[DeviceInfo]\nVendorName=x\n"), r"none\.eds:1: describes no object"),
    ],
)
def test_what_cannot_be_read_at_all_is_refused(tmp_path, make, match, monkeypatch):
    """At once: a FIFO, say, would be waited for."""
    monkeypatch.chdir(tmp_path)  # the name of a socket is short
    make(tmp_path / "none.eds")
    with pytest.raises(EdsError, match=match):
        read_eds(tmp_path / "none.eds")


NOISE = [
    "",
    "[",
    "]",
    "=",
    "0x",
    "$NODEID",
    "+",
    "-",
    ";",
    "0x1FFFFFFFFF",
    "[1800]",
    "[1A00sub1]",
    "\x00",
    "\u00fc",
    "1e999",
]


@pytest.mark.parametrize("seed", range(60))
def test_a_damaged_file_is_read_or_refused_and_never_more(tmp_path, seed):
    """Lines lost, doubled, swapped and overwritten: no exception but EdsError, no PDO wider than 64
    bits.
    """
    chance = random.Random(seed)
    lines = (ROOT / "eds" / "motor.eds").read_text().split("\n")
    for _ in range(chance.randrange(1, 200)):
        at = chance.randrange(len(lines))
        key, _, value = lines[at].partition("=")
        damage = chance.randrange(5)
        if damage == 0:
            del lines[at]
        elif damage == 1:
            lines.insert(chance.randrange(len(lines)), lines[at])
        elif damage == 2:
            lines[at] = key + "=" + chance.choice(NOISE) + value
        elif damage == 3:
            lines[at] = lines[at][: chance.randrange(len(lines[at]) + 1)] + chance.choice(NOISE)
        else:
            lines[at] = key + "=" + lines[chance.randrange(len(lines))].partition("=")[2]
    path = tmp_path / "device.eds"
    path.write_text("\n".join(lines), chance.choice(["utf-8", "latin-1", "utf-16"]))
    d = read_eds(path)
    assert d.diagnoses
    try:
        pdos = layouts(d, 1)
    except EdsError as error:
        pdos = ()
        said = str(error)
    else:
        said = f"{path}:1: "
    assert re.match(re.escape(str(path)) + r":\d+: ", said)
    assert all(p.length <= 8 and len(p.entries) <= 64 for p in pdos)


# CiA 301's tables


def test_data_types_have_the_widths_of_their_names():
    for code, data_type in DATA_TYPES.items():
        width = re.search(r"\d+$", data_type.name)
        others = {"BOOLEAN": 1, "TIME_OF_DAY": 48, "TIME_DIFFERENCE": 48}
        assert data_type.code == code
        assert data_type.bits == (int(width[0]) if width else others.get(data_type.name, 0))
        assert data_type.signed == data_type.name.startswith(("INTEGER", "REAL"))
    codes = {data_type.name: code for code, data_type in DATA_TYPES.items()}
    assert [codes[f"INTEGER{bits}"] for bits in range(8, 65, 8)] == [2, 3, 0x10, 4, 0x12, 0x13, 0x14, 0x15]
    assert [codes[f"UNSIGNED{bits}"] for bits in range(8, 65, 8)] == [5, 6, 0x16, 7, 0x18, 0x19, 0x1A, 0x1B]


def test_every_code_has_a_text():
    assert set(ABORT_TEXT) == set(Abort)
    assert set(EMCY_TEXT) == set(Emcy)
    assert abort_text(0x06020000) == "0x06020000: object does not exist in the object dictionary"
    assert abort_text(1) == "0x00000001: unknown abort code"
    assert emcy_text(0x8250) == "0x8250: RPDO time-out"
    assert emcy_text(0x4310) == "0x4310: unknown emergency code"
    assert emcy_text(0x2211) == "0x2211: current inside the device"
    assert [int(state) for state in NmtState] == [0, 4, 5, 127]


# The corpus of real files

corpus = beside(CORPUS)
each_file = pytest.mark.parametrize("path", CORPUS_FILES, ids=lambda path: path.stem)


@corpus
@each_file
def test_every_real_file_is_read(path):
    d = read_eds(path)
    lines = d.text.count("\n") + 1
    assert len(d.objects) >= 7
    for diagnosis in d.diagnoses:
        assert 1 <= diagnosis.line <= lines
        assert str(diagnosis).startswith(f"{path}:{diagnosis.line}: {diagnosis.severity}: ")
        assert diagnosis.text
        assert diagnosis.assumed
    for entry in d.objects.values():
        for x in entry.variables.values():
            kind = DATA_TYPES.get(x.data_type)
            if kind and kind.kind == "int" and x.default is not None:
                low = -(2 ** (x.bits - 1)) if kind.signed else 0
                assert low <= x.default < low + 2**x.bits


def canopen_variables(dictionary):
    from canopen.objectdictionary import ODVariable

    for index in (i for i in dictionary if i >= 0x1000):
        entry = dictionary[index]
        for entry_variable in [entry] if isinstance(entry, ODVariable) else entry.values():
            goes_with_the_node_id = entry_variable.relative and entry_variable.access_type in ("ro", "const")
            configured = None if goes_with_the_node_id else getattr(entry_variable, "value", None)
            value = entry_variable.default if configured is None else configured
            if value is not None:
                yield index, entry_variable.subindex, value


@pytest.mark.slow
@corpus
def test_real_files_agree_with_canopen_where_it_reads_them_right(caplog):
    """canopen reads neither hexadecimal of signed types as two's complement nor a REAL's
    pattern.
    """
    import canopen

    caplog.set_level(logging.CRITICAL)
    files = compared = 0
    for path in CORPUS_FILES:
        try:
            dictionary = canopen.import_od(str(path), 5)
        except Exception:
            continue  # a tenth of the files: that is why the reader is our own
        files += 1
        d = read_eds(path)
        for index, subindex, expected in canopen_variables(dictionary):
            x = d.variable(index, subindex)
            data_type = DATA_TYPES.get(x.data_type)
            if data_type is None or data_type.kind in ("bytes", "domain") or x.unreadable:
                continue
            if data_type.kind == "int" and data_type.signed and expected >= 2 ** (x.bits - 1):
                expected -= 2**x.bits
            assert d.default(index, subindex, 5) == expected, f"{path.name} {index:04X}:{subindex}"
            compared += 1
    assert files >= 20
    assert compared >= 5000


@pytest.mark.parametrize(
    ("data_type", "low", "high", "largest"),
    [
        (0x0003, None, None, 32767),
        (0x0006, None, None, 65535),
        (0x0003, None, 5000, 5000),
        (0x0002, None, 5000, 127),
        (0x0003, None, 0, 32767),  # nobody has set it
        (0x0003, 0, 0, 32767),
        (0x0003, -1000, 0, 0),
        (0x0003, -1, 0, 0),
        (0x0003, -1000, -5, -5),
        (0x0001, None, None, 1),
        (0x0008, None, None, math.inf),
        (0x0008, None, 2.5, 2.5),
    ],
)
def test_the_largest_number_is_the_types_or_the_high_limit_and_0_is_none(read, data_type, low, high, largest):
    x = replace(read(variable()).variable(0x2000, 0), data_type=data_type, low=low, high=high)
    assert x.largest == largest
    assert x.admits(largest)
    assert largest == math.inf or not x.admits(largest + 1)
    if low is not None and low <= largest:
        assert x.admits(low)
        assert not x.admits(low - 1)
