"""Every data type and access by SDO, several SDO servers at once, sub-index FFh, limits: on an EDS
that has them all.
"""

from __future__ import annotations

import struct

import pytest

from coulombus.eds.reader import parse_eds
from coulombus.node.brake404 import BRAKE404
from coulombus.node.device import SDO_TIMEOUT_NS
from coulombus.node.drive402 import DRIVE402
from coulombus.node.kinds import GENERIC
from node_bench import MS, Bench, SdoAborted

INTEGERS = {8: 0x02, 16: 0x03, 24: 0x10, 32: 0x04, 40: 0x12, 48: 0x13, 56: 0x14, 64: 0x15}
UNSIGNED = {8: 0x05, 16: 0x06, 24: 0x16, 32: 0x07, 40: 0x18, 48: 0x19, 56: 0x1A, 64: 0x1B}
REAL32, REAL64, VISIBLE, OCTETS, UNICODE, TIME, DOMAIN = 0x08, 0x11, 0x09, 0x0A, 0x0B, 0x0C, 0x0F


def section(name: str, data_type: int, access: str = "rw", **keys: object) -> str:
    extra = "".join(f"{key}={value}\n" for key, value in keys.items())
    return f"[{name}]\nParameterName=X {name}\nObjectType=7\nDataType={data_type}\nAccessType={access}\n{extra}\n"


def eds() -> bytes:
    text = "[DeviceInfo]\nVendorName=test\n\n[DummyUsage]\nDummy0005=1\n\n"
    text += section("1000", 7, "ro", DefaultValue=0) + section("1001", 5, "ro", DefaultValue=0)
    for first, types in ((0x2000, INTEGERS), (0x2100, UNSIGNED)):
        for bits, code in types.items():
            text += section(f"{first + bits:04X}", code)
    kinds = {
        0x2200: REAL32,
        0x2201: REAL64,
        0x2202: VISIBLE,
        0x2203: OCTETS,
        0x2204: UNICODE,
        0x2205: TIME,
        0x2206: DOMAIN,
    }
    for index, code in kinds.items():
        text += section(f"{index:04X}", code)
    text += section("2210", REAL64, LowLimit=-1.5, HighLimit=2.5) + section(
        "2211", 0x10, LowLimit=-8000000, HighLimit=5
    )
    for k, access in enumerate(("ro", "const", "wo", "rw", "rwr", "rww")):
        text += section(f"{0x2220 + k:04X}", 6, access, DefaultValue=7)
    text += "[607D]\nParameterName=Software position limit\nObjectType=8\nSubNumber=3\n\n"
    text += section("607Dsub0", 5, "const", DefaultValue=2)
    text += section("607Dsub1", 4, DefaultValue=-5) + section("607Dsub2", 4, DefaultValue=5)
    for index in range(0x1200, 0x1280):
        access, word = ("ro", "$NODEID+0x600") if index == 0x1200 else ("rw", "0x80000000")
        text += f"[{index:04X}]\nParameterName=SDO\nObjectType=9\nSubNumber=3\n\n"
        text += section(f"{index:04X}sub0", 5, "const", DefaultValue=2)
        text += section(f"{index:04X}sub1", 7, access, DefaultValue=word)
        text += section(f"{index:04X}sub2", 7, access, DefaultValue=word.replace("600", "580"))
    return text.encode()


def powered(node_id: int = 3) -> Bench:
    bench = Bench("types", node_id, kind=GENERIC, eds=parse_eds(eds(), "types.eds"))
    bench.power_on()
    bench.take()
    return bench


@pytest.mark.parametrize(("first", "signed"), [(0x2000, True), (0x2100, False)])
def test_integers_of_every_width(first, signed):
    bench = powered()
    for bits in INTEGERS:
        size = bits // 8
        low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if signed else (0, (1 << bits) - 1)
        for value in (low, high, 0, 1, -1 if signed else high - 1):
            data = value.to_bytes(size, "little", signed=signed)
            bench.download(first + bits, 0, data)
            assert bench.upload(first + bits) == data
            assert bench.device[first + bits, 0] == value
        for wrong, abort in ((size + 1, "06070012"), (size - 1, "06070013")):
            if wrong:
                with pytest.raises(SdoAborted, match=abort):
                    bench.download(first + bits, 0, bytes(wrong))


def test_reals_strings_times_and_domains():
    bench = powered()
    for value in (0.0, -1.5, 1e300):
        bench.download(0x2201, 0, struct.pack("<d", value))
        assert struct.unpack("<d", bench.upload(0x2201)) == (value,)
    bench.download(0x2200, 0, struct.pack("<f", 0.1))
    assert bench.upload(0x2200) == struct.pack("<f", 0.1)
    for index in (0x2202, 0x2203, 0x2206):
        for data in (b"", b"a", b"abcd", b"abcde", bytes(range(256)) * 3):
            bench.download(index, 0, data)
            assert bench.upload(index) == data
    bench.download(0x2204, 0, "Kraft √".encode("utf-16-le"))
    assert bench.upload(0x2204).decode("utf-16-le") == "Kraft √"
    bench.download(0x2205, 0, b"\x01\x02\x03\x04\x05\x06")
    assert bench.upload(0x2205) == b"\x01\x02\x03\x04\x05\x06"


