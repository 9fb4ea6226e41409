"""The hand-over from motor to brake, and the doubt that a law oscillates: settings and edges, kernel by kernel."""

from __future__ import annotations

import pytest

from coulombus.host.cycle import hand_over, step
from coulombus.host.cycle.records import Phase, Trip
from coulombus.wire.frame import new_queue
from host_bench import HostBench, armed
from plain_records import record_for_kernels

WEAK = "limits.brake_torque_Nm=0.5"


@pytest.mark.parametrize(
    ("mode", "overrides", "hands_over"),
    [
        ("active", (), 1),
        ("passive", (), 0),
        ("hybrid", (), 0),
        ("passive", ("law.function=wall",), 0),
        ("hybrid", ("law.function=wall",), 1),
        ("hybrid", ('world.rest="law"',), 1),
    ],
)
def test_what_hands_over(mode, overrides, hands_over):
    c = HostBench(mode, *overrides).c
    assert (c.hands_over, c.ends_by_nmt) == (hands_over, 1)


@pytest.mark.parametrize(
    ("overrides", "rise", "fade"),
    [
        ((), 60, 50),  # three times 20 ms
        (("brake.coil_lag_s=0.004", "brake.fluid_lag_s=0.021"), 75, 50),
        (("brake.fluid_lag_s=0.0019",), 6, 50),
        (("brake.fluid_lag_s=0.0001",), 1, 50),
        ((WEAK, "limits.safe_ramp_s=0.8"), 60, 800),
        ((WEAK, "limits.safe_ramp_s=0.0018"), 60, 2),
        ((WEAK, "limits.safe_ramp_s=0"), 60, 1),
    ],
)
def test_the_durations_are_of_the_brakes_lags_and_of_its_strength(overrides, rise, fade):
    c = HostBench("active", *overrides).c
    assert (c.rise_cycles, c.fade_cycles) == (rise, fade)


@pytest.mark.parametrize(
    ("lagged", "displayed", "level", "takes_over"), [(1.0, 2.0, 3.0, 1), (3.0, 5.0, 4.5, 1), (1.0, 0.0, 1.0, 0)]
)
def test_the_brake_takes_over_what_both_displayed_within_its_limit(lagged, displayed, level, takes_over):
    bench = HostBench("active")
    assert bench.c.brake_limit_Nm == 4.5
    bench.h.brake_lagged_Nm, bench.h.displayed_Nm, bench.h.takes_over = lagged, displayed, 1 - takes_over
    hand_over.take_over(bench.c, bench.h)
    assert (bench.h.level_Nm, bench.h.takes_over) == (level, takes_over)


@pytest.mark.parametrize(
    ("end_cycles", "before", "after"),
    [(0, 0.5, 0.6), (0, 0.95, 1.0), (10, 0.5, 0.5), (11, 0.5, 0.3), (11, 0.1, 0.0)],
)
def test_the_gain_rises_stays_and_falls(end_cycles, before, after):
    bench = HostBench("active")
    bench.c.gain_step, bench.c.rise_cycles, bench.c.fade_cycles = 0.1, 10, 5
    bench.h.end_cycles, bench.h.gain = end_cycles, before
    hand_over.ramp_gain(bench.c, bench.h)
    assert bench.h.gain == pytest.approx(after)


@pytest.mark.parametrize("phase", Phase)
@pytest.mark.parametrize(("end_cycles", "goes_on"), [(0, True), (14, True), (15, False)])
def test_the_display_goes_on_until_the_hand_over_has_ended(phase, end_cycles, goes_on):
    bench = HostBench("active")
    bench.c.rise_cycles, bench.c.fade_cycles = 10, 5
    bench.h.phase, bench.h.end_cycles = phase, end_cycles
    for stop, asked in ((0, False), (1, True), (int(Trip.NET_WORK), False)):
        bench.h.stop = stop
        assert hand_over.hands_over(bench.c, bench.h) == (goes_on and asked and phase is Phase.RUN)


# the doubt that a law oscillates


def running(**fields):
    bench = HostBench("active")
    bench.h.phase = Phase.RUN
    bench.c.coil_step = bench.c.fluid_step = 0.0
    for name, value in fields.items():
        setattr(bench.c if name in ("coil_step", "fluid_step") else bench.h, name, value)
    return bench


def limit_Nm(bench):
    return bench.c.motor_limit_raw * abs(bench.c.motor_Nm_raw)


def doubted(bench, torques=(), brakes=()):
    """Return the reversals of motor and brake over some commands."""
    for torque_Nm in torques:
        bench.h.torque_Nm = torque_Nm
        step._doubt_oscillating_law(bench.axis)
    for brake_Nm in brakes:
        bench.h.brake_Nm = brake_Nm
        step._doubt_oscillating_law(bench.axis)
    return [round(float(n), 1) for n in bench.h.reversals]


