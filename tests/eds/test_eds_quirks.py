"""Quirks of other vendors' files, one at a time: each is said with its line and with what is
assumed.
"""

from __future__ import annotations

import time

import pytest

from coulombus.eds.check import check
from coulombus.eds.pdo import layouts
from coulombus.eds.reader import EdsError, parse_eds
from eds_text import HEAD, complaints, record, variable

LISTED = HEAD + variable()


def parse(text, head=HEAD):
    return parse_eds((head + text).encode(), "quirk.eds")


def line_of(text, what, head=HEAD):
    """The number of the line that is, or begins with, `what`."""
    return 1 + next(i for i, line in enumerate((head + text).split("\n")) if line.startswith(what))


def expect(text, where, complaint, head=HEAD):
    """Hold the only diagnosis against its line and its text."""
    description = parse(text, head)
    assert complaints(description) == [f"{line_of(text, where, head)}: {complaint}"]
    return description


# the bytes


@pytest.mark.parametrize("encoding", ["utf-16-le", "utf-16-be"])
def test_utf_16_without_a_mark(encoding):
    d = parse_eds(LISTED.encode(encoding), "q.eds")
    assert complaints(d) == ["1: warning: the file is UTF-16, not ASCII; assumed UTF-16"]
    assert d.variable(0x1000, 0).default == 0x00020192


def test_bytes_that_are_no_character():
    raw = LISTED.encode().replace(b"ParameterName=X", b"ParameterName=X\x81")
    line = line_of(variable(), "ParameterName=X")
    assert complaints(parse_eds(raw, "q.eds")) == [
        f"{line}: warning: the file is neither ASCII nor UTF-8; assumed Windows-1252",
        f"{line}: warning: invalid bytes for this encoding; assumed the character U+FFFD",
    ]


def test_the_line_of_a_foreign_byte_with_old_line_ends():
    raw = LISTED.replace("\n", "\r").encode().replace(b"ParameterName=X", b"ParameterName=\xdc")
    line = line_of(variable(), "ParameterName=X")
    assert complaints(parse_eds(raw, "q.eds")) == [
        f"{line}: warning: the file is neither ASCII nor UTF-8; assumed Windows-1252"
    ]


def test_tabs_are_spaces():
    text = "\t[2000]\t\n\tParameterName\t=\tX\nDataType=\t0x0003\t\nAccessType=rw\t\nDefaultValue=\t-5\n"
    d = parse(text)
    assert complaints(d) == []
    assert (d.variable(0x2000, 0).name, d.variable(0x2000, 0).default) == ("X", -5)


# section heads


@pytest.mark.parametrize(
    "head",
    ["[2000sub001]", "[02000sub1]", "[0x2000sub1]", "[2000 sub 1]", "[2000subindex1]", "[2000sub0x1]", "[2000_sub1]"],
)
def test_section_heads_of_another_spelling(head):
    text = record("[2000sub0]", head, said=2).replace("DefaultValue=4", "DefaultValue=1", 1)
    expect(text, head, f"warning: the section head {head} does not follow CiA 306; assumed [2000sub1]")


def test_a_section_of_no_known_name():
    text = variable() + "[Vendor]\nColour=red\n"
    expect(text, "[Vendor]", "warning: the section [Vendor] is not defined in CiA 306; assumed a comment")
    text = variable() + "[2001sub1FF]\nParameterName=Y\nDataType=5\n"
    expect(text, "[2001sub1FF]", "error: the section [2001sub1FF] is not defined in CiA 306; assumed a comment")


def test_sections_of_cia_306_that_hold_no_object():
    names = (
        "Comments",
        "StandardDataTypes",
        "Tools",
        "Tool1",
        "DeviceComissioning",
        "ConnectedModules",
        "M1Comments",
    )
    assert complaints(parse(variable() + "".join(f"[{name}]\nLines=0\n" for name in names))) == []


