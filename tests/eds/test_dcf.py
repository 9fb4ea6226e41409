"""DCF files: what they configure, read and as live nodes.

CiA 306-1: ParameterValue is the value that the device is given.
"""

from __future__ import annotations

import struct
import subprocess
import sys

import pytest

from coulombus.eds.check import check
from coulombus.eds.reader import parse_eds
from coulombus.sim_bus.network.network import VirtualNetwork
from coulombus.sim_bus.server.live_nodes import LiveNodes, NodeError
from eds_text import HEAD, complaints, variable
from places import ROOT

NODE = 9
COMMISSIONED = "[DeviceComissioning]\nNodeID=0x11\nBaudrate=250\n"


def parse(text, head=HEAD):
    return parse_eds((head + text).encode(), "quirk.dcf")


def diagnosed(description):
    return [f"{d.severity}: {d.text}; assumed {d.assumed}" for d in description.diagnoses]


def dcf(count=1):
    return f"warning: the file is a DCF, with {count} configured value{'s' * (count > 1)}; assumed that the device starts with them"


def numbered(index, name, *rows):
    """A record with one section for each row of (data type, other keys)."""
    text = f"[{index}]\nParameterName={name}\nObjectType=0x9\nSubNumber={len(rows)}\n"
    for subindex, (kind, keys) in enumerate(rows):
        text += f"[{index}sub{subindex}]\nParameterName={name} {subindex}\nDataType={kind}\nAccessType=rw\n{keys}\n"
    return text


def pdos(mapped="ParameterValue=0x20000010", count="ParameterValue=1"):
    """RPDO 1 whose identifier and map stand only in the DCF's values."""
    return (
        numbered(
            "1400", "R", ("5", "DefaultValue=2"), ("7", "ParameterValue=$NODEID+0x200"), ("5", "ParameterValue=255")
        )
        + numbered("1600", "M", ("5", count), ("7", mapped))
        + variable(PDOMapping="1")
    )


def compact(values, kind="0x8", index="2000", code=5):
    body = f"[{index}]\nParameterName=L\nObjectType={kind}\nDataType={code}\nAccessType=rw\nCompactSubObj=3\nDefaultValue=1\n"
    return body + f"[{index}Value]\nNrOfEntries={values.count('=')}\n{values}"


# reading


@pytest.mark.parametrize(
    ("code", "written", "value"),
    [
        ("0x0003", "-7", -7),
        ("0x0003", "0xFFF9", -7),
        ("0x0007", "$NODEID+0x180", 0x189),
        ("0x0008", "-0.25", -0.25),
        ("0x0009", "seven; eight", "seven; eight"),
        ("0x000A", "01 02", b"\x01\x02"),
    ],
)
def test_the_device_starts_with_the_configured_value(code, written, value):
    d = parse(variable(DataType=code, DefaultValue=None, ParameterValue=written))
    assert diagnosed(d) == [dcf()]
    assert d.default(0x2000, 0, NODE) == value


def test_an_empty_value_configures_nothing():
    d = parse(variable(DefaultValue="5", ParameterValue=""))
    assert (complaints(d), d.variable(0x2000, 0).default) == ([], 5)


@pytest.mark.parametrize(
    ("written", "complaint"),
    [
        ("11", "is outside the object's limits"),
        ("-1", "is outside the object's limits"),
        ("70000", "does not fit into INTEGER16"),
        ("five", "is not a number"),
    ],
)
def test_a_value_that_an_sdo_could_not_write_is_told_and_not_loaded(written, complaint):
    d = parse(variable(DefaultValue="5", LowLimit="0", HighLimit="10", ParameterValue=written))
    assert set(diagnosed(d)) == {dcf(), f"error: [2000] ParameterValue={written} {complaint}; assumed the default"}
    assert {x.line for x in d.diagnoses} == {HEAD.count("\n") + 8}
    assert d.variable(0x2000, 0).default == 5
    assert not d.variable(0x2000, 0).unreadable


def test_values_of_compact_sub_objects():
    d = parse(compact("01=7\n3=0x1FF\n"))
    assert diagnosed(d) == [dcf(2), "error: [2000Value] 3=0x1FF does not fit into UNSIGNED8; assumed the default"]
    assert [d.variable(0x2000, k).default for k in range(4)] == [3, 7, 1, 1]


def test_a_value_for_an_object_as_a_whole_belongs_nowhere():
    d = parse(
        numbered("2000", "W", ("5", "DefaultValue=1"), ("5", "DefaultValue=4")).replace(
            "Number=2", "Number=2\nParameterValue=2"
        )
    )
    assert diagnosed(d) == ["warning: [2000] ParameterValue belongs to no sub-index; assumed a comment"]


def test_files_beside_a_dcf_are_told():
    d = parse(variable(DataType="0x000F", DownloadFile="firmware.bin"))
    assert diagnosed(d) == ["warning: [2000] DownloadFile=firmware.bin is another file; assumed no value"]


