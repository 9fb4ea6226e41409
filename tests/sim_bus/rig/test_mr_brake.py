"""The MR brake and the device's friction in detail: minor loops, residual torque, lags, heat."""

from __future__ import annotations

import math

import numpy as np
import pytest

from coulombus.rigs.rig import load_rig
from coulombus.sim_bus.rig.mr_brake import brake_capacity, heat, iron, thin
from coulombus.sim_bus.rig.own_friction import set_levels
from coulombus.sim_bus.rig.plant import new_plant
from coulombus.sim_bus.rig.plant_step import advance_detailed
from tests.sim_bus.rig.test_detail import keys, run

IRON = keys(iron={"play_Nm": [0.2, 0.5], "weights": [0.3, 0.2]})


def plant_of(*overrides):
    return new_plant(load_rig("bench", overrides).one_axis())[0]


def along(d, *currents):
    """Lead the coil through these torques in small steps; return what the fluid sees at each end."""
    found, at = [], 0.0
    for wanted in currents:
        for coil in np.linspace(at, wanted, 50):
            seen = iron(d, coil)
        at = wanted
        found.append(seen)
    return found


def test_what_is_left_after_a_set_point_is_the_sum_of_plays():
    seen = along(plant_of(*IRON).detail, 3.0, 0.0)
    assert seen[0] == pytest.approx(0.5 * 3.0 + 0.3 * 2.8 + 0.2 * 2.5)
    assert seen[1] == pytest.approx(0.3 * 0.2 + 0.2 * 0.5)


def test_pulses_of_the_opposite_current_demagnetise():
    left = along(plant_of(*IRON).detail, 3.0, 0.0)[1]
    one = along(plant_of(*IRON).detail, 3.0, 0.0, -0.5, 0.0)[-1]
    assert one < 0.4 * left
    assert along(plant_of(*IRON).detail, 3.0, 0.0, -0.5, 0.2, 0.0)[-1] == pytest.approx(0.0, abs=1e-12)


def test_a_minor_loop_closes_and_is_forgotten_by_a_larger_one():
    closed = along(plant_of(*IRON).detail, 2.0, 1.2, 2.0)
    assert closed[2] == pytest.approx(closed[0], abs=1e-12)
    assert closed[1] > 0.5 * 1.2 + 0.3 * 1.0 + 0.2 * 0.7  # above the virgin curve
    direct = along(plant_of(*IRON).detail, 3.0, 0.5)[-1]
    assert along(plant_of(*IRON).detail, 2.0, 1.2, 1.8, 3.0, 0.5)[-1] == pytest.approx(direct, abs=1e-12)


def test_the_iron_does_not_depend_on_the_rate():
    d, fast = plant_of(*IRON).detail, plant_of(*IRON).detail
    slow = along(d, 1.0, 0.3, 2.0, 0.0)
    assert [iron(fast, coil) for coil in (1.0, 0.3, 2.0, 0.0)] == pytest.approx(slow, abs=1e-12)


def test_a_display_leaves_torque_in_the_brake_and_reverse_current_takes_it():
    plant, _ = run(IRON, 0.3, brake_Nm=lambda t: 2.0 * (t < 0.15))
    assert plant["fluid"] == pytest.approx(0.16, abs=5e-3)
    truth = np.zeros((20, 19))
    for reverse_A, duration_s in ((0.1, 0.05), (0.0, 0.2)):
        plant["reverse_A"] = reverse_A
        for _ in range(round(duration_s / 1e-3)):
            advance_detailed(plant, np.zeros(2), 20, 0, 20, truth, -1)
    assert plant["fluid"] < 0.065


def lag_of(p, start, target):
    """Return the time constant with which the fluid goes from `start` to `target` [s]."""
    p["fluid"] = start
    thin(p.detail)
    for _ in range(100):
        brake_capacity(p, target)
    return -100 * p.h / math.log((target - p.fluid) / (target - start))