def test_sub_indices_that_are_counted_in_decimal():
    heads = [f"[2000sub{k}]" for k in range(11)]
    text = record(*heads, said=11).replace("DefaultValue=4", "DefaultValue=16", 1)
    d = expect(
        text,
        "[2000sub10]",
        "error: [2000] has sub9 and sub10, but no subA: decimal numbers?; assumed hexadecimal ones".replace(
            "error: [2000] has", "error: [2000] has"
        ),
    )
    assert 0x10 in d.objects[0x2000].variables


def test_sub_indices_are_decimal_where_sub_index_0_proves_it():
    heads = [f"[2000sub{k}]" for k in range(13)]
    text = record(*heads, said=13).replace("DefaultValue=4", "DefaultValue=12", 1)
    d = parse(text)
    assert [x.text for x in d.diagnoses] == ["[2000sub10] and the others count in decimal: sub-index 0 says 12"]
    assert sorted(d.objects[0x2000].variables) == list(range(13))
    hexadecimal = parse(text.replace("DefaultValue=12", "DefaultValue=18", 1))
    assert sorted(hexadecimal.objects[0x2000].variables) == [*range(10), 0x10, 0x11, 0x12]


# what is told


@pytest.mark.parametrize("key", ["DefaultValue", "DataType", "AccessType", "LowLimit", "PDOMapping", "ObjectType"])
def test_a_diagnosis_quotes_at_most_60_characters(key):
    for value in ("x" * 5000, "7" * 5000, '"' + "y" * 5000 + '"', "z" * 5000 + " ; why"):
        diagnoses = parse(variable(**{key: value})).diagnoses
        assert diagnoses
        assert max(len(d.text + d.assumed) for d in diagnoses) < 260
    long = "q" * 5000
    for text in (f"[{long}]\na=b\n", f"[2000]\n{long}=1\n", f"[2000] {long}\n", f"{long}\n"):
        assert max(len(d.text + d.assumed) for d in parse(variable() + text).diagnoses) < 260


def test_many_alike_are_one_line_with_their_number():
    some = parse(variable() + "".join(f"[Junk{k}]\na=b\n" for k in range(20)))
    assert sum("is not defined in CiA 306" in d.text for d in some.diagnoses) == 20
    many = parse(variable() + "".join(f"[Junk{k}]\na=b\n" for k in range(500)))
    (diagnosis,) = (d for d in many.diagnoses if "is not defined in CiA 306" in d.text)
    assert diagnosis.text.startswith(
        "the section [Junk0] is not defined in CiA 306 (and 499 more like this, up to line "
    )
    assert diagnosis.line == line_of(variable() + "[Junk0]", "[Junk0]")


@pytest.mark.thorough
@pytest.mark.slow
def test_a_hundred_thousand_sections_are_read_in_seconds():
    heads = "".join(f"[{0x2000 + k:04X}]\nParameterName=H\nObjectType=8\nSubNumber=250\n" for k in range(400))
    subs = "".join(
        f"[{0x2000 + k // 250:04X}sub{k % 250:X}]\nParameterName=P\nObjectType=7\nDataType=5\nAccessType=rw\nDefaultValue=1\n"
        for k in range(100_000)
    )
    begin = time.process_time()
    d = parse(heads + subs)
    assert time.process_time() - begin < 8.0  # 2 s on a quiet machine
    assert sum(len(entry.variables) for entry in d.objects.values()) >= 100_000


def test_compact_pdo_describes_what_the_file_leaves_out():
    line = "CompactPDO=0x13\nNrOfRXPDO=1\nNrOfTXPDO=6"
    d = parse(variable(), HEAD.replace("VendorName=Nobody", line))
    assert [x.severity for x in d.diagnoses] == ["warning", "warning"]
    assert sorted(i for i in d.objects if 0x1400 <= i < 0x1C00) == [
        *(0x1400, 0x1600, *range(0x1800, 0x1806), *range(0x1A00, 0x1A06))
    ]
    assert sorted(d.objects[0x1801].variables) == [0, 1, 2, 5]
    assert [d.default(0x1800 + k, 1, 5) for k in (0, 3, 4)] == [0x185, 0x485, 0x80000000]
    assert (d.default(0x1801, 0, 5), d.default(0x1A01, 0, 5), len(d.objects[0x1A01].variables)) == (5, 0, 65)
    first = layouts(d, 5)[0]
    assert (first.cob_id, first.transmission, first.entries) == (0x205, 255, ())