GOES = (
    "warning: 1 configured value is what the default is for the node id 17; assumed that with another node id it moves"
)


def stays(value, default="0x200", where="for the node id 17"):
    what = f"is another identifier than the default $NODEID+{default} {where}"
    return f"warning: [2000] ParameterValue={value} {what}; assumed {value} with every node id"


@pytest.mark.parametrize(
    ("access", "written", "at_9", "complaint"),
    [
        ("rw", "0x211", 0x209, [GOES]),  # what the default is for the node id of the file
        ("rw", "0x212", 0x212, [stays("0x212")]),
        ("rw", "0x40000211", 0x40000211, [stays("0x40000211")]),  # no COB-ID: all bits count
        ("ro", "0x211", 0x209, [GOES]),
        ("ro", "0x212", 0x209, ["warning: [2000] ParameterValue=0x212 cannot be written; assumed $NODEID+0x200"]),
        ("rw", "$NODEID+0x300", 0x309, []),
    ],
)
def test_what_goes_with_the_node_id_goes_with_another_one_too(access, written, at_9, complaint):
    body = variable(DataType="7", AccessType=access, DefaultValue="$NODEID+0x200", ParameterValue=written)
    d = parse(COMMISSIONED + body)
    assert set(diagnosed(d)) == {dcf(), *complaint}
    assert d.default(0x2000, 0, NODE) == at_9


COB_IDS = {
    0x1400: ("$NODEID+0x200", "0x211"),
    0x1401: ("$NODEID+0x80000300", "0x311"),
    0x1800: ("$NODEID+0x40000180", "0x191"),
    0x1801: ("$NODEID+0x40000280", "0x40000291"),
    0x1802: ("$NODEID+0x40000380", "0x80000391"),
    0x1803: ("$NODEID+0x480", "0xC0000491"),
}
"""Identifiers of node 17: default, and configured value.

Bits 30 and 31 are set in one of them, in both or in none.
"""


def identifiers(commissioned, cob_ids=COB_IDS):
    rows = ((f"{index:X}", *pair) for index, pair in cob_ids.items())
    return parse(
        commissioned
        + "".join(
            numbered(index, "P", ("5", "DefaultValue=1"), ("7", f"DefaultValue={default}\nParameterValue={value}"))
            for index, default, value in rows
        )
    )


@pytest.mark.parametrize("node_id", [1, 9, 17, 127])
def test_with_another_node_id_all_identifiers_move_and_the_bits_beside_them_stay(node_id):
    d = identifiers(COMMISSIONED)
    cob_ids = {index: d.default(index, 1, node_id) for index in COB_IDS}
    assert cob_ids == {index: int(value, 0) - 17 + node_id for index, (_, value) in COB_IDS.items()}
    assert (
        "6 configured values are what the default is for the node id 17; assumed that with another node id they move"
        in [f"{x.text}; assumed {x.assumed}" for x in d.diagnoses]
    )


@pytest.mark.parametrize(
    ("commissioned", "value", "where"),
    [
        (COMMISSIONED, "0x192", "for the node id 17"),
        (COMMISSIONED, "0x20000191", "for the node id 17"),  # bit 29 is a longer identifier
        ("", "0x191", "and the file tells no node id"),
    ],
)
def test_an_identifier_that_does_not_move_is_told(commissioned, value, where):
    d = identifiers(commissioned, {0x1800: ("$NODEID+0x40000180", value)})
    assert d.default(0x1800, 1, 9) == int(value, 0)
    where = where if where.startswith("for") else f", {where}"
    text = f"[1800sub1] ParameterValue={value} is another identifier than the default $NODEID+0x40000180"
    assert any(x.text.replace(text, "").strip(" ,") == where.strip(" ,") for x in d.diagnoses if text in x.text)


# PDOs


def test_a_map_that_stands_in_the_values():
    report = check(parse(pdos()), NODE)
    assert report.refusals == ()
    (pdo,) = report.pdos
    assert (pdo.cob_id, pdo.transmission, [(e.index, e.bits) for e in pdo.entries]) == (0x209, 255, [(0x2000, 16)])
    compactly = pdos().partition("[1600]")[0] + compact("1=0x20000010\n2=0x20000010\n3=0x20000010\n", "0x9", "1600", 7)
    report = check(parse(compactly + variable(PDOMapping="1")), NODE)
    assert [len(pdo.entries) for pdo in report.pdos] == [3]


