"""XDD and XDC files (CiA 311): the same objects as of an EDS or DCF, with the lines of the XML; what
is hostile, torn or another kind of XML is refused with its line and what to do.
"""

from __future__ import annotations

import re
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coulombus.conformance.tester.described_device import DescribedDevice
from coulombus.eds import xdd, xml_elements
from coulombus.eds.check import check
from coulombus.eds.cia301 import ARRAY, DATA_TYPES, DOMAIN, RECORD, VAR
from coulombus.eds.convert import eds_text
from coulombus.eds.dcf_text import configured, with_values
from coulombus.eds.description import Object, Variable
from coulombus.eds.eds_folder import read_folder
from coulombus.eds.reader import EdsError, parse_eds, read_eds
from coulombus.system.errors import CoulombusError
from places import CORPUS, EDS, beside
from xdd_text import as_xdd, attributes, container, elements, number

OWN = ("motor", "mr_brake")
REFERRED = {"by attributes": lambda variable: False, "by parameters": lambda variable: True}
CAR = '<CANopenObject index="2000" name="X" objectType="7" dataType="0003" accessType="rw" defaultValue="5"/>'
REFUSAL = r"f\.xdd:\d+: [^;]+; .+"


def read(text, name="f.xdd"):
    return parse_eds(text if isinstance(text, bytes) else text.encode(), name)


def texts(description):
    return [str(diagnosis).partition(":")[2] for diagnosis in description.diagnoses]


def places(description):
    """Every variable without its line, by index and sub-index; and the objects' names and types."""
    variables = {
        (index, sub): replace(variable, line=0)
        for index, entry in description.objects.items()
        for sub, variable in entry.variables.items()
    }
    return variables, {index: (entry.name, entry.object_type) for index, entry in description.objects.items()}


def only(*rows, parameters="", **keys):
    """The variable 2000h:0 of a file with the element in `rows`."""
    return read(container("\n".join(rows) or CAR, parameters=parameters, **keys)).variable(0x2000, 0)


# One object model behind both.


@pytest.mark.parametrize("referred", REFERRED.values(), ids=list(REFERRED))
@pytest.mark.parametrize("name", OWN)
def test_our_devices_are_the_same_as_xdd_and_as_eds(name, referred):
    eds = read_eds(EDS / f"{name}.eds")
    description = read(as_xdd(eds, referred))
    assert places(description) == places(eds)
    assert (description.dummies, description.diagnoses) == (eds.dummies, ())
    assert [pdo.entries for pdo in check(description).pdos] == [pdo.entries for pdo in check(eds).pdos]


@pytest.mark.thorough
@beside(CORPUS)
def test_every_file_of_the_corpus_is_the_same_as_xdd():
    count = 0
    for path in sorted(CORPUS.iterdir()):
        if path.suffix.lower() not in (".eds", ".dcf"):
            continue
        eds = read_eds(path)
        if any(variable.unreadable or not variable.data_type for variable in places(eds)[0].values()):
            continue  # an XDD of this description cannot have the same defect
        count += 1
        assert places(read(as_xdd(eds)))[0] == places(eds)[0], path.name
    assert count > 10


INTEGERS = {code: data_type for code, data_type in DATA_TYPES.items() if data_type.kind == "int" and data_type.bits}
NAMES = st.text(st.sampled_from("aZ09 <>&\"'äµ-_.,()"), min_size=1, max_size=12).map(str.strip).filter(bool)


@st.composite
def variables(draw, index, subindex):
    code = draw(st.sampled_from((*INTEGERS, 0x01, 0x08, 0x09)))
    access = draw(st.sampled_from(("ro", "wo", "rw", "const", "rwr", "rww")))
    mappable = access in ("rwr", "rww") or draw(st.booleans())
    low = high = default = None
    relative = False
    if code in INTEGERS:
        data_type = INTEGERS[code]
        half = 1 << data_type.bits - 1
        least, most = (-half, half - 1) if data_type.signed else (0, 2 * half - 1)
        if draw(st.booleans()):
            low, high = sorted(draw(st.lists(st.integers(least, most), min_size=2, max_size=2)))
        default = draw(
            st.none() | st.integers(least if low is None else low, most if high is None or high == 0 else high)
        )
        relative = code == 0x07 and low is None and default is not None and default < 1 << 31 and draw(st.booleans())
    elif code == 0x01:
        default = draw(st.none() | st.integers(0, 1))
    elif code == 0x08:
        default = draw(st.none() | st.floats(-1e6, 1e6, width=32))
    else:
        default = draw(st.none() | NAMES)
    return Variable(index, subindex, draw(NAMES), code, access, default, relative, low, high, mappable, 0)


