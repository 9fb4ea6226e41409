"""Node guarding and life time, heartbeat versus guarding, 1029h, start-up by 1F80h, TIME, the
window of 1007h.
"""

from __future__ import annotations

from datetime import datetime, timedelta

import pytest

from coulombus.eds.reader import parse_eds
from coulombus.sim_bus.network.network import VirtualNetwork
from coulombus.wire.frame import CAN_RTR_FLAG
from node_bench import MS, Bench, SdoAborted, motor, setpoint

PRE_OPERATIONAL, OPERATIONAL, STOPPED = 127, 5, 4


def powered(name: str = "motor", node_id: int = 1, **objects: int) -> Bench:
    bench = Bench(name, node_id)
    bench.power_on()
    bench.take()
    return bench


def guarded(guard_ms: int = 100, factor: int = 3) -> Bench:
    bench = powered()
    bench.write(0x100C, 0, guard_ms, 2)
    bench.write(0x100D, 0, factor, 1)
    return bench


def ask(bench: Bench) -> list[int]:
    bench.frame(0x701 | CAN_RTR_FLAG, length=1)
    return [frame.data[0] for frame in bench.take(0x701)]


def test_the_toggle_bit_begins_with_0_and_alternates_in_every_state():
    bench = guarded()
    assert [ask(bench) for _ in range(3)] == [[127], [0x80 | 127], [127]]
    bench.nmt(1)
    assert [ask(bench) for _ in range(2)] == [[0x80 | 5], [5]]
    bench.nmt(2)
    assert ask(bench) == [0x80 | 4]
    for command in (129, 130):
        bench.nmt(command)
        bench.take()
        assert [ask(bench) for _ in range(2)] == [[127], [0x80 | 127]]


def test_it_is_answered_without_a_life_time_and_without_an_event():
    bench = powered()
    assert [ask(bench) for _ in range(2)] == [[127], [0x80 | 127]]
    bench.run(10_000 * MS)
    assert bench.emcy() == []


@pytest.mark.parametrize(("behaviour", "state"), [(0, PRE_OPERATIONAL), (1, OPERATIONAL), (2, STOPPED)])
def test_life_guarding_event_at_its_time(behaviour, state):
    bench = guarded()
    bench.write(0x1029, 1, behaviour, 1)
    bench.nmt(1)
    bench.run(1000 * MS)
    assert bench.emcy() == []  # the watch begins with the first remote frame
    ask(bench)
    bench.run(250 * MS)
    ask(bench)
    bench.until(bench.t + 300 * MS, judge_end=False)
    assert bench.emcy() == []
    bench.run(0)
    assert [code for code, _, _ in bench.emcy()] == [0x8130]
    assert bench.node.nmt == state
    bench.run(1000 * MS)
    assert bench.emcy() == []  # told once


def test_a_brake_is_released_by_the_next_remote_frame():
    bench = powered("mr_brake", 1)
    bench.write(0x100C, 0, 10, 2)
    bench.write(0x100D, 0, 2, 1)
    ask(bench)
    bench.run(20 * MS)
    assert [code for code, _, _ in bench.emcy()] == [0x8130]
    assert bench.number(0x1001) == 0x11
    ask(bench)
    assert bench.emcy() == [(0, 0, 0)]
    bench.run(20 * MS)
    assert [code for code, _, _ in bench.emcy()] == [0x8130]  # and watched again


def test_a_changed_guard_time_begins_anew():
    bench = guarded(10, 1)
    ask(bench)
    bench.write(0x100D, 0, 0, 1)
    bench.run(100 * MS)
    assert bench.emcy() == []


def test_with_a_heartbeat_there_is_no_guarding():
    bench = guarded(10, 2)
    ask(bench)
    bench.write(0x1017, 0, 40, 2)
    assert ask(bench) == []
    bench.take()
    bench.run(100 * MS)
    assert [frame.data for frame in bench.take()] == [b"\x7f", b"\x7f"]  # no toggle bit, no EMCY
    bench.write(0x1017, 0, 0, 2)
    assert ask(bench) == [127]


def test_a_remote_frame_for_another_node_is_none():
    bench = guarded()
    bench.frame(0x702 | CAN_RTR_FLAG, length=1)
    assert bench.take() == []


@pytest.mark.parametrize(("behaviour", "state"), [(0, PRE_OPERATIONAL), (1, OPERATIONAL), (2, STOPPED)])
def test_a_device_fault_does_what_1029_02_says(behaviour, state):
    bench = motor()
    bench.write(0x1029, 2, behaviour, 1)
    bench.node.in_faults = 1
    bench.node.next_ns = bench.t
    bench.run(MS)
    assert bench.node.nmt == state
    assert bench.node.out_torque_pm == 0


