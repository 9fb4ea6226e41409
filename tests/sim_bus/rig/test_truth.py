"""A truth that differs from the belief: Stribeck friction, transducer, encoder, coil, and hands."""

from __future__ import annotations

import math

import numpy as np
import pytest

from coulombus.rigs.rig import RigError, load_rig
from coulombus.sim_bus.rig.operator import Operator, drawn
from coulombus.sim_bus.rig.plant import encoder_rad, new_plant, transducer_Nm
from tests.sim_bus.rig.test_plant import run

STRIBECK = ("plant.stribeck_Nm=0.1", "plant.stribeck_rad_s=0.5")


def test_a_static_friction_that_is_more_holds_until_it_is_exceeded():
    _, truth, _ = run(STRIBECK, 1.0, f_h=lambda t: 0.5 * t)
    slides = np.argmax(truth["speed_rad_s"] > 0.0)
    assert 0.5 * truth["t_s"][slides] == pytest.approx(0.14 + 0.1, abs=1e-3)  # coulomb, off-state, Stribeck's
    assert np.all(truth["angle_rad"][:slides] == 0.0)


def test_friction_falls_with_speed_as_stribeck_says():
    _, truth, _ = run(STRIBECK, 0.3, v0=2.0)
    v = truth["speed_rad_s"]
    moves = v > 0.01
    expected = 0.06 + 0.1 * np.exp(-((v[moves] / 0.5) ** 2))
    assert np.abs(-truth["friction_Nm"][moves] - expected).max() < 2e-3
    assert np.all(np.diff(truth["friction_work_J"]) <= 0.0)


def test_with_stribeck_friction_the_course_is_right_to_the_first_order():
    def stops_at(step_s):
        _, truth, _ = run((*STRIBECK, f"plant.step_s={step_s}"), 0.2, v0=1.0)
        return truth["angle_rad"][-1]

    exact = stops_at(1e-6)
    errors = [abs(stops_at(step_s) - exact) for step_s in (2e-4, 1e-4)]
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.3)


def test_the_energy_balance_closes_with_stribeck_friction():
    _, truth, _ = run(STRIBECK, 1.0, f_h=lambda t: 1.5 * np.sin(8 * t))
    works = sum(truth[f"{name}_work_J"][-1] for name in ("operator", "motor", "brake", "friction"))
    assert works - truth["viscous_loss_J"][-1] == pytest.approx(truth["kinetic_energy_J"][-1], abs=1e-12)


def test_the_transducer_has_a_bias_that_drifts():
    quiet = ("plant.transducer_noise_Nm=0.0", "plant.transducer_bias_Nm=0.02", "plant.transducer_drift_Nm_s=-0.01")
    p = new_plant(load_rig("bench", quiet).one_axis())[0]
    p["f_operator"], p["t_ns"] = 0.5, 3_000_000_000
    assert transducer_Nm(p) == pytest.approx(0.5 + 0.02 - 0.03)


def test_the_transducer_follows_a_load_with_its_lag():
    quiet = ("plant.transducer_noise_Nm=0.0", "plant.transducer_lag_s=0.01", "operator.stiffness_Nm_rad=0.0")
    plant, _, _ = run(quiet, 0.02, f_h=lambda t: 0.1 + 0.0 * t)
    assert transducer_Nm(plant) == pytest.approx(0.1 * (1 - math.exp(-2.0)), rel=1e-3)


def test_an_eccentric_encoder_is_off_by_a_sine_of_the_motors_angle():
    p = new_plant(load_rig("bench", ("plant.encoder_eccentricity_rad=0.01",)).one_axis())[0]
    ratio, errors = 9.587, []
    for turn in np.linspace(0.0, 1.0, 17):
        p["x"] = 2 * math.pi * turn / ratio
        errors.append((encoder_rad(p) - p["x"]) * ratio)
    assert np.abs(errors - 0.01 * np.sin(2 * np.pi * np.linspace(0.0, 1.0, 17))).max() < 1e-12


def test_a_coil_current_comes_in_steps():
    plant, _, _ = run(("plant.coil_step_A=0.1",), 0.2, brake_Nm=lambda t: 1.3)
    assert plant["coil"] * 0.2 == pytest.approx(0.3)  # A: the step next to 0.26


def test_each_seed_is_a_subject_of_the_population():
    hand = load_rig("bench", ("operator.population=0.3",)).one_axis().simulation.operator
    inertias = np.array([drawn(hand, seed).inertia_kg_m2 for seed in range(400)])
    assert np.std(np.log(inertias)) == pytest.approx(0.3, rel=0.1)
    assert np.median(inertias) == pytest.approx(hand.inertia_kg_m2, rel=0.06)
    assert drawn(hand, 7) == drawn(hand, 7) != drawn(hand, 8)


def test_plant_and_muscles_belong_to_the_same_subject():
    axis = load_rig("bench", ("operator.population=0.3",)).one_axis()
    hand = drawn(axis.simulation.operator, 5)
    assert new_plant(axis, 5)[0]["operator_stiffness"] == hand.stiffness_Nm_rad
    t = np.arange(0.0, 0.5, 1e-3)
    one, other = (Operator(axis, "hybrid", seed).tremor_Nm(t) for seed in (5, 6))
    assert np.abs(one).max() == pytest.approx(hand.tremor_Nm, rel=1e-2)
    assert np.corrcoef(one, other)[0, 1] < 0.99


def test_subjects_push_and_tap_each_in_their_own_way():
    axis = load_rig("bench", ("operator.population=0.3", "operator.tremor_Nm=0.0")).one_axis()
    t = 1.0 + np.arange(0.0, 4.0, 1e-3)
    pushes, taps, late = [], [], []
    for seed in range(200):
        force = Operator(axis, "hybrid", seed).schedule_Nm(t)
        pushes.append(force[500] / (0.6 * 3.5))  # the sine's peak, before the first tap
        tap = np.diff(force)
        late.append(np.argmax(tap[590:1500]) + 591)
        taps.append(tap.max() / 0.6)
    assert np.std(np.log(pushes)) == pytest.approx(0.3, rel=0.15)
    assert np.median(pushes) == pytest.approx(1.0, rel=0.1)
    assert np.std(np.log(taps)) == pytest.approx(0.3, rel=0.2)
    assert min(late) >= 600
    assert np.mean(late) - 600 == pytest.approx(0.3 * 100 * math.sqrt(2 / math.pi), rel=0.2)  # ms


def test_without_a_population_every_seed_has_the_rig_files_hand():
    axis = load_rig("bench").one_axis()
    assert drawn(axis.simulation.operator, 5) is axis.simulation.operator
    t = np.arange(0.0, 0.5, 1e-3)
    assert np.array_equal(Operator(axis, "hybrid", 5).tremor_Nm(t), Operator(axis, "hybrid", 6).tremor_Nm(t))


@pytest.mark.parametrize(
    "wrong", ["operator.population=-0.1", "plant.stribeck_Nm=-1", "plant.transducer_lag_s=-1", "plant.coil_step_A=-1"]
)
def test_what_cannot_be_is_refused(wrong):
    with pytest.raises(RigError, match=wrong.partition("=")[0]):
        load_rig("bench", (wrong,))
