"""Objects by number and by name, values with types, limits and units; the EDS file of a node."""

from __future__ import annotations

import json

import pytest

from coulombus.eds.cia301 import DATA_TYPES
from coulombus.eds.data import decode, encode
from coulombus.eds.reader import Variable, parse_eds
from coulombus.eds.units import Unit, fixed_unit, unit_from_code
from coulombus.host.devices.device import KnownDevice, ObjectUnknown, ValueRefused, describe
from coulombus.host.errors import DeviceMismatch
from coulombus.host.sdo.sdo_client import SdoClient
from devices_bench import DevicesLink, Server, eds


@pytest.fixture
def link():
    link = DevicesLink()
    link.add(eds("motor"), 1)
    link.add(eds("mr_brake"), 2)
    return link


def device(link, node_id, description=None, **options):
    client = SdoClient(link, node_id)
    return KnownDevice(client, description or describe(client, None), **options)


def of_type(data_type, **keys):
    values = {"low": None, "high": None, "access": "rw", **keys}
    return Variable(0x2000, 0, "x", data_type, values["access"], None, False, values["low"], values["high"], False, 1)


@pytest.mark.parametrize(
    "text",
    [
        "1018h:01",
        "1018:1",
        "0x1018:0x01",
        "1018.01",
        "Identity_object.Vendor-ID",
        "identity object.vendor-id",
        "vendor-id",
    ],
)
def test_an_object_has_many_names(link, text):
    found = device(link, 1).find(text)
    assert (found.index, found.subindex) == (0x1018, 1)


def test_sub_indices_are_hexadecimal_as_everywhere(link):
    assert device(link, 1).find("1003h:08").subindex == 8
    assert device(link, 1).find("2000h:10").subindex == 0x10


def test_every_name_leads_to_its_own_object(link):
    for node_id in (1, 2):
        one = device(link, node_id)
        assert len(one.names) == len(list(one.variables()))
        for name, variable in one.names.items():
            assert one.find(name) == variable
            assert " " not in name


def test_names_that_stand_twice_have_their_numbers_behind_them(link):
    rows = ((0x2000, "Digital inputs"), (0x2001, "Digital Inputs"), (0x2002, "Other"))
    body = "\nObjectType=7\nDataType=5\nAccessType=rw\n"
    text = "".join(f"[{index:04X}]\nParameterName={name}{body}" for index, name in rows)
    one = KnownDevice(SdoClient(link, 1), parse_eds(text.encode(), "x.eds"))
    assert list(one.names) == ["Digital_inputs_2000h00", "Digital_Inputs_2001h00", "Other"]
    assert [one.find(name).index for name in one.names] == [0x2000, 0x2001, 0x2002]
    with pytest.raises(ObjectUnknown, match=r"did you mean Digital_[iI]nputs_200"):
        one.find("digital_inputs")


def test_an_unknown_name_is_told_with_the_nearest(link):
    with pytest.raises(ObjectUnknown, match="did you mean Producer_heartbeat_time"):
        device(link, 1).find("producer_hartbeat_time")
    with pytest.raises(ObjectUnknown, match="`ls`"):
        device(link, 1).find("zzzzzzzzzzzz")
    with pytest.raises(ObjectUnknown, match="without an EDS file"):
        KnownDevice(SdoClient(link, 1)).find("vendor")


def test_values_have_types_and_units(link):
    brake, motor = device(link, 2), device(link, 1)
    link.devices[1][0x7300, 1] = -1500
    for one, name, value, unit in (
        (motor, "1017h", 0, "ms"),
        (motor, "6076h", 180, "mNm"),
        (motor, "1008h", "Coulombus motor drive", ""),
        (brake, "7300h:01", -1.5, "Nm"),
        (brake, "1800h:05", 0, "ms"),
    ):
        reading = one.read(one.find(name))
        assert (reading.value, reading.unit) == (value, unit), name
        json.dumps(reading.as_dict(one.node_id), allow_nan=False)
    assert brake.read(brake.find("7300h:01")).raw == -1500
    assert str(brake.read(brake.find("7300h:01"))) == "-1.5 Nm (FA24h)"


