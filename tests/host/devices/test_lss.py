"""LSS as the master: devices without a node id are found and numbered."""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coulombus.eds.cia305 import LssState
from coulombus.host.devices.lss import Identity, LssMaster, LssRefused, rate_index
from coulombus.host.devices.numbering import check_free, give, only
from coulombus.host.errors import AnswerUntrusted, DeviceMismatch, NodeMissing
from devices_bench import UNCONFIGURED, DevicesLink, eds
from lss_slave import LssSlave

S = 1_000_000_000
MS = 1_000_000
IDENTITY = Identity(0x999, 2, 3, 4)
words = st.integers(0, 0xFFFFFFFF)


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
    assert link.t < S


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


# slaves of the field


def slave_of(**quirks):
    link = DevicesLink()
    return link, LssSlave(link, IDENTITY, **quirks)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(
    identity=st.tuples(words, words, words, words),
    deaf_ms=st.floats(0, 95),
    answer_ms=st.floats(0.1, 900),
    store_ms=st.floats(0.1, 9900),
)
def test_a_slow_slave_is_selected_numbered_and_stored(identity, deaf_ms, answer_ms, store_ms):
    """It misses messages that come too soon, and its memory takes seconds."""
    link = DevicesLink()
    slave = LssSlave(
        link,
        identity,
        deaf_ns=round(deaf_ms * MS),
        answer_ns=round(answer_ms * MS),
        store_ns=round(store_ms * MS),
    )
    with LssMaster(link) as master:
        done = give(master, link, Identity(*identity), 20, store=True)
    assert (done.node_id, done.stored, slave.node_id, slave.stored) == (20, True, 20, 20)
    assert (slave.configures, slave.stores) == (False, 1)


@settings(max_examples=12, deadline=None, derandomize=True)
@given(identity=st.tuples(words, words, words, words), early=st.booleans(), deaf_ms=st.floats(0, 4.8))
def test_a_slave_is_found_though_it_enters_configuration_early(identity, early, deaf_ms):
    link = DevicesLink()
    LssSlave(link, identity, early=early, deaf_ns=round(deaf_ms * MS))
    LssSlave(link, (1, 2, 3, 5))
    with LssMaster(link) as master:
        assert sorted(master.unconfigured()) == sorted([identity, (1, 2, 3, 5)])


def test_an_early_slave_that_tells_no_identity_is_no_empty_bus():
    link, slave = slave_of(early=True, inquiries=False)
    with pytest.raises(NodeMissing, match="leaves it before the end; name it by --device"), LssMaster(link) as master:
        master.unconfigured()
    assert not slave.configures


@pytest.mark.parametrize(
    ("quirks", "timeout_s", "error", "text"),
    [
        ({"store_ns": 11 * S}, None, NodeMissing, r"answers LSS \(store\) late, 10 s are allowed"),
        ({"store_ns": 1200 * MS}, 1.0, NodeMissing, r"answers LSS \(store\) late, 1 s are allowed: --timeout"),
        ({"store_ns": 60 * S}, None, NodeMissing, r"does not answer LSS \(store\) within 10 s"),
        ({"odd": {0x17: b"\x17\0"}}, None, AnswerUntrusted, "with 17 00: 2 bytes, and 8 are right"),
        ({"odd": {0x11: b"\x13" + bytes(7)}}, None, AnswerUntrusted, "with 13 00 .*: another service's answer"),
        ({"odd": {0x43: b"\x44"}}, None, AnswerUntrusted, r"\(its selection\) with 44: 1 bytes, and 8 are right"),
        ({"odd": {0x11: b""}}, None, NodeMissing, r"does not answer LSS \(the node id 20\) within 1 s"),
        ({"answer_ns": 1500 * MS}, 0.5, NodeMissing, r"answers LSS \(the node id 20\) late, 0.5 s"),
    ],
)
def test_a_slave_that_fails_is_told_and_left_waiting(quirks, timeout_s, error, text):
    link, slave = slave_of(**quirks)
    with pytest.raises(error, match=text), LssMaster(link, timeout_s) as master:
        give(master, link, IDENTITY, 20, store=True)
    assert not slave.configures
    assert link.sent[-1] == (0x7E5, b"\x04" + bytes(7))


def test_a_deaf_slave_is_left_waiting_by_whoever_is_interrupted():
    link, slave = slave_of(deaf_ns=80 * MS)

    def interrupted(master):
        master.select(IDENTITY)
        assert slave.configures
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt), LssMaster(link) as master:
        interrupted(master)
    assert not slave.configures


def test_the_store_is_asked_for_once_and_the_rest_again():
    link, slave = slave_of(odd={0x11: b"", 0x17: b""})
    for act, count in ((lambda master: master.set_node_id(5), 2), (lambda master: master.store(), 1)):
        link.sent.clear()
        with LssMaster(link) as master:
            master.select(IDENTITY)
            with pytest.raises(NodeMissing):
                act(master)
        assert len([data for _, data in link.sent if data[0] in (0x11, 0x17)]) == count
    assert slave.stores == 1
