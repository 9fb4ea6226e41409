"""The motor drive: CiA 402's states, torque modes, limits, statusword.

The expectations are written from IEC 61800-7-201.
"""

from __future__ import annotations

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coulombus.node import emcy
from node_bench import MS, US, Bench, SdoAborted, cycle, enable, motor, setpoint

SHUTDOWN, SWITCH_ON, ENABLE, DISABLE_VOLTAGE, QUICK_STOP, RESET = 0x06, 0x07, 0x0F, 0x00, 0x02, 0x80
SOD, RTSO, SO, OE, QSA, FAULT = 1, 2, 3, 4, 5, 7
PATH = {SOD: (), RTSO: (SHUTDOWN,), SO: (SHUTDOWN, SWITCH_ON), OE: (SHUTDOWN, SWITCH_ON, ENABLE)}
MASKED = {
    SOD: (0x4F, 0x40),
    RTSO: (0x6F, 0x21),
    SO: (0x6F, 0x23),
    OE: (0x6F, 0x27),
    QSA: (0x6F, 0x07),
    FAULT: (0x4F, 8),
}


def word(bench: Bench) -> int:
    return bench.number(0x6041)


def command(bench: Bench, controlword: int) -> None:
    bench.write(0x6040, 0, controlword, 2)


def at_state(state: int) -> Bench:
    bench = motor()
    for controlword in PATH[state]:
        command(bench, controlword)
    assert bench.node.power_state == state
    return bench


@pytest.mark.parametrize(
    ("state", "controlword", "expected"),
    [
        (SOD, SHUTDOWN, RTSO),  # 2
        (SOD, SWITCH_ON, SOD),
        (SOD, ENABLE, SOD),
        (SOD, DISABLE_VOLTAGE, SOD),
        (SOD, QUICK_STOP, SOD),
        (RTSO, SWITCH_ON, SO),  # 3
        (RTSO, ENABLE, OE),  # 3, and 4 by itself
        (RTSO, QUICK_STOP, SOD),  # 7
        (RTSO, DISABLE_VOLTAGE, SOD),  # 7
        (RTSO, SHUTDOWN, RTSO),
        (SO, ENABLE, OE),  # 4
        (SO, SHUTDOWN, RTSO),  # 6
        (SO, DISABLE_VOLTAGE, SOD),  # 10
        (SO, QUICK_STOP, SOD),  # 10
        (OE, SWITCH_ON, SO),  # 5
        (OE, SHUTDOWN, RTSO),  # 8
        (OE, DISABLE_VOLTAGE, SOD),  # 9
        (OE, QUICK_STOP, SOD),  # 11 and 12: 605Ah is 2
        (OE, ENABLE, OE),
    ],
)
def test_transitions_by_controlword(state, controlword, expected):
    bench = at_state(state)
    command(bench, controlword)
    assert bench.node.power_state == expected
    mask, value = MASKED[expected]
    assert word(bench) & mask == value


def test_quick_stop_option_5_stays_and_can_be_left():
    bench = at_state(OE)
    bench.write(0x605A, 0, 6, 2)
    bench.write(0x6071, 0, 100, 2)
    command(bench, QUICK_STOP)
    assert bench.node.power_state == QSA
    assert word(bench) & 0x6F == 0x07
    assert bench.node.out_torque_pm == 0
    command(bench, ENABLE)  # 16
    assert bench.node.power_state == OE
    command(bench, QUICK_STOP)
    command(bench, DISABLE_VOLTAGE)  # 12
    assert bench.node.power_state == SOD


@pytest.mark.parametrize("supply", [1, 0])
def test_enable_operation_in_ready_to_switch_on_is_transition_3_and_by_itself_4(supply):
    bench = motor()
    bench.node.in_supply_ok = supply
    states = []
    for controlword in (SHUTDOWN, ENABLE, ENABLE):
        cycle(bench, setpoint(controlword, 50))
        bench.sync()
        states.append(int(bench.node.power_state))
    assert states == ([RTSO, OE, OE] if supply else [RTSO] * 3)
    assert bench.node.out_torque_pm == 50 * supply


