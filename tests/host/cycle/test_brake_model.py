"""What coil, iron and fluid are believed to do: against the plant's own iron, and with beliefs that are wrong."""

from __future__ import annotations

import itertools
import math
import random
from types import SimpleNamespace

import numpy as np
import pytest

from coulombus.host.cycle.brake_model import brake_level, coil_for, expect, lead, magnetise, seen_by_fluid
from coulombus.host.cycle.records import Phase
from coulombus.rigs.rig import RigError, load_rig
from coulombus.sim_bus.rig.mr_brake import iron as plants_iron
from host_bench import HostBench

iron = getattr(plants_iron, "py_func", plants_iron)  # the truth here is no record

PLAYS, WEIGHTS = [0.1, 0.4], [0.25, 0.2]
IRON = (f"brake.iron.play_Nm={PLAYS}", f"brake.iron.weights={WEIGHTS}")
LAGS = ("brake.coil_lag_s=0.003", "brake.fluid_lag_s=0.015")
FELT = ('law.level="felt"', "law.velocity_window_cycles=32", *LAGS)


def true_iron(plays=PLAYS, weights=WEIGHTS):
    """Return the plant's iron, which is other code than the host's."""
    return SimpleNamespace(
        plays=len(plays), play_r=plays, play_w=weights, play_y=[0.0] * len(plays), direct=1 - math.fsum(weights)
    )


def levels(n=200, seed=3):
    rng = random.Random(seed)
    return [rng.uniform(0.4, 4.0) for _ in range(n)]


def test_the_brake_bears_what_friction_and_motor_leave():
    bench = HostBench("hybrid", *FELT)
    c, h = bench.c, bench.h
    h.slide_counts = 0.0
    assert brake_level(c, h, 1.0, 0.0) == pytest.approx(0.86)
    h.slide_counts = -1e-3 / abs(c.rad_count)  # 1 rad/s
    assert brake_level(c, h, 1.0, 0.1358) == pytest.approx(1.0 - 0.14 - 0.005 + 0.1358)
    assert brake_level(c, h, 0.1, 0.0) == 0.0


def test_without_the_section_nothing_is_inverted():
    bench = HostBench()
    assert bench.c.iron_plays == 0
    for coil in (1.25, -0.25):
        assert [f(bench.c, bench.h, coil) for f in (coil_for, magnetise, seen_by_fluid)] == [coil] * 3
    assert lead(bench.c, bench.h, 1.25) == 1.25


def test_the_host_believes_what_the_plant_does_if_their_numbers_are_the_same():
    bench, truth = HostBench("hybrid", *IRON), true_iron()
    for coil in levels():
        assert seen_by_fluid(bench.c, bench.h, coil) == pytest.approx(iron(true_iron_at(truth), coil), abs=1e-12)
        assert magnetise(bench.c, bench.h, coil) == pytest.approx(iron(truth, coil), abs=1e-12)


def true_iron_at(truth):
    return SimpleNamespace(**{**vars(truth), "play_y": list(truth.play_y)})


def test_through_the_inverse_the_fluid_sees_what_is_wanted_up_and_down():
    bench, truth = HostBench("hybrid", *IRON), true_iron()
    plain = true_iron()
    worst = 0.0
    for wanted in levels():
        coil = coil_for(bench.c, bench.h, wanted)
        magnetise(bench.c, bench.h, coil)
        assert iron(truth, coil) == pytest.approx(wanted, abs=1e-9)
        worst = max(worst, abs(iron(plain, wanted) - wanted))
    assert worst > 0.1  # what it is without


@pytest.mark.parametrize("beyond", [-0.5, 0.0, 0.5])
def test_beyond_the_ends_the_inverse_goes_on_with_slope_1(beyond):
    bench = HostBench("hybrid", *IRON)
    magnetise(bench.c, bench.h, 3.0)
    limit = float(bench.c.brake_limit_Nm)
    least, most = seen_by_fluid(bench.c, bench.h, 0.0), seen_by_fluid(bench.c, bench.h, limit)
    assert least > 0.05  # it remembers
    assert coil_for(bench.c, bench.h, most + abs(beyond)) == pytest.approx(limit + abs(beyond))
    assert coil_for(bench.c, bench.h, least - abs(beyond)) == pytest.approx(-abs(beyond), abs=1e-9)


