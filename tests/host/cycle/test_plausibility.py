"""The torque that the hand feels against the displayed one: what counts, what trips, and what says nothing."""

from __future__ import annotations

import math
import random

import numpy as np
import pytest

from coulombus.host.cycle.plausibility import SPEED_STEP, compare_felt
from coulombus.host.cycle.records import Phase
from coulombus.kernels.decorator import kernel
from host_bench import HostBench

LEVEL_NM, SPEED_COUNTS = 1.0, 5.0


@kernel
def _compared(axes, speeds, torques, motor_Nm):
    """Compare cycle by cycle; return whether it trips."""
    c, h, trips = axes[0].control, axes[0].host, False
    for k in range(len(speeds)):
        h.v_counts, h.handle_Nm = speeds[k], torques[k]
        trips = compare_felt(c, h, motor_Nm) or trips
    return trips


class Felt:
    """An axis in RUN that displays 1 Nm; the hand's torque and the speed are given cycle by cycle."""

    def __init__(self, sign=1, **control):
        bench = HostBench("hybrid").enter(Phase.RUN)
        self.axes, self.c, self.h = bench.k.records, bench.c, bench.h
        self.c.rad_count = sign * abs(self.c.rad_count)
        self.c.viscous = self.c.inertia = self.c.friction_Nm = 0.0
        for name, value in control.items():
            setattr(self.c, name, value)
        self.h.brake_lagged_Nm, self.h.fresh = LEVEL_NM, 1
        self.sign = sign

    def cycles(self, count, felt_Nm, counts=SPEED_COUNTS, motor_Nm=0.0):
        """Go on; return whether it trips, and in how many cycles the error counted."""
        before = int(self.h.implausible_torque)
        speeds, torques = (
            np.array([value(k) if callable(value) else value for k in range(count)], float)
            for value in (counts, felt_Nm)
        )
        trips = _compared(self.axes, speeds, torques, motor_Nm)
        return trips, int(self.h.implausible_torque) - before


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize(
    ("felt_Nm", "trips", "counts"),
    [
        *((1.0, False, False), (0.75, False, False), (1.25, False, False)),
        *((0.62, False, True), (1.38, False, True), (0.3, True, True), (1.7, True, True), (-0.5, True, True)),
    ],
)
def test_the_error_along_the_motion_is_compared_with_the_displayed_torque(sign, felt_Nm, trips, counts):
    for direction in (1, -1):
        felt = Felt(sign)
        tripped, counted = felt.cycles(3000, sign * direction * felt_Nm, direction * SPEED_COUNTS)
        assert tripped == trips
        assert (counted > 0) == counts


def test_the_motors_torque_belongs_to_the_balance():
    assert Felt().cycles(3000, 0.5, motor_Nm=0.5) == (False, 0)
    assert Felt().cycles(3000, 1.0, motor_Nm=0.5)[1] > 0


def test_a_trip_needs_its_time_and_the_error_in_a_row():
    felt = Felt(mismatch_cycles=400)
    first = next(k for k in range(3000) if felt.cycles(1, 0.0)[0])
    assert felt.h.felt_wrong == 401
    felt = Felt(mismatch_cycles=400)
    assert felt.cycles(first - 350, 0.0)[0] is False
    assert felt.cycles(2000, 1.0)[0] is False
    assert felt.h.felt_wrong == 0


@pytest.mark.parametrize("felt_Nm", [0.0, 0.4, -0.9])
def test_a_handle_that_rests_within_the_level_says_nothing(felt_Nm):
    felt = Felt()
    felt.cycles(2000, 0.62)
    error, size = float(felt.h.mean_error_Nm), float(felt.h.mean_size_Nm)
    felt.cycles(100, felt_Nm, counts=0.0)
    settled = float(felt.h.mean_error_Nm), float(felt.h.mean_size_Nm)
    felt.cycles(3000, felt_Nm, counts=0.0)
    assert (felt.h.mean_error_Nm, felt.h.mean_size_Nm) == settled
    assert settled == pytest.approx((error, size), abs=0.1)


def test_a_handle_that_is_held_above_the_level_is_locked():
    assert Felt().cycles(3000, 2.0, counts=0.0)[0]
    assert Felt().cycles(3000, -2.0, counts=0.0)[0]


def test_an_oscillation_around_the_displayed_torque_is_none():
    def inertia(k):
        return 1.0 + 0.8 * math.sin(2 * math.pi * 0.02 * k)

    assert Felt().cycles(4000, inertia) == (False, 0)


def test_the_inertia_of_the_rig_file_is_in_the_balance():
    rad_s2 = 40.0
    step = rad_s2 * 1e-6 / abs(Felt().c.rad_count)

    def speed(k):
        return SPEED_COUNTS + step * k

    assert Felt(inertia=0.0).cycles(400, 1.0 + 0.025 * rad_s2, speed)[1] > 0
    assert Felt(inertia=0.025).cycles(400, 1.0 + 0.025 * rad_s2, speed)[1] == 0


@pytest.mark.parametrize(
    "absent", [{"still_handle_Nm": math.inf}, {"fresh": 0}, {"phase": int(Phase.SETTLE)}, {"phase": int(Phase.SAFE)}]
)
def test_without_a_transducer_a_position_or_a_display_nothing_is_compared(absent):
    felt = Felt()
    for name, value in absent.items():
        setattr(felt.c if name == "still_handle_Nm" else felt.h, name, value)
    assert felt.cycles(3000, 5.0) == (False, 0)
    assert felt.h.mean_error_Nm == 0.0