def test_torque_acts_on_the_next_sync_and_only_in_operation_enabled():
    bench = motor()
    seen = []
    for controlword in (SHUTDOWN, SWITCH_ON, ENABLE, ENABLE):
        start = bench.t
        bench.sync()
        bench.at(start + 500 * US, 0x201, setpoint(controlword, 250))
        seen.append(float(bench.node.out_torque_pm))
        bench.until(start + MS, judge_end=False)
    assert seen == [0, 0, 0, 250]  # the ENABLE of the third cycle acts on the fourth SYNC
    bench.at(bench.t, 0x080)
    bench.frame(0x201, setpoint(ENABLE, -40))
    assert bench.node.out_torque_pm == 250
    bench.run(MS)
    bench.sync()
    assert bench.node.out_torque_pm == -40


def test_fault_reset_needs_a_rising_edge_and_the_cause_to_be_gone():
    bench = motor()
    enable(bench, 100)
    bench.node.in_supply_ok = 0
    bench.sync()
    assert bench.node.power_state == FAULT
    assert bench.node.out_torque_pm == 0
    assert bench.emcy() == [(0x3220, 0x05, 0)]
    assert word(bench) & 0x4F == 0x08
    assert word(bench) & 0x10 == 0
    assert bench.number(0x603F) == 0x3220
    command(bench, RESET)
    assert bench.node.power_state == FAULT  # the cause is present
    bench.node.in_supply_ok = 1
    bench.sync()
    command(bench, RESET)
    assert bench.node.power_state == FAULT  # no edge
    command(bench, 0)
    bench.take()
    command(bench, RESET)
    assert bench.node.power_state == SOD
    assert bench.emcy() == [(0x0000, 0x00, 0)]
    assert bench.number(0x1001) == 0
    assert bench.number(0x603F) == 0
    assert word(bench) & 0x10


def test_a_torque_from_before_the_fault_does_not_return():
    bench = motor()
    enable(bench, 100)
    bench.node.in_supply_ok = 0
    bench.sync()
    bench.node.in_supply_ok = 1
    bench.sync()
    for controlword in (0, RESET, SHUTDOWN, SWITCH_ON, ENABLE):
        command(bench, controlword)
    assert bench.node.power_state == OE
    assert bench.node.out_torque_pm == 0
    bench.frame(0x201, setpoint(ENABLE, 60))
    bench.sync()
    assert bench.node.out_torque_pm == 60


def test_supply_lost_before_switching_on_is_no_fault_but_bars_it():
    bench = motor()
    bench.node.in_supply_ok = 0
    bench.sync()
    assert bench.emcy() == []
    assert word(bench) & 0x10 == 0
    command(bench, SHUTDOWN)
    command(bench, SWITCH_ON)
    assert bench.node.power_state == RTSO
    bench.node.in_supply_ok = 1
    command(bench, SWITCH_ON)
    assert bench.node.power_state == SO


def test_supply_lost_between_frames_is_seen_on_time():
    bench = motor()
    enable(bench, 100)
    bench.node.in_supply_ok = 0
    bench.node.next_ns = bench.t
    bench.run(0)
    assert bench.node.out_torque_pm == 0
    assert bench.node.power_state == FAULT


@pytest.mark.parametrize(
    ("bit", "code", "register"), [(0, 0x2310, 0x03), (1, 0x4210, 0x09), (2, 0x7305, 0x21), (5, 0x3120, 0x05)]
)
def test_device_faults(bit, code, register):
    bench = motor()
    enable(bench, 100)
    bench.node.in_faults = 1 << bit
    bench.sync()
    assert bench.emcy() == [(code, register, 0)]
    assert bench.node.power_state == FAULT
    assert bench.node.out_torque_pm == 0
    bench.sync()
    assert bench.emcy() == []
    bench.node.in_faults = 0
    bench.sync()
    command(bench, 0)
    command(bench, RESET)
    assert bench.node.power_state == SOD
    assert emcy.CAUSES[emcy.FIRST_DEVICE_CAUSE + bit].code == code


def test_limit_6072_clips_both_signs_and_is_counted_once_a_setpoint():
    bench = motor(limit=120)
    enable(bench)
    before = int(bench.node.clipped_setpoints)
    for torque, acts in ((119, 119), (120, 120), (121, 120), (-500, -120), (-32768, -120)):
        bench.frame(0x201, setpoint(ENABLE, torque))
        bench.sync()
        assert bench.node.out_torque_pm == acts
        assert bool(word(bench) & 0x0800) == (torque != acts)
        bench.sync()
    assert bench.node.clipped_setpoints - before == 3
    bench.write(0x6072, 0, 50, 2)
    assert bench.node.out_torque_pm == -50  # at once
    assert bench.number(0x6074, signed=True) == -50


