"""Loss of the host: heartbeat, RPDO deadline, SYNC, age of the set-point.

Safe output and EMCY at their times.
"""

from __future__ import annotations

import pytest

from node_bench import MS, US, Bench, SdoAborted, cycle, enable, motor, setpoint

ENABLE = 0x0F
FAULT, OE, SOD = 7, 4, 1
HOST = 0x7F


def running(**settings: int) -> Bench:
    """A motor that drives 300 per mille; the set-point is received at half the cycle."""
    bench = motor(**settings)
    enable(bench, 300)
    cycle(bench, setpoint(ENABLE, 300))
    bench.emcy()
    bench.sync()
    assert bench.node.out_torque_pm == 300
    bench.take()
    return bench


def brake(**settings: int) -> Bench:
    bench = Bench("mr_brake", 2)
    bench.power_on()
    bench.write(0x1400, 5, settings.get("deadline_ms", 10), 2)
    bench.write(0x2002, 0, settings.get("sync_us", 0), 4)
    bench.nmt(1)
    bench.take()
    return bench


# the motor


def test_a_stale_setpoint_is_torque_zero_at_its_time_and_recovers():
    bench = running(age_us=3000)
    received = int(bench.node.setpoint_ns)
    bench.until(received + 3 * MS, judge_end=False)
    assert bench.node.out_torque_pm == 300
    bench.run(0)
    assert bench.node.out_torque_pm == 0
    assert bench.node.power_state == OE
    assert bench.emcy() == []
    bench.run(20 * MS)
    bench.frame(0x201, setpoint(ENABLE, 120))
    assert bench.node.out_torque_pm == 0
    bench.sync()
    assert bench.node.out_torque_pm == 120
    assert bench.node.power_state == OE


def test_a_setpoint_each_cycle_is_never_stale():
    bench = running(age_us=3000, deadline_ms=10, sync_us=20_000)
    for _ in range(100):
        cycle(bench, setpoint(ENABLE, 300))
        assert bench.node.out_torque_pm == 300
    assert bench.emcy() == []


def test_one_and_two_lost_setpoints_do_nothing():
    bench = running(age_us=3000)
    for lost in (1, 2):
        for _ in range(lost):
            bench.run(MS)
            bench.sync()
            assert bench.node.out_torque_pm == 300
        bench.at(bench.t + 400 * US, 0x201, setpoint(ENABLE, 300))
        bench.run(600 * US)
        bench.sync()


def test_rpdo_deadline_is_a_fault_with_8250_at_its_time():
    bench = running(deadline_ms=10)
    received = int(bench.node.rpdo_ns[0])
    for _ in range(9):  # SYNC goes on
        bench.run(MS)
        bench.sync()
    bench.until(received + 10 * MS, judge_end=False)
    assert bench.emcy() == []
    assert bench.node.out_torque_pm == 300
    bench.run(0)
    frames = [s for s in bench.sent if s.can_id == 0x081]
    assert [s.t_ns for s in frames] == [received + 10 * MS + 20 * US]
    assert bench.emcy() == [(0x8250, 0x11, 1)]
    assert bench.node.out_torque_pm == 0
    assert bench.node.power_state == FAULT
    bench.run(100 * MS)
    assert bench.emcy() == []


def test_a_frame_at_the_deadline_is_in_time():
    bench = running(deadline_ms=10)
    received = int(bench.node.rpdo_ns[0])
    bench.at(received + 10 * MS, 0x201, setpoint(ENABLE, 300))
    bench.run(0)
    assert bench.emcy() == []
    bench.run(10 * MS)
    assert [code for code, _, _ in bench.emcy()] == [0x8250]


def test_the_deadline_starts_with_the_first_rpdo():
    bench = motor(deadline_ms=10)
    bench.run(500 * MS)
    assert bench.emcy() == []
    bench.frame(0x201, setpoint(0))
    bench.run(10 * MS)
    assert [code for code, _, _ in bench.emcy()] == [0x8250]


def test_an_rpdo_that_is_too_short_does_not_feed_the_deadline():
    bench = running(deadline_ms=10)
    received = int(bench.node.rpdo_ns[0])
    bench.at(received + 9 * MS, 0x201, b"\x0f")
    bench.until(received + 10 * MS)
    assert [code for code, _, _ in bench.emcy()] == [0x8210, 0x8250]


