"""The LSS slave (CiA 305) by hand-written frames, and with `canopen`'s master."""

from __future__ import annotations

import canopen
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coulombus.eds import cia305
from coulombus.eds.cia305 import UNCONFIGURED, LssService
from coulombus.node import lss
from coulombus.node.store import FileStore, Store
from coulombus.wire.frame import CAN_RTR_FLAG
from node_bench import MS, Bench, enable, motor, setpoint

RX, TX = 0x7E5, 0x7E4
VENDOR, PRODUCT, REVISION, SERIAL = 0x4C0, 0x402, 0x00010000, 0x12345678
IDENTITY = (VENDOR, PRODUCT, REVISION, SERIAL)


def u32(value):
    return value.to_bytes(4, "little")


def started(node_id=1, name="motor"):
    bench = Bench(name, node_id)
    bench.power_on()
    bench.device[0x1018, 3], bench.device[0x1018, 4] = REVISION, SERIAL
    if node_id != UNCONFIGURED:
        assert [s.can_id for s in bench.take()] == [0x700 + node_id]
    return bench


def ask(bench, *data, length=None):
    """Send one LSS frame; return the data of the answers."""
    content = b"".join(bytes((part,)) if isinstance(part, int) else part for part in data)
    bench.frame(RX, content.ljust(8, b"\0"), length=length)
    return [s.data for s in bench.take(TX)]


def answer(*data):
    return [b"".join(bytes((part,)) if isinstance(part, int) else part for part in data).ljust(8, b"\0")]


def configuring(bench):
    assert ask(bench, 0x04, 1) == []
    return bench


def select(bench, identity, codes=(0x40, 0x41, 0x42, 0x43)):
    """Send the numbers of an address; return the answers to the last."""
    got = []
    for code, number in zip(codes, identity, strict=True):
        assert got == []
        got = ask(bench, code, u32(number))
    return got


def identify(bench, *numbers):
    return select(bench, numbers, range(0x46, 0x4C))


# switch state, inquire


def test_what_the_core_hands_to_python_is_what_python_serves():
    assert set(lss._SERVICES) == cia305.REQUESTS


def test_a_slave_that_waits_answers_no_question_of_its_settings():
    bench = started()
    for code in (0x11, 0x13, 0x15, 0x17, 0x5A, 0x5B, 0x5C, 0x5D, 0x5E):
        assert ask(bench, code, 5) == []
    configuring(bench)
    assert ask(bench, 0x5E) == answer(0x5E, 1)  # and nothing was configured
    assert ask(bench, 0x04, 0) == []
    assert ask(bench, 0x5E) == []


def test_identity_and_node_id_are_told():
    bench = configuring(started(23))
    for code, number in zip(range(0x5A, 0x5E), IDENTITY, strict=True):
        assert ask(bench, code) == answer(code, u32(number))
    assert ask(bench, 0x5E) == answer(0x5E, 23)


def test_switch_state_selective_takes_the_whole_address():
    bench = started()
    assert select(bench, IDENTITY) == answer(0x44)
    assert ask(bench, 0x5E) == answer(0x5E, 1)
    assert select(bench, IDENTITY) == []  # it is served by slaves that wait


@pytest.mark.parametrize("wrong", range(4))
def test_switch_state_selective_is_for_one_device_only(wrong):
    bench = started()
    assert select(bench, [number ^ (1 << 7 * k) * (k == wrong) for k, number in enumerate(IDENTITY)]) == []
    assert ask(bench, 0x43, u32(SERIAL)) == []  # an address is complete or nothing
    assert ask(bench, 0x5E) == []
    assert select(bench, IDENTITY) == answer(0x44)


def test_a_new_address_begins_with_its_vendor():
    bench = started()
    for code, number in ((0x41, PRODUCT), (0x42, REVISION), (0x40, VENDOR)):
        ask(bench, code, u32(number))
    assert ask(bench, 0x43, u32(SERIAL)) == []


# node id