def test_limits_of_wide_types():
    bench = powered()
    for value, abort in ((2.6, "06090031"), (-1.6, "06090032")):
        with pytest.raises(SdoAborted, match=abort):
            bench.download(0x2210, 0, struct.pack("<d", value))
    for number, abort in ((6, "06090031"), (-8000001, "06090032")):
        with pytest.raises(SdoAborted, match=abort):
            bench.write(0x2211, 0, number, 3)
    bench.write(0x2211, 0, -8000000, 3)
    assert bench.number(0x2211, signed=True) == -8000000


def test_access_types():
    bench = powered()
    for k, access in enumerate(("ro", "const", "wo", "rw", "rwr", "rww")):
        if access == "wo":
            with pytest.raises(SdoAborted, match="06010001"):
                bench.number(0x2220 + k)
        else:
            assert bench.number(0x2220 + k) == 7
        if access in ("ro", "const"):
            with pytest.raises(SdoAborted, match="06010002"):
                bench.write(0x2220 + k, 0, 8, 2)
        else:
            bench.write(0x2220 + k, 0, 8, 2)
            assert bench.device[0x2220 + k, 0] == 8


def test_a_minimum_above_its_maximum_is_refused():
    bench = powered()
    with pytest.raises(SdoAborted, match="06090036"):
        bench.write(0x607D, 1, 6, 4)
    with pytest.raises(SdoAborted, match="06090036"):
        bench.write(0x607D, 2, -6, 4)
    bench.write(0x607D, 2, 10, 4)
    bench.write(0x607D, 1, 6, 4)
    assert bench.number(0x607D, 1) == 6


def test_sub_index_255_tells_the_structure():
    bench = Bench("motor", 1)
    bench.power_on()
    # object code in the low byte, data type above it
    assert bench.number(0x1000, 0xFF) == 0x0007_07
    assert bench.number(0x1008, 0xFF) == 0x0009_07
    assert bench.number(0x1003, 0xFF) == 0x0007_08
    assert bench.number(0x1018, 0xFF) == 0x0023_09
    assert bench.number(0x1400, 0xFF) == 0x0020_09
    assert bench.number(0x1A00, 0xFF) == 0x0021_09
    assert bench.number(0x1200, 0xFF) == 0x0022_09
    assert len(bench.upload(0x1017, 0xFF)) == 4
    with pytest.raises(SdoAborted, match="06020000"):
        bench.number(0x1FFF, 0xFF)
    with pytest.raises(SdoAborted, match="06010002"):
        bench.write(0x1018, 0xFF, 0, 4)


def ask(bench: Bench, can_id: int, request: str) -> list[tuple[int, bytes]]:
    bench.frame(can_id, bytes.fromhex(request).ljust(8, b"\0"))
    while bench.node.outbox_count:
        bench.run(100_000)
    return [(frame.can_id, frame.data) for frame in bench.take()]


@pytest.mark.parametrize("index", [0x1201, 0x127F])
def test_another_server_serves_as_the_first_does(index):
    bench = powered()
    assert ask(bench, 0x6E0 - 1, "40001000") == []
    bench.write(index, 1, 0x6D0, 4)
    assert ask(bench, 0x6D0, "40001000") == []  # both identifiers have to be valid
    bench.write(index, 2, 0x5D0 - 0x50, 4)
    assert ask(bench, 0x6D0, "40001000") == [(0x580, bytes.fromhex("4300100000000000"))]
    assert ask(bench, 0x603, "40001000") == [(0x583, bytes.fromhex("4300100000000000"))]
    bench.write(index, 1, 0x800006D0, 4)
    assert ask(bench, 0x6D0, "40001000") == []


@pytest.mark.parametrize("word", [0x601, 0x581, 0x000, 0x701, 0x200006D0, 0x1000])
def test_identifiers_that_no_server_may_have(word):
    bench = powered()
    with pytest.raises(SdoAborted, match="06090030"):
        bench.write(0x1201, 1, word, 4)


def test_the_identifier_of_a_valid_server_stands_and_no_two_are_alike():
    bench = powered()
    bench.write(0x1201, 1, 0x6D0, 4)
    with pytest.raises(SdoAborted, match="06090030"):
        bench.write(0x1201, 1, 0x6D1, 4)
    with pytest.raises(SdoAborted, match="06040043"):
        bench.write(0x1202, 1, 0x6D0, 4)
    with pytest.raises(SdoAborted, match="06010002"):
        bench.write(0x1200, 1, 0x6D2, 4)


