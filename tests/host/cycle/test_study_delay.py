"""A longer delay for study: what the law asks for comes late, what makes it safe does not."""

from __future__ import annotations

from functools import cache

import pytest

from coulombus.host.cycle.records import ASKED, Phase
from coulombus.host.cycle.study_delay import forget, hold_back
from coulombus.host.laws.laws import compile_law
from coulombus.host.run.preflight import check_no_delay
from coulombus.rigs.rig import RigError, load_rig
from coulombus.wire.address import parse_address
from host_bench import HostBench

CYCLES = [2, 3, 16]


def asking(motion, law, state):
    """Ask for as much as the handle stands off, of motor and brake."""
    state.brake_Nm = abs(motion.x_rad) * 100.0
    return motion.x_rad * 100.0


@cache
def compiled():
    return compile_law(asking)


def standing(n, mode="active", counts=5, *overrides):
    bench = HostBench(mode, f"bus.delay_cycles={n}", *overrides).enter(Phase.RUN, counts)
    bench.k.law_function = compiled()
    bench.c.motor_rate_Nm = 100.0
    return bench


def test_nothing_is_held_back_without_the_key():
    bench = HostBench()
    assert bench.c.delay_cycles == 1
    assert hold_back(bench.c, bench.h, 1.0, -2.0, 3.0) == (1.0, -2.0, 3.0)
    assert not any(bench.h.asked_psi_Nm)


@pytest.mark.parametrize("n", [2, 3, 5, 16])
def test_what_is_asked_for_comes_n_cycles_later_and_before_that_nothing(n):
    bench = standing(n)
    assert bench.c.delay_cycles == n
    asked = [((-1.0) ** k, 0.5 + k, -0.25 - k) for k in range(3 * n)]
    came = [hold_back(bench.c, bench.h, *one) for one in asked]
    assert came == [(0.0, 0.0, 0.0)] * (n - 1) + asked[: 2 * n + 1]


def test_more_than_the_memory_is_no_write_behind_it():
    bench = standing(16)
    bench.c.delay_cycles = 1000
    came = [hold_back(bench.c, bench.h, 1.0, float(k), 2.0)[1] for k in range(2 * ASKED + 1)]
    assert came[ASKED:] == [float(k) for k in range(ASKED + 1)]


def test_a_display_begins_with_nothing_of_the_one_before():
    bench = standing(4)
    for _ in range(4):
        hold_back(bench.c, bench.h, 1.0, 2.0, 3.0)
    forget(bench.h)
    assert bench.h.asked_row == 0
    assert [hold_back(bench.c, bench.h, 1.0, 7.0, 9.0) for _ in range(4)] == [(0.0, 0.0, 0.0)] * 3 + [(1.0, 7.0, 9.0)]


@pytest.mark.parametrize("n", CYCLES)
@pytest.mark.parametrize("counts", [40, -40])
def test_motor_and_brake_follow_the_law_n_minus_1_cycles_later(n, counts):
    active, passive = standing(n, "active", counts), standing(n, "passive", counts)
    for bench in (active, passive):
        bench.cycles(n - 1)
        assert bench.motor_pm == 0
        assert bench.brake_Nm == 0.0
        bench.cycle()
    asked = counts * active.c.rad_count * 100.0
    assert active.motor_pm * active.c.motor_Nm_raw == pytest.approx(-asked, abs=1e-3)
    assert passive.brake_Nm == pytest.approx(abs(asked), abs=1e-3)


def begins(bench):
    bench.h.phase = int(Phase.SETTLE)
    bench.h.still = 10**6
    bench.cycle()
    assert bench.phase is Phase.RUN


def test_a_run_that_begins_forgets():
    bench = standing(3, "active", 40)
    bench.cycles(5)
    assert bench.motor_pm != 0
    bench.h.torque_Nm = 0.0
    begins(bench)
    bench.h.gain = 1.0
    bench.cycles(2)
    assert bench.motor_pm == 0


