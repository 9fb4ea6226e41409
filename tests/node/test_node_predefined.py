"""Files that describe a communication object and give it no default: the device takes CiA 301's
(section 7.3.5), never identifier 0.
"""

from __future__ import annotations

import pytest

from coulombus.eds.check import check
from coulombus.eds.cia301 import predefined
from coulombus.eds.reader import parse_eds
from coulombus.sim_bus.network.network import VirtualNetwork
from eds_text import HEAD, variable

NODE = 9
WITHOUT = "ParameterName=C\nDataType=0x0007\nAccessType=rw\n"


def record(index, *subs):
    """A record whose sub-indices are (number, data type, default or None)."""
    text = f"[{index}]\nParameterName=R\nObjectType=0x9\nSubNumber={len(subs)}\n"
    for subindex, kind, default in subs:
        text += f"[{index}sub{subindex}]\nParameterName=S\nDataType={kind}\nAccessType=rw\n"
        text += "" if default is None else f"DefaultValue={default}\n"
    return text


def mapped(communication, mapping, word="0x20000010"):
    subs = ((0, 5, 2), (1, 7, None), (2, 5, None))
    return record(communication, *subs) + record(mapping, (0, 5, 1), (1, 7, word))


BARE = record("1200", (0, 5, 2), (1, 7, None), (2, 7, None)) + mapped("1400", "1600") + mapped("1801", "1A01")
BARE += "".join(f"[{index}]\n{WITHOUT}" for index in ("1005", "1012", "1014")) + variable(
    PDOMapping="1", DefaultValue="7"
)


def node(text):
    network = VirtualNetwork(capacity=1)
    device = network.add(parse_eds((HEAD + text).encode(), "bare.eds"), NODE)
    station = network.station()
    network.power_on()
    network.wait_ns(5_000_000)
    return network, device, station


def read(station, index, subindex=0):
    station.take()
    station.send(0x600 + NODE, bytes((0x40, index & 0xFF, index >> 8, subindex, 0, 0, 0, 0)))
    answer = station.wait_for(0x580 + NODE, 5_000_000)
    return None if answer is None else int.from_bytes(answer.data[4:], "little")


def test_a_bare_description_is_a_whole_node():
    network, device, station = node(BARE)
    found = {
        (index, k): read(station, index, k)
        for index, k in ((0x1005, 0), (0x1012, 0), (0x1014, 0), (0x1200, 1), (0x1200, 2))
    }
    assert found == {key: predefined(*key, NODE) for key in found}
    assert list(found.values()) == [0x80, 0x100, 0x89, 0x609, 0x589]
    assert (read(station, 0x1400, 1), read(station, 0x1400, 2)) == (0x209, 255)
    station.send(0x000, bytes((1, NODE)))
    station.send(0x209, b"\x34\x12")
    network.wait_ns(5_000_000)
    assert device[0x2000, 0] == 0x1234
    assert [frame.data for frame in station.take(0x289)] == [b"\x07\x00", b"\x34\x12"]


def test_a_pdo_whose_sub_indices_are_not_described_is_where_it_belongs():
    network, device, station = node(
        record("1400", (0, 5, 2)) + record("1600", (0, 5, 1), (1, 7, "0x20000010")) + variable(PDOMapping="1")
    )
    station.send(0x000, bytes((1, NODE)))
    station.send(0x209, b"\x05\x00")
    network.wait_ns(5_000_000)
    assert device[0x2000, 0] == 5


@pytest.mark.parametrize("index", ["1005", "1012", "1014"])
def test_nothing_is_ever_sent_with_the_identifier_of_nmt(index):
    """1005h, 1012h with the bit of a producer; SYNC each millisecond, an emergency that a short
    RPDO causes.
    """
    text = f"[{index}]\n{WITHOUT}DefaultValue=0{'' if index == '1014' else 'x40000000'}\n"
    text += f"[1006]\n{WITHOUT}DefaultValue=1000\n" + mapped("1400", "1600") + variable(PDOMapping="1")
    network, _, station = node(text)
    station.send(0x000, bytes((1, NODE)))
    station.send(0x209, b"\x05")
    network.wait_ns(20_000_000)
    assert [frame for frame in station.take() if frame.can_id == 0x000] == []