@st.composite
def dictionaries(draw):
    objects = []
    for index in sorted(draw(st.sets(st.integers(0x2000, 0x9FFF), min_size=1, max_size=6))):
        kind = draw(st.sampled_from((VAR, ARRAY, RECORD)))
        subs = {0: draw(variables(index, 0))}
        name = subs[0].name
        if kind != VAR:
            name = draw(NAMES)
            last = draw(st.integers(1, 12))
            subs[0] = Variable(index, 0, "Highest sub-index", 5, "const", last, False, None, None, False, 0)
            subs |= {sub: draw(variables(index, sub)) for sub in range(1, last + 1)}
        objects.append(Object(index, name, kind, subs))
    return objects


def section(name, pairs):
    return f"[{name}]\n" + "".join(f"{key}={value}\n" for key, value in pairs.items() if value is not None)


def as_eds(entries):
    text = "[FileInfo]\nFileName=f.eds\n[DeviceInfo]\nVendorName=Nobody\n"
    for entry in entries:
        if entry.object_type != VAR:
            keys = {"ParameterName": entry.name, "ObjectType": entry.object_type, "SubNumber": len(entry.variables)}
            text += section(f"{entry.index:04X}", keys)
        for sub, v in entry.variables.items():
            default = None if v.default is None else number(v.default, v.node_relative)
            keys = {
                "ParameterName": v.name,
                "ObjectType": VAR,
                "DataType": f"0x{v.data_type:04X}",
                "AccessType": v.access,
            }
            keys |= {"DefaultValue": default, "LowLimit": v.low, "HighLimit": v.high, "PDOMapping": int(v.pdo_mappable)}
            text += section(f"{entry.index:04X}" + (f"sub{sub:X}" if entry.object_type != VAR else ""), keys)
    return text


@pytest.mark.thorough
@settings(derandomize=True, deadline=None, max_examples=60)
@given(dictionaries(), st.integers(0, 1 << 30))
def test_the_same_random_dictionary_is_the_same_as_eds_and_as_xdd(entries, seed):
    written = {(v.index, v.subindex): v for entry in entries for v in entry.variables.values()}
    referred = {place for number, place in enumerate(written) if seed >> number % 30 & 1}
    objects, parameters = elements(entries, lambda v: (v.index, v.subindex) in referred)
    description, eds = read(container(objects, parameters=parameters)), read(as_eds(entries), "f.eds")
    assert places(description) == places(eds)
    assert places(description)[0] == written
    assert not [d for d in description.diagnoses if d.severity == "error"]


def test_the_line_of_an_object_is_that_of_its_element():
    entries = [
        f'<CANopenObject index="{index:04X}" name="N" objectType="7"\n dataType="0005" accessType="ro"/>'
        for index in (0x2000, 0x2001)
    ]
    text = container("\n".join(entries))
    description = read(text)
    for index in (0x2000, 0x2001):
        line = text.splitlines()[description.variable(index, 0).line - 1]
        assert f'index="{index:04X}"' in line


# What XML spells in its own way.


@pytest.mark.parametrize(
    ("pairs", "expected"),
    [
        ({"accessType": "rw", "PDOmapping": "TPDO"}, ("rwr", True)),
        ({"accessType": "rw", "PDOmapping": "RPDO"}, ("rww", True)),
        ({"accessType": "ro", "PDOmapping": "TPDO"}, ("ro", True)),
        ({"accessType": "rw", "PDOmapping": "optional"}, ("rw", True)),
        ({"accessType": "rw", "PDOmapping": "default"}, ("rw", True)),
        ({"accessType": "rw", "PDOmapping": "no"}, ("rw", False)),
        ({"accessType": "rw"}, ("rw", False)),
    ],
)
def test_the_direction_of_a_mapping_is_kept_in_the_access_type(pairs, expected):
    variable = only(f'<CANopenObject index="2000" name="X" objectType="7" dataType="0003"{attributes(pairs)}/>')
    assert (variable.access, variable.pdo_mappable) == expected