def test_at_0_and_at_the_first_guess_the_inverse_is_exact():
    bench = HostBench("hybrid", *IRON)
    limit = float(bench.c.brake_limit_Nm)
    assert coil_for(bench.c, bench.h, -0.05) == -0.05  # below 0 with slope 1, though the iron's is less there
    magnetise(bench.c, bench.h, 3.0)
    for coil in (0.0, 0.5 * limit):
        assert coil_for(bench.c, bench.h, seen_by_fluid(bench.c, bench.h, coil)) == coil


def test_between_the_ends_the_inverse_never_falls_and_has_no_jump():
    bench = HostBench("hybrid", *IRON)
    for coil in (3.0, 0.5, 1.5):
        magnetise(bench.c, bench.h, coil)
    asked = [0.001 * k for k in range(6000)]
    coils = [coil_for(bench.c, bench.h, wanted_Nm) for wanted_Nm in asked]
    steps = [later - earlier for earlier, later in itertools.pairwise(coils)]
    assert min(steps) >= 0
    assert max(steps) < 0.001 / bench.c.iron_direct + 1e-6


def shown(bench, truth, course):
    """Return the plant's torque, cycle by cycle, while the host leads through its belief."""
    c, h = bench.c, bench.h
    coil = fluid = 0.0
    torques_Nm = []
    for level in course:
        h.brake_Nm = lead(c, h, level)
        assert 0.0 <= h.brake_Nm <= c.brake_limit_Nm
        for _ in range(20):
            coil += (h.brake_Nm - coil) * (1 - math.exp(-5e-5 / 0.003))
            fluid += (iron(truth, coil) - fluid) * (1 - math.exp(-5e-5 / 0.015))
        expect(c, h)
        torques_Nm.append(fluid)
    return torques_Nm


def test_the_lead_brings_the_brake_to_its_level_sooner():
    slow, fast = (np.array(shown(HostBench("hybrid", *lags), true_iron([], []), [2.0] * 100)) for lags in ((), LAGS))
    arrived = [int(np.argmax(np.abs(course - 2.0) < 0.1)) for course in (slow, fast)]
    assert arrived[1] < 0.5 * arrived[0]
    assert fast.max() < 1.05 * 2.0
    assert fast[-1] == pytest.approx(2.0, rel=5e-3)


def test_the_set_point_that_is_sent_leads():
    bench = HostBench("passive", *FELT).enter(Phase.RUN)
    bench.c.gain_step, bench.k.law[0].F_s = 1.0, 1.0
    bench.cycles(2)
    assert bench.h.brake_Nm > 1.5  # a level of 1 Nm less the device's own friction


def test_a_lead_that_believes_in_wrong_lags_ends_at_the_level_all_the_same():
    bench = HostBench("hybrid", "brake.coil_lag_s=0.006", "brake.fluid_lag_s=0.03")
    assert shown(bench, true_iron([], []), [2.0] * 100)[-1] == pytest.approx(2.0, rel=0.01)


COURSE = [2.0] * 150 + [3.0] * 150 + [1.0] * 150 + [2.0] * 150


@pytest.mark.parametrize("lags", [LAGS, LAGS[1:], LAGS[:1], ()])
def test_the_torque_comes_to_its_level_from_above_and_from_below(lags):
    torques_Nm = shown(HostBench("hybrid", *IRON, *lags), true_iron(), COURSE)
    for k in (149, 299, 449, 599):
        assert torques_Nm[k] == pytest.approx(COURSE[k], rel=0.005)
    without = shown(HostBench("hybrid", *lags), true_iron(), COURSE)
    assert max(abs(without[k] / COURSE[k] - 1) for k in (149, 299, 449, 599)) > 0.04


def test_what_is_expected_is_what_the_plant_bears():
    bench, truth = HostBench("hybrid", *IRON, *LAGS), true_iron()
    torques_Nm = shown(bench, truth, COURSE)
    assert bench.h.brake_lagged_Nm == pytest.approx(torques_Nm[-1], abs=2e-3)