def test_sync_lost_is_a_fault_with_8700():
    bench = running(sync_us=20_000)
    last = int(bench.node.sync_ns)
    for k in range(1, 40):  # RPDOs go on
        bench.at(last + k * 500 * US, 0x201, setpoint(ENABLE, 300))
    bench.until(last + 20 * MS, judge_end=False)
    assert bench.emcy() == []
    bench.run(0)
    assert bench.emcy() == [(0x8700, 0x11, 0)]
    assert bench.node.out_torque_pm == 0
    assert bench.node.power_state == FAULT


def test_sync_time_out_starts_with_the_first_sync_in_operational():
    bench = motor(sync_us=20_000)
    bench.run(500 * MS)
    assert bench.emcy() == []
    bench.nmt(128)
    bench.sync()
    bench.nmt(1)
    bench.run(500 * MS)
    assert bench.emcy() == []
    bench.sync()
    bench.run(20 * MS)
    assert [code for code, _, _ in bench.emcy()] == [0x8700]


def test_heartbeat_lost_is_a_fault_with_8130_and_leaves_operational():
    bench = running()
    bench.write(0x1016, 1, HOST << 16 | 150, 4)
    bench.run(1000 * MS)
    assert bench.emcy() == []  # it starts with the first heartbeat
    bench.frame(0x700 + HOST, b"\x00")
    bench.run(1000 * MS)
    assert bench.emcy() == []  # a boot-up is none
    bench.frame(0x700 + HOST, b"\x05")
    last = bench.t
    bench.at(last + 150 * MS, 0x700 + HOST, b"\x7f")
    bench.run(0)
    assert bench.emcy() == []
    bench.until(last + 300 * MS, judge_end=False)
    assert bench.emcy() == []
    bench.run(0)
    assert bench.emcy() == [(0x8130, 0x11, HOST)]
    assert bench.node.power_state == FAULT
    assert bench.node.out_torque_pm == 0
    assert bench.node.nmt == 127  # 1029h:01 is 0


@pytest.mark.parametrize(("behaviour", "state"), [(0, 127), (1, 5), (2, 4)])
def test_error_behaviour_of_1029(behaviour, state):
    bench = motor()
    bench.write(0x1029, 1, behaviour, 1)
    bench.write(0x1016, 1, HOST << 16 | 10, 4)
    bench.frame(0x700 + HOST, b"\x05")
    bench.run(10 * MS)
    assert bench.node.nmt == state


def test_two_producers_are_watched_and_told_of_one_by_one():
    bench = motor()
    bench.write(0x1029, 1, 1, 1)
    bench.write(0x1016, 1, HOST << 16 | 10, 4)
    bench.write(0x1016, 2, 5 << 16 | 30, 4)
    with pytest.raises(SdoAborted, match="06040043"):
        bench.write(0x1016, 2, HOST << 16 | 30, 4)
    bench.frame(0x700 + HOST, b"\x05")
    bench.frame(0x705, b"\x05")
    bench.run(20 * MS)
    assert bench.emcy() == [(0x8130, 0x11, HOST)]
    bench.run(20 * MS)
    assert bench.emcy() == [(0x8130, 0x11, 5)]
    bench.frame(0x705, b"\x05")
    bench.run(5 * MS)
    bench.frame(0x700 + HOST, b"\x05")
    assert bench.node.causes == 0


@pytest.mark.parametrize("cause", ["deadline", "sync", "heartbeat"])
def test_recovery_is_a_fault_reset_once_the_cause_is_gone(cause):
    settings = {"deadline": {"deadline_ms": 10}, "sync": {"sync_us": 10_000}, "heartbeat": {}}[cause]
    bench = running(**settings)
    bench.write(0x1029, 1, 1, 1)
    if cause == "heartbeat":
        bench.write(0x1016, 1, HOST << 16 | 10, 4)
        bench.frame(0x700 + HOST, b"\x05")
    bench.run(12 * MS)
    assert bench.node.power_state == FAULT
    bench.emcy()
    bench.write(0x6040, 0, 0x00, 2)
    bench.write(0x6040, 0, 0x80, 2)
    assert bench.node.power_state == FAULT
    bench.write(0x6040, 0, 0x00, 2)
    if cause == "heartbeat":
        bench.frame(0x700 + HOST, b"\x05")
    for _ in range(2):
        bench.frame(0x201, setpoint(0x00))
        bench.sync()
    assert bench.node.power_state == FAULT  # it waits for the reset
    assert bench.number(0x1001) == 0x11
    bench.frame(0x201, setpoint(0x80))
    bench.sync()
    assert bench.node.power_state == SOD
    assert bench.emcy() == [(0x0000, 0x00, 0)]