# keys


def test_a_misspelled_key_is_told_once():
    text = variable(DefualtValue=5) + "[2001]\nParameterName=Y\nDataType=5\nAccessType=ro\nDefualtValue=6\n"
    head = HEAD.replace("SupportedObjects=1\n1=0x2000", "SupportedObjects=2\n1=0x2000\n2=0x2001")
    expect(
        text,
        "DefualtValue=5",
        "warning: [2000] DefualtValue is not a key of CiA 306 (2 times); assumed a comment",
        head,
    )


def test_keys_that_some_tools_add_are_no_defect():
    assert complaints(parse(variable(ObjFlags="0x3", Factor="0.1", Unit="mm", Denotation="", Category="x"))) == []


# numbers


@pytest.mark.parametrize(
    ("code", "written", "value", "complaint"),
    [
        ("0x0002", "0xFFFFFFFD", -3, "is longer than INTEGER8; assumed -3, sign-extended"),
        ("0x0010", "0xFFFFFFFF", -1, "is longer than INTEGER24; assumed -1, sign-extended"),
        ("0x0003", "0xFFFFFFFFFFFF8000", -32768, "is longer than INTEGER16; assumed -32768, sign-extended"),
        ("0x0014", "0xFFFFFFFFFFFFFFFF", -1, "is longer than INTEGER56; assumed -1, sign-extended"),
    ],
)
def test_negative_numbers_in_the_width_of_the_tool_s_integers(code, written, value, complaint):
    d = expect(
        variable(DataType=code, DefaultValue=written),
        "DefaultValue=" + written,
        f"warning: [2000] DefaultValue={written} {complaint}",
    )
    assert d.variable(0x2000, 0).default == value


@pytest.mark.parametrize(
    ("code", "written"),
    [
        ("0x0002", "0xFFFFFF7F"),  # below -128 in 32 bits
        ("0x0003", "4294967295"),  # decimal: nobody means -1
        ("0x0006", "0xFFFFFFFF"),
        ("0x0005", "100 ms"),
        ("0x0005", "5.0"),
        ("0x0007", "0x6041 0010"),
        ("0x0007", "0x6041_0010"),
        ("0x0004", "9" * 5000),
        ("0x0004", "0x" + "F" * 5000),
        ("0x0008", "1e39"),
        ("0x0008", "1,000.5"),
        ("0x0007", "NODEID+0x180"),
        ("0x0005", "16#FF"),
        ("0x0005", "$NODEID+0x90"),
        ("0x0007", "$NODEID+0xFFFFFFFF"),
    ],
)
def test_a_number_that_fits_no_reading_is_no_number(code, written):
    d = parse(variable(DataType=code, DefaultValue=written))
    assert d.variable(0x2000, 0).default is None
    assert d.variable(0x2000, 0).unreadable
    assert [x.severity for x in d.diagnoses] == ["error"]
    assert d.diagnoses[0].line == line_of(variable(), "[2000]") + 4


@pytest.mark.parametrize("written", ["1e3", "0b101"])
def test_numbers_of_other_languages_are_told_and_never_a_pdo_parameter(written):
    d = parse(variable(DataType="0x0007", DefaultValue=written))
    assert d.variable(0x2000, 0).default == int(written, 16)
    assert "which may mean another number" in d.diagnoses[0].text
    d = parse(
        f"[1400]\nParameterName=R\nObjectType=9\n[1400sub1]\nParameterName=C\nDataType=7\nDefaultValue={written}\n"
    )
    assert "which may mean another number" in d.variable(0x1400, 1).unreadable