@pytest.mark.parametrize(
    ("spelled", "code", "value"),
    [
        ("12", 7, 12),
        ("0x1F", 7, 31),
        ("-3", 3, -3),
        ("0xFFFD", 3, -3),
        ("2.5", 8, 2.5),
        ("true", 1, 1),
        ("a b", 9, "a b"),
    ],
)
def test_numbers_are_decimal_or_hexadecimal(spelled, code, value):
    element = f'<CANopenObject index="2000" name="X" objectType="7" dataType="{code:04X}" accessType="rw" defaultValue="{spelled}"/>'
    assert only(element).default == value


@pytest.mark.parametrize("spelled", ["$NODEID+0x180", "$NODEID + 0x180", "$NodeID+384"])
def test_a_value_that_depends_on_the_node_id(spelled):
    element = CAR.replace('"0003"', '"0007"').replace('"5"', f'"{spelled}"')
    description = read(container(element))
    assert description.default(0x2000, 0, 9) == 0x189


def test_a_parameter_gives_what_the_object_leaves_out_and_its_template_the_rest():
    parameters = (
        '<parameter uniqueID="P" templateIDRef="T" access="readWriteOutput"><label lang="de">Eins</label>'
        '<label lang="en">One</label><INT/></parameter>'
        '<parameterTemplate uniqueID="T"><UDINT/><defaultValue value="-7"/><allowedValues><range>'
        '<minValue value="-9"/><maxValue value="0x10"/></range></allowedValues></parameterTemplate>'
    )
    variable = only(
        '<CANopenObject index="2000" objectType="7" PDOmapping="RPDO" uniqueIDRef="P"/>', parameters=parameters
    )
    assert variable == Variable(0x2000, 0, "One", 3, "rww", -7, False, -9, 16, True, variable.line)


def test_a_parameter_that_is_missing_is_told_with_its_line():
    text = container(CAR.replace("/>", ' uniqueIDRef="P_1"/>'))
    assert any("uniqueIDRef=P_1 names no parameter" in line for line in texts(read(text)))


def test_two_defaults_of_one_object_are_told_and_leave_a_pdo_unreadable():
    parameters = '<parameter uniqueID="P" access="readWrite"><UDINT/><defaultValue value="0x60410010"/></parameter>'
    entry = (
        '<CANopenObject index="1A00" name="M" objectType="9" subNumber="2">'
        '<CANopenSubObject subIndex="00" name="N" dataType="0005" accessType="rw" defaultValue="1"/>'
        '<CANopenSubObject subIndex="01" name="E" dataType="0007" defaultValue="0x60640020" uniqueIDRef="P"/>'
        "</CANopenObject>"
    )
    description = read(container(entry, parameters=parameters))
    variable = description.variable(0x1A00, 1)
    assert variable.default is None
    assert "given twice" in variable.unreadable
    assert any("error: [1A00sub1] defaultValue=0x60410010, but line" in line for line in texts(description))


def test_elements_and_attributes_of_other_namespaces_are_passed_over():
    foreign = '<v:CANopenObject index="2001"/><v:note><CANopenObject index="2002"/></v:note>' + CAR.replace(
        "/>", ' v:defaultValue="9" v:index="2003" tool="x"><v:more/></CANopenObject>'
    )
    description = read(container(foreign, device='<v:ISO15745Profile/><v:dummy entry="Dummy0005=1"/>'))
    assert list(description.objects) == [0x2000]
    assert description.variable(0x2000, 0).default == 5
    assert (description.diagnoses, description.dummies) == ((), frozenset())


def test_a_prefix_for_the_files_own_namespace_is_no_other():
    text = re.sub(r"<(/?)(?=[A-Za-z])(?!\?)", r"<\1c:", container(CAR)).replace("xmlns=", "xmlns:c=")
    assert read(text).variable(0x2000, 0).default == 5