def test_limit_zero_is_no_torque():
    bench = motor(limit=0)
    enable(bench, 1000)
    bench.sync()
    assert bench.node.out_torque_pm == 0


def test_limits_by_sign():
    bench = motor(limit=1000)
    bench.write(0x60E0, 0, 200, 2)
    bench.write(0x60E1, 0, 300, 2)
    enable(bench)
    acts = []
    for torque in (500, -500):
        bench.frame(0x201, setpoint(ENABLE, torque))
        bench.sync()
        acts.append(float(bench.node.out_torque_pm))
    assert acts == [200, -300]


def test_profile_torque_follows_the_slope():
    bench = motor(limit=1000)
    bench.write(0x6060, 0, 4, 1)
    bench.write(0x6087, 0, 10_000, 4)  # per mille a second: 10 a millisecond
    enable(bench)
    assert bench.number(0x6061) == 4
    bench.write(0x6071, 0, 100, 2)
    start = bench.t
    for elapsed_ms, expected in ((1, 10), (4, 40), (9, 90), (10, 100), (30, 100)):
        bench.until(start + elapsed_ms * MS)
        assert bench.node.out_torque_pm == pytest.approx(expected)
        assert bool(word(bench) & 0x0400) == (expected == 100)
    bench.write(0x6071, 0, -50 & 0xFFFF, 2)
    bench.run(5 * MS)
    assert bench.node.out_torque_pm == pytest.approx(50)
    bench.run(10 * MS)
    assert bench.node.out_torque_pm == pytest.approx(-50)
    command(bench, ENABLE | 0x100)  # halt
    bench.run(2 * MS)
    assert bench.node.out_torque_pm == pytest.approx(-30)
    bench.run(3 * MS)
    assert bench.node.out_torque_pm == pytest.approx(0)
    command(bench, ENABLE)
    bench.run(5 * MS)
    assert bench.node.out_torque_pm == pytest.approx(-50)
    bench.write(0x6072, 0, 20, 2)
    assert bench.node.out_torque_pm == -20  # the limit is no ramp


def test_halt_in_cst_is_torque_zero():
    bench = motor()
    enable(bench, 100)
    for halt in (0, 0x100, 0):
        cycle(bench, setpoint(ENABLE | halt, 100))
        bench.sync()
        assert bench.node.power_state == OE
        assert bench.node.out_torque_pm == (0 if halt else 100)
        assert word(bench) & 0x1000 == (0 if halt else 0x1000)  # "target torque ignored"


@pytest.mark.parametrize("reset", [129, 130, "power"])
def test_a_fault_that_outlives_a_reset_is_there_behind_the_boot_up(reset):
    bench = motor()
    bench.node.in_faults = 1
    bench.node.next_ns = bench.t
    bench.run(MS)
    assert bench.emcy() == [(0x2310, 0x03, 0)]
    if reset == "power":
        bench.device.power_off()
        bench.power_on()
    else:
        bench.nmt(reset)
    bench.run(MS)
    told = [] if reset == 130 else [0x81]  # its fault outlives reset communication, and was told before
    assert [sent.can_id for sent in bench.take()] == [0x701, *told]
    for controlword in (SHUTDOWN, SWITCH_ON, ENABLE):
        command(bench, controlword)
    assert bench.node.power_state == FAULT
    assert bench.number(0x603F) == 0x2310


@pytest.mark.parametrize("mode", [-1, 1, 2, 5, 6, 7, 8, 11])
def test_modes_that_6502_does_not_tell_are_refused(mode):
    bench = motor()
    with pytest.raises(SdoAborted, match="06090030"):
        bench.write(0x6060, 0, mode, 1)
    assert bench.number(0x6060) == 10
    assert mode < 1 or not bench.number(0x6502) >> (mode - 1) & 1


def test_mode_zero_gives_no_torque():
    bench = motor()
    bench.write(0x6060, 0, 0, 1)
    enable(bench, 200)
    bench.sync()
    assert bench.node.out_torque_pm == 0