def test_a_node_id_is_pending_until_reset_communication():
    bench = configuring(started(1))
    assert ask(bench, 0x11, 9) == answer(0x11, 0)
    assert ask(bench, 0x5E) == answer(0x5E, 1)
    assert bench.number(0x1000) == 0x00020192  # still node 1
    bench.nmt(130)
    assert [(s.can_id, s.data) for s in bench.take()] == [(0x709, b"\0")]
    assert ask(bench, 0x5E) == []  # it waits again
    bench.node_id = 9
    assert bench.number(0x1000) == 0x00020192
    assert bench.number(0x1400, 1) & 0x7FF == 0x209
    assert bench.number(0x1014) == 0x89
    bench.frame(0x601, b"\x40\x00\x10\x00".ljust(8, b"\0"))
    bench.nmt(130, 1)
    assert bench.take() == []  # nobody is node 1


@pytest.mark.parametrize("number", [0, 128, 254])
def test_a_node_id_out_of_range_is_refused(number):
    bench = configuring(started(1))
    assert ask(bench, 0x11, number) == answer(0x11, 1)
    bench.nmt(130)
    assert [s.can_id for s in bench.take()] == [0x701]


def test_only_what_is_stored_survives_power_off_and_reset_node():
    bench = configuring(started(1))
    ask(bench, 0x11, 9)
    bench.nmt(130)
    bench.nmt(129, 9)
    assert [s.can_id for s in bench.take()] == [0x709, 0x701]
    configuring(bench)
    ask(bench, 0x11, 10)
    assert ask(bench, 0x17) == answer(0x17, 0)
    bench.device.power_off()
    bench.power_on()
    assert [s.can_id for s in bench.take()] == [0x70A]
    bench.nmt(129, 10)
    assert [s.can_id for s in bench.take()] == [0x70A]


def with_store(store, node_id=1):
    bench = Bench("motor", node_id, store=store)
    bench.power_on()
    bench.take()
    return bench


def test_what_is_stored_outlives_the_process(tmp_path):
    bench = configuring(with_store(FileStore(tmp_path / "lss")))
    ask(bench, 0x11, 9)
    ask(bench, 0x13, 0, 2)
    assert ask(bench, 0x17) == answer(0x17, 0)
    again = with_store(FileStore(tmp_path / "lss"))
    assert (again.node.node_id, again.device.lss.rate) == (9, 2)
    again.node_id = 9
    assert again.number(0x1014) == 0x89


def test_storage_that_fails_is_told_and_changes_nothing(tmp_path):
    (tmp_path / "there").mkdir()
    bench = with_store(FileStore(tmp_path / "there" / "lss"))
    configuring(bench)
    ask(bench, 0x11, 9)
    (tmp_path / "there").rmdir()
    assert ask(bench, 0x17) == answer(0x17, 2)
    bench.device.power_off()
    bench.power_on()
    assert bench.take()[-1].can_id == 0x701


def test_a_store_with_nonsense_is_not_used():
    store = Store()
    store.put({"lss": {"node_id": b"\x80", "bit_rate": b"\x05"}})
    bench = with_store(store, 3)
    assert (bench.node.node_id, bench.device.lss.rate) == (3, 0)


def test_a_drive_with_torque_is_not_disturbed():
    bench = motor()
    enable(bench, 100)
    assert bench.node.out_torque_pm == 100
    bench.take()
    configuring(bench)
    assert ask(bench, 0x11, 9) == answer(0x11, 0)
    assert ask(bench, 0x13, 0, 2) == answer(0x13, 0)
    assert ask(bench, 0x15, (100).to_bytes(2, "little")) == []  # not in OPERATIONAL
    assert ask(bench, 0x17) == answer(0x17, 0)
    bench.sync()
    bench.frame(0x201, setpoint(0x0F, 50))
    bench.sync()
    assert (bench.node.power_state, bench.node.out_torque_pm, bench.node.nmt) == (4, 50, 5)
    assert {s.can_id for s in bench.take()} >= {0x181}
    bench.nmt(130)
    assert (bench.node.out_torque_pm, bench.take(0x709)[0].data) == (0, b"\0")


def test_the_services_run_in_every_nmt_state():
    bench = started()
    for command, state in ((1, 5), (2, 4), (128, 127)):
        bench.nmt(command)
        assert select(bench, IDENTITY) == answer(0x44)
        assert ask(bench, 0x5E) == answer(0x5E, 1)
        assert ask(bench, 0x04, 0) == []
        assert bench.node.nmt == state


# without a node id


