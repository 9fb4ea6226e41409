"""LSS as the master: devices without a node id are found and numbered."""

from __future__ import annotations

import pytest

from coulombus.eds.cia305 import LssState
from coulombus.host.devices.lss import Identity, LssMaster, LssRefused, rate_index
from coulombus.host.devices.numbering import check_free, give, only
from coulombus.host.errors import DeviceMismatch, NodeMissing
from devices_bench import UNCONFIGURED, DevicesLink, eds

S = 1_000_000_000


def bus(*serials, latency_ns=0):
    """Return a link with a motor that has the node id 1, and devices without one."""
    link = DevicesLink()
    link.add(eds("motor"), 1)
    for k, serial in enumerate(serials):
        device = link.add(eds("motor", vendor=0x77, serial=serial), UNCONFIGURED)
        device.record["processing_ns"] = latency_ns * k
    return link


def serials(found):
    return sorted(one.serial for one in found)


@pytest.mark.parametrize("latency_ns", [0, 300_000, 3_000_000])
def test_all_devices_without_a_node_id_are_found(latency_ns):
    """Also those that answer later than the others: their answers are none to the next step."""
    link = bus(0, 0xFFFFFFFF, 0x12345678, latency_ns=latency_ns)
    with LssMaster(link) as master:
        found = master.unconfigured()
    assert serials(found) == [0, 0x12345678, 0xFFFFFFFF]
    assert {one[:3] for one in found} == {(0x77, 0x402, 0x10000)}
    assert all(device.lss.state is LssState.WAITING for device in link.devices)


def test_slow_devices_are_found_with_patience():
    link = bus(5, 9, latency_ns=45_000_000)
    with LssMaster(link) as master:
        assert serials(master.unconfigured()) == [5, 9]


def test_no_device_is_found_where_none_is():
    link = bus()
    with LssMaster(link) as master:
        assert master.unconfigured() == []
    assert link.t < S // 5


def test_two_devices_of_one_serial_number_are_told():
    link = bus(7, 7)
    with LssMaster(link) as master:
        assert len(master.unconfigured()) == 1  # they answer as one; both are in LSS configuration


def test_answers_that_fit_nothing_end_the_scan():
    link = DevicesLink()
    link.others.append(lambda can_id, data: [(0x7E4, b"\x4f" + bytes(7))] if data[:1] == b"\x51" and data[5] else [])
    with pytest.raises(NodeMissing, match="no identity that fits"), LssMaster(link) as master:
        master.unconfigured()


def test_a_device_boots_with_the_node_id_that_it_is_given():
    link = bus(7, 8)
    with LssMaster(link) as master:
        found = master.unconfigured()
        check_free(link, [10, 11], str)
        told = [give(master, link, one, 10 + k, store=True) for k, one in enumerate(found)]
    assert [(one.node_id, one.before, one.booted, one.stored) for one in told] == [
        (10, None, True, True),
        (11, None, True, True),
    ]
    assert [device.node_id for device in link.devices] == [1, 10, 11]
    assert "node id 10 (was none), stored, booted" in str(told[0])


def test_a_device_that_has_a_node_id_gets_another_one():
    link = bus(7)
    identity = Identity(0x4C0, 0x402, 0x10000, 1)
    with LssMaster(link) as master:
        told = give(master, link, identity, 5)
    assert (told.before, told.booted, told.stored) == (1, True, False)
    assert [device.node_id for device in link.devices] == [5, UNCONFIGURED]


def test_a_bit_rate_is_given_and_stored():
    link = bus(7)
    with LssMaster(link) as master:
        (found,) = master.unconfigured()
        told = give(master, link, found, None, bit_s=500_000, store=True)
    assert link.devices[1].lss.persistent_rate == rate_index(500_000) == 2
    assert told.booted is None
    with pytest.raises(ValueError, match="expected one of 1000000, 800000"):
        rate_index(123)


def test_taken_ids_and_ids_beyond_the_last_are_refused():
    link = bus(7, 8)
    with pytest.raises(DeviceMismatch, match="has the node id 1 already"):
        check_free(link, [127, 1], str)
    with pytest.raises(DeviceMismatch, match="the last one is 127"):
        check_free(link, [127, 128], str)


def test_which_device_is_meant_has_to_be_clear():
    one = Identity(1, 2, 3, 4)
    assert only([one]) == one
    with pytest.raises(NodeMissing, match="--device"):
        only([])
    with pytest.raises(DeviceMismatch, match="--all"):
        only([one, one])


def test_an_absent_device_and_a_refusal_are_told():
    link = bus(7)
    with LssMaster(link) as master:
        with pytest.raises(NodeMissing, match="00000001:00000002"):
            give(master, link, Identity(1, 2, 3, 4), 9)
        link.tamper = lambda frame: [
            type(frame)(frame.t_ns, frame.can_id, frame.data[:1] + b"\1" + frame.data[2:], 8)
            if frame.can_id == 0x7E4 and frame.data[0] == 0x11
            else frame
        ]
        (found,) = master.unconfigured()
        with pytest.raises(LssRefused, match="node id 9: the node id is out of range"):
            give(master, link, found, 9)


@pytest.mark.parametrize("text", ["", "1:2:3", "1:2:3:g", "1:2:3:-4", "1:2:3:123456789", "1:2:3:4:5"])
def test_an_identity_that_is_none_is_refused(text):
    with pytest.raises(ValueError, match="expected VENDOR:PRODUCT:REVISION:SERIAL"):
        Identity.parse(text)


def test_an_identity_reads_what_it_prints():
    one = Identity(0x4C0, 0x402, 0x10000, 0xFFFFFFFF)
    assert Identity.parse(str(one)) == one