@pytest.mark.thorough
@pytest.mark.parametrize("n", CYCLES)
@pytest.mark.parametrize("way", ["trip", "stop", "switch"])
@pytest.mark.parametrize("mode", ["active", "passive"])
def test_a_trip_a_stop_and_the_switch_wait_for_nothing(n, mode, way):
    bench = standing(n, mode, 40)
    bench.cycles(n + 3)
    assert bench.motor_pm != 0 or bench.brake_Nm > 0.0
    level = float(bench.h.brake_lagged_Nm) + float(bench.h.displayed_Nm)
    if way == "trip":
        bench.counts = 1e7
    elif way == "switch":
        bench.h.deadman_ok = 0
    else:
        bench.h.stop = 1
        bench.h.end_cycles = bench.c.rise_cycles + bench.c.fade_cycles if mode == "active" else 0
        bench.h.level_Nm = level
    bench.cycle()
    assert bench.phase is Phase.SAFE
    assert bench.motor_pm == 0
    assert bench.h.level_Nm == pytest.approx(level, abs=0.25)
    levels = []
    for _ in range(int(bench.c.safe_longest_cycles) + 20):
        bench.cycle()
        assert bench.motor_pm == 0
        levels.append(bench.h.level_Nm)
    assert levels == sorted(levels, reverse=True)
    assert bench.brake_Nm == 0.0
    assert bench.phase is Phase.DONE


@pytest.mark.parametrize("n", CYCLES)
def test_limits_act_on_what_comes_late_in_the_cycle_in_which_they_are_lowered(n):
    motor, brake = standing(n, "active", 400), standing(n, "passive", 400)
    motor.cycles(n + 3)
    brake.cycles(n + 3)
    motor.c.motor_limit_raw, brake.c.brake_limit_Nm = 7, 0.25
    motor.cycle()
    brake.cycle()
    assert abs(motor.motor_pm) <= 7
    assert brake.brake_Nm <= 0.25 + 1e-3


@pytest.mark.parametrize("n", CYCLES)
def test_near_the_speed_limit_the_motor_is_off_at_once(n):
    bench = standing(n, "active", -400)  # the spring's torque is positive
    bench.cycles(n + 3)
    assert bench.motor_pm > 0
    bench.counts += 0.9 * bench.c.speed_limit * 1e-3 / bench.c.rad_count
    bench.cycle()
    assert bench.phase is Phase.RUN
    assert bench.motor_pm == 0


def test_the_observers_share_is_that_of_now():
    bench = standing(4, "hybrid", 0, "mode.hybrid.F_s_Nm=0.0", "mode.hybrid.F_d_Nm=0.0")
    bench.c.passivity_J = float("inf")
    bench.k.law_function = compile_law(lambda motion, law, state: 0.0)
    step = 4 * bench.c.velocity_band_counts
    for _ in range(8):
        bench.counts += step
        bench.cycle()
    full = bench.motor_pm
    assert full > 0
    bench.h.share = 0.0
    bench.counts += step
    bench.cycle()
    assert bench.motor_pm == 0


def test_arming_is_as_fast_as_ever():
    late, prompt = HostBench("hybrid", "bus.delay_cycles=16"), HostBench("hybrid")
    for bench in (late, prompt):
        bench.arm()
    assert late.phase is Phase.RUN
    assert late.h.cycle == prompt.h.cycle


@pytest.mark.parametrize("channel", ["socketcan:can0", "coulombus:bench"])
def test_a_live_bus_refuses_the_delay_with_its_line(channel):
    address = parse_address(channel)
    check_no_delay(load_rig("bench"), address)
    check_no_delay(load_rig("bench", ["bus.delay_cycles=1"]), address)
    with pytest.raises(
        RigError, match=r"--set bus\.delay_cycles=2: bus\.delay_cycles: got '2', expected 1 .* virtual time"
    ):
        check_no_delay(load_rig("bench", ["bus.delay_cycles=2"]), address)


@pytest.mark.parametrize(
    ("value", "told"), [("0", "1 to 16"), ("17", "1 to 16"), ("2.5", "1 to 16"), ("true", "1 to 16")]
)
def test_a_delay_that_is_none_is_refused(value, told):
    with pytest.raises(RigError, match=told):
        load_rig("bench", [f"bus.delay_cycles={value}"])


def test_only_the_next_sync_delays_by_whole_cycles():
    with pytest.raises(
        RigError, match=r"bus\.delay_cycles: got '2', expected no such key, or bus\.actuation = 'next_sync'"
    ):
        load_rig("bench", ["bus.delay_cycles=2", 'bus.actuation="on_reception"'])


def test_a_longer_delay_is_remarked_at_check():
    rig = load_rig("bench", ["bus.delay_cycles=2"])
    assert any("bus.delay_cycles" in text and "coulombus run refuses it" in text for text in rig.warnings)
    assert not any("delay_cycles" in text for text in load_rig("bench").warnings)
