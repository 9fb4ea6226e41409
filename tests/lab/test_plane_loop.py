"""Friction in the plane without a bus: hold, break-away, circles, and the energies, on rigs/plane.toml."""

from __future__ import annotations

import math

import numpy as np
import pytest

from coulombus.host.laws.plane.plane_laws import load_plane_law
from coulombus.lab.plane_loop import PlaneRun, circle, simulate_plane
from coulombus.rigs.errors import RigError
from coulombus.rigs.rig import load_rig

F_S, F_D = 3.3, 3.0
LAW = load_plane_law("plane_karnopp", [f"F_s_N={F_S}", f"F_d_N={F_D}", "band_m_s=0.008"])
IDEAL = (
    *("plant.coulomb_Nm=0", "plant.brake_off_state_Nm=0", "mechanics.friction_Nm=0"),
    *("plant.brake_coil_lag_s=0", "brake.coil_lag_s=0"),  # as the host believes
)
pytestmark = pytest.mark.slow  # each runs 60,000 steps of the plant, or more

ELBOWS = (90, 110, 130)
CELLS = [(elbow, frequency) for elbow in ELBOWS for frequency in (0.25, 0.5, 1.0)]


def rig_at(elbow, *overrides):
    """The rig with its tip on the x axis at an elbow [deg], and the tip there [m]."""
    q2 = math.radians(elbow)
    return load_rig("plane", (f"kinematics.start_rad=[{-q2 / 2}, {q2}]", *overrides)), 0.4 * math.cos(q2 / 2)


def drawn(elbow, frequency, *overrides, laps=2.5, **run):
    """A circle of 5 cm about the start, and the errors from half a lap on."""
    rig, x = rig_at(elbow, *overrides)
    share = np.linspace(0, 1, 1001)[:-1, None]
    way = np.hstack((x + 0.05 * share**2 * (3 - 2 * share), 0 * share))
    course = simulate_plane(
        rig, np.vstack((way, circle((x, 0.0), 0.05, frequency, laps / frequency))), PlaneRun(law=LAW, **run)
    )
    return course, course.display_errors(from_s=1.0 + 0.5 / frequency)


LINKS = tuple(
    f"kinematics.link_{name}=[{value}, {value}]"
    for name, value in (("mass_kg", 0.3), ("centre_m", 0.1), ("inertia_kg_m2", 1e-3))
)

HEAVIER_KG = 0.54
"""The arm's mass at the tip along its heavier direction, with an elbow of 110 degrees."""
BOUND_NS_M = 0.88 * 0.8 * HEAVIER_KG * 2 * math.pi * 9.0


def swing_m_s(k, damping_Ns_m, friction_Nm):
    """Return the tip's speed 4 s after a tap, without friction, in a springy hand of 9 Hz."""
    stiffness = (2 * math.pi * 9.0) ** 2 * (HEAVIER_KG + 0.05)
    hand = (f"plane.hand_{name}=[{value}, {value}]" for name, value in
            (("damping_Ns_m", damping_Ns_m), ("stiffness_N_m", stiffness)))  # fmt: skip
    beliefs = (f"mechanics.friction_Nm={friction_Nm}", "mode.hybrid.compensation=0.0")
    truth = ("plant.coulomb_Nm=0", "plant.brake_off_state_Nm=0", "plane.hand_mass_kg=0.05")
    rig, x = rig_at(110, *LINKS, *hand, *beliefs, *truth, f"mode.hybrid.inertia_compensation={k}")
    push = np.zeros((2501, 2))
    push[100:110] = 3.0
    run = PlaneRun("hybrid", load_plane_law("plane_viscous", ["B_Ns_m=0"]), period_s=0.002, window_cycles=4)
    speed = np.hypot(*simulate_plane(rig, np.tile([x, 0.0], (2501, 1)), run, push).vectors("vx_m_s", "vy_m_s").T)
    return float(speed[-250:].max())


@pytest.mark.thorough
def test_a_springy_hand_rings_beyond_the_bound_of_the_compensated_inertia_and_within_it_does_not():
    """A friction that the host believes far too high frees the motors from the split's bound of the power."""
    assert swing_m_s(0.8, 1.1 * BOUND_NS_M, friction_Nm=1.5) < 0.01
    assert swing_m_s(0.8, 0.9 * BOUND_NS_M, friction_Nm=1.5) > 0.1
    assert swing_m_s(0.0, 0.9 * BOUND_NS_M, friction_Nm=1.5) < 1e-3


def test_the_splits_bound_of_the_power_keeps_such_a_hand_quiet():
    assert swing_m_s(0.8, 0.75 * BOUND_NS_M, friction_Nm=0.0) < 1e-3