def test_the_largest_real32_is_one():
    largest = 3.4028234663852886e38
    assert parse(variable(DataType="0x0008", DefaultValue=repr(largest))).variable(0x2000, 0).default == largest


def test_every_node_id_fits_into_an_unsigned8():
    d = parse(variable(DataType="0x0005", DefaultValue="$NODEID"))
    assert (complaints(d), d.default(0x2000, 0, 127)) == ([], 127)


@pytest.mark.parametrize("kind", ["0x000F", "0x0021"])
def test_a_default_of_what_has_no_number(kind):
    name = {"0x000F": "DOMAIN", "0x0021": "PDO_MAPPING"}[kind]
    d = expect(
        variable(DataType=kind, DefaultValue="7"),
        "DefaultValue=7",
        f"warning: [2000] DefaultValue=7, but a {name} has no value here; assumed none",
    )
    assert d.variable(0x2000, 0).default is None


@pytest.mark.parametrize(
    ("code", "bits"), [("0x0010", 24), ("0x0012", 40), ("0x0013", 48), ("0x0014", 56), ("0x0015", 64)]
)
def test_limits_of_the_odd_widths(code, bits):
    low, high = -(1 << bits - 1), (1 << bits - 1) - 1
    for written in ((f"0x{1 << bits - 1:X}", f"0x{high:X}"), (str(low), str(high))):
        d = parse(variable(DataType=code, LowLimit=written[0], HighLimit=written[1]))
        assert complaints(d) == []
        assert (d.variable(0x2000, 0).low, d.variable(0x2000, 0).high) == (low, high)


@pytest.mark.parametrize("written", ["0x01 0x02", "01 02", "0x0102", "0X01,0x02"])
def test_rows_of_octets(written):
    d = parse(variable(DataType="0x000A", DefaultValue=written))
    assert (complaints(d), d.variable(0x2000, 0).default) == ([], b"\x01\x02")


def test_a_limit_below_0_limits_no_unsigned_number():
    d = expect(
        variable(DataType="0x0006", DefaultValue="5", LowLimit="-1", HighLimit="10"),
        "LowLimit=",
        "warning: [2000] LowLimit=-1, but no UNSIGNED16 is below 0; assumed no limit",
    )
    assert (d.variable(0x2000, 0).low, d.variable(0x2000, 0).high) == (None, 10)
    assert parse(variable(DataType="0x0006", LowLimit="-0")).variable(0x2000, 0).low == 0


# objects


def test_a_data_type_by_its_name():
    d = expect(
        variable(DataType="INTEGER32", DefaultValue="-1"),
        "DataType=INTEGER32",
        "warning: [2000] DataType=INTEGER32 is not a number; assumed 0x0004",
    )
    assert (d.variable(0x2000, 0).data_type, d.variable(0x2000, 0).default) == (4, -1)


@pytest.mark.parametrize("code", ["0x0040", "0x005F", "0x0026", "0x1000"])
def test_a_data_type_of_the_manufacturer(code):
    expect(
        variable(DataType=code),
        f"DataType={code}",
        f"warning: [2000] DataType={code} is not defined in CiA 301; assumed a type of unknown width",
    )


def test_an_object_type_that_there_is_not():
    d = expect(
        variable(ObjectType="0x4"),
        "ObjectType=0x4",
        "error: [2000] ObjectType=0x4 is not defined in CiA 301; assumed 0x7",
    )
    assert d.objects[0x2000].object_type == 7


def test_type_definitions_are_objects_too():
    text = "[0005]\nParameterName=UNSIGNED8\nObjectType=0x5\nDataType=0x0005\nAccessType=ro\nDefaultValue=8\n"
    struct = "[0040]\nParameterName=Point\nObjectType=0x6\nSubNumber=2\n"
    struct += "".join(
        f"[0040sub{k}]\nParameterName=P\nDataType=0x0005\nAccessType=ro\nDefaultValue=1\n" for k in (0, 1)
    )
    d = parse(text + struct + variable())
    assert complaints(d) == []
    assert (d.objects[5].object_type, d.objects[0x40].object_type) == (5, 6)
    assert list(d.objects[0x40].variables) == [0, 1]