@pytest.mark.parametrize("sign", [1, -1])
def test_reversals_near_the_motors_limit_are_counted(sign):
    bench = running()
    bench.c.motor_Nm_raw *= sign
    bench.c.reversal_decay = 1.0
    high = 0.9 * limit_Nm(bench)
    assert doubted(bench, [high, -high, high, high]) == [2.0, 0.0]
    assert list(bench.h.side) == [1, 0]
    assert doubted(bench, [0.5 * high, -0.5 * high, -step.NEAR_LIMIT * limit_Nm(bench)]) == [2.0, 0.0]
    assert doubted(bench, [-high]) == [3.0, 0.0]
    assert bench.h.side[0] == -1
    bench.h.clipped = 1
    assert doubted(bench, [0.5]) == [4.0, 0.0]
    assert doubted(bench, [-0.5]) == [5.0, 0.0]
    assert doubted(bench, [0.5, 0.0]) == [7.0, 0.0]


@pytest.mark.parametrize(
    ("fields", "counted"),
    [
        ({}, True),
        ({"phase": Phase.SAFE}, False),
        ({"phase": Phase.SETTLE}, False),
        ({"end_cycles": 1}, False),
        ({"coil_step": 0.5}, True),
    ],
)
def test_only_a_display_is_doubted(fields, counted):
    bench = running(**fields)
    assert any(doubted(bench, [limit_Nm(bench), -limit_Nm(bench)])) == counted


@pytest.mark.parametrize(("on", "share", "counted"), [(1, 0.5, 0), (1, 0.0, 1), (0, 1.0, 1), (0, 0.0, 1)])
def test_what_a_world_does_is_no_doubt_of_the_law(on, share, counted):
    bench = running()
    bench.axis.world.on, bench.axis.world.share = on, share
    assert any(doubted(bench, [limit_Nm(bench), -limit_Nm(bench)])) == counted


@pytest.mark.parametrize(("fields", "counted"), [({}, 3.0), ({"coil_step": 0.5}, 0.0), ({"fluid_step": 0.5}, 0.0)])
def test_a_brake_that_alternates_is_counted_unless_its_lags_are_led(fields, counted):
    bench = running(**fields)
    bench.c.reversal_decay = 1.0
    fast = 0.6 * bench.c.brake_fall_Nm
    assert doubted(bench, brakes=[fast, 0.0, fast, 0.0]) == [0.0, counted]
    assert bench.h.side[1] == (-1 if counted else 0)
    assert doubted(bench, brakes=[step.FAST_SHARE * bench.c.brake_fall_Nm]) == [0.0, counted]  # as fast as that is slow


@pytest.mark.parametrize(("stop", "after"), [(0, True), (1, True), (2, False), (int(Trip.NET_WORK), False)])
@pytest.mark.parametrize("k", [0, 1])
def test_more_reversals_than_a_limit_cycle_has_trip_but_write_over_no_trip(stop, after, k):
    bench = running(stop=stop)
    bench.c.reversal_decay, bench.c.most_reversals = 1.0, 5.0
    bench.h.reversals[k] = 5.0
    doubted(bench, [0.0])
    assert bench.h.stop == stop
    bench.h.reversals[k] = 5.1
    doubted(bench, [0.0])
    assert bench.h.stop == (Trip.LAW_OSCILLATES if after else stop)


# what the motor displayed, and whose drive it is


@pytest.mark.parametrize(
    ("fields", "active", "shown"),
    [
        ({}, 1, 1.0),
        ({}, 0, 0.5),
        ({"phase": Phase.SAFE}, 1, 0.2),
        ({"fresh": 0}, 1, 0.2),
        ({"end_cycles": 1}, 1, 0.2),
        ({"torque_Nm": -99.0}, 1, None),
    ],
)
@pytest.mark.parametrize("sign", [1, -1])
def test_the_largest_torque_on_which_a_hand_leans_is_followed(fields, active, shown, sign):
    bench = running(**{"fresh": 1, "torque_Nm": -1.0, "pushed_Nm": 0.5, "displayed_Nm": 0.2, **fields})
    bench.c.motor_active = active
    bench.c.motor_Nm_raw *= sign
    step._follow_display(bench.c, bench.h)
    assert bench.h.displayed_Nm == pytest.approx(limit_Nm(bench) if shown is None else shown)


@pytest.mark.parametrize("phase", Phase)
@pytest.mark.parametrize(
    ("trip", "foreign_id", "commanded"),
    [(Trip.SECOND_HOST, -1, True), (Trip.SPEED, 0x201, True), (Trip.SPEED, -1, False)],
)
def test_a_drive_that_another_station_commands_is_taken_once_in_the_safe_state(phase, trip, foreign_id, commanded):
    bench = HostBench("active")
    bench.h.phase, bench.h.trip, bench.h.foreign_id = phase, trip, foreign_id
    for first in (True, False):
        bench.out = record_for_kernels(new_queue())
        step._take_the_drive(bench.c, bench.h, 0, bench.out)
        assert len(bench.frames()) == (first and commanded and Phase.SAFE <= phase < Phase.DONE)


def test_the_first_stranger_is_named_and_none_is_a_reason_in_the_safe_state():
    bench = armed("active")
    bench.frame(0x202, 2, 0)
    bench.frame(0x201, 4, 0)
    assert (bench.h.foreign_id, bench.h.stop) == (0x202, Trip.SECOND_HOST)
    safe = HostBench("active").enter(Phase.SAFE)
    safe.frame(0x201, 4, 0)
    assert (safe.h.foreign_id, safe.h.stop) == (0x201, 0)