def test_measured_values_are_sampled_at_sync_and_wrap_or_saturate():
    bench = motor()
    bench.node.in_position_counts = (1 << 31) + 5
    bench.node.in_velocity_counts_s = -1234.6
    bench.node.in_torque_pm = 71.5
    bench.sync()
    tpdo1, tpdo2 = bench.take(0x181)[0].data, bench.take(0x281)[0].data
    assert int.from_bytes(tpdo1[2:6], "little", signed=True) == -(1 << 31) + 5
    assert int.from_bytes(tpdo1[6:], "little", signed=True) == 72
    assert int.from_bytes(tpdo2, "little", signed=True) == -1235
    bench.node.in_velocity_counts_s = 1e12
    bench.node.in_torque_pm = -1e9
    assert bench.number(0x606C, signed=True) == (1 << 31) - 1
    assert bench.number(0x6077, signed=True) == -32768
    assert bench.number(0x6079) == 24000
    bench.node.in_supply_ok = 0
    assert bench.number(0x6079) == 0


@pytest.mark.parametrize(("nmt", "after"), [(2, SOD), (128, SOD), (129, SOD), (130, SOD)])
def test_leaving_operational_disables_the_drive(nmt, after):
    bench = motor()
    enable(bench, 300)
    bench.sync()
    assert bench.node.out_torque_pm == 300
    bench.take()
    bench.nmt(nmt)
    assert bench.node.out_torque_pm == 0
    assert bench.node.power_state == after
    assert bench.emcy() == []  # what the master commands is no error


@pytest.mark.parametrize(("option", "state", "torque"), [(0, OE, 300), (1, FAULT, 0), (2, SOD, 0), (3, SOD, 0)])
def test_stop_from_pre_operational_acts_as_leaving_operational(option, state, torque):
    """Enabled over SDO alone; in STOPPED nobody could command it any more."""
    bench = Bench("motor")
    bench.power_on()
    bench.write(0x6072, 0, 1000, 2)
    bench.write(0x6071, 0, 300, 2)
    bench.write(0x6007, 0, option, 2)
    for controlword in (SHUTDOWN, SWITCH_ON, ENABLE):
        command(bench, controlword)
    assert bench.node.out_torque_pm == 300
    bench.nmt(128)  # no change
    assert bench.node.out_torque_pm == 300
    bench.nmt(2)
    assert (bench.node.power_state, bench.node.out_torque_pm) == (state, torque)


@pytest.mark.parametrize(("option", "state", "torque"), [(0, OE, 300), (1, FAULT, 0), (2, SOD, 0), (3, SOD, 0)])
def test_abort_connection_option(option, state, torque):
    bench = motor()
    bench.write(0x6007, 0, option, 2)
    enable(bench, 300)
    bench.sync()
    bench.nmt(128)
    assert (bench.node.power_state, bench.node.out_torque_pm) == (state, torque)
    bench.nmt(129)  # a reset is stronger than "no action"
    assert (bench.node.power_state, bench.node.out_torque_pm) == (SOD, 0)


def test_warning_bit_tells_of_what_is_no_fault():
    bench = motor()
    bench.frame(0x201, b"\x00")
    assert word(bench) & 0x80
    bench.frame(0x201, setpoint(0))
    assert not word(bench) & 0x80


STEPS = st.lists(
    st.tuples(
        st.sampled_from([0x00, 0x02, 0x06, 0x07, 0x0F, 0x0F, 0x0F, 0x80, 0x8F, 0x10F]),
        st.integers(-32768, 32767),
        st.sampled_from([1, 1, 1, 1, 0]),
        st.integers(0, 4 * MS),
    ),
    max_size=40,
)


@settings(max_examples=60, deadline=None)
@given(STEPS, st.integers(0, 10000), st.sampled_from([4, 10]))
def test_torque_is_never_beyond_the_limit_nor_outside_operation_enabled(steps, limit, mode):
    bench = motor(limit=limit, age_us=3000, deadline_ms=10, sync_us=20_000)
    bench.write(0x6060, 0, mode, 1)
    for controlword, torque, supply, wait_ns in steps:
        bench.node.in_supply_ok = supply
        bench.frame(0x201, setpoint(controlword, torque))
        bench.run(wait_ns)
        bench.sync()
        out = bench.node.out_torque_pm
        assert abs(out) <= limit
        assert out == 0 or (bench.node.power_state == OE and supply)
        assert out == 0 or bench.t - bench.node.setpoint_ns < 3 * MS
