"""The plants of two axes as joints of one arm: energy, signs, and the hand's force."""

from __future__ import annotations

import math

import numpy as np
import pytest

from coulombus.kernels.records import new_records
from coulombus.rigs.rig import RigError, load_rig
from coulombus.sim_bus.rig.arm_plant import PLANE_COLUMNS, advance_joints, new_plane_plant
from coulombus.sim_bus.rig.plane_hand import PlaneHand, drawn_hand
from coulombus.sim_bus.rig.plant import TRUTH_COLUMNS, new_plant
from coulombus.sim_bus.rig.records import PlantRecord

COLUMNS = (*TRUTH_COLUMNS, *PLANE_COLUMNS)


def joints(*overrides):
    rig = load_rig("plane", overrides)
    plants = new_records(PlantRecord, 2)
    for a, axis in enumerate(rig.axes):
        plants[a : a + 1] = new_plant(axis)
    plants["plane"][:1] = new_plane_plant(rig)
    return plants


def course(plants, force_N, steps=400, per_knot=20):
    """Return both joints' courses by column, under a force (shape (2,) or a function of time)."""
    t_s = np.arange(steps // per_knot + 2) * per_knot * 50e-6
    f_h = np.ascontiguousarray(np.stack([np.broadcast_to(force_N(t_s)[k], t_s.shape) for k in (0, 1)]))
    truth = np.zeros((2, steps, len(COLUMNS)))
    advance_joints(plants, f_h, per_knot, 0, steps, truth, 0)
    return [dict(zip(COLUMNS, truth[k].T, strict=True)) for k in (0, 1)]


def push(t_s):
    return 20.0 * np.sin(40.0 * t_s), -30.0 * np.cos(25.0 * t_s)


@pytest.mark.parametrize("signs", [[1, 1], [-1, 1], [1, -1]])
def test_the_works_are_the_change_of_the_kinetic_energy(signs):
    q2 = 1.92 * signs[1]
    plants = joints(f"kinematics.signs={signs}", f"kinematics.start_rad=[{-0.95 * signs[0]}, {q2}]")
    plants["brake_Nm"], plants["motor_pm"] = [1.0, 0.4], [300.0, -200.0]
    both = course(plants, push)
    names = ("operator_work_J", "motor_work_J", "brake_work_J", "friction_work_J")
    works = sum(joint[name] for joint in both for name in names) - sum(joint["viscous_loss_J"] for joint in both)
    kinetic = both[0]["kinetic_energy_J"]
    assert kinetic.max() > 0.05
    assert np.abs(works - kinetic).max() < 1e-12
    assert not both[1]["kinetic_energy_J"].any()
    assert all(np.all(np.diff(joint["brake_work_J"] + joint["friction_work_J"]) <= 1e-15) for joint in both)


def test_a_joint_of_the_other_sense_moves_the_tip_alike():
    plain, turned = (
        course(joints(*told), push) for told in ((), ("kinematics.signs=[-1, 1]", "kinematics.start_rad=[0.95, 1.92]"))
    )
    for name in PLANE_COLUMNS:
        np.testing.assert_allclose(turned[0][name], plain[0][name], rtol=1e-9, atol=1e-12)
    for name in ("angle_rad", "speed_rad_s", "operator_Nm", "brake_Nm"):
        np.testing.assert_allclose(turned[0][name], -plain[0][name], rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(turned[1][name], plain[1][name], rtol=1e-9, atol=1e-12)


def test_brakes_hold_both_joints_exactly_at_rest():
    plants = joints()
    plants["brake_Nm"] = 4.0
    still = course(plants, lambda t_s: (0.0 * t_s, 0.0 * t_s), 3000)  # the brakes' lags are over
    assert not still[0]["speed_rad_s"].any()
    held = course(plants, lambda t_s: (3.0 + 0.0 * t_s, 1.0 + 0.0 * t_s), 400)
    assert not any(joint["speed_rad_s"].any() for joint in held)
    shown = np.array([held[0]["shown_x_N"][-1], held[0]["shown_y_N"][-1]])
    np.testing.assert_allclose(shown, [-3.0, -1.0], atol=1e-12)


def test_the_tip_moves_as_the_joints_say():
    plants = joints()
    both = course(plants, push)
    q1, q2 = -0.95 + both[0]["angle_rad"], 1.92 + both[1]["angle_rad"]
    np.testing.assert_allclose(both[0]["tip_x_m"], 0.2 * np.cos(q1) + 0.2 * np.cos(q1 + q2), atol=1e-12)
    np.testing.assert_allclose(both[0]["tip_y_m"], 0.2 * np.sin(q1) + 0.2 * np.sin(q1 + q2), atol=1e-12)


def test_a_link_longer_than_believed_moves_the_tip_elsewhere():
    truth = {"l1_m": 0.25, "l2_m": 0.15, "offsets_rad": [0.1, -0.2], "signs": [1, -1], "start_rad": [-0.9, -1.8]}
    both = course(joints(*(f"plane.kinematics.{key}={value}" for key, value in truth.items())), push)
    a1, a2 = -0.8 + both[0]["angle_rad"], 1.6 - both[1]["angle_rad"]
    assert np.ptp(a2) > 0.01
    np.testing.assert_allclose(both[0]["tip_x_m"], 0.25 * np.cos(a1) + 0.15 * np.cos(a1 + a2), atol=1e-12)
    np.testing.assert_allclose(both[0]["tip_y_m"], 0.25 * np.sin(a1) + 0.15 * np.sin(a1 + a2), atol=1e-12)


@pytest.mark.parametrize(
    ("override", "reason"),
    [
        ('kinematics.kind="five_bar"', "two links in series are the only mechanism"),
        ("axis.elbow.plant.step_s=25e-6", "differs from that of axis shoulder"),
        ("axis.elbow.plant.transducer_inertia_kg_m2=0.001", "a joint of \\[plane\\] is one rigid body"),
    ],
)
def test_what_is_not_simulated_is_refused(override, reason):
    more = ("kinematics.l3_m=0.2", "kinematics.l4_m=0.2", "kinematics.base_m=0.1", "kinematics.start_rad=[2.0, 1.0]")
    with pytest.raises(RigError, match=reason):
        new_plane_plant(load_rig("plane", (override, *(more if "five" in override else ()))))


SCHEDULE = (
    'phase=[{kind = "rest", duration_s = 1.0}, {kind = "tip_hold", duration_s = 1.0, push_F_s = 0.5, frequency_Hz = 1.0, '
    'direction_rad = 0.6, taps_s = [0.5], tap_N = 4.0, tap_s = 0.1}, {kind = "tip_line", duration_s = 1.0, length_m = 0.1, '
    'direction_rad = 1.0, frequency_Hz = 0.5}, {kind = "tip_circle", duration_s = 2.5, radius_m = 0.05, frequency_Hz = 1.0, '
    'approach_s = 0.5, direction_rad = 0.4}, {kind = "tip_eight", duration_s = 1.0, width_m = 0.1, height_m = 0.06, '
    "frequency_Hz = 1.0}]"
)


def targets(name, *overrides):
    """Return times, and the hand's targets that its force means [m], shape (2, n)."""
    rig = load_rig("plane", (SCHEDULE, "plane.hand_damping_Ns_m=[0, 0]", *overrides))
    t_s = np.arange(0.0, 7.0, 1e-3)
    return t_s, np.stack([PlaneHand(rig, 3.0, k).torque_Nm(t_s, 0.0) for k in (0, 1)]) / 400.0


def test_the_hand_goes_where_the_schedule_says():
    t_s, x = targets("x")
    assert not x[:, t_s < 1.0].any()
    line = (t_s > 2.0) & (t_s < 3.0)
    np.testing.assert_allclose(np.hypot(*x[:, line]), 0.05 * (1 - np.cos(math.pi * (t_s[line] - 2.0))), atol=1e-12)
    centre = x[:, t_s < 3.0][:, -1]  # the line's end
    round_s = (t_s > 3.5) & (t_s < 5.5)
    np.testing.assert_allclose(np.hypot(*(x[:, round_s] - centre[:, None])), 0.05, atol=1e-6)
    eight = x[:, (t_s > 5.5) & (t_s < 6.5)]
    assert np.ptp(eight[0]) == pytest.approx(0.1, abs=1e-4)
    assert np.ptp(eight[1]) == pytest.approx(0.06, abs=1e-4)


def test_the_damping_pulls_with_the_targets_speed():
    rig = load_rig("plane", (SCHEDULE, "plane.hand_stiffness_N_m=[0, 0]", "plane.hand_damping_Ns_m=[10, 10]"))
    t_s, (_, x) = np.arange(2.0, 6.5, 1e-4), targets("x")
    fine = np.stack([np.interp(t_s, np.arange(0.0, 7.0, 1e-3), row) for row in x])
    for k in (0, 1):
        force = PlaneHand(rig, 3.0, k).torque_Nm(t_s, 0.0)
        smooth = np.ones(len(t_s), bool)
        for corner in (3.0, 3.5, 5.5):
            smooth &= np.abs(t_s - corner) > 0.01
        np.testing.assert_allclose(force[smooth], 10.0 * np.gradient(fine[k], t_s)[smooth], atol=0.05)


def test_a_push_is_a_share_of_the_laws_force_in_its_direction():
    t_s, x = targets("x")
    quarter = 400.0 * x[:, np.argmin(np.abs(t_s - 1.25))]
    np.testing.assert_allclose(quarter, [1.5 * math.cos(0.6), 1.5 * math.sin(0.6)], rtol=1e-6)
    tapped = 400.0 * x[:, np.argmin(np.abs(t_s - 1.5))]
    np.testing.assert_allclose(tapped, [4.0 * math.cos(0.6), 4.0 * math.sin(0.6)], rtol=1e-2)


def test_a_population_has_a_hand_for_each_seed():
    truth = load_rig("plane", ("plane.hand_population=0.3",)).in_plane.plane
    first, again, other = drawn_hand(truth, 1), drawn_hand(truth, 1), drawn_hand(truth, 2)
    assert first == again != other
    assert first.hand_mass_kg > 0
    assert first.hand_stiffness_N_m[0] == first.hand_stiffness_N_m[1] != 400.0
    alike = truth.model_copy(update={"hand_population": 0.0})
    assert drawn_hand(alike, 9) is alike
