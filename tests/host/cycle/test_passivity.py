"""The passivity observer: which motion takes the motor's compensation away, and what a run begins with."""

from __future__ import annotations

import math

import pytest

from coulombus.host.cycle.phases import enter
from coulombus.host.cycle.records import Image, Phase
from host_bench import HostBench

FELT = ('law.level="felt"', "law.velocity_window_cycles=32", "brake.coil_lag_s=0.003", "brake.fluid_lag_s=0.015")


def turned(handle_Nm, cycles=400):
    """Return the bench after a hand of `handle_Nm` turned the free handle at 2 rad/s."""
    bench = HostBench("hybrid", "law.gain_ramp_s=0", "mode.hybrid.F_s_Nm=0.0", "mode.hybrid.F_d_Nm=0.0")
    bench.arm()
    bench.handle_Nm = handle_Nm
    for _ in range(cycles):
        bench.counts += 25
        bench.cycle()
    return bench


def test_a_hand_that_pays_for_the_motion_leaves_the_motor_its_compensation():
    bench = turned(0.03)
    assert bench.h.withheld_compensation == 0
    assert bench.h.torque_Nm == pytest.approx(bench.c.compensation_Nm)


def test_motion_that_nobody_pays_for_takes_the_compensation_away_and_the_brake_bears_it():
    bench = turned(0.0)
    assert bench.h.withheld_compensation > 0
    assert bench.h.share == 0.0
    assert bench.h.torque_Nm == 0.0
    assert bench.h.brake_Nm == pytest.approx(bench.c.compensation_Nm)


def kicked(moves, handle_Nm=0.0, belief=()):
    """Return the bench after a course of moves [counts a cycle; None: no position comes]."""
    bench = HostBench("hybrid", "law.gain_ramp_s=0", "mode.hybrid.F_s_Nm=0.0", "mode.hybrid.F_d_Nm=0.0", *belief)
    bench.arm()
    bench.handle_Nm = handle_Nm
    for moved in moves:
        bench.silent = {"motor"} if moved is None else set()
        bench.counts += moved or 0
        bench.cycle()
    return bench


@pytest.mark.parametrize("uneven", [3, 10, 20])
def test_a_velocity_that_is_uneven_by_the_sampling_is_no_doubt(uneven):
    moves = [25 + (uneven if k % 2 else -uneven) for k in range(400)]
    assert kicked(moves, 0.03).h.withheld_compensation == 0


@pytest.mark.parametrize("late", [1, 2])
def test_a_sample_that_comes_late_now_and_then_is_no_doubt(late):
    moves = []
    for _ in range(40):
        moves += [25] * 8 + [25 - 10 * late, 25 + 10 * late]
    assert kicked(moves, 0.03).h.withheld_compensation == 0


def test_positions_that_are_lost_now_and_then_are_no_doubt():
    moves = []
    for _ in range(40):
        moves += [25] * 8 + [None, 50]
    bench = kicked(moves, 0.03)
    assert bench.phase == Phase.RUN
    assert bench.h.withheld_compensation == 0


def test_an_uneven_velocity_hides_no_motion_that_nobody_pays_for():
    bench = kicked([25 + (10 if k % 2 else -10) for k in range(600)])
    assert bench.h.share == 0.0


def test_an_elastic_transmission_that_winds_in_stick_is_no_doubt():
    """The encoder moves by up to 2 counts a cycle, while the brake holds the hand with 3.5 Nm."""
    bench = HostBench("hybrid", "law.gain_ramp_s=0")
    bench.arm()
    for k in range(4000):
        bench.handle_Nm = 3.0 * math.sin(k / 40)
        bench.counts = round(40 * math.sin(k / 40))
        bench.cycle()
    assert bench.h.port_J >= 0.0
    assert bench.h.share == 1.0
    assert bench.h.withheld_compensation == 0


def test_a_debt_is_not_forgotten_in_stick():
    bench = kicked([25] * 400 + [0] * 50)
    assert bench.h.port_J < -2 * bench.c.passivity_J
    assert bench.h.share == 0.0


def test_a_balance_begins_anew_with_each_run():
    bench = kicked([25] * 400)
    assert bench.h.port_J < 0.0
    assert bench.h.port_way > 0.0
    assert bench.h.port_slid_ns > 0
    bench.h.port_pushed_Nm = 1.0
    enter(bench.axis, Phase.RUN, 0)
    assert [bench.h.port_way, bench.h.port_slid_ns, bench.h.port_pushed_Nm] == [0, 0, 0]
    assert bench.h.port_J == 0.0
    assert max(bench.h.port_kinetic_J) == 0.0
    assert bench.h.share == 1.0


def test_a_run_begins_with_the_hand_s_torque_of_now_and_a_window_without_positions():
    bench = HostBench("hybrid", *FELT)
    h = bench.h
    h.handle_Nm, h.port_handle_Nm, h.track_length = 0.25, -0.5, 7
    enter(bench.axis, Phase.RUN, 0)
    assert h.port_handle_Nm == 0.25
    assert h.track_length == 0


def test_the_motor_s_net_work_counts_the_whole_way_across_a_lost_position():
    bench = HostBench("hybrid")
    bench.arm()
    for moved in (10, None, 30):
        bench.silent = {"motor"} if moved is None else set()
        bench.counts += moved or 0
        bench.torque_pm = 100
        bench.cycle()
    row = int(bench.h.work_row) - 1
    assert bench.h.moved_counts == 30
    torque_Nm = bench.h.image[Image.TORQUE] * bench.c.torque_Nm_raw + bench.c.torque_commanded * bench.h.torque_Nm
    assert bench.h.work[row] == pytest.approx(torque_Nm * 30 * bench.c.rad_count)
    assert bench.h.work[row] != 0.0