def test_a_record_that_says_neither_what_it_is_nor_how_many():
    body = "ParameterName=Part\nDataType=0x0005\nAccessType=rw\n"
    d = parse("[2000]\nParameterName=Whole\n" + "".join(f"[2000sub{k}]\n{body}" for k in (0, 1)))
    assert (d.objects[0x2000].object_type, list(d.objects[0x2000].variables)) == (9, [0, 1])
    assert sorted(x.text for x in d.diagnoses) == [
        "[2000] SubNumber is missing, 2 are described",
        "[2000] has sub-indices, but no ObjectType",
    ]
    assert {x.line for x in d.diagnoses} == {HEAD.count("\n") + 1}


@pytest.mark.parametrize(
    ("heads", "complaint"),
    [
        (("[2000sub1]",), "has no sub-index 0; assumed that a client cannot read it"),
        (("[2000sub0]", "[2000sub1]"), "has sub-indices up to 1, but sub-index 0 says 4; assumed what is described"),
        (("[2000sub0]", "[2000sub4]"), ""),
        (("[2000sub0]", "[2000sub4]", "[2000subFF]"), ""),
    ],
)
def test_sub_index_0_tells_the_highest(heads, complaint):
    d = parse(record(*heads, said=len(heads)).replace("AccessType=rw", "AccessType=ro"))
    assert [complaint in c for c in complaints(d)] == ([True] if complaint else [])


def test_names_of_compact_sub_objects_are_held_against_them():
    body = "[2000]\nParameterName=L\nObjectType=8\nDataType=5\nAccessType=rw\nCompactSubObj=3\n"
    text = body + "[2000Name]\nNrOfEntries=3\n1=a\n9=b\n"
    d = parse(text)
    assert complaints(d) == [
        f"{line_of(text, 'NrOfEntries')}: warning: [2000Name] has 2 entries, not 3; assumed 2",
        f"{line_of(text, '9=b')}: warning: [2000Name] names the sub-index 9, which 2000h has not; assumed a comment",
    ]
    assert [d.variable(0x2000, k).name for k in range(1, 4)] == ["a", "L 2", "L 3"]
    text = body + "[2000Name]\nNrOfEntries=2\n01=a\n0x2=b\n"
    d = parse(text)
    assert complaints(d) == [
        f"{line_of(text, 'NrOfEntries')}: warning: [2000Name] has 1 entries, not 2; assumed 1",
        f"{line_of(text, '0x2=b')}: warning: [2000Name] 0x2 is not a decimal sub-index; assumed a comment",
    ]
    assert [d.variable(0x2000, k).name for k in range(1, 4)] == ["a", "L 2", "L 3"]
    text = variable() + "[2001Name]\nNrOfEntries=0\n"
    expect(text, "[2001Name]", "warning: [2001Name] belongs to 2001h, which is not described; assumed a comment")


@pytest.mark.parametrize(
    ("line", "complaint"),
    [
        ("ObjectType=8\nSubNumber=9", "[2000] SubNumber=9, but CompactSubObj=3; assumed 3 entries"),
        ("ObjectType=8\nSubNumber=4", ""),
        ("ObjectType=", "[2000] has sub-indices, but no ObjectType; assumed 0x8"),
        ("ObjectType=7", "[2000] is ObjectType 0x7 but has sub-indices; assumed 0x8"),
    ],
)
def test_compact_sub_objects_that_contradict_other_keys(line, complaint):
    d = parse(f"[2000]\nParameterName=L\n{line}\nDataType=5\nAccessType=rw\nCompactSubObj=3\n")
    assert [c.split(": ", 2)[2] for c in complaints(d)] == ([complaint] if complaint else [])
    assert list(d.objects[0x2000].variables) == [0, 1, 2, 3]