def test_objects_of_modules_are_left_out_and_told():
    module = f"<moduleManagement><moduleTypeList><CANopenObjectList>{CAR}</CANopenObjectList></moduleTypeList></moduleManagement>"
    description = read(container(CAR.replace("2000", "2001"), management=module))
    assert list(description.objects) == [0x2001]
    assert any("describes modules" in line for line in texts(description))


@pytest.mark.parametrize(
    ("element", "complaint"),
    [
        (CAR.replace('"2000"', '"20000"'), "<CANopenObject> has index=20000"),
        (CAR.replace('index="2000" ', ""), "<CANopenObject> has no index"),
        (CAR + "\n" + CAR.replace('"5"', '"6"'), "defaultValue=6, but line"),
        (CAR.replace('"0003"', '"0F00"'), "DataType=0x0F00 is not defined in CiA 301"),
        (CAR.replace(' accessType="rw"', ""), "AccessType is missing"),
        (CAR.replace('"5"', '"five"'), "defaultValue=five is not a number"),
        (CAR.replace("/>", ' PDOmapping="yes"/>'), "PDOmapping=yes is not a number"),
        (CAR.replace("/>", ' highLimit="4"/>'), "defaultValue=5 is outside its limits"),
    ],
)
def test_defects_are_told_as_of_an_eds(element, complaint):
    description = read(container(element + CAR.replace("2000", "3000")))
    assert any(complaint in line for line in texts(description)), texts(description)
    assert 0x3000 in description.objects


# XDC: a configured device.


XDC = (
    CAR.replace("/>", ' actualValue="6"/>')
    + '<CANopenObject index="2001" name="Y" objectType="7" dataType="0003" uniqueIDRef="P"/>'
    + '<CANopenObject index="2002" name="Z" objectType="7" dataType="0003" accessType="rw" defaultValue="1" objFlags="0002"/>'
)
P = '<parameter uniqueID="P" access="readWrite"><INT/><actualValue value="8"/><defaultValue value="7"/></parameter>'
NODE = '<NetworkManagement><deviceCommissioning nodeID="{}" actualBaudRate="{}" nodeName="N"/></NetworkManagement>'


@pytest.mark.parametrize(
    ("node_id", "rate", "expected"),
    [
        ("5", "250 Kbps", (5, 250_000)),
        ("0x0A", "1000", (10, 1_000_000)),
        ("0", "125", (0, 125_000)),
        ("3", "auto-baudRate", (3, 0)),
    ],
)
def test_an_xdc_gives_configured_values_node_id_and_bit_rate(node_id, rate, expected):
    description = read(container(XDC, parameters=P, management=NODE.format(node_id, rate)), "f.xdc")
    assert [description.default(0x2000 + k, 0, 1) for k in range(3)] == [6, 8, 1]
    assert (description.node_id, description.bit_rate) == expected
    assert any("the file is an XDC, with 2 configured values" in line for line in texts(description))


def test_an_xdc_is_restored_and_dumped_as_a_dcf_is():
    description = read(container(XDC, parameters=P, management=NODE.format(5, "250 Kbps")), "f.xdc")
    assert configured(description) == ((0x2000, 0), (0x2001, 0))
    dcf = read(with_values(description, {(0x2000, 0): -2}, 7, 500_000), "f.dcf")
    assert [dcf.default(0x2000 + k, 0, 1) for k in range(3)] == [-2, 7, 1]
    assert (dcf.node_id, dcf.bit_rate) == (7, 500_000)
    assert [line for line in texts(dcf) if "DCF" not in line] == []
    assert DescribedDevice(description, 5).flags == {(0x2002, 0): 2}


@pytest.mark.parametrize("referred", REFERRED.values(), ids=list(REFERRED))
@pytest.mark.parametrize("name", OWN)
def test_an_xdd_in_cia_306s_words_is_the_same(name, referred):
    description = read(as_xdd(read_eds(EDS / f"{name}.eds"), referred))
    eds = read(eds_text(description), "f.eds")
    assert places(eds) == places(description)
    assert eds.diagnoses == ()