@pytest.mark.parametrize(
    ("plays", "weights"),
    [
        ([0.2, 0.8], WEIGHTS),  # 100 % too much play
        (PLAYS, [0.5, 0.4]),  # 100 % too heavy
        (PLAYS, [-0.25, -0.2]),  # the wrong sign
        ([50.0, 80.0], [0.5, 0.5]),  # nothing follows but by the plays
        ([1e-3], [1.0]),
        (PLAYS, [-3.0, -2.0]),
    ],
)
def test_a_wrong_belief_is_wrong_by_no_more_than_the_limits_let_it(plays, weights):
    bench = HostBench("hybrid", *IRON, *LAGS)
    c = bench.c
    c.iron_plays, c.iron_direct = len(plays), 1 - math.fsum(weights)
    for k, (play, weight) in enumerate(zip(plays, weights, strict=True)):
        c.iron_r[k], c.iron_w[k] = play, weight
    torques_Nm = shown(bench, true_iron(), COURSE * 2)  # each cycle's set-point is within 0 and the limit
    assert all(0.0 <= torque_Nm <= c.brake_limit_Nm for torque_Nm in torques_Nm)
    last = torques_Nm[-50:]
    assert max(last) - min(last) < 2e-3  # and it comes to rest


@pytest.mark.parametrize("wanted", [math.inf, -math.inf, 1e300, -1e300, math.nan])
def test_what_is_no_torque_becomes_no_set_point_beyond_the_limits(wanted):
    bench = HostBench("hybrid", *IRON, *LAGS)
    sent = lead(bench.c, bench.h, wanted)
    assert math.isnan(wanted) or 0.0 <= sent <= bench.c.brake_limit_Nm


@pytest.mark.parametrize(
    ("overrides", "text"),
    [
        (["brake.iron.weights=[0.2]"], "play_Nm: missing in .brake.iron."),
        (["brake.iron.play_Nm=[0.1]", "brake.iron.weights=[0.2, 0.3]"], "got 2 values where play_Nm has 1"),
        (["brake.iron.play_Nm=[0.1, 0.2]", "brake.iron.weights=[0.7, 0.7]"], "together 1.4; expected at most 1"),
        (["brake.iron.play_Nm=[0.0]", "brake.iron.weights=[0.7]"], "numbers above 0"),
        (["brake.iron.play_Nm=[0.1]", "brake.iron.weights=[-0.7]"], "numbers from 0 to 1"),
        (["brake.iron=3"], "brake.iron"),
    ],
)
def test_iron_that_is_none_is_refused(overrides, text):
    with pytest.raises(RigError, match=text):
        load_rig("bench", overrides)


def test_at_the_upper_end_of_an_iron_that_gives_nothing_at_once_the_coil_is_full():
    """Such an iron is flat behind a reversal: a lower coil would show the same now, and the brake was at its limit."""
    bench = HostBench("hybrid", "brake.iron.play_Nm=[0.25]", "brake.iron.weights=[1.0]", "limits.brake_torque_Nm=1.0",
                      "mode.hybrid.F_s_Nm=0.75", "mode.hybrid.F_d_Nm=0.75")  # fmt: skip
    c, h = bench.c, bench.h
    magnetise(c, h, c.brake_limit_Nm)
    largest_Nm = seen_by_fluid(c, h, c.brake_limit_Nm)
    assert largest_Nm == seen_by_fluid(c, h, 0.5 * c.brake_limit_Nm + 0.25) == 0.75
    assert coil_for(c, h, largest_Nm) == c.brake_limit_Nm == 1.0


def test_a_single_operator_is_inverted_too():
    bench, truth = HostBench("hybrid", "brake.iron.play_Nm=[0.3]", "brake.iron.weights=[0.4]"), true_iron([0.3], [0.4])
    for wanted in (2.0, 1.0, 3.0, 1.5):
        coil = coil_for(bench.c, bench.h, wanted)
        assert iron(truth, coil) == pytest.approx(wanted, abs=1e-9)
        assert magnetise(bench.c, bench.h, coil) == pytest.approx(wanted, abs=1e-9)


def test_a_belief_of_the_wrong_sign_expects_no_negative_torque():
    bench = HostBench("hybrid", *IRON)
    bench.c.iron_direct = -2.0
    assert magnetise(bench.c, bench.h, 3.0) == 0.0