def test_values_in_quotes():
    d = expect(
        variable(DefaultValue='"0x10"'),
        'DefaultValue="',
        'warning: [2000] DefaultValue="0x10" is in quotes; assumed 0x10',
    )
    assert d.variable(0x2000, 0).default == 16
    d = expect(
        variable(DataType="0x0009", DefaultValue='"as it is"'),
        'DefaultValue="',
        'warning: [2000] DefaultValue="as it is" is in quotes; assumed that they belong to the text',
    )
    assert d.variable(0x2000, 0).default == '"as it is"'


@pytest.mark.parametrize(
    ("written", "meant"),
    [("R", "ro"), ("W", "wo"), ("read-only", "ro"), ("Read Write", "rw"), ("R?", "ro"), ("x", "rw")],
)
def test_access_types_in_other_words(written, meant):
    d = expect(
        variable(AccessType=written),
        f"AccessType={written}",
        f"warning: [2000] AccessType={written} is unknown; assumed {meant}",
    )
    assert d.variable(0x2000, 0).access == meant


def test_an_array_without_sub_indices_is_a_variable():
    d = expect(
        variable(ObjectType="0x8", DefaultValue="3"),
        "[2000]",
        "warning: [2000] is ObjectType 0x8 but has no sub-indices; assumed 0x7",
    )
    assert (d.objects[0x2000].object_type, d.variable(0x2000, 0).default) == (7, 3)


@pytest.mark.parametrize(("said", "severity", "count"), [(255, "warning", 254), (256, "error", 0), (-1, "error", 0)])
def test_more_compact_sub_objects_than_an_object_has(said, severity, count):
    d = parse(variable(ObjectType="0x8", CompactSubObj=said))
    text = f"[2000] CompactSubObj={said} is not 0 to 254; assumed {count}"
    assert complaints(d)[-1] == f"{line_of(variable(), '[2000]') + 5}: {severity}: {text}"
    assert max(d.objects[0x2000].variables) == count


# the file


def test_lists_that_skip_repeat_and_misplace():
    lists = "SupportedObjects=3\n1=0x2000\n3=0x1000\n4=0x7FFF"
    d = parse(variable(), HEAD.replace("SupportedObjects=1\n1=0x2000", lists))
    name = "[ManufacturerObjects]"
    assert sorted(x.text for x in d.diagnoses) == sorted(
        [
            f"{name} has no entry 2, its numbers jump to 4",
            f"{name} lists 1000h, which [MandatoryObjects] lists already",
            f"{name} lists 1000h, 7FFFh, which belong into another list",
            f"{name} lists 7FFFh, which is not described",
        ]
    )


def test_an_entry_of_a_list_that_is_no_number_lists_nothing():
    d = parse(variable(), HEAD.replace("1=0x2000", "1=all"))
    assert [x.text for x in d.diagnoses] == [
        "[ManufacturerObjects] 1=all is not a number",
        "[2000] is in no list of objects",
    ]


@pytest.mark.parametrize(
    ("line", "complaint"),
    [
        ("NrOfRXPDO=0", ""),
        ("NrOfRXPDO=4", "warning: [DeviceInfo] NrOfRXPDO=4, but 0 RPDOs are described; assumed 0"),
        ("NrOfTXPDO=1\nCompactPDO=0", "warning: [DeviceInfo] NrOfTXPDO=1, but 0 TPDOs are described; assumed 0"),
        (
            "CompactPDO=0x3\nNrOfTXPDO=2",
            "warning: [DeviceInfo] CompactPDO=3: 2 TPDOs are told of, 0 are described; assumed the 2 that CiA 306 implies",
        ),
    ],
)
def test_pdos_that_the_device_tells_of(line, complaint):
    d = parse(variable(), HEAD.replace("VendorName=Nobody", line))
    assert [c.split(": ", 1)[1] for c in complaints(d)] == ([complaint] if complaint else [])