def test_after_a_fault_and_a_new_start_the_drive_runs_again():
    bench = running(age_us=3000, deadline_ms=10, sync_us=20_000)
    bench.run(100 * MS)
    assert bench.node.power_state == FAULT
    bench.nmt(130)
    bench.write(0x1400, 5, 10, 2)
    bench.nmt(1)
    for controlword in (0x00, 0x80, 0x06, 0x07, ENABLE, ENABLE):
        cycle(bench, setpoint(controlword, 55))
    bench.sync()
    assert bench.node.power_state == OE
    assert bench.node.out_torque_pm == 55


def test_watches_end_with_operational():
    bench = running(deadline_ms=10, sync_us=20_000, age_us=3000)
    bench.nmt(128)
    bench.take()
    bench.run(1000 * MS)
    assert bench.take() == []
    assert bench.node.causes == 0


def test_deadlines_are_lazy():
    """One call of on_time for many cycles: a reception only stores its time."""
    bench = running(age_us=3000, deadline_ms=10, sync_us=20_000)
    calls = 0
    for _ in range(300):
        start = bench.t
        for offset, can_id, data in ((0, 0x080, b""), (MS // 2, 0x201, setpoint(ENABLE, 300))):
            before = int(bench.node.next_ns)
            bench.at(start + offset, can_id, data)
            calls += bench.node.next_ns != before
        before = int(bench.node.next_ns)
        bench.until(start + MS, judge_end=False)
        calls += bench.node.next_ns != before
    assert calls <= 160
    assert bench.emcy() == []


# the brake


@pytest.mark.parametrize("lost", ["deadline", "sync", "heartbeat"])
def test_brake_tells_at_the_deadline_holds_then_ramps(lost):
    bench = brake(deadline_ms=10 if lost == "deadline" else 0, sync_us=20_000 if lost == "sync" else 0)
    bench.write(0x1029, 1, 1, 1)
    if lost == "heartbeat":
        bench.write(0x1016, 1, HOST << 16 | 30, 4)
        bench.frame(0x700 + HOST, b"\x05")
    bench.frame(0x202, (2000).to_bytes(2, "little"))
    bench.sync()
    bench.take()
    code, after_ms = {"deadline": (0x8250, 10), "sync": (0x8700, 20), "heartbeat": (0x8130, 30)}[lost]
    bench.until(after_ms * MS, judge_end=False)
    assert bench.emcy() == []
    bench.run(0)
    assert [c for c, _, _ in bench.emcy()] == [code]
    assert bench.node.out_brake_Nm == pytest.approx(2.0)
    bench.until(100 * MS)
    assert bench.node.out_brake_Nm == pytest.approx(2.0)
    bench.until(225 * MS)
    assert bench.node.out_brake_Nm == pytest.approx(1.5)
    bench.until(600 * MS)
    assert bench.node.out_brake_Nm == 0


def test_brake_holds_even_when_the_lost_heartbeat_ends_operational():
    bench = brake()
    bench.write(0x1016, 1, HOST << 16 | 30, 4)
    bench.frame(0x700 + HOST, b"\x05")
    bench.frame(0x202, (2000).to_bytes(2, "little"))
    bench.sync()
    bench.until(50 * MS)
    assert bench.node.nmt == 127  # by itself: 1029h:01 is 0
    assert bench.node.out_brake_Nm == pytest.approx(2.0)
    bench.until(350 * MS)
    assert bench.node.out_brake_Nm == pytest.approx(1.0)
    bench.until(600 * MS)
    assert bench.node.out_brake_Nm == 0


def test_brake_ramps_when_syncs_stop_although_setpoints_come():
    bench = brake(sync_us=20_000)
    bench.frame(0x202, (2000).to_bytes(2, "little"))
    bench.sync()
    for k in range(1, 700):
        bench.at(k * MS, 0x202, (2000).to_bytes(2, "little"))
    assert bench.node.out_brake_Nm == 0


def test_brake_recovers_with_the_host():
    bench = brake()
    bench.frame(0x202, (2000).to_bytes(2, "little"))
    bench.sync()
    bench.until(700 * MS)
    assert bench.emcy() == [(0x8250, 0x11, 1)]
    bench.frame(0x202, (1000).to_bytes(2, "little"))
    bench.sync()
    assert bench.emcy() == [(0x0000, 0x00, 0)]
    assert bench.node.out_brake_Nm == pytest.approx(1.0)