def held(elbow, mode):
    rig, x = rig_at(elbow)
    t = np.arange(3001) * 1e-3
    push = 0.6 * F_S * np.sin(2 * math.pi * 0.5 * t)
    for tap in (600, 2100):
        push[tap : tap + 10] += 0.17 * F_S
    course = simulate_plane(rig, np.tile([x, 0.0], (len(t), 1)), PlaneRun(mode, LAW), np.outer(push, [0.6, 0.8]))
    v = course.vectors("vx_m_s", "vy_m_s")[500:]
    return course, float(np.sqrt((v**2).sum(axis=1).mean()))


@pytest.mark.parametrize("elbow", ELBOWS)
@pytest.mark.parametrize("mode", ["hybrid", "passive"])
def test_brakes_hold_a_hand_below_the_static_friction(elbow, mode):
    course, rms = held(elbow, mode)
    assert rms == 0.0
    assert np.ptp(course.vectors("x_m", "y_m"), axis=0).max() == 0.0
    assert (course.column("stuck") == 1).all()


@pytest.mark.parametrize("elbow", ELBOWS)
def test_motors_alone_oscillate_at_rest(elbow):
    _, rms = held(elbow, "active")
    assert 0.005 < rms < 0.05


@pytest.mark.thorough
@pytest.mark.parametrize("elbow", ELBOWS)
@pytest.mark.parametrize("rate_N_s", [1.0, 10.0])
def test_break_away_is_at_the_static_friction_in_all_directions(elbow, rate_N_s):
    rig, x = rig_at(elbow)
    t = np.concatenate((np.zeros(300), np.arange(0, 1.3 * F_S / rate_N_s, 1e-3)))
    for turn in np.arange(36) * 2 * math.pi / 36:
        push = np.outer(rate_N_s * t, [math.cos(turn), math.sin(turn)])
        course = simulate_plane(rig, np.tile([x, 0.0], (len(t), 1)), PlaneRun("hybrid", LAW), push)
        speed = np.hypot(*course.vectors("vx_m_s", "vy_m_s").T)
        first = int(np.flatnonzero(speed > 1e-5)[0])
        assert rate_N_s * t[first] == pytest.approx(F_S, rel=0.04)


@pytest.mark.parametrize(("elbow", "frequency"), CELLS)
def test_a_circle_is_displayed_within_the_targets(elbow, frequency):
    course, errors = drawn(elbow, frequency)
    assert errors["median_deg"] <= 2.0
    assert errors["p95_deg"] <= 12.0
    assert errors["median_N"] == pytest.approx(F_D, rel=0.02)
    assert errors["p95_N"] == pytest.approx(F_D, rel=0.05)
    assert course.host[0]["outside"] == 0


@pytest.mark.parametrize(("elbow", "frequency"), CELLS)
def test_without_friction_of_its_own_a_circle_is_displayed_better(elbow, frequency):
    _, errors = drawn(elbow, frequency, *IDEAL)
    assert errors["median_deg"] <= 1.2
    assert errors["p95_deg"] <= 4.0
    assert errors["median_N"] == pytest.approx(F_D, rel=0.005)
    assert errors["p95_N"] == pytest.approx(F_D, rel=0.015)


@pytest.mark.parametrize("elbow", ELBOWS)
def test_the_direction_that_is_foreseen_follows_a_fast_circle(elbow):
    foreseen, seen = drawn(elbow, 1.0)[1], drawn(elbow, 1.0, turn_s=0.0)[1]
    assert foreseen["median_deg"] < 1.0 < 1.5 < seen["median_deg"]


@pytest.mark.parametrize("elbow", ELBOWS)
@pytest.mark.parametrize("frequency", [0.25, 0.5, 1.0])
def test_a_circle_is_displayed_within_the_targets_at_500_hz(elbow, frequency):
    rig, x = rig_at(elbow)
    share = np.linspace(0, 1, 501)[:-1, None]
    way = np.hstack((x + 0.05 * share**2 * (3 - 2 * share), 0 * share))
    goal = np.vstack((way, circle((x, 0.0), 0.05, frequency, 2.5 / frequency, 2e-3)))
    course = simulate_plane(rig, goal, PlaneRun(law=LAW, period_s=2e-3, window_cycles=3))
    errors = course.display_errors(1.0 + 0.5 / frequency)
    assert errors["median_deg"] <= 2.0
    assert errors["p95_deg"] <= 12.0
    assert (errors["median_N"], errors["p95_N"]) == pytest.approx((F_D, F_D), rel=0.05)


@pytest.mark.parametrize("elbow", [75, 130])
def test_a_slow_circle_is_displayed_within_four_degrees(elbow):
    rig, x = rig_at(elbow, "plane.hand_stiffness_N_m=[800, 800]")
    goal_m = circle((x - 0.05, 0.0), 0.05, 0.1, 8.0, 2e-3)
    course = simulate_plane(rig, goal_m, PlaneRun(law=LAW, period_s=2e-3, window_cycles=4))
    assert course.display_errors(from_s=1.0, least_m_s=0.02)["p95_deg"] < 4.0


