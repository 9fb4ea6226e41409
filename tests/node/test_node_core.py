"""The compiled core: dispatch, heartbeat producer, SYNC producer, EMCY and 1003h, malformed
frames.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coulombus.eds.reader import read_eds
from coulombus.node import emcy, slots402
from coulombus.node.device import Device
from coulombus.node.drive402 import DRIVE402
from coulombus.node.kinds import GENERIC
from coulombus.node.profile import Profile
from coulombus.node.record import new_nodes
from coulombus.wire.clock import NEVER_NS
from coulombus.wire.frame import CAN_EFF_FLAG, CAN_RTR_FLAG
from node_bench import MS, US, Bench, SdoAborted, cycle, description, motor, on_time, setpoint
from places import CORPUS, beside


def test_powered_off_nothing_goes_in_and_nothing_comes_out():
    bench = Bench("motor")
    assert bench.node.next_ns == NEVER_NS
    bench.sync()
    bench.nmt(1)
    bench.frame(0x601, bytes.fromhex("4000100000000000"))
    bench.frame(0x201, setpoint(0x0F, 100))
    bench.run(1000 * MS)
    assert bench.take() == []
    assert bench.node.nmt == 0


def test_power_off_in_mid_run_silences_the_device_and_its_outputs():
    bench = motor()
    bench.write(0x1017, 0, 10, 2)
    for controlword in (6, 7, 15, 15):
        cycle(bench, setpoint(controlword, 300))
    bench.sync()
    assert bench.node.out_torque_pm == 300
    bench.take()
    bench.device.power_off()
    assert bench.node.out_torque_pm == 0
    bench.sync()
    bench.run(100 * MS)
    assert bench.take() == []
    bench.power_on()
    assert [(s.can_id, s.data) for s in bench.take()] == [(0x701, b"\0")]
    assert bench.number(0x1017) == 0  # what was not stored is lost


def test_frames_of_others_change_nothing():
    bench = motor()
    before = bench.node.tobytes()
    for can_id in (0x081, 0x082, 0x181, 0x182, 0x202, 0x282, 0x581, 0x582, 0x602, 0x67F, 0x702, 0x77F, 0x7FF):
        bench.frame(can_id, bytes(range(8)))
    bench.frame(CAN_EFF_FLAG | 0x201, setpoint(0x0F, 100))
    bench.frame(CAN_EFF_FLAG | 0x080)
    bench.frame(CAN_RTR_FLAG | 0x201)
    bench.frame(0x20000080, bytes(8))  # an error frame
    assert bench.take() == []
    assert bench.node.tobytes() == before


def test_a_node_is_told_apart_from_its_neighbour_in_the_same_records():
    nodes = new_nodes(3)
    assert nodes.shape == (3,)
    assert np.all(nodes["next_ns"] == NEVER_NS)
    assert np.all(nodes["processing_ns"] == 20_000)


def test_heartbeat_keeps_its_period_and_tells_the_state():
    bench = Bench("mr_brake", 5)
    bench.power_on()
    bench.take()
    bench.run(7 * MS)
    bench.write(0x1017, 0, 50, 2)
    bench.take()
    bench.run(120 * MS)
    bench.nmt(1)
    bench.run(50 * MS)
    bench.nmt(2)
    bench.run(50 * MS)
    beats = bench.take(0x705)
    assert [s.t_ns for s in beats] == [57 * MS, 107 * MS, 157 * MS, 207 * MS]
    assert [s.data[0] for s in beats] == [127, 127, 5, 4]


def test_a_late_call_gives_no_burst_of_heartbeats():
    bench = Bench("motor")
    bench.power_on()
    bench.write(0x1017, 0, 10, 2)
    bench.take()
    bench.t = 95 * MS
    on_time(bench.nodes, 0, bench.t, bench.out)
    bench._collect()
    assert [s.t_ns for s in bench.take(0x701)] == [95 * MS]
    assert bench.node.next_ns == 105 * MS


def test_sync_producer_counts_and_drives_its_own_pdos():
    bench = Bench("motor")
    bench.power_on()
    bench.write(0x1019, 0, 3, 1)
    bench.write(0x1006, 0, 2000, 4)
    bench.write(0x1005, 0, 0x40000080, 4)
    bench.nmt(1)
    bench.take()
    bench.run(10 * MS)
    assert [(s.t_ns, s.data) for s in bench.take(0x080)] == [
        (2 * MS, b"\x01"),
        (4 * MS, b"\x02"),
        (6 * MS, b"\x03"),
        (8 * MS, b"\x01"),
        (10 * MS, b"\x02"),
    ]
    assert [s.t_ns - 20 * US for s in bench.take(0x181)] == [2 * MS, 4 * MS, 6 * MS, 8 * MS, 10 * MS]


@pytest.mark.parametrize(("command", "stopped_ns"), [(1, 0), (1, 50 * MS), (128, 5 * MS)])
def test_sync_producer_begins_anew_after_stopped(command, stopped_ns):
    bench = Bench("motor")
    bench.power_on()
    bench.write(0x1019, 0, 10, 1)
    bench.write(0x1006, 0, 2000, 4)
    bench.write(0x1005, 0, 0x40000080, 4)
    bench.run(6 * MS)
    bench.nmt(2)
    assert [s.data for s in bench.take(0x080)] == [b"\x01", b"\x02", b"\x03"]
    bench.run(stopped_ns)
    assert bench.take(0x080) == []
    bench.nmt(command)
    start = bench.t
    bench.run(5 * MS)
    assert [(s.t_ns - start, s.data) for s in bench.take(0x080)] == [(2 * MS, b"\x01"), (4 * MS, b"\x02")]


@pytest.mark.parametrize("command", [129, 130])
def test_a_stored_sync_producer_begins_anew_after_a_reset(command):
    bench = Bench("motor")
    bench.power_on()
    bench.write(0x1019, 0, 10, 1)
    bench.write(0x1006, 0, 2000, 4)
    bench.write(0x1005, 0, 0x40000080, 4)
    bench.download(0x1010, 1, b"save")
    bench.run(5 * MS)
    bench.take()
    bench.nmt(command)
    start = bench.t
    bench.run(5 * MS)
    assert [(s.t_ns - start, s.data) for s in bench.take(0x080)] == [(2 * MS, b"\x01"), (4 * MS, b"\x02")]


def test_sync_of_a_wrong_length_is_counted_told_once_and_released():
    bench = motor()
    bench.sync(b"\x05")
    bench.sync(b"\x06")
    assert bench.node.dropped_length == 2
    assert bench.take(0x181) == []
    assert bench.emcy() == [(0x8240, 0x11, 1)]
    bench.sync()
    assert bench.emcy() == [(0x0000, 0x00, 0)]
    assert len(bench.take(0x181)) == 1


def test_error_history_is_newest_first_and_cleared_by_zero_only():
    bench = motor()
    assert bench.number(0x1003) == 0
    with pytest.raises(SdoAborted, match="08000024"):
        bench.upload(0x1003, 1)
    bench.sync(b"\x01")
    bench.frame(0x201, b"\x00")
    assert bench.number(0x1003) == 2
    assert bench.number(0x1003, 1) == 0x0001_8210
    assert bench.number(0x1003, 2) == 0x0001_8240
    assert bench.device[0x1003, 1] == 0x0001_8210
    assert bench.number(0x1001) == 0x11
    with pytest.raises(SdoAborted, match="06090030"):
        bench.write(0x1003, 0, 1, 1)
    bench.write(0x1003, 0, 0, 1)
    assert bench.number(0x1003) == 0


def test_history_keeps_the_last_eight():
    bench = motor()
    for _ in range(6):  # two entries each
        bench.frame(0x201, b"\x00")
        bench.sync(b"\x01")
        bench.frame(0x201, bytes(4))
        bench.sync()
    assert bench.number(0x1003) == 8
    assert [bench.number(0x1003, k) & 0xFFFF for k in range(1, 9)] == [0x8240, 0x8210] * 4


def test_emcy_inhibit_time_spaces_the_messages():
    bench = motor()
    bench.write(0x1015, 0, 50, 2)  # 5 ms
    start = bench.t
    bench.frame(0x201, b"\x00")
    bench.sync(b"\x01")
    bench.run(20 * MS)
    assert [s.t_ns - start for s in bench.take(0x081)] == [20 * US, 5 * MS + 20 * US]


def test_few_emcys_wait_for_the_inhibit_time_and_the_last_one_is_the_newest():
    bench = motor()
    bench.write(0x1015, 0, 50, 2)
    for _ in range(1000):  # 2000 messages in 1 s, of which 200 may be sent
        bench.frame(0x201, b"\x00")
        bench.frame(0x201, bytes(4))
        bench.run(MS)
    bench.take(0x081)
    last = bench.t
    bench.run(100 * MS)
    late = bench.take(0x081)
    assert len(late) == 8
    assert late[-1].t_ns - last <= 40 * MS
    assert late[-1].data == bytes(8)  # error reset: what holds now


@pytest.mark.parametrize("command", [2, 129, 130])
def test_a_waiting_emcy_is_forgotten_where_nmt_allows_none(command):
    bench = motor()
    bench.write(0x1015, 0, 50, 2)
    bench.frame(0x201, b"\x00")
    bench.frame(0x201, bytes(4))
    assert len(bench.take(0x081)) == 1
    bench.nmt(command)
    bench.run(20 * MS)
    assert bench.take(0x081) == []


def test_what_waits_goes_out_though_the_inhibit_time_is_switched_off():
    bench = motor()
    bench.write(0x1015, 0, 0xFFFF, 2)
    bench.frame(0x201, b"\x00")
    bench.frame(0x201, bytes(4))
    bench.run(7_000 * MS)  # 6.5535 s
    assert len(bench.take(0x081)) == 2
    bench.frame(0x201, b"\x00")
    bench.write(0x1015, 0, 0, 2)
    bench.run(7_000 * MS)
    assert len(bench.take(0x081)) == 1


@pytest.mark.parametrize(
    "end", [lambda bench: bench.write(0x1015, 0, 0, 2), lambda b: b.nmt(129), lambda b: b.nmt(130)]
)
def test_an_inhibit_time_holds_no_longer_than_1015_says(end):
    bench = motor()
    bench.write(0x1015, 0, 0xFFFF, 2)
    bench.frame(0x201, b"\x00")
    end(bench)
    bench.nmt(1)
    bench.frame(0x201, bytes(4))
    bench.take(0x081)
    bench.frame(0x201, b"\x00")
    bench.run(MS)
    assert [frame.data[:2] for frame in bench.take(0x081)] == [b"\x10\x82"]


def test_emcy_identifier_can_be_moved_and_switched_off():
    bench = motor()
    with pytest.raises(SdoAborted, match="06090030"):
        bench.write(0x1014, 0, 0x0A1, 4)  # to be made invalid first
    with pytest.raises(SdoAborted, match="06090030"):
        bench.write(0x1014, 0, 0x40000081, 4)  # a reserved bit
    bench.write(0x1014, 0, 0x80000081, 4)
    bench.frame(0x201, b"\x00")
    assert bench.emcy() == []
    bench.write(0x1014, 0, 0x0A1, 4)
    bench.sync(b"\x01")
    assert len(bench.take(0x0A1)) == 1


def test_causes_are_named_and_fault_codes_are_in_their_class():
    assert emcy.CAUSES[emcy.HEARTBEAT].code == 0x8130
    assert emcy.CAUSES[emcy.RPDO_DEADLINE].code == 0x8250
    assert emcy.CAUSES[emcy.SYNC_LOST].code == 0x8700
    assert emcy.FAULT_MASK >> emcy.RPDO_SHORT & 1 == 0


def test_sync_identifier_can_be_moved():
    bench = Bench("motor")
    bench.power_on()
    bench.write(0x1005, 0, 0x90, 4)
    bench.nmt(1)
    bench.take()
    bench.sync()
    assert bench.take() == []
    bench.frame(0x090)
    assert [s.can_id for s in bench.take()] == [0x181, 0x281]


def test_counter_overflow_stands_while_a_period_is_set():
    bench = Bench("motor")
    bench.power_on()
    bench.write(0x1006, 0, 1000, 4)
    with pytest.raises(SdoAborted, match="08000022"):
        bench.write(0x1019, 0, 10, 1)
    bench.write(0x1006, 0, 0, 4)
    bench.write(0x1019, 0, 10, 1)


def test_a_device_refuses_what_it_cannot_be():
    nodes = new_nodes(1)
    for node_id, kind, text in (
        (0, DRIVE402, "node id 0"),
        (128, DRIVE402, "expected 1 to 127"),
        (1, Profile("3"), "kind 3"),
    ):
        with pytest.raises(ValueError, match=text):
            Device(description("motor"), node_id, kind, nodes[0])
    with pytest.raises(KeyError, match="no object 5555h"):
        Bench("motor").device[0x5555, 0]


@pytest.mark.thorough
@beside(CORPUS)
def test_any_readable_eds_becomes_a_live_node():
    lived = 0
    for path in sorted(CORPUS.glob("**/*.[ed][dc][sf]")):
        bench = Bench("", 5, GENERIC, read_eds(path))
        bench.power_on()
        assert [(s.can_id, s.data) for s in bench.take()] == [(0x705, b"\0")]
        if bench.device.dictionary.number(0x1200, 1, 0x605) != 0x605:
            continue  # SDO is where the file has it, whatever the node id
        for index, entry in bench.device.description.objects.items():
            for subindex, variable in entry.variables.items():
                if variable.access != "wo" and not (index == 0x1003 and subindex):
                    bench.upload(index, subindex)
        bench.nmt(1)
        for _ in range(3):
            bench.sync()
            bench.run(5 * MS)
        assert bench.node.nmt == 5
        lived += 1
    assert lived


FRAMES = st.tuples(
    st.one_of(st.sampled_from([0x000, 0x080, 0x201, 0x301, 0x601, 0x77F, 0x701]), st.integers(0, 0x7FF)),
    st.binary(min_size=0, max_size=8),
    st.integers(0, 3 * MS),
)


@settings(max_examples=60, deadline=None)
@given(st.lists(FRAMES, max_size=60), st.sampled_from(["motor", "mr_brake"]))
def test_no_sequence_of_frames_breaks_a_node(sequence, name):
    bench = Bench(name, 1)
    bench.power_on()
    own = {0x081, 0x181, 0x281, 0x381, 0x481, 0x581, 0x701}
    for can_id, data, wait_ns in sequence:
        bench.run(wait_ns)
        bench.frame(can_id, data)
        assert bench.node.nmt in (4, 5, 127)
        assert bench.node.out_torque_pm == 0 or bench.node.power_state == 4
        assert abs(bench.node.out_torque_pm) <= bench.node.values[slots402.MAX_TORQUE]
        assert 0 <= bench.node.out_brake_Nm <= 32.767
        assert bench.out["dropped"] == 0
        remapped = {int(p["cob_id"]) for p in bench.node.tpdo} | {int(bench.node.emcy_id), int(bench.node.sync_id)}
        assert {s.can_id for s in bench.take()} <= own | remapped
