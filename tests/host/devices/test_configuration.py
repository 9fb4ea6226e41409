"""A device's configuration as a DCF: dumped, compared, restored; what acts is left out."""

from __future__ import annotations

import re

import pytest

from coulombus.eds.dcf_text import configured, with_values
from coulombus.eds.reader import parse_eds
from coulombus.host.devices.configuration import Restored, acts, check_file, differences, dump, restore
from coulombus.host.devices.device import KnownDevice, describe
from coulombus.host.errors import DeviceMismatch
from coulombus.host.sdo.sdo_client import SdoClient
from devices_bench import DevicesLink, eds
from eds_edit import edit

MOTOR = eds("motor")


def bench(name="motor", node_id=1, description=None):
    link = DevicesLink()
    link.add(description or eds(name), node_id)
    client = SdoClient(link, node_id)
    return link, KnownDevice(client, describe(client, None))


def dcf_of(device, values=None, node_id=1):
    found = dump(device).values if values is None else values
    return parse_eds(with_values(device.description, found, node_id, 500_000).encode(), "x.dcf")


@pytest.mark.parametrize(("name", "node_id"), [("motor", 1), ("mr_brake", 44)])
def test_a_dump_is_a_dcf_that_holds_what_the_device_holds(name, node_id):
    _, device = bench(name, node_id)
    device.client.download(0x1017, 0, b"\x7b\0")
    found = dump(device)
    dcf = dcf_of(device, found.values, node_id)
    assert [one.severity for one in dcf.diagnoses if one.severity == "error"] == []
    assert set(configured(dcf)) == set(found.values)
    assert dcf.default(0x1017, 0, node_id) == 123
    assert (dcf.node_id, dcf.bit_rate) == (node_id, 500_000)
    values = check_file(device, dcf)
    assert len(values) == len(found.values) > 100
    assert differences(device, dcf, values) == []
    assert found.aborted == ()


def test_a_value_that_the_file_does_not_admit_is_told_and_left_out():
    _, device = bench()
    device = KnownDevice(device.client, parse_eds(edit(MOTOR.text, "1017", LowLimit="5").encode(), "strict.eds"))
    found = dump(device)
    assert (0x1017, 0) not in found.values
    assert found.aborted == ("1017h:00: it holds 0; the EDS file admits 5 to 65535",)


def test_what_acts_is_neither_dumped_nor_restored():
    _, device = bench()
    found = dump(device)
    assert {(0x6040, 0), (0x6071, 0), (0x1010, 1), (0x1011, 1)} <= set(found.left_out)
    text = with_values(device.description, {(0x6040, 0): 15, (0x6071, 0): 500, (0x1017, 0): 9}, 1)
    assert check_file(device, parse_eds(text.encode(), "x.dcf")) == {(0x1017, 0): 9}
    assert acts(MOTOR.variable(0x1017, 0), [(0x1017, 0)])
    assert not acts(MOTOR.variable(0x1017, 0))


def test_the_controlword_of_a_drives_second_axis_acts_too():
    variable = parse_eds(re.sub(r"(?i)\[6040\]", "[6840]", MOTOR.text).encode(), "x.eds").variable(0x6840, 0)
    assert acts(type(variable)(**{**vars(variable), "access": "rw"}))


def test_only_what_differs_is_written():
    link, device = bench()
    dcf = dcf_of(device)
    device.client.download(0x1017, 0, b"\x7b\0")
    device.client.download(0x2004, 0, b"another label")
    found = differences(device, dcf, values := check_file(device, dcf))
    assert [(one.place, one.held, one.wanted) for one in found] == [
        ((0x1017, 0), 123, 0),
        ((0x2004, 0), "another label", dcf.default(0x2004, 0, 1)),
    ]
    before = len(link.sent)
    told = restore(KnownDevice(device.client, dcf), values, found)
    assert (told.written, told.failed) == ([(0x1017, 0), (0x2004, 0)], [])
    begun = {data[1:4] for can_id, data in link.sent[before:] if can_id == 0x601 and data[0] >> 5 in (1, 2)}
    assert begun == {b"\x17\x10\0", b"\x04\x20\0"}
    assert differences(device, dcf, values) == []


def test_a_pdo_is_invalid_while_its_mapping_changes_and_valid_at_the_end():
    _, device = bench()
    dcf = dcf_of(device)
    for index, sub, value in ((0x1800, 1, 0x80000181), (0x1A00, 0, 0), (0x1A00, 1, 0x10010008), (0x1A00, 0, 1)):
        device.client.download(index, sub, value.to_bytes(1 if sub == 0 else 4, "little"))
    device.client.download(0x1800, 1, (0x181).to_bytes(4, "little"))
    values = check_file(device, dcf)
    found = differences(device, dcf, values)
    assert {one.place for one in found} == {(0x1A00, 0), (0x1A00, 1)}
    told = restore(KnownDevice(device.client, dcf), values, found)
    assert told.failed == []
    assert set(told.written) == {(0x1A00, 0), (0x1A00, 1)}
    assert differences(device, dcf, values) == []
    assert device.client.upload(0x1800, 1) == (0x181).to_bytes(4, "little")