def test_modules_and_dynamic_channels_are_not_there():
    for name, key, what in (("SupportedModules", "NrOfEntries", "modules"), ("DynamicChannels", "NrOfSeg", "segments")):
        text = f"warning: [{name}] describes {what}, whose objects depend on the device; assumed none"
        expect(variable() + f"[{name}]\n{key}=2\n", f"[{name}]", text)
    assert complaints(parse(variable() + "[DynamicChannels]\nNrOfSeg=0\n[SupportedModules]\nNrOfEntries=0\n")) == []


# PDOs


def pdo(
    communication="0x201", entries=("0x20000010",), *, count=None, first=0x1400, kinds=("7", "5"), transmission="255"
):
    """The sections of one PDO, and their list."""
    body = "AccessType=rw\nParameterName=P\n"
    sub = f"[{first:04X}]\nParameterName=C\nObjectType=9\nSubNumber=3\n[{first:04X}sub0]\n{body}DataType=5\nDefaultValue=2\n"
    for k, (kind, value) in enumerate(zip(kinds, (communication, transmission), strict=True), 1):
        sub += f"[{first:04X}sub{k}]\n{body}DataType={kind}\n" + (
            f"DefaultValue={value}\n" if value is not None else ""
        )
    mapping = first + 0x200
    sub += f"[{mapping:04X}]\nParameterName=M\nObjectType=9\nSubNumber={len(entries) + 1}\n"
    number = len(entries) if count is None else count
    sub += f"[{mapping:04X}sub0]\n{body}DataType=5\nDefaultValue={number}\n"
    for k, word in enumerate(entries, 1):
        sub += f"[{mapping:04X}sub{k:X}]\n{body}DataType=7\nDefaultValue={word}\n"
    return sub


def with_pdos(*texts, **keys):
    """A report on a file with these PDOs and the object 2000h, which may be mapped."""
    listed = sorted({line[1:5] for text in texts for line in text.split("\n") if line.startswith("[")})
    entries = "".join(f"{k}=0x{index}\n" for k, index in enumerate(listed, 1))
    head = HEAD.replace(
        "[OptionalObjects]\nSupportedObjects=0\n", f"[OptionalObjects]\nSupportedObjects={len(listed)}\n{entries}"
    )
    return check(parse("".join(texts) + variable(**{"PDOMapping": "1", **keys}), head), 1)


def said(report):
    return [f"{d.text}; assumed {d.assumed}" for d in report.diagnoses]


def test_a_pdo_without_a_defect():
    report = with_pdos(pdo())
    assert (said(report), report.refusals) == ([], ())
    assert [(p.cob_id, p.length) for p in report.pdos] == [(0x201, 2)]


@pytest.mark.parametrize(
    ("make", "complaint"),
    [
        (lambda: with_pdos(pdo("0")), "1400h:1 is 0, the identifier of NMT; assumed a PDO that is not valid"),
        (lambda: with_pdos(pdo(None)), "1400h:1 has no default; assumed $NODEID+0x200"),
        (lambda: with_pdos(pdo(None, first=0x1804)), "1804h:1 has no default; assumed a PDO that is not valid"),
        (lambda: with_pdos(pdo(transmission=None)), "1400h:2 has no default; assumed transmission type 255"),
        (lambda: with_pdos(pdo("$NODEID+0x600")), "1400h:1 is 0x601 for node 1, which CiA 301 keeps for other services; assumed that identifier"),
        (lambda: with_pdos(pdo(), PDOMapping="0"), "1600h:1 maps 2000h:0, which has no PDOMapping=1; assumed that it is mapped"),
        (lambda: with_pdos(pdo(), AccessType="ro"), "1600h:1 maps 2000h:0, whose AccessType is ro; assumed that it is mapped"),
        (lambda: with_pdos(pdo(entries=["0x00060010"])), "1600h:1 maps 0006h:0, which [DummyUsage] does not allow; assumed a gap"),
        (lambda: with_pdos(pdo(first=0x1800), pdo(first=0x1801)), "1801h:1 is 0x201 for node 1, and so is 1800h:1; assumed both"),
        (lambda: with_pdos(pdo(entries=[], count="")), "1600h:0 has no default; assumed nothing is mapped"),
        (lambda: with_pdos("[1600]" + pdo().split("[1600]")[1]), "1600h is the map of RPDO1, which has no 1400h; assumed no RPDO1"),
        (lambda: with_pdos(pdo().split("[1600]")[0]), "RPDO1 has no 1600h; assumed nothing is mapped"),
    ],
)  # fmt: skip
def test_odd_pdos_are_told(make, complaint):
    report = make()
    assert said(report) == [complaint]
    assert report.refusals == ()
    assert report.diagnoses[0].line > 1