# Text, and what recordings keep of it.


@pytest.mark.parametrize("encoding", ["UTF-8", "UTF-16", "ISO-8859-1", "windows-1252"])
def test_the_text_is_read_in_its_encoding_and_read_again_as_it_is_kept(encoding):
    text = container(CAR.replace('name="X"', 'name="Größe"'), encoding=encoding)
    description = read(text.encode(encoding))
    assert description.variable(0x2000, 0).name == "Größe"
    again = read(description.text)
    assert (again.text, places(again)) == (description.text, places(description))
    assert description.diagnoses == ()


def test_the_content_decides_and_not_the_name(tmp_path):
    for name, text in (("a.xdd", container(CAR)), ("b.xdc", container(CAR)), ("c.eds", container(CAR)), ("d.txt", "")):
        (tmp_path / name).write_text(text)
    descriptions, refused = read_folder(tmp_path)
    assert [description.variable(0x2000, 0).default for description in descriptions] == [5, 5, 5]
    assert refused == []


# What is refused.


DTD = "<!DOCTYPE ISO15745ProfileContainer {}>\n"
HEAD, BODY = container(CAR).split("\n", 1)
BOMB = "".join(f'<!ENTITY e{k} "{f"&e{k - 1};" * 10 if k else "lol"}">' for k in range(10))


@pytest.mark.parametrize(
    "text",
    [
        HEAD + DTD.format(f"[{BOMB}]") + BODY.replace('name="X"', 'name="&e9;"'),
        HEAD + DTD.format('[<!ENTITY x SYSTEM "file:///etc/hostname">]') + BODY.replace("Nobody", "&x;"),
        HEAD + DTD.format('SYSTEM "http://192.0.2.1/evil.dtd"') + BODY,
        HEAD + DTD.format('[<!ENTITY % p SYSTEM "file:///etc/hostname">%p;]') + BODY,
    ],
    ids=["bomb", "external entity", "external DTD", "parameter entity"],
)
def test_a_dtd_and_its_entities_are_refused(text):
    with pytest.raises(EdsError, match=REFUSAL) as refused:
        read(text)
    assert "DTD or entities" in str(refused.value)
    assert isinstance(refused.value, CoulombusError)
    assert refused.value.exit_status == 3


def test_a_huge_nesting_is_refused_at_its_line():
    with pytest.raises(EdsError, match=r"f\.xdd:\d+: elements are nested more than 64 deep; "):
        read(container("\n<x>" * 100_000))
    with pytest.raises(EdsError, match="nested more than 64 deep"):
        read(container("<v:x>" * 100_000))


def test_a_huge_text_is_refused(monkeypatch):
    monkeypatch.setattr(xdd, "MOST_CHARACTERS", 5000)
    assert only() is not None
    with pytest.raises(EdsError, match=r"f\.xdd:1: has more than 16 MiB; expected the XDD or XDC file of one device"):
        read(container(CAR + "<!--" + "x" * 5000 + "-->"))


def test_more_elements_than_a_description_has_are_refused(monkeypatch):
    monkeypatch.setattr(xml_elements, "MOST_ELEMENTS", 1000)
    with pytest.raises(EdsError, match="has more than 1000 elements"):
        read(container("<v:x/>" * 2000))


def test_a_file_of_100_mb_is_refused(tmp_path):
    path = tmp_path / "large.xdd"
    path.write_text(container(CAR))
    with path.open("r+b") as file:
        file.truncate(100_000_000)
    with pytest.raises(
        EdsError, match=r"large\.xdd: has more than 64 MiB; expected an EDS or DCF file, or an XDD or XDC"
    ):
        read_eds(path)