def test_what_is_assumed_is_what_is_told():
    lines = [f"{d.text}; assumed {d.assumed}" for d in check(parse_eds((HEAD + BARE).encode(), "bare.eds")).diagnoses]
    for text in (
        "1005h:0 has no default; assumed 0x80",
        "1012h:0 has no default; assumed 0x100",
        "1014h:0 has no default; assumed $NODEID+0x80",
        "1200h:1 has no default; assumed $NODEID+0x600",
        "1200h:2 has no default; assumed $NODEID+0x580",
        "1400h:1 has no default; assumed $NODEID+0x200",
        "1801h:1 has no default; assumed $NODEID+0x280",
        "1801h:2 has no default; assumed transmission type 255",
    ):
        assert text in lines


def test_identifiers_that_are_not_where_cia_301_has_them_are_told():
    other = BARE.replace("[1200sub1]\nParameterName=S\n", "[1200sub1]\nParameterName=S\nDefaultValue=0x640\n")
    zero = BARE.replace(f"[1014]\n{WITHOUT}", f"[1014]\n{WITHOUT}DefaultValue=0\n")
    for text, complaint in (
        (
            other,
            "1200h:1 is 0x640 for node 9, not $NODEID+0x600 as CiA 301 has an SDO request; assumed that identifier",
        ),
        (zero, "1014h:0 is 0x0, the identifier of NMT; assumed no EMCY"),
    ):
        lines = [
            f"{d.text}; assumed {d.assumed}"
            for d in check(parse_eds((HEAD + text).encode(), "odd.eds"), NODE).diagnoses
        ]
        assert complaint in lines


UNREADABLE = {
    "no number of entries": record("1800", (0, 5, 2), (1, 7, "0x189"), (2, 5, 255))
    + record("1A00", (0, 5, None), (1, 7, "0x20000010")),
    "an object that is not there": record("1800", (0, 5, 2), (1, 7, "0x189"), (2, 5, 255))
    + record("1A00", (0, 5, 1), (1, 7, "0x20010010")),
    "an identifier that is none": record("1800", (0, 5, 2), (1, 7, "0x1zz"), (2, 5, 255))
    + record("1A00", (0, 5, 1), (1, 7, "0x20000010")),
}


@pytest.mark.parametrize("name", UNREADABLE)
def test_a_pdo_that_cannot_be_read_is_not_valid_at_start_and_the_rest_is_served(name):
    """Nothing is guessed of it; a client maps it anew.

    A reset and 1011h bring back what was at start.
    """
    network, device, station = node(BARE + UNREADABLE[name])
    assert len(device.unreadable) == 1
    assert device.unreadable[0].startswith("bare.eds:")
    station.send(0x000, bytes((1, NODE)))
    network.wait_ns(5_000_000)
    assert [frame.can_id for frame in station.take() if frame.can_id < 0x580] == [0x289]  # the other PDO
    assert read(station, 0x1800, 1) & 0x80000000
    assert read(station, 0x1A00, 0) & 0xFF == 0
    for index, subindex, value, size in ((0x1A00, 1, 0x20000010, 4), (0x1A00, 0, 1, 1), (0x1800, 1, 0x189, 4)):
        station.send(
            0x600 + NODE,
            bytes((0x23 | (4 - size) << 2, index & 0xFF, index >> 8, subindex)) + value.to_bytes(4, "little"),
        )
        assert station.wait_for(0x580 + NODE, 5_000_000).data[0] == 0x60
    network.wait_ns(5_000_000)
    assert [frame.data for frame in station.take(0x189)] == [b"\x07\x00"]
    station.send(0x000, bytes((129, NODE)))
    network.wait_ns(5_000_000)
    assert read(station, 0x1800, 1) & 0x80000000