def test_a_mapping_that_is_refused_leaves_the_pdo_invalid_and_says_so():
    _, device = bench()
    values = dump(device).values | {(0x1A00, 1): 0x10180120}  # 1018h:01 cannot be mapped
    dcf = dcf_of(device, values)
    values = check_file(device, dcf)
    told = restore(KnownDevice(device.client, dcf), values, differences(device, dcf, values))
    assert told.written == []
    assert any("0x06040041" in text for text in told.failed)
    assert "stays invalid" in told.failed[-1]
    assert device.client.upload(0x1800, 1)[3] & 0x80


def test_a_device_that_refuses_each_write_is_told_object_by_object():
    link, device = bench()
    dcf = dcf_of(device, dump(device).values | {(0x1017, 0): 5, (0x1800, 2): 254})
    original = link.send

    def send(can_id, data=b"", length=None):
        if can_id == 0x601 and data[0] >> 5 == 1:
            link.put(0x581, b"\x80" + data[1:4] + b"\x22\x00\x00\x08")
        else:
            original(can_id, data, length)

    link.send = send
    values = check_file(device, dcf)
    found = differences(device, dcf, values)
    told = restore(KnownDevice(device.client, dcf), values, found)
    assert told.written == []
    assert len(told.failed) == len(found) == 2
    assert all("because of the present device state" in text for text in told.failed)


def test_who_is_interrupted_knows_what_was_written():
    _, device = bench()
    dcf = dcf_of(device, dump(device).values | {(0x100C, 0): 5, (0x1017, 0): 5})
    values, told = check_file(device, dcf), Restored()

    def interrupt(done, total):
        if done:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        restore(KnownDevice(device.client, dcf), values, differences(device, dcf, values), interrupt, told)
    assert told.written == [(0x100C, 0)]


@pytest.mark.parametrize(
    ("text", "why"),
    [
        (MOTOR.text, "gives no values"),
        (edit(MOTOR.text, "1017", ParameterValue="fast"), "1017.*correct the file first"),
        (
            edit(edit(MOTOR.text, "1017", ParameterValue="5"), "1018sub1", DefaultValue="0x77"),
            "is of the device 1018h 0x00000077",
        ),
    ],
)
def test_a_file_that_is_none_of_this_device_is_refused(text, why):
    _, device = bench()
    with pytest.raises(DeviceMismatch, match=why) as caught:
        check_file(device, parse_eds(text.encode(), "x.dcf"))
    assert caught.value.exit_status == 3


def test_values_of_compact_objects_stand_in_a_section_of_their_own():
    text = (
        "[2000]\nParameterName=Row\nObjectType=0x8\nDataType=0x0006\nAccessType=rw\nCompactSubObj=3\nDefaultValue=1\n"
        "\n[2000Value]\nNrOfEntries=1\n1=9\n\n[2001]\nParameterName=B\nObjectType=7\nDataType=0x000A\nAccessType=rw\n"
    )
    description = parse_eds(text.encode(), "x.eds")
    assert configured(description) == ((0x2000, 1),)
    dcf = parse_eds(
        with_values(description, {(0x2000, 2): 7, (0x2000, 3): 8, (0x2001, 0): b"\1\2"}, 5).encode(), "y.dcf"
    )
    assert set(configured(dcf)) == {(0x2000, 2), (0x2000, 3), (0x2001, 0)}
    assert [dcf.default(0x2000, sub, 5) for sub in (1, 2, 3)] == [1, 7, 8]
    assert dcf.default(0x2001, 0, 5) == b"\1\2"


@pytest.mark.parametrize(
    ("code", "value"), [(0x0008, 1.5), (0x0011, -1e-300), (0x0003, -2), (0x0001, 1), (0x001B, 2**64 - 1)]
)
def test_every_kind_of_number_survives_the_file(code, value):
    text = f"[2000]\nParameterName=A\nObjectType=7\nDataType=0x{code:04X}\nAccessType=rw\nParameterValue=1\n"
    description = parse_eds(text.encode(), "x.eds")
    written = with_values(description, {(0x2000, 0): value}, 5)
    assert parse_eds(written.encode(), "y.dcf").default(0x2000, 0, 5) == value
    assert written.count("ParameterValue") == 1


def test_a_file_keeps_its_line_ends():
    crlf = parse_eds(MOTOR.text.replace("\n", "\r\n").encode(), "x.eds")
    written = with_values(crlf, {(0x1017, 0): 5}, 1)
    assert "\n" not in written.replace("\r\n", "")