def test_a_torn_file_is_refused_at_every_place():
    text = container(CAR)
    for length in range(30, len(text) - 2, 7):
        with pytest.raises(EdsError, match=REFUSAL) as refused:
            read(text[:length])
        assert "not well-formed XML" in str(refused.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            '<?xml version="1.0"?>\n<EtherCATInfo Version="1.2"><Vendor/></EtherCATInfo>',
            "f.xdd:2: is an EtherCAT slave",
        ),
        ("<!DOCTYPE html>\n<html><body><br></body></html>", "f.xdd:1: is a web page; it was saved instead"),
        ("<html><p>404", "f.xdd:1: is a web page"),
        (
            container(CAR, space="http://www.ethernet-powerlink.org"),
            "f.xdd:2: is a device description of Ethernet POWERLINK",
        ),
        ("<ISO15745Profile/>", "f.xdd:1: is a profile of ISO 15745 without a container"),
        ("<device><CANopenObjectList/></device>", "f.xdd:1: is an editor's project; export an EDS or XDD"),
        ("<IODevice/>", "IO-Link"),
        (
            "<DriveParameters/>",
            "f.xdd:1: is XML with the root element <DriveParameters>, no device description of CiA 311",
        ),
        (container(), "f.xdd:2: describes no object in a CANopenObjectList; expected CANopenObject elements"),
    ],
)
def test_other_xml_is_refused_as_what_it_is(text, words):
    with pytest.raises(EdsError, match=REFUSAL) as refused:
        read(text)
    assert words in str(refused.value)


PIECES = st.sampled_from(
    (
        *(
            "<",
            ">",
            "/>",
            '"',
            "&",
            "&amp;",
            "&#10;",
            "&#x2028;[3000]=",
            "<!--",
            "]]>",
            "<x>",
            "</CANopenObject>",
            "\n",
            "\ud7ff",
        ),
        *('index="2000"', 'subIndex="01"', 'actualValue="7"', 'uniqueIDRef="P"', 'PDOmapping="TPDO"', 'objectType="9"'),
        *('dataType="0001"', 'defaultValue="$NODEID+0x200"', 'defaultValue=""', CAR, P, "<dummy entry='Dummy0005=1'/>"),
    )
)


@settings(derandomize=True, deadline=None, max_examples=120)
@given(st.lists(st.tuples(st.floats(0, 1), st.integers(0, 30), PIECES | st.text(max_size=5)), min_size=1, max_size=4))
def test_whatever_the_text_it_is_read_or_refused(edits):
    text = container(XDC, parameters=P, management=NODE.format(5, "250 Kbps"))
    for at, length, piece in edits:
        start = int(at * len(text))
        text = text[:start] + piece + text[start + length :]
    description, refusal = None, ""
    try:
        description = read(text)
    except EdsError as error:
        refusal = str(error)
    if description is None:
        assert re.fullmatch(REFUSAL, refusal, re.DOTALL)
        return
    lines = len(re.split(r"\r*\n|\r", description.text))
    assert all(1 <= diagnosis.line <= lines for diagnosis in check(description, 127).diagnoses)
    assert places(read(eds_text(description), "f.eds"))[0].keys() == places(description)[0].keys()


def test_a_domain_has_no_value_and_no_parameter():
    element = '<CANopenObject index="2000" name="D" objectType="2" dataType="000F" accessType="rw"/>'
    description = read(container(element))
    assert description.objects[0x2000].object_type == DOMAIN
    assert description.diagnoses == ()


@pytest.mark.parametrize(
    ("access", "template", "expected"),
    [("", "", "ro"), ('access="readWrite"', "", "rw"), ("", 'access="write"', "wo"), ('access="const"', "", "const")],
)
def test_a_parameter_without_access_is_read_only(access, template, expected):
    """CiA 311's schema: the attribute has the default "read"."""
    parameters = (
        f'<parameterTemplate uniqueID="T" {template}><INT/></parameterTemplate>'
        f'<parameter uniqueID="P" templateIDRef="T" {access}><INT/></parameter>'
    )
    text = container('<CANopenObject index="2000" name="X" objectType="7" uniqueIDRef="P"/>', parameters=parameters)
    description = read(text)
    assert description.variable(0x2000, 0).access == expected
    assert texts(description) == []


def test_the_access_of_the_object_counts_before_the_default_of_its_parameter():
    row = '<CANopenObject index="2000" name="X" objectType="7" accessType="rw" uniqueIDRef="P"/>'
    assert only(row, parameters='<parameter uniqueID="P"><INT/></parameter>').access == "rw"