def test_two_clients_at_once_do_not_disturb_each_other():
    bench = powered()
    bench.download(0x2206, 0, bytes(range(200)) * 10)
    bench.write(0x1201, 1, 0x6D0, 4)
    bench.write(0x1201, 2, 0x580, 4)
    bench.take()
    first = ask(bench, 0x603, "a406220014")  # block upload, 20 segments a block
    assert first[0][1][0] == 0xC6
    ask(bench, 0x6D0, "210222000c000000")  # and a segmented download
    bench.frame(0x603, b"\xa3" + bytes(7))
    bench.frame(0x6D0, b"\x00" + b"seven 7")
    bench.run(5 * MS)
    got = bench.take()
    assert [frame.data for frame in got if frame.can_id == 0x580] == [b"\x20" + bytes(7)]
    assert [frame.data[0] & 0x7F for frame in got if frame.can_id == 0x583] == list(range(1, 21))
    assert ask(bench, 0x6D0, "6000000000000000")[0][1][0] == 0x80  # a mistake of the one
    assert len(ask(bench, 0x603, "a21414")) == 20  # is nothing to the other
    bench.frame(0x6D0, bytes.fromhex("4006220000000000"))
    bench.take()
    bench.run(SDO_TIMEOUT_NS + MS)  # both stop midway
    late = sorted((frame.can_id, frame.data.hex()) for frame in bench.take())
    assert late == [(0x580, "8006220000000405"), (0x583, "8006220000000405")]


@pytest.mark.parametrize("kind", [DRIVE402, BRAKE404])
def test_the_core_leaves_alone_what_another_maker_defines(kind):
    """2001h, 2002h and 2005h of another maker are no set-point age, no SYNC time-out and
    no ramp.
    """
    text = section("1000", 7, "ro", DefaultValue=0) + section("1001", 5, "ro", DefaultValue=0)
    text += (
        section("2001", 6, DefaultValue=1) + section("2002", 5, DefaultValue=5) + section("2005", 9, DefaultValue="x")
    )
    bench = Bench("other", 3, kind=kind, eds=parse_eds(text.encode(), "other.eds"))
    bench.power_on()
    bench.nmt(1)
    bench.sync()
    bench.run(10 * MS)
    assert bench.emcy() == []
    assert bench.number(0x2002) == 5
    assert bench.upload(0x2005) == b"x"


@pytest.mark.parametrize("code", [VISIBLE, OCTETS, TIME, DOMAIN, 0xFFFFF])
def test_a_core_object_of_a_type_that_is_no_number_is_served_as_it_is(code):
    text = section("1000", 7, "ro", DefaultValue=0)
    for index in ("1001", "6040", "6071", "6072"):
        text += section(index, code)
    bench = Bench("odd", 3, kind=DRIVE402, eds=parse_eds(text.encode(), "odd.eds"))
    bench.power_on()
    bench.nmt(1)
    content = bytes(range(1, 7))
    bench.download(0x6040, 0, content)
    bench.run(MS)
    assert bench.upload(0x6040) == content
    assert bench.upload(0x6040, 0xFF) == bytes((7, code & 0xFF, code >> 8 & 0xFF, 0))
    assert bench.node.out_torque_pm == 0


@pytest.mark.parametrize("digits", [-0x80000000, 0x7FFFFFFF, 255])
def test_decimals_beyond_a_float_and_a_scale_without_length(digits):
    text = section("1000", 7, "ro", DefaultValue=0)
    for index, default in (("6132", digits), ("6302", digits), ("7320", 7), ("7322", 7)):
        text += f"[{index}]\nParameterName=X\nObjectType=8\nSubNumber=2\n\n" + section(
            f"{index}sub0", 5, DefaultValue=1
        )
        text += section(f"{index}sub1", 4, DefaultValue=default)
    bench = Bench("odd", 3, kind=BRAKE404, eds=parse_eds(text.encode(), "odd.eds"))
    bench.power_on()
    bench.nmt(1)
    bench.sync()
    assert bench.number(0x6132, 1) == digits & 0xFFFFFFFF
    assert bench.node.out_brake_Nm == 0


def test_a_time_of_day_travels_in_a_pdo():
    text = section("1000", 7, "ro", DefaultValue=0) + section("2000", TIME, "rww", PDOMapping=1)
    for index, subs in (("1400", ("0x201", "255")), ("1600", ("0x20000030",))):
        text += f"[{index}]\nParameterName=X\nObjectType=9\nSubNumber={len(subs) + 1}\n\n"
        text += section(f"{index}sub0", 5, DefaultValue=len(subs))
        for k, word in enumerate(subs, 1):
            text += section(f"{index}sub{k}", 5 if word == "255" else 7, DefaultValue=word)
    bench = Bench("time", 1, kind=GENERIC, eds=parse_eds(text.encode(), "time.eds"))
    bench.power_on()
    bench.nmt(1)
    bench.frame(0x201, bytes(range(1, 7)))
    assert bench.upload(0x2000) == bytes(range(1, 7))