def test_both_lacks_of_a_mapped_object_are_told():
    report = with_pdos(pdo(), PDOMapping="0", AccessType="ro")
    assert ["PDOMapping=1" in text or "AccessType is ro" in text for text in said(report)] == [True, True]


@pytest.mark.parametrize(
    ("make", "reason"),
    [
        (lambda: with_pdos(pdo(count=2)), "1600h:0 says 2 entries, but entry 2 has no default"),
        (lambda: with_pdos(pdo(count="")), "1600h:0 has no default, yet entries are mapped"),
        (lambda: with_pdos(pdo(count=254)), "1600h:0 is 254"),
        (lambda: with_pdos(pdo(entries=["0x20010010"])), "maps 2001h:0 in 16 bits, which the file does not describe"),
        (lambda: with_pdos(pdo(entries=["0x20000110"])), "maps 2000h:1 in 16 bits, which the file does not describe"),
        (lambda: with_pdos(pdo(entries=["0x20000020"])), "maps 2000h:0 in 32 bits, but INTEGER16 has 16"),
        (lambda: with_pdos(pdo(entries=["0x20000041"]), DataType="0x0009"), "maps 2000h:0 in 65 bits"),
        (lambda: with_pdos(pdo(entries=["0x20000010"] * 5)), "1600h maps 80 bits"),
        (lambda: with_pdos(pdo(), DataType="0x0040"), "maps 2000h:0 in 16 bits, whose DataType is not known"),
        (lambda: with_pdos(pdo(entries=["20000010h ; X", "6 0 4"])), "[1600sub2] DefaultValue=6 0 4 is not a number"),
        (lambda: with_pdos(pdo(entries=["0x2000001000"])), "does not fit into UNSIGNED32"),
        (lambda: with_pdos(pdo("0x20000181")), "1400h:1 has the identifier 0x181"),
        (lambda: with_pdos(pdo("$NODEID*2")), "[1400sub1] DefaultValue=$NODEID*2 is not a number"),
        (lambda: with_pdos(pdo("0201")), "which may mean octal"),
        (lambda: with_pdos(pdo("0x201\nDefaultValue=0x202")), "DefaultValue is given twice with different values"),
    ],
)  # fmt: skip
def test_what_cannot_be_read_right_is_refused(make, reason):
    report = make()
    assert len(report.refusals) == 1
    assert report.refusals[0].startswith("quirk.eds:")
    assert reason in report.refusals[0]
    assert report.pdos == ()
    with pytest.raises(EdsError) as refused:
        layouts(report.description, 1)
    assert str(refused.value) == report.refusals[0]


def test_every_refused_pdo_is_told_and_the_others_are_read():
    report = with_pdos(pdo(count=2), pdo("0x202", first=0x1401), pdo("0x203", first=0x1402, count=9))
    assert [("1600h:0" in r, "1602h:0" in r) for r in report.refusals] == [(True, False), (False, True)]
    assert [p.cob_id for p in report.pdos] == [0x202]