def test_a_device_without_a_node_id_is_silent_until_it_gets_one():
    bench = started(UNCONFIGURED)
    bench.run(10_000 * MS)
    for can_id in (0x000, 0x080, 0x67F, 0x6FF, 0x77F, 0x7FF):
        bench.frame(can_id, bytes(8))
    bench.frame(0x000, b"\x01\x00")
    bench.frame(0x000, b"\x82\x00")
    assert bench.take() == []
    configuring(bench)
    assert ask(bench, 0x5E) == answer(0x5E, 255)
    assert ask(bench, 0x11, 5) == answer(0x11, 0)
    assert ask(bench, 0x04, 0) == []
    assert [(s.can_id, s.data) for s in bench.take()] == [(0x705, b"\0")]
    bench.node_id = 5
    assert bench.number(0x1000) == 0x00020192
    bench.nmt(1, 5)
    assert bench.node.nmt == 5
    bench.sync()
    assert 0x185 in {s.can_id for s in bench.take()}


def test_back_to_waiting_without_a_node_id_boots_nothing():
    bench = started(UNCONFIGURED)
    configuring(bench)
    ask(bench, 0x04, 0)
    assert bench.take() == []


def test_a_node_id_may_be_taken_away_and_the_brake_still_ramps():
    bench = Bench("mr_brake", 2)
    bench.power_on()
    bench.nmt(1)
    bench.sync()
    bench.frame(0x202, (2000).to_bytes(2, "little"))
    bench.sync()
    assert bench.node.out_brake_Nm == pytest.approx(2.0)
    configuring(bench)
    assert ask(bench, 0x11, 255) == answer(0x11, 0)
    bench.nmt(130)
    bench.take()
    bench.run(1000 * MS)
    assert bench.node.out_brake_Nm == 0.0
    assert bench.take() == []
    assert ask(bench, 0x4C) == answer(0x50)


@pytest.mark.parametrize("reset", [129, 130, "power"])
def test_a_stored_255_is_no_node_id_after_every_reset(reset):
    bench = started(1)
    bench.write(0x1017, 0, 10, 2)
    bench.write(0x1800, 5, 10, 2)
    bench.write(0x1800, 2, 254, 1)
    bench.write(0x1010, 1, 0x65766173, 4)
    bench.nmt(1)
    configuring(bench)
    assert ask(bench, 0x11, 255) == answer(0x11, 0)
    assert ask(bench, 0x17) == answer(0x17, 0)
    bench.run(15 * MS)
    assert {sent.can_id for sent in bench.take()} >= {0x181, 0x701}  # until the reset it is node 1
    for node_id in (1, 9):
        if reset == "power":
            bench.device.power_off()
            bench.power_on()
        else:
            bench.nmt(reset, node_id)
        bench.node_id = 255
        for can_id in (0x000, 0x080, 0x601, 0x67F, 0x6FF, 0x701 | CAN_RTR_FLAG, 0x7FF | CAN_RTR_FLAG):
            bench.frame(can_id, bytes((1, 0)) if can_id == 0 else b"")
        bench.run(100 * MS)
        bench.node.in_faults = 1
        bench.node.next_ns = bench.t
        bench.run(MS)
        bench.node.in_faults = 0
        assert (bench.take(), bench.node.nmt) == ([], 0)  # no boot-up, no heartbeat, no PDO, no EMCY
        assert ask(bench, 0x4C) == answer(0x50)
        configuring(bench)
        assert ask(bench, 0x5E) == answer(0x5E, 255)
        ask(bench, 0x11, 9)
        ask(bench, 0x04, 0)
        assert bench.take(0x709)[0].data == b"\0"
        if reset == 130:  # what is pending stays: 9
            break
        bench.take()


def test_heartbeats_and_sync_of_a_device_end_with_its_node_id():
    bench = started(1)
    bench.write(0x1017, 0, 10, 2)
    configuring(bench)
    ask(bench, 0x11, 255)
    bench.run(25 * MS)
    assert len(bench.take(0x701)) == 2
    bench.nmt(130)
    bench.run(100 * MS)
    assert bench.take() == []


# identify