def test_the_share_is_that_of_the_rig_file():
    assert Felt(mismatch_share=1e6).cycles(3000, 0.0) == (False, 0)
    assert Felt(mismatch_share=0.2).cycles(3000, 0.6)[0]


def test_a_small_torque_is_not_compared_with_itself_alone():
    weak = Felt(still_handle_Nm=0.25)
    weak.h.brake_lagged_Nm = 0.05
    assert weak.cycles(3000, 0.15) == (False, 0)
    assert weak.cycles(3000, 0.5)[0]


@pytest.mark.parametrize("direction", [1, -1])
@pytest.mark.parametrize(("share", "moves"), [(1.0, False), (1.001, True)])
def test_a_speed_of_just_the_band_is_no_motion(direction, share, moves):
    felt = Felt()
    counts = direction * share * SPEED_STEP * felt.c.velocity_band_counts
    felt.h.felt_v_counts = felt.h.mean_v_counts = counts
    felt.cycles(1, 0.0, counts)  # a hand that rests feels nothing; one that moves misses 1 Nm
    assert (felt.h.mean_error_Nm < 0.0) == moves
    felt.h.felt_error_Nm = felt.h.mean_error_Nm = 0.0
    felt.cycles(1, 2.0, counts)  # locked in the positive sense
    assert felt.h.mean_error_Nm * (direction if moves else 1) > 0.0


@pytest.mark.parametrize(
    ("still_handle_Nm", "counted", "wrong"), [(2.0, 0, 0), (1.999, 1, 0), (1.0, 1, 0), (0.999, 1, 1)]
)
def test_an_error_of_just_the_bound_is_none_too_large(still_handle_Nm, counted, wrong):
    felt = Felt(still_handle_Nm=still_handle_Nm, mismatch_share=0.0)
    felt.h.felt_v_counts = felt.h.mean_v_counts = SPEED_COUNTS
    felt.h.felt_error_Nm = felt.h.mean_error_Nm = 1.0
    assert felt.cycles(1, LEVEL_NM + 1.0)[1] == counted
    assert (felt.h.mean_error_Nm, felt.h.felt_wrong) == (1.0, wrong)


def equations(c, cycles):
    """The module's equations, cycle by cycle: mean error, size, and the counted cycles."""
    rad_s = c.rad_count * 1e9 / c.period_ns
    sign = math.copysign(1.0, c.rad_count)
    short = smooth_v = smooth_r = error = size = 0.0
    counted = wrong = 0

    def direction(v, band):
        return 0 if abs(v) <= band else math.copysign(1, v)

    for v, felt, level, motor in cycles:
        short, before = short + (v - short) / 5, smooth_v
        smooth_v += c.smooth_step * (v - smooth_v)
        moving = sign * direction(short, max(0.2 * c.velocity_band_counts, 0.2 * abs(smooth_v)))
        along = sign * direction(smooth_v, 0.2 * c.velocity_band_counts)
        lam, balance = level + c.friction_Nm, felt + motor
        if moving:
            r = balance - moving * lam - c.viscous * v * rad_s
        else:
            r = math.copysign(max(abs(balance) - lam, 0.0), balance)
        smooth_r += c.smooth_step * (r - smooth_r)
        if moving or r:
            inertia = c.inertia * (smooth_v - before) * rad_s / (c.period_ns * 1e-9)
            rest = smooth_r - inertia
            error += c.mean_step * ((along * rest if along else abs(rest)) - error)
            size += c.mean_step * (lam + abs(motor) + 3 * abs(inertia) - size)
            counted += abs(error) > max(0.3 * size, 0.5 * c.still_handle_Nm)
            wrong = wrong + 1 if abs(error) > max(0.5 * size, c.still_handle_Nm) else 0
        yield error, size, counted, wrong


def drawn(draw, count):
    """Speed [counts], hand's, brake's and motor's torque in each cycle: strokes, rests, pushes."""
    v = felt = level = motor = 0.0
    for k in range(count):
        if k % 97 == 0:
            v, felt = draw.choice((0.0, 0.0, draw.uniform(-40, 40))), draw.uniform(-2, 2)
            level, motor = draw.uniform(0, 2), draw.choice((0.0, draw.uniform(-1, 1)))
        yield draw.choice((v, v, v + draw.uniform(-2, 2))), felt + draw.uniform(-0.1, 0.1), level, motor


@pytest.mark.parametrize("seed", range(6))
def test_every_cycle_is_that_of_the_equations(seed):
    draw = random.Random(seed)
    felt = Felt(draw.choice((1, -1)), viscous=0.05, inertia=0.002, friction_Nm=0.14, velocity_band_counts=2.0)
    felt.c.still_handle_Nm, felt.c.period_ns = draw.uniform(0.05, 0.4), draw.choice((1_000_000, 2_000_000))
    felt.c.mismatch_cycles = 50
    cycles = list(drawn(draw, 3000))
    for (v, felt_Nm, level, motor), expected in zip(cycles, equations(felt.c, cycles), strict=True):
        felt.h.brake_lagged_Nm, before = level, float(felt.h.mean_size_Nm)
        trips, _ = felt.cycles(1, felt_Nm, v, motor)
        state = felt.h.mean_error_Nm, felt.h.mean_size_Nm, felt.h.implausible_torque, felt.h.felt_wrong
        assert state == pytest.approx(expected, abs=1e-9)
        assert trips == (felt.h.felt_wrong > 50 and felt.h.mean_size_Nm != before)
    assert felt.h.implausible_torque > 100