def test_the_fluid_rises_and_falls_with_its_own_lags_and_sooner_when_sheared():
    p = plant_of(*keys(fluid={"fall_lag_s": 0.006, "shear_s_rad": 0.5}))
    assert lag_of(p, 0.0, 1.0) == pytest.approx(0.015, rel=1e-4)
    assert lag_of(p, 1.0, 0.2) == pytest.approx(0.006, rel=1e-4)
    p.detail["v"][0] = -4.0
    assert lag_of(p, 0.0, 1.0) == pytest.approx(0.005, rel=1e-4)


def test_warmth_thins_the_fluid():
    p = plant_of(
        *keys(
            fluid={"viscous_Nms_rad": 0.02, "viscous_1_K": 0.01, "torque_1_K": 0.004},
            heat={"capacity_J_K": 10.0, "resistance_K_W": 2.0},
        ),
        "plant.brake_fluid_lag_s=0.0",
    )
    p.detail["degC"] = 47.0
    thin(p.detail)
    assert brake_capacity(p, 2.0) == pytest.approx(2.0 * (1 - 0.004 * 25) + 0.08)
    assert p.detail["wet"] == pytest.approx(0.02 * math.exp(-0.25))


def test_all_that_friction_loses_warms_the_device():
    warm = keys(heat={"capacity_J_K": 0.01, "resistance_K_W": 1e6})
    off = "plant.coil_resistance_ohm=0.0"
    plant, truth = run((*warm, off), 0.1, f_h=lambda t: 3 * np.sin(60 * t), brake_Nm=lambda t: 0.5)
    lost = truth["viscous_loss_J"][-1] - truth["brake_work_J"][-1] - truth["friction_work_J"][-1]
    assert lost > 0.01
    assert (truth["device_degC"][-1] - 22.0) * 0.01 == pytest.approx(lost, rel=1e-4)
    assert plant["detail"]["degC"] == truth["device_degC"][-1]


def test_the_coil_warms_the_device_up_to_the_balance_of_heat():
    p = plant_of(*keys(heat={"capacity_J_K": 0.01, "resistance_K_W": 2.0}))
    for _ in range(10_000):
        heat(p, 0.0, 0.5)
    assert p.detail["degC"] == pytest.approx(22.0 + 2.0 * 4.0 * 0.5**2, abs=1e-3)


def test_the_devices_friction_follows_speed_angle_temperature_and_time():
    p = plant_of(
        "plant.stribeck_Nm=0.1", "plant.stribeck_rad_s=0.5",
        *keys(
            friction={"stribeck_exponent": 1.0, "angle_share": 0.3, "angle_periods": 4, "angle_phase_rad": 0.2,
                      "share_1_K": -0.01, "drift_1_s": 0.02},
            heat={"capacity_J_K": 10.0, "resistance_K_W": 2.0},
        ),
    )  # fmt: skip
    d = p.detail
    d["v"][0], d["q"][0], d["degC"], p["t_ns"] = -0.25, 0.7, 32.0, 5_000_000_000
    set_levels(p, 0.5)
    own = (0.06 + 0.1 * math.exp(-0.5)) * (1 + 0.3 * math.sin(4 * 0.7 + 0.2)) * 0.9 * 1.1
    assert d["level"][0] == pytest.approx(0.5 + own)
    p["t_ns"] = 0
    d["degC"] = 22.0 + 200.0  # less than nothing is nothing
    set_levels(p, 0.5)
    assert d["level"][0] == 0.5


def test_ripple_is_in_proportion_to_the_motors_torque():
    held = ("plant.coulomb_Nm=50.0", "plant.motor_lag_s=0.0")
    _, truth = run((*held, *keys(ripple={"share": 0.1, "phase_rad": 0.5})), 0.01, motor_pm=100.0)
    assert truth["motor_Nm"][-1] == pytest.approx(0.1 * 0.18 * 9.587 * (1 + 0.1 * math.sin(0.5)))


def test_bristles_give_no_energy_at_a_speed_where_lugre_would():
    """sigma_1 |v| = 20 g: with sigma_1 as it is a fast reversal of the deflection gains energy."""
    bristles = keys(friction={"law": "lugre", "sigma_0_Nm_rad": 300.0, "sigma_1_Nms_rad": 0.6})
    _, truth = run(bristles, 0.1, f_h=lambda t: 2 * np.sin(500 * t), v0=2.0)
    assert np.all(np.diff(truth["friction_work_J"]) <= 0.0)
