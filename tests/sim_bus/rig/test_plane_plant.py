"""The plant of two coupled joints: against an integrator of its own, exact in energy and in stick-slip."""

from __future__ import annotations

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from coulombus.kernels.records import new_records
from coulombus.sim_bus.rig.plane_plant import advance_plane, kinetic_J, tip_force
from coulombus.sim_bus.rig.records import PlanePlantRecord

L1, L2 = 0.22, 0.18


def plant(step=50e-6, **values):
    p = new_records(PlanePlantRecord)[0]
    p["h"], p["l1"], p["l2"] = step, L1, L2
    p["a1"], p["a2"], p["a3"], p["k"] = 0.05, 0.012, 0.014, 0.011
    p["angle"] = 0.3, 1.4
    for name, value in values.items():
        p[name] = value
    return p


def balance(p):
    works = sum(p[name].sum() for name in ("work_hand", "work_motor", "work_brake", "work_friction"))
    return float(works - p["work_viscous"].sum())


def energy(p):
    return kinetic_J(p, *(float(v) for v in p["v"]), math.cos(p["angle"][1]))


def tip(angle):
    x2, y2 = L2 * math.cos(angle[0] + angle[1]), L2 * math.sin(angle[0] + angle[1])
    x, y = L1 * math.cos(angle[0]) + x2, L1 * math.sin(angle[0]) + y2
    return np.array([x, y]), np.array([[-y, -y2], [x, x2]])


def derivative(p, force):
    """Lagrange's equations, from the derivatives of M by hand."""

    def of(t, state):
        angle, v = state[:2], state[2:]
        x, jacobian = tip(angle)
        c, s = math.cos(angle[1]), math.sin(angle[1])
        mass = np.array([[p["a1"] + 2 * p["k"] * c, p["a2"] + p["k"] * c], [p["a2"] + p["k"] * c, p["a3"]]])
        coriolis = p["k"] * s * np.array([-v[1] * (2 * v[0] + v[1]), v[0] ** 2])
        hand = p["stiffness"] * (np.array([0.2, 0.1]) - x) - p["damping"] * (jacobian @ v) + force(t)
        return [*v, *np.linalg.solve(mass, jacobian.T @ hand - p["viscous"] * v - coriolis)]

    return of


@pytest.mark.parametrize("speeds", [(3.0, -5.0), (-2.0, 4.0)])
def test_without_friction_it_moves_as_lagranges_equations_say(speeds):
    p = plant(50e-6, v=speeds, stiffness=[300.0, 200.0], damping=[2.0, 5.0], viscous=[0.01, 0.02], goal_m=[0.2, 0.1])
    exact = solve_ivp(derivative(p, lambda t: 0.0), (0, 0.04), [0.3, 1.4, *speeds], rtol=1e-10, atol=1e-12).y[:, -1]
    advance_plane(p, 800)
    assert p["angle"] == pytest.approx(exact[:2], abs=2e-6)
    assert p["v"] == pytest.approx(exact[2:], abs=5e-5)


def test_a_free_arm_keeps_its_energy_and_its_turning_moment():
    p = plant(1e-3, v=[4.0, -7.0])
    before, moment = energy(p), (p["a1"] + 2 * p["k"] * math.cos(1.4)) * 4.0 + (p["a2"] + p["k"] * math.cos(1.4)) * -7.0
    advance_plane(p, 800)
    cosine = math.cos(p["angle"][1])
    after = (p["a1"] + 2 * p["k"] * cosine) * p["v"][0] + (p["a2"] + p["k"] * cosine) * p["v"][1]
    assert energy(p) == pytest.approx(before, rel=1e-11)
    assert after == pytest.approx(moment, rel=1e-9)
    assert abs(p["angle"][1]) > 1.0


@pytest.mark.parametrize("step", [20e-6, 200e-6, 1e-3])
@pytest.mark.parametrize("seed", range(3))
def test_the_energies_close_to_rounding_whatever_the_step(step, seed):
    random = np.random.default_rng(seed)
    p = plant(step, stiffness=[400.0, 250.0], damping=[8.0, 8.0], viscous=[0.01, 0.02], inherent=[0.1, 0.06])
    p["goal_m"], _ = tip([0.3, 1.4])
    p["motor_decay"], p["fluid_decay"] = math.exp(-step / 1e-3), math.exp(-step / 12e-3)
    stops = 0
    for _ in range(60):
        p["motor_want"], p["brake_want"] = random.normal(0, 0.6, 2), random.uniform(0, 0.6, 2)
        p["goal_m_s"] = random.normal(0, 0.5, 2)
        before = energy(p), balance(p)
        advance_plane(p, 20)
        stops += int((p["v"] == 0.0).sum())
        assert energy(p) - before[0] == pytest.approx(balance(p) - before[1], abs=1e-13)
    assert stops < 120
    assert stops > 0 or step < 1e-4
    assert (p["work_friction"] < 0).all()
    assert (p["work_brake"] < 0).all()