@pytest.mark.parametrize(
    ("answer", "raw", "remark"),
    [
        (b"\x4b%b\x34\x12\xaa\xbb", 0x1234, ""),
        (b"\x42%b\x34\x12\xaa\xbb", 0x1234, ""),  # nobody says how many of the four count: the type does
        (b"\x43%b\x34\x12\0\0", 0x1234, ""),
        (b"\x43%b\x34\x12\xaa\xbb", "3412aabb", "1017h:00 has 4 bytes in the device; UNSIGNED16 has 2 (motor.eds)"),
        (b"\x4f%b\x34\0\0\0", "34", "1017h:00 has 1 bytes in the device; UNSIGNED16 has 2 (motor.eds)"),
    ],
)
def test_an_object_of_another_length_is_told_as_that(answer, raw, remark):
    link = DevicesLink()
    Server(link, 5, lambda request: [answer % request[1:4]])
    one = KnownDevice(SdoClient(link, 5), eds("motor"))
    reading = one.read(one.find("1017h"))
    assert (reading.raw, reading.remark) == (raw, remark)


def test_a_rig_files_units_go_before_cias(link):
    one = device(link, 1, units={(0x1017, 0): Unit(1e-3, "s")})
    one.write(one.find("1017h"), one.parse(one.find("1017h"), "0.25 s"))
    reading = one.read(one.find("1017h"))
    assert (reading.raw, reading.value, reading.unit) == (250, 0.25, "s")


def test_without_an_eds_file_numbers_are_unsigned_and_texts_are_bytes(link):
    one = KnownDevice(SdoClient(link, 1))
    assert one.read(one.find("1000h")).value == 0x00020192
    assert one.read(one.find("1008h")).value == b"Coulombus motor drive".hex(" ")
    with pytest.raises(ValueRefused, match="--type"):
        one.parse(one.find("1017h"), "5")
    assert one.parse(one.find("1017h"), "5", type_name="unsigned16") == b"\5\0"
    with pytest.raises(ValueRefused, match="expected one of BOOLEAN"):
        one.parse(one.find("1017h"), "5", type_name="word")


@pytest.mark.parametrize(
    ("variable", "text", "data"),
    [
        (of_type(0x0003), "-2", b"\xfe\xff"),
        (of_type(0x0006), "0x1F", b"\x1f\0"),
        (of_type(0x0006), "1Fh", b"\x1f\0"),
        (of_type(0x0001), "true", b"\1"),
        (of_type(0x0010), "-1", b"\xff\xff\xff"),
        (of_type(0x0008), "1.5", b"\0\0\xc0\x3f"),
        (of_type(0x0011), "-1e300", b"\x9c\x75\0\x88\x3c\xe4\x37\xfe"),
        (of_type(0x0009), "a text", b"a text"),
        (of_type(0x000A), "0A 0b", b"\x0a\x0b"),
        (of_type(0x001B), str(2**64 - 1), b"\xff" * 8),
    ],
)
def test_a_value_is_written_as_its_type_has_it(link, variable, text, data):
    found = device(link, 1).parse(variable, text)
    assert found == data
    kind = DATA_TYPES[variable.data_type].kind
    if kind not in ("text", "bytes"):
        assert encode(variable, decode(variable, found)) == found