@pytest.mark.parametrize(
    ("mapped", "why"),
    [
        ("ParameterValue=0x2000001O", "is not a number"),
        ("ParameterValue=020000", "may mean octal"),
        ("DefaultValue=0x20000010\nParameterValue=oops", "is not a number"),
        ("ParameterValue=0x20000010\nParameterValue=0x20000008", "is given twice with different values"),
        ("DataType=8\nParameterValue=0x20000010", "is given twice with different values"),
        ("ParameterValue=0x20000008", "but INTEGER16 has 16"),
        ("LowLimit=1\nHighLimit=2\nParameterValue=0x20000010", "is outside the object's limits"),
    ],
)
def test_a_configured_map_that_cannot_be_read_right_is_refused(mapped, why):
    (refusal,) = check(parse(pdos(mapped)), NODE).refusals
    assert why in refusal


def test_a_compact_map_of_two_readings_is_refused():
    text = pdos().partition("[1600]")[0] + variable(PDOMapping="1")
    for values, why in (("1=0x20000010\n1=0x20000008\n", "is given twice"), ("1=010\n", "may mean octal")):
        (refusal,) = check(parse(text + compact(values, "0x9", "1600", 7)), NODE).refusals
        assert why in refusal


# commissioning


@pytest.mark.parametrize(
    ("section", "node_id", "bit_rate", "complaint"),
    [
        (COMMISSIONED, 17, 250_000, []),
        ("[DeviceComissioning]\nNodeID=\nBaudrate=\n", 0, 0, []),
        ("[DeviceComissioning]\nNodeID=200\n", 0, 0, ["[DeviceComissioning] NodeID=200 is not 1 to 127; assumed none"]),
        (
            "[DeviceComissioning]\nBaudRate=500000\n",
            *(0, 0, ["[DeviceComissioning] BaudRate=500000 is not a bit rate of CiA 301 in kbit/s; assumed none"]),
        ),
        (
            "[DeviceCommissioning]\nNodeID=3\n",
            *(
                3,
                0,
                ["the section head [DeviceCommissioning] does not follow CiA 306; assumed [DeviceComissioning]"],
            ),
        ),
    ],
)
def test_node_id_and_bit_rate(section, node_id, bit_rate, complaint):
    d = parse(section + variable())
    assert (d.node_id, d.bit_rate) == (node_id, bit_rate)
    assert diagnosed(d) == [f"warning: {text}" for text in complaint]


def live(tmp_path, *texts):
    paths = [tmp_path / f"{k}.dcf" for k in range(len(texts))]
    for path, text in zip(paths, texts, strict=True):
        path.write_text(HEAD + text + variable())
    return paths


def test_the_command_line_wins_over_the_file(tmp_path):
    (path,) = live(tmp_path, COMMISSIONED)
    nodes = LiveNodes(((path, None),))
    assert (nodes.node_ids, nodes.bit_rate) == ([17], 250_000)
    nodes = LiveNodes(((path, 5),), bit_rate=125_000)
    assert (nodes.node_ids, nodes.bit_rate) == ([5], 125_000)
    first, second = live(tmp_path, COMMISSIONED, "[DeviceComissioning]\nNodeID=2\nBaudrate=50\n")
    with pytest.raises(NodeError, match=r"50000 and 250000 bit/s, .*give --bitrate"):
        LiveNodes(((first, None), (second, None)))
    assert LiveNodes(((first, None), (second, None)), bit_rate=1_000_000).node_ids == [17, 2]
    (path,) = live(tmp_path, "")
    with pytest.raises(NodeError, match=r"has no node id .*give --node-id"):
        LiveNodes(((path, None),))
    assert LiveNodes(((path, 1),)).bit_rate == 0  # not said: whatever the bus has


@pytest.mark.slow
def test_the_command_needs_a_node_id_for_each_file_or_for_none(tmp_path):
    first, second = live(tmp_path, "", COMMISSIONED)
    command = [sys.executable, "-m", "coulombus", "node", first, second, "--bus", "coulombus:t"]
    for options, text in ((["--node-id", "1"], "one --node-id for each file"), ([], "0.dcf has no node id")):
        done = subprocess.run([*command, *options], cwd=ROOT, capture_output=True, text=True, check=False)
        assert done.returncode == 2
        assert text in done.stderr


# live


def test_a_configured_node_starts_configured_and_after_a_reset_is_so_again():
    text = pdos() + "[1017]\nParameterName=H\nDataType=6\nAccessType=rw\nDefaultValue=0\nParameterValue=10\n"
    network = VirtualNetwork(capacity=1)
    device = network.add(parse(text.replace("PDOMapping=1", "PDOMapping=1\nDefaultValue=3\nParameterValue=4")), NODE)
    station = network.station()
    network.power_on()
    for _ in range(2):
        network.wait_ns(55_000_000)
        assert device[0x2000, 0] == 4
        assert len(station.take(0x700 + NODE)) == 6
        station.send(0x000, bytes((1, NODE)))
        station.send(0x200 + NODE, struct.pack("<h", -5))
        network.wait_ns(1_000_000)
        assert device[0x2000, 0] == -5
        station.send(0x000, bytes((129, NODE)))