def test_start_up_by_itself():
    bench = powered()
    bench.write(0x1F80, 0, 0, 4)
    assert bench.node.nmt == PRE_OPERATIONAL
    bench.download(0x1010, 2, b"save")
    bench.nmt(130)
    assert [frame.can_id for frame in bench.take(0x701)] == [0x701]
    assert bench.node.nmt == OPERATIONAL
    bench.write(0x1F80, 0, 4, 4)
    bench.download(0x1010, 2, b"save")
    bench.nmt(129)
    assert bench.node.nmt == PRE_OPERATIONAL
    with pytest.raises(SdoAborted, match="06090030"):
        bench.write(0x1F80, 0, 1, 4)  # it is no NMT master


def test_what_starts_by_itself_boots_up_before_it_sends_a_pdo():
    """A TPDO's identifier wins every arbitration against the boot-up's."""
    text = "".join(
        f"[{head}]\nParameterName=x\n{keys}\n"
        for head, keys in (
            *(("1F80", "DataType=7\nDefaultValue=0"), ("2000", "DataType=5\nPDOMapping=1\nDefaultValue=1")),
            *(("1800", "ObjectType=9\nSubNumber=2"), ("1800sub0", "DataType=5"), ("1800sub1", "DataType=7")),
            *(("1A00", "ObjectType=9\nSubNumber=2"), ("1A00sub0", "DataType=5\nDefaultValue=1")),
            ("1A00sub1", "DataType=7\nDefaultValue=0x20000008"),
        )
    )
    network = VirtualNetwork(capacity=1)
    device = network.add(parse_eds(text.encode(), "own.eds"), 9)
    station = network.station()
    network.power_on()
    network.wait_ns(5 * MS)
    assert device.record["nmt"] == OPERATIONAL
    assert [frame.can_id for frame in station.take()] == [0x709, 0x189]


def test_time_is_taken_and_goes_on():
    bench = powered()
    assert bench.device.time_of_day(0) is None
    days = (datetime(2026, 11, 21) - datetime(1984, 1, 1)).days
    bench.frame(0x100, (12 * 3_600_000).to_bytes(4, "little") + days.to_bytes(2, "little"))
    assert bench.device.time_of_day(bench.t) == datetime(2026, 11, 21, 12)
    bench.run(1500 * MS)
    assert bench.device.time_of_day(bench.t) == datetime(2026, 11, 21, 12, 0, 1, 500_000)
    bench.frame(0x100, bytes(5))
    assert bench.node.dropped_length == 1
    bench.nmt(2)
    bench.frame(0x100, bytes(6))  # STOPPED knows no TIME
    bench.nmt(128)
    assert bench.device.time_of_day(bench.t) == datetime(2026, 11, 21, 12, 0, 1, 500_000)
    bench.write(0x1012, 0, 0x00000100, 4)
    bench.frame(0x100, bytes(6))
    assert bench.device.time_of_day(bench.t) == datetime(2026, 11, 21, 12) + timedelta(seconds=1.5)


def test_time_is_produced_where_1012_says_so():
    bench = powered()
    send = bench.device.produce_time
    assert not send(bench.t, datetime(2026, 1, 1), bench.out)
    bench.write(0x1012, 0, 0x40000100, 4)
    assert send(bench.t, datetime(1984, 1, 3, 0, 0, 1), bench.out)
    bench.frame(0x7FF)  # what waits is taken with any frame
    (frame,) = bench.take(0x100)
    assert frame.data == (1000).to_bytes(4, "little") + b"\x02\x00"
    with pytest.raises(SdoAborted, match="08000022"):
        bench.write(0x1012, 0, 0x40000101 + 0x80, 4)  # the identifier stands while TIME is produced
    bench.nmt(2)
    assert not send(bench.t, datetime(2026, 1, 1), bench.out)
    bench.nmt(1)
    with pytest.raises(ValueError, match="1984"):
        send(bench.t, datetime(1970, 1, 1), bench.out)


def test_an_rpdo_after_the_window_acts_on_no_sync():
    bench = motor()
    bench.write(0x1007, 0, 500, 4)
    bench.sync()
    bench.at(bench.t + 500_000, 0x201, setpoint(6, 11))
    bench.until(bench.t + 500_000)
    bench.sync()
    assert bench.number(0x6071) == 11
    bench.at(bench.t + 500_001, 0x201, setpoint(6, 22))
    bench.until(bench.t + 499_999)
    bench.sync()
    assert bench.number(0x6071) == 11
    assert bench.node.dropped_window == 1
    assert len(bench.take(0x181)) == 3
    bench.write(0x1007, 0, 10, 4)  # less than the device takes to answer
    bench.sync()
    assert bench.take(0x181) == []
    bench.write(0x1007, 0, 0, 4)
    bench.sync()
    assert len(bench.take(0x181)) == 1


def test_more_than_eight_heartbeats_are_watched():
    bench = powered()
    record = bench.node
    assert record["consumer_ns"].shape == (127,)
    bench.write(0x1016, 2, 9 << 16 | 50, 4)
    assert bench.node.consumers_used == 2
    bench.frame(0x709, b"\x05")
    bench.run(50 * MS)
    assert [code for code, _, _ in bench.emcy()] == [0x8130]