@pytest.mark.parametrize(
    ("variable", "text", "why"),
    [
        (of_type(0x0006), "65536", "expected 0 to 65535"),
        (of_type(0x0006), "-1", "expected 0 to 65535"),
        (of_type(0x0003, low=-5, high=7), "8", "expected -5 to 7"),
        (of_type(0x0003, low=-5, high=7), "-6", "expected -5 to 7"),
        (of_type(0x0006), "1.5", "not a whole number"),
        (of_type(0x0006), "1e999", "too large"),
        (of_type(0x0008), "1e39", "out of range"),
        (of_type(0x0008), "nan", "not a number"),
        (of_type(0x0006), "", "not a number"),
        (of_type(0x0006), "1.2.3", "not a number"),
        (of_type(0x0006), "five", "not a number"),
        (of_type(0x0006), "5 ms", "no unit"),
        (of_type(0x000A), "xyz", "hexadecimal"),
        (of_type(0x0006, access="ro"), "1", "can only be read"),
        (of_type(0x0006, access="const"), "1", "can only be read"),
        (of_type(0), "1", "type is not known"),
    ],
)
def test_a_value_that_does_not_fit_is_refused_before_it_is_sent(link, variable, text, why):
    one = device(link, 1)
    with pytest.raises(ValueRefused, match=why) as caught:
        one.parse(variable, text)
    assert caught.value.exit_status == 2


def test_a_value_in_units_becomes_counts_or_is_refused(link):
    brake = device(link, 2)
    setpoint = brake.find("7300h:01")
    assert brake.parse(setpoint, "0.5 Nm") == (500).to_bytes(2, "little")
    assert brake.parse(setpoint, "0.5Nm") == (500).to_bytes(2, "little")
    with pytest.raises(ValueRefused, match=r"between two counts; the nearest value is 0\.5 Nm"):
        brake.parse(setpoint, "0.50033 Nm")
    with pytest.raises(ValueRefused, match="its unit is 'Nm'"):
        brake.parse(setpoint, "0.5 A")


def test_what_is_written_is_read_back(link):
    one = device(link, 1)
    assert one.write(one.find("1017h"), b"\x64\0").raw == 100
    assert one.write(Variable(**{**vars(one.find("1017h")), "access": "wo"}), b"\x65\0") is None


def test_the_eds_file_is_found_by_the_identity(link, tmp_path):
    client = SdoClient(link, 1)
    assert describe(client, None).path.endswith("motor.eds")
    (tmp_path / "m.eds").write_text(eds("motor").text)
    (tmp_path / "corrupt.eds").write_bytes(b"\0" * 100)
    assert describe(client, tmp_path).path == str(tmp_path / "m.eds")
    assert describe(client, tmp_path / "m.eds").has(0x6041)
    assert describe(client, "device").has(0x6041)
    with pytest.raises(DeviceMismatch, match="none of 1 EDS files"):
        describe(SdoClient(link, 2), tmp_path)
    with pytest.raises(DeviceMismatch, match="is the file of 0x000004c0 0x00000402"):
        describe(SdoClient(link, 2), tmp_path / "m.eds")


def test_a_stranger_has_no_eds_file(link):
    Server(link, 5, lambda request: [b"\x80" + request[1:4] + b"\0\0\x02\x06"])
    assert describe(SdoClient(link, 5), None) is None


@pytest.mark.parametrize(
    ("place", "expected"),
    [
        ((0x1017, 0), Unit(1, "ms")),
        ((0x1400, 5), Unit(1, "ms")),
        ((0x1803, 3), Unit(0.1, "ms")),
        ((0x6879, 0), Unit(1, "mV")),
    ],
)
def test_units_that_the_standards_fix(place, expected):
    assert fixed_unit(*place) == expected


@pytest.mark.parametrize("place", [(0x1000, 0), (0x1017, 1), (0x1400, 1), (0x2017, 0), (0x607A, 0)])
def test_what_has_no_fixed_unit(place):
    assert fixed_unit(*place) is None


def test_units_that_a_device_tells():
    assert unit_from_code(0x00560000, 3) == Unit(1e-3, "Nm")
    assert unit_from_code(0xFD040000, 0) == Unit(1e-3, "A")
    assert unit_from_code(0x00560300, 0) is None  # per second
    assert unit_from_code(0x00990000, 0) is None
    assert unit_from_code(0x00560000, 200) is None
