"""The device's own friction as elements that slip: the plant's generalised Maxwell-slip friction and
Leuven's, held against the host's laws along the plant's own motion.
"""

from __future__ import annotations

import numpy as np
import pytest

from coulombus.host.laws.along import given_law
from tests.sim_bus.rig.test_detail import balance, keys, run

STIFFNESS, SHARES = [40.0, 20.0, 10.0, 5.0], [1.0, 2.0, 1.5, 0.5]
FRICTION = ("plant.coulomb_Nm=0.3", "plant.stribeck_Nm=0.1", "plant.stribeck_rad_s=0.8", "plant.brake_off_state_Nm=0.0")
OWN = {"gms": {"C_Nm_s": 2.0}, "leuven": {"sigma_1_Nms_rad": 0.01}}


def plant_of(law, *more):
    friction = {"law": law, "elements_Nm_rad": STIFFNESS, "shares": SHARES, **OWN[law]}
    return (*keys(friction=friction), *FRICTION, *more)


def host_law(law, **more):
    values = {"F_c_Nm": 0.3, "F_s_Nm": 0.4, "v_s_rad_s": 0.8, **OWN[law], **more}
    values |= {f"k_{j}_Nm_rad": k for j, k in enumerate(STIFFNESS, 1)} | {f"w_{j}": w for j, w in enumerate(SHARES, 1)}
    return given_law(law, [f"{key}={value!r}" for key, value in values.items()])


def hand(t):
    return 0.7 * np.sin(2 * np.pi * 3 * t) + 0.35 * np.sin(2 * np.pi * 17 * t + 1.0)


@pytest.mark.parametrize("law", ["gms", "leuven"])
def test_truth_and_belief_say_the_same_along_the_same_motion(law):
    def between(step_s):
        _, truth = run(plant_of(law, f"plant.step_s={step_s!r}"), 0.4, f_h=hand)
        t, x = (np.concatenate(([0.0], truth[name])) for name in ("t_s", "angle_rad"))
        believed = host_law(law).along(t, x).samples["torque_Nm"][1:]
        assert np.ptp(believed) > 0.5
        return np.sqrt(np.mean((-truth["friction_Nm"] - believed) ** 2))

    coarse, fine = between(5e-5), between(1e-5)
    assert coarse < 1e-3
    assert fine == pytest.approx(coarse / 5, rel=0.2)  # of first order


@pytest.mark.parametrize("law", ["gms", "leuven"])
def test_stuck_elements_hold_the_hand_and_let_it_come_back(law):
    slow = ("operator.stiffness_Nm_rad=0.0", "operator.damping_Nms_rad=0.05", "plant.stribeck_Nm=0.0")
    _, truth = run(
        plant_of(law, *slow), 1.0, f_h=lambda t: 0.1 * np.sin(2 * np.pi * t) * (t < 0.25) + 0.1 * (t >= 0.25)
    )
    assert 0 < truth["angle_rad"][-1] < 0.01
    assert abs(truth["speed_rad_s"][-1]) < 1e-3
    assert truth["friction_Nm"][-1] == pytest.approx(-0.1, rel=1e-2)
    assert truth["stored_energy_J"][-1] > 0.0


def test_a_slipping_element_is_wound_by_the_motion_alone():
    """The law as it is printed gives energy here: a soft element follows the rising level."""
    t = np.arange(0.0, 0.101, 1e-5)
    x = np.cumsum(np.interp(t, [0.1, 0.101], [1.0, 0.0])) * 1e-5
    soft = host_law("gms", C_Nm_s=1e6, **{f"k_{j}_Nm_rad": 5.0 for j in range(1, 5)})
    assert soft.along(t, x).samples["torque_Nm"][-1] > 0.38
    friction = {"law": "gms", "elements_Nm_rad": [5.0], "shares": [1.0], "C_Nm_s": 1e6}
    quick = ("operator.inertia_kg_m2=0.0", "operator.stiffness_Nm_rad=0.0", "operator.damping_Nms_rad=1e3")
    _, truth = run(
        (*keys(friction=friction), *FRICTION, *quick), 0.11, f_h=lambda t: 1e3 * np.interp(t, [0.1, 0.101], [1.0, 0.0])
    )
    assert 0.3 < -truth["friction_Nm"][-1] < 0.33


@pytest.mark.parametrize("law", ["gms", "leuven"])
@pytest.mark.parametrize("seed", range(4))
def test_elements_of_extreme_stiffness_give_no_energy(law, seed):
    rng = np.random.default_rng(seed)
    friction = {
        "law": law, "elements_Nm_rad": (10 ** rng.uniform(0, 8, 8)).tolist(), "shares": rng.uniform(0.01, 1, 8).tolist(),
        "C_Nm_s": 10 ** rng.uniform(-2, 8), "sigma_1_Nms_rad": 10 ** rng.uniform(-3, 3),
    }  # fmt: skip
    rig = (
        *keys(friction=friction),
        "plant.stribeck_Nm=0.5",
        "plant.stribeck_rad_s=0.02",
        "plant.friction.angle_share=0.9",
    )
    _, truth = run(rig, 0.1, f_h=lambda t: 4 * np.sin(rng.uniform(20, 400) * t), v0=rng.uniform(-5, 5), motor_pm=200.0)
    found = balance(truth)
    assert np.abs(found - found[0]).max() < 1e-11 * truth["kinetic_energy_J"].max()
    assert np.all(np.diff(truth["friction_work_J"]) <= 1e-15)