@pytest.mark.parametrize("corner_deg", [90, 120])
def test_a_slow_motion_that_turns_a_corner_is_not_pushed_on(corner_deg):
    rig, x = rig_at(110, "plane.hand_stiffness_N_m=[3000, 3000]")
    way_m = 0.04e-3 * np.arange(1, 601)[:, None]  # at 4 cm/s
    corner = math.radians(corner_deg)
    legs_m = way_m * [1.0, 0.0], way_m[-1] * [1.0, 0.0] + way_m * [math.cos(corner), math.sin(corner)]
    start_m = np.linspace([x, 0.0], [x - 0.02, 0.0], 500)
    course = simulate_plane(rig, np.vstack((start_m, start_m[-1] + np.vstack(legs_m))), PlaneRun(law=LAW))
    power = (course.vectors("shown_x_N", "shown_y_N") * course.vectors("vx_m_s", "vy_m_s")).sum(axis=1)
    assert power.max() < 1e-6


def test_brakes_alone_and_a_host_without_the_lag_are_worse():
    hybrid, passive = drawn(110, 0.5)[1], drawn(110, 0.5, mode="passive")[1]
    ignorant = drawn(110, 0.5, models_lag=False)[1]
    assert passive["p95_deg"] > 30 > 12 > hybrid["p95_deg"]
    assert passive["median_deg"] > 5 > hybrid["median_deg"]
    assert passive["p95_N"] > 1.3 * F_D
    assert ignorant["median_deg"] > 1.5 * hybrid["median_deg"]
    assert ignorant["p95_deg"] > 2 * hybrid["p95_deg"]


@pytest.mark.parametrize("mode", ["active", "passive", "hybrid"])
def test_energies_close_and_the_whole_takes_energy_on_each_lap(mode):
    course, _ = drawn(110, 1.0, laps=2, mode=mode)
    p = course.plant[0]
    assert abs(course.residual_J) < 1e-11
    assert (p["work_brake"] <= 0).all()
    assert (p["work_friction"] <= 0).all()
    shown, v = course.vectors("shown_x_N", "shown_y_N"), course.vectors("vx_m_s", "vy_m_s")
    lap = slice(len(shown) - 1000, len(shown))
    assert float((shown[lap] * v[lap]).sum()) * 1e-3 < -0.8 * F_D * 2 * math.pi * 0.04


def test_the_motors_work_is_bounded_by_what_the_whole_takes_up_and_observed():
    course, _ = drawn(90, 1.0)
    p, split = course.plant[0], course.host[0]["split"]
    taken = -float(p["work_motor"].sum() + p["work_brake"].sum() + p["work_friction"].sum())
    assert 0.05 < p["work_motor"].sum() < 0.25 * taken
    assert split["motor_J"] == pytest.approx(p["work_motor"], abs=0.03)
    assert split["taken_J"] == pytest.approx(taken, rel=0.05)


def test_a_turned_arm_with_other_signs_displays_the_same():
    plain, _ = drawn(110, 1.0, laps=1)
    rig, x = rig_at(110, "kinematics.signs=[-1, 1]", "kinematics.offsets_rad=[0.2, -0.1]")
    q1, q2 = -math.radians(55), math.radians(110)
    rig = rig.variant(f"kinematics.start_rad=[{-(q1 - 0.2)}, {q2 + 0.1}]")
    share = np.linspace(0, 1, 1001)[:-1, None]
    way = np.hstack((x + 0.05 * share**2 * (3 - 2 * share), 0 * share))
    turned = simulate_plane(rig, np.vstack((way, circle((x, 0.0), 0.05, 1.0, 1.0))), PlaneRun(law=LAW))
    ours, theirs = turned.display_errors(1.2), plain.display_errors(1.2)
    assert ours["median_deg"] == pytest.approx(theirs["median_deg"], abs=0.4)
    assert ours["median_N"] == pytest.approx(theirs["median_N"], rel=0.01)


def test_no_force_is_displayed_near_a_singular_pose():
    rig, x = rig_at(50)
    goal = np.stack((np.linspace(x, 0.399, 2001), np.zeros(2001)), axis=1)
    course = simulate_plane(rig, goal, PlaneRun(law=LAW))
    assert course.host[0]["outside"] > 100
    assert course.host[0]["split"]["brake_Nm"].tolist() == [0.0, 0.0]
    assert course.host[0]["split"]["motor_Nm"].tolist() == [0.0, 0.0]


@pytest.mark.parametrize(
    ("rig", "words"),
    [
        (("two_axes",), r"no \[plane\]"),
        (("plane", ("kinematics.kind=cartesian", "kinematics.radii_m_rad=[0.1, 0.1]")), "kinematics"),
    ],
)
def test_another_mechanism_than_two_links_is_refused(rig, words):
    with pytest.raises(RigError, match=words):
        simulate_plane(load_rig(*rig), np.zeros((2, 2)))


def test_a_cycle_is_a_whole_number_of_steps():
    with pytest.raises(RigError, match="whole number of steps"):
        simulate_plane(load_rig("plane"), np.zeros((2, 2)), PlaneRun(period_s=1.01e-3))