def test_joints_stand_exactly_while_their_friction_bears_the_load():
    p = plant(inherent=[0.5, 0.4])
    _, jacobian = tip([0.3, 1.4])
    p["push_N"] = np.linalg.solve(jacobian.T, [0.49, -0.39])
    advance_plane(p, 200)
    assert (p["v"] == 0.0).all()
    assert p["angle"].tolist() == [0.3, 1.4]
    assert p["friction_Nm"] == pytest.approx([-0.49, 0.39])


@pytest.mark.parametrize(("loads", "moves"), [([0.52, 0.0], (1, 0)), ([0.0, 0.41], (0, 1)), ([0.6, -0.5], (1, -1))])
def test_the_joint_that_is_loaded_beyond_its_friction_starts(loads, moves):
    p = plant(inherent=[0.5, 0.4])
    _, jacobian = tip([0.3, 1.4])
    p["push_N"] = np.linalg.solve(jacobian.T, loads)
    advance_plane(p, 1)
    assert tuple(np.sign(p["v"])) == moves


def test_a_joint_is_dragged_along_by_the_others_acceleration():
    p = plant(inherent=[0.5, 0.05])
    _, jacobian = tip([0.3, 1.4])
    p["push_N"] = np.linalg.solve(jacobian.T, [3.0, 0.0])  # no load on joint 2, which lags behind joint 1
    advance_plane(p, 1)
    assert p["v"][0] > 0 > p["v"][1]


@pytest.mark.parametrize("seed", range(20))
def test_the_choice_of_what_sticks_is_the_one_that_fits(seed):
    random = np.random.default_rng(seed)
    p = plant(1e-9, inherent=random.uniform(0.1, 1.0, 2), motor_want=random.normal(0, 1, 2))
    p["motor_lagged"] = p["motor_want"]
    advance_plane(p, 1)
    acceleration, load, level = p["v"] / 1e-9, -(p["friction_Nm"] + p["brake_Nm"]), p["inherent"]
    c = math.cos(1.4)
    mass = np.array([[p["a1"] + 2 * p["k"] * c, p["a2"] + p["k"] * c], [p["a2"] + p["k"] * c, p["a3"]]])
    assert mass @ acceleration == pytest.approx(p["motor_want"] - load, abs=1e-6)
    for a, friction, most in zip(acceleration, load, level, strict=True):
        assert abs(friction) <= most * (1 + 1e-9)
        assert a == 0.0 or friction == pytest.approx(math.copysign(most, a))


def test_friction_alone_brings_the_arm_to_rest_for_good():
    p = plant(2e-3, v=[3.0, -4.0], inherent=[0.2, 0.15])
    advance_plane(p, 600)
    stood = p["angle"].tolist()
    assert (p["v"] == 0.0).all()
    advance_plane(p, 100)
    assert p["angle"].tolist() == stood


def test_a_brakes_torque_comes_behind_its_lags():
    p = plant(fluid_decay=math.exp(-50e-6 / 12e-3), brake_want=[2.0, 1.0])
    advance_plane(p, 240)
    assert p["fluid"] == pytest.approx([2 * (1 - math.exp(-1)), 1 - math.exp(-1)])


def test_the_shown_force_is_that_of_the_joints_torques():
    p = plant(motor_want=[0.3, -0.2], inherent=[0.5, 0.5])
    p["motor_lagged"] = p["motor_want"]
    advance_plane(p, 1)
    tip_force(p)
    x, jacobian = tip([0.3, 1.4])
    assert p["tip_m"] == pytest.approx(x)
    assert jacobian.T @ p["shown_N"] == pytest.approx(p["motor"] + p["brake_Nm"] + p["friction_Nm"], abs=1e-12)


def test_the_transducers_do_not_see_what_moves_the_hands_own_mass():
    _, jacobian = tip([0.3, 1.4])
    free = plant(1e-6, push_N=[1.0, 2.0], hand_kg=0.4)
    advance_plane(free, 1)
    acceleration = jacobian @ free["v"] / 1e-6
    assert free["transduced_Nm"] == pytest.approx(jacobian.T @ ([1.0, 2.0] - 0.4 * acceleration), rel=1e-3)
    stuck = plant(push_N=[1.0, 2.0], hand_kg=0.4, inherent=[9.0, 9.0])
    advance_plane(stuck, 1)
    assert stuck["transduced_Nm"] == pytest.approx(jacobian.T @ [1.0, 2.0])