@pytest.mark.parametrize(
    ("numbers", "found"),
    [
        ((VENDOR, PRODUCT, REVISION, REVISION, SERIAL, SERIAL), True),
        ((VENDOR, PRODUCT, 0, 0xFFFFFFFF, 0, 0xFFFFFFFF), True),
        ((VENDOR + 1, PRODUCT, 0, 0xFFFFFFFF, 0, 0xFFFFFFFF), False),
        ((VENDOR, PRODUCT + 1, 0, 0xFFFFFFFF, 0, 0xFFFFFFFF), False),
        ((VENDOR, PRODUCT, 0, REVISION - 1, 0, 0xFFFFFFFF), False),
        ((VENDOR, PRODUCT, REVISION + 1, 0xFFFFFFFF, 0, 0xFFFFFFFF), False),
        ((VENDOR, PRODUCT, 0, 0xFFFFFFFF, 0, SERIAL - 1), False),
        ((VENDOR, PRODUCT, 0, 0xFFFFFFFF, SERIAL + 1, 0xFFFFFFFF), False),
    ],
)
def test_identify_remote_slave(numbers, found):
    bench = started()
    expected = answer(0x4F) if found else []
    assert identify(bench, *numbers) == expected
    assert identify(configuring(bench), *numbers) == expected


def test_half_an_address_identifies_nobody():
    bench = started()
    ask(bench, 0x46, u32(VENDOR))
    assert ask(bench, 0x4B, u32(0xFFFFFFFF)) == []


def test_identify_non_configured():
    assert ask(started(1), 0x4C) == []
    bench = started(UNCONFIGURED)
    assert ask(bench, 0x4C) == answer(0x50)
    configuring(bench)
    ask(bench, 0x11, 5)
    assert ask(bench, 0x4C) == []


# fastscan


def scan(*arguments):
    return b"\x51" + u32(arguments[0]) + bytes(arguments[1:])


def test_fastscan_finds_the_identity_bit_by_bit():
    bench = started(UNCONFIGURED)
    bench.device[0x1018, 4] = 0xFFFFFFFF
    assert ask(bench, scan(0, 128, 0, 0)) == answer(0x4F)
    found = []
    for sub in range(4):
        number = 0
        for bit in reversed(range(32)):
            if not ask(bench, scan(number, bit, sub, sub)):
                number |= 1 << bit
        assert ask(bench, scan(number, 0, sub, (sub + 1) % 4)) == answer(0x4F)
        found.append(number)
    assert found == [VENDOR, PRODUCT, REVISION, 0xFFFFFFFF]
    assert ask(bench, 0x5E) == answer(0x5E, 255)  # it was switched to configuration


def test_fastscan_is_not_for_those_that_have_a_node_id_or_are_scanned_elsewhere():
    assert ask(started(1), scan(0, 128, 0, 0)) == []
    bench = started(UNCONFIGURED)
    assert ask(bench, scan(0, 128, 0, 0)) == answer(0x4F)
    assert ask(bench, scan(PRODUCT, 0, 1, 1)) == []  # the vendor comes first
    assert ask(bench, scan(VENDOR, 0, 0, 1)) == answer(0x4F)
    assert ask(bench, scan(VENDOR, 0, 0, 1)) == []
    assert ask(bench, scan(PRODUCT, 0, 1, 2)) == answer(0x4F)


# bit timing


@pytest.mark.parametrize(
    ("table", "index", "error"),
    [(0, i, 0) for i in (0, 1, 2, 3, 4, 6, 7, 8)]
    + [(0, 5, 1), (0, 9, 1), (0, 10, 1), (0, 255, 1), (1, 0, 1), (128, 3, 1)],
)
def test_configure_bit_timing(table, index, error):
    assert ask(configuring(started()), 0x13, table, index) == answer(0x13, error)


def test_activate_bit_timing_is_silent_twice():
    bench = started()
    bench.write(0x1017, 0, 10, 2)
    configuring(bench)
    ask(bench, 0x13, 0, 3)
    start = bench.t
    ask(bench, 0x15, (50).to_bytes(2, "little"))
    bench.until(start + 99 * MS)
    assert bench.request(b"\x40\x00\x10\x00".ljust(8, b"\0")) is None
    assert bench.take() == []
    bench.until(start + 100 * MS)
    assert bench.number(0x1000) == 0x00020192
    assert [s.t_ns for s in bench.take(0x701)] == [start + 100 * MS]
    assert bench.device.lss.rate == 3


# bad input


@pytest.mark.parametrize("length", range(8))
def test_a_frame_that_is_too_short_is_counted(length):
    bench = started()
    assert ask(bench, 0x04, 1, length=length) == []
    assert bench.node.dropped_length == 1
    assert ask(bench, 0x5E) == []


@pytest.mark.parametrize(
    "data",
    [
        b"\x04\x02",
        b"\x00",
        b"\x12",
        b"\x44",
        b"\x4f",
        b"\xff",
        scan(0, 32, 0, 0),
        scan(0, 127, 0, 0),
        scan(0, 0, 4, 0),
        scan(0, 0, 0, 4),
    ],
)
def test_what_spells_no_service_is_counted(data):
    bench = started(UNCONFIGURED)
    assert ask(bench, data) == []
    assert bench.node.dropped_unknown == 1
    assert bench.take() == []


def test_a_device_has_a_node_id_or_none():
    with pytest.raises(ValueError, match="node id 128; expected 1 to 127, or 255 for none"):
        Bench("motor", 128)


@settings(max_examples=100, deadline=None, derandomize=True)
@given(
    st.sampled_from([1, UNCONFIGURED]),
    st.lists(
        st.binary(min_size=8, max_size=8)
        | st.builds(
            lambda code, rest: bytes((code,)) + rest,
            st.sampled_from([*LssService]),
            st.sampled_from([bytes(7), b"\x01" + bytes(6), u32(VENDOR) + bytes(3), b"\x09" * 7])
            | st.binary(min_size=7, max_size=7),
        ),
        max_size=30,
    ),
)
def test_whatever_frames_come_the_node_id_is_one_and_answers_go_out_on_one_identifier(node_id, contents):
    bench = started(node_id)
    for content in contents:
        ask(bench, content)
        for sent in bench.take():
            assert sent.can_id == 0x700 + bench.node.node_id  # it was given one, and booted
        assert 1 <= bench.node.node_id <= 127 or bench.node.node_id == UNCONFIGURED
    bench.nmt(129, 0)
    assert 1 <= bench.node.node_id <= 127 or bench.node.node_id == UNCONFIGURED


# canopen's master


class BenchNetwork(canopen.Network):
    """A network without threads: what the devices answer is heard before `send_message` returns."""

    def __init__(self, *benches):
        super().__init__()
        self.benches = benches

    def send_message(self, can_id, data, remote=False):
        for bench in self.benches:
            bench.frame(can_id, bytes(data))
        for bench in self.benches:
            for sent in bench.take():
                self.notify(sent.can_id, bytearray(sent.data), sent.t_ns * 1e-9)


@pytest.fixture
def master(monkeypatch):
    monkeypatch.setattr("canopen.lss.time.sleep", lambda _: None)
    monkeypatch.setattr("canopen.lss.LssMaster.RESPONSE_TIMEOUT", 0.001)

    def network(*benches):
        return BenchNetwork(*benches).lss

    return network


def test_canopen_s_master_finds_and_configures_two_new_devices(master):
    first, second = started(UNCONFIGURED), started(UNCONFIGURED, "mr_brake")
    lss = master(first, second)
    found = {}
    for node_id in (11, 12):
        ok, identity = lss.fast_scan()
        assert ok
        found[node_id] = identity
        assert lss.inquire_node_id() == 255
        lss.configure_node_id(node_id)
        lss.configure_bit_timing(0)
        lss.store_configuration()
        lss.send_switch_state_global(lss.WAITING_STATE)
    assert lss.fast_scan() == (False, None)
    assert found[11] != found[12]
    ids = {tuple(identity): node_id for node_id, identity in found.items()}
    assert first.node.node_id == ids[IDENTITY]
    assert {first.node.node_id, second.node.node_id} == {11, 12}
    assert {first.node.nmt, second.node.nmt} == {127}


def test_canopen_s_master_selects_inquires_and_is_refused(master):
    bench = started(7)
    lss = master(bench, started(8, "mr_brake"))
    assert lss.send_switch_state_selective(*IDENTITY)
    assert [lss.inquire_lss_address(code) for code in range(0x5A, 0x5E)] == list(IDENTITY)
    assert lss.inquire_node_id() == 7
    with pytest.raises(canopen.lss.LssError, match="LSS Error: 1"):
        lss.configure_node_id(200)
    with pytest.raises(canopen.lss.LssError, match="LSS Error: 1"):
        lss.configure_bit_timing(5)
    lss.configure_node_id(70)
    lss.network.nmt.send_command(130)
    assert (bench.node.node_id, bench.node.nmt) == (70, 127)
