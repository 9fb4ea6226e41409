"""A plant in detail: elastic transmission and handle, backlash, friction on several bodies.

Held against the one rigid body, against scipy, and against its own energy.
"""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from coulombus.kernels.records import new_records
from coulombus.rigs.rig import RigError, load_rig
from coulombus.sim_bus.rig.chain import NO_EVENT, _first_event, _next_event, _try
from coulombus.sim_bus.rig.own_friction import set_levels
from coulombus.sim_bus.rig.plant import advance, new_plant, transducer_Nm, truth_columns
from coulombus.sim_bus.rig.plant_step import advance_detailed
from coulombus.sim_bus.rig.records import WaveRecord, wave

CABLE = {"stiffness_Nm_rad": 800.0, "damping_Nms_rad": 0.02, "motor_inertia_kg_m2": 1e-3}
HANDLE = {"stiffness_Nm_rad": 500.0, "damping_Nms_rad": 0.01, "inertia_kg_m2": 5e-4}
ONE_BODY = ("plant.friction.law=coulomb",)
WORKS = "operator", "motor", "brake", "friction"

BACKLASH = (
    "plant.cable.motor_inertia_kg_m2=5e-4",
    "plant.cable.stiffness_Nm_rad=100.0",
    "plant.cable.backlash_rad=0.002",
    "plant.cable.friction_share=0.5",
)


def keys(**sections):
    return tuple(f"plant.{name}.{key}={value!r}" for name, of in sections.items() for key, value in of.items())


def run(overrides, seconds=0.1, *, f_h=lambda t: 0.0 * t, motor_pm=0.0, brake_Nm=lambda t: 0.0, v0=0.0, of=None):
    """Run the bench plant in detail; return plant and truth by column."""
    axis = load_rig("bench", ("operator.tremor_Nm=0.0", *overrides)).one_axis()
    truly = axis.simulation.plant
    plant = new_plant(axis)
    plant["v"] = v0
    plant["detail"]["v"][:] = v0
    per_knot, knots = round(1e-3 / truly.step_s), round(seconds / 1e-3)
    force = np.asarray(f_h(np.arange(knots + 1) * 1e-3), float)
    columns = truth_columns(truly)
    truth = np.zeros((knots * per_knot, len(columns)))
    plant["motor_pm"] = motor_pm
    for k in range(knots):
        plant["brake_Nm"] = brake_Nm(k * 1e-3)
        (of or advance_detailed)(plant[0], force, per_knot, k * per_knot, per_knot, truth, k * per_knot)
    return plant[0], dict(zip(columns, truth.T, strict=True))


def balance(truth):
    works = sum(truth[f"{name}_work_J"] for name in WORKS)
    return works - truth["viscous_loss_J"] - truth["kinetic_energy_J"] - truth["stored_energy_J"]


def push(t):
    return 1.5 * np.sin(2 * np.pi * 7 * t) + 0.4 * np.sin(2 * np.pi * 31 * t + 1.0)


def test_one_body_in_detail_is_the_rigid_plant():
    given_ = {"seconds": 0.3, "f_h": push, "motor_pm": 60.0, "brake_Nm": lambda t: 1.5 * (t > 0.1)}
    _, plain = run((), of=advance, **given_)
    _, detailed = run(ONE_BODY, **given_)
    assert np.mean(plain["speed_rad_s"] == 0.0) > 0.02
    for name, column in plain.items():
        assert detailed[name] == pytest.approx(column, abs=1e-10), name


def test_a_stiff_transmission_is_the_rigid_plant():
    stiff = keys(cable=CABLE | {"stiffness_Nm_rad": 1.5e5, "damping_Nms_rad": 5.0, "friction_share": 0.0})
    _, plain = run((), 0.2, f_h=push, of=advance)
    _, elastic = run(stiff, 0.2, f_h=push)
    assert elastic["angle_rad"] == pytest.approx(plain["angle_rad"], abs=2e-3 * np.ptp(plain["angle_rad"]))


def test_a_locked_brake_holds_the_drum_exactly_while_motor_and_hand_move():
    both = keys(cable=CABLE | {"friction_share": 0.0}, handle=HANDLE)
    slow = ("operator.stiffness_Nm_rad=0.0", "operator.damping_Nms_rad=0.3")
    _, truth = run((*both, *slow), 0.6, f_h=lambda t: 2.0 + 0.0 * t, motor_pm=100.0, brake_Nm=lambda t: 4.0)
    late = truth["t_s"] > 0.3
    assert np.all(truth["drum_speed_rad_s"][late] == 0.0)
    drum = truth["drum_angle_rad"][-1]
    assert truth["angle_rad"][-1] - drum == pytest.approx(2.0 / 500.0, rel=1e-3)
    assert truth["motor_angle_rad"][-1] - drum == pytest.approx(0.1 * 0.18 * 9.587 / 800.0, rel=2e-2)


def test_the_encoder_is_on_the_motors_side():
    plant, truth = run(keys(cable=CABLE), 0.05, f_h=push)
    assert plant["x"] == truth["motor_angle_rad"][-1] != truth["angle_rad"][-1]
    assert plant["v"] == truth["motor_speed_rad_s"][-1]


def test_within_the_backlash_the_motors_side_feels_nothing():
    loose = keys(cable=CABLE | {"backlash_rad": 0.2, "damping_Nms_rad": 0.0})
    _, truth = run(loose, 0.2, f_h=lambda t: 2.0 + 0.0 * t)
    before = truth["angle_rad"] < 0.1
    assert before.any()
    assert np.all(truth["motor_speed_rad_s"][before] == 0.0)
    assert truth["motor_angle_rad"][-1] > 0.0
    assert np.max(truth["angle_rad"] - truth["motor_angle_rad"]) > 0.1


def three_bodies(rng, *, backlash):
    return keys(
        cable={
            "stiffness_Nm_rad": rng.uniform(100, 1500), "damping_Nms_rad": rng.uniform(0.0, 0.05),
            "motor_inertia_kg_m2": rng.uniform(4e-4, 1e-3), "friction_share": rng.uniform(0.2, 1.0),
            "backlash_rad": backlash * rng.uniform(1e-3, 5e-3),
        },
        handle={
            "stiffness_Nm_rad": rng.uniform(100, 1500), "damping_Nms_rad": rng.uniform(0.0, 0.05),
            "inertia_kg_m2": rng.uniform(2e-4, 8e-4), "backlash_rad": backlash * rng.uniform(1e-3, 5e-3),
        },
    )  # fmt: skip


def reference(overrides, seconds, *, motor_Nm, brake_Nm=0.0, smooth_rad_s=None, at):
    """Return the handle's angle by scipy, with the equations as docs/simulation.md has them: bristles
    (`smooth_rad_s` None), or dry friction made smooth.
    """
    axis = load_rig("bench", ("operator.tremor_Nm=0.0", *overrides)).one_axis()
    p, hand = axis.simulation.plant, axis.simulation.operator
    knots = np.arange(round(seconds / 1e-3) + 1) * 1e-3
    force = push(knots)
    masses = np.array(
        [
            p.cable.motor_inertia_kg_m2,
            p.inertia_kg_m2 - p.cable.motor_inertia_kg_m2 - p.handle.inertia_kg_m2,
            p.handle.inertia_kg_m2 + hand.inertia_kg_m2,
        ]
    )
    shares = np.array([p.cable.friction_share, 1 - p.cable.friction_share, 0.0])

    def torque(one, way, speed):
        g = one.backlash_rad / 2
        if abs(way) <= g and g > 0:
            return 0.0
        return one.stiffness_Nm_rad * (way - math.copysign(g, way)) + one.damping_Nms_rad * speed

    def slope(t, y):
        q, v, z = y[:3], y[3:6], y[6:]
        total = np.array([motor_Nm, 0.0, np.interp(t, knots, force) - hand.damping_Nms_rad * v[2]])
        total[2] -= hand.stiffness_Nm_rad * q[2]
        total -= shares * p.viscous_Nms_rad * v
        for j, one in enumerate((p.cable, p.handle)):
            between = torque(one, q[j] - q[j + 1], v[j] - v[j + 1])
            total[j] -= between
            total[j + 1] += between
        g = p.coulomb_Nm + p.stribeck_Nm * np.exp(-((v / p.stribeck_rad_s) ** 2))
        dz = np.zeros(3)
        if smooth_rad_s is None:
            f = p.friction
            dz = v - f.sigma_0_Nm_rad * np.abs(v) / g * z
            total -= shares * (f.sigma_0_Nm_rad * z + f.sigma_1_Nms_rad * dz)
        else:
            total -= shares * g * np.tanh(v / smooth_rad_s)
            total[1] -= brake_Nm * np.tanh(v[1] / smooth_rad_s)
        return np.concatenate((v, total / masses, dz))

    found = solve_ivp(slope, (0, seconds + 1e-6), np.zeros(9), "LSODA", t_eval=at, rtol=1e-9, atol=1e-12, max_step=1e-3)
    return found.y[2]


@pytest.mark.thorough
@pytest.mark.parametrize("seed", range(6))
def test_random_elastic_rigs_with_bristles_agree_with_scipy(seed):
    rng = np.random.default_rng(seed)
    bristles = {"law": "lugre", "sigma_0_Nm_rad": rng.uniform(50, 300), "sigma_1_Nms_rad": rng.uniform(0.01, 0.05)}
    rig = (
        *three_bodies(rng, backlash=seed % 2),
        *keys(friction=bristles),
        "plant.stribeck_Nm=0.04", "plant.stribeck_rad_s=0.3", "plant.brake_off_state_Nm=0.0",
        "plant.motor_lag_s=0.0", "plant.step_s=1e-5",
    )  # fmt: skip
    _, truth = run(rig, 0.12, f_h=push, motor_pm=30.0)
    expected = reference(rig, 0.12, motor_Nm=0.03 * 0.18 * 9.587, at=truth["t_s"][99::100])
    assert truth["angle_rad"][99::100] == pytest.approx(expected, abs=1e-3 * np.ptp(expected))


@pytest.mark.parametrize("seed", range(4))
def test_random_elastic_rigs_with_dry_friction_agree_with_scipy(seed):
    rng = np.random.default_rng(100 + seed)
    rig = (
        *three_bodies(rng, backlash=seed % 2),
        f"plant.brake_off_state_Nm={rng.uniform(0.05, 0.3)!r}", "plant.motor_lag_s=0.0",
    )  # fmt: skip
    off = load_rig("bench", rig).one_axis().simulation.plant.brake_off_state_Nm
    _, truth = run(rig, 0.12, f_h=push, motor_pm=30.0)
    assert np.mean(truth["drum_speed_rad_s"] == 0.0) > 0.0
    at = truth["t_s"][19::20]
    expected = reference(rig, 0.12, motor_Nm=0.03 * 0.18 * 9.587, brake_Nm=off, smooth_rad_s=1e-4, at=at)
    assert truth["angle_rad"][19::20] == pytest.approx(expected, abs=4e-3 * np.ptp(expected))


def order(overrides, **given_):
    """Return the observed order of convergence of the handle's angle over four halvings of the step."""
    steps = [2e-4, 1e-4, 5e-5, 2.5e-5, 1.25e-5]
    courses = [run((*overrides, f"plant.step_s={step!r}"), **given_)[1]["angle_rad"] for step in steps]
    coarse = [course[2**k * 5 - 1 :: 2**k * 5] for k, course in enumerate(courses)]  # at each 1 ms
    gaps = [np.sqrt(np.mean((a - b) ** 2)) for a, b in pairwise(coarse)]
    return math.log2(gaps[0] / gaps[-1]) / (len(gaps) - 1)


@pytest.mark.parametrize("backlash_rad", [0.0, 0.002])
def test_an_elastic_rig_with_dry_friction_converges_faster_than_the_first_order(backlash_rad):
    elastic = keys(cable=CABLE | {"backlash_rad": backlash_rad}, handle=HANDLE)
    assert order((*elastic, "plant.motor_lag_s=0.0"), seconds=0.1, f_h=push, motor_pm=40.0) > 1.4


def test_bristles_converge_with_the_first_order_at_least():
    bristles = keys(cable=CABLE, friction={"law": "lugre", "sigma_0_Nm_rad": 100.0, "sigma_1_Nms_rad": 0.03})
    assert order((*bristles, "plant.motor_lag_s=0.0"), seconds=0.1, f_h=push, motor_pm=40.0) > 0.9


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 10**6), law=st.sampled_from(["coulomb", "lugre", "gms", "leuven"]), extra=st.booleans())
def test_of_random_rigs_the_energy_balances_and_nothing_passive_gives_any(seed, law, extra):
    rng = np.random.default_rng(seed)
    friction = {"law": law, "angle_share": rng.uniform(0, 0.9), "angle_periods": int(rng.integers(1, 40))}
    friction |= {"load_share": rng.uniform(0, 0.5)}
    if law == "lugre":
        friction |= {"sigma_0_Nm_rad": rng.uniform(10, 1e5), "sigma_1_Nms_rad": rng.uniform(0, 5)}
    elif law != "coulomb":
        count = int(rng.integers(1, 9))
        friction |= {"elements_Nm_rad": (10 ** rng.uniform(0, 5, count)).tolist(), "C_Nm_s": 10 ** rng.uniform(-1, 5)}
        friction |= {"shares": rng.uniform(0.01, 1, count).tolist(), "sigma_1_Nms_rad": rng.uniform(0, 5)}
    rig = (*three_bodies(rng, backlash=int(rng.integers(0, 2))), *keys(friction=friction), "plant.stribeck_Nm=0.05")
    if extra:
        rig += keys(
            fluid={"viscous_Nms_rad": rng.uniform(0, 0.05), "shear_s_rad": 0.5, "fall_lag_s": 0.004},
            iron={"play_Nm": [0.1, 0.3], "weights": [0.2, 0.3]},
            heat={"capacity_J_K": 0.05, "resistance_K_W": 3.0},
            ripple={"share": 0.2},
        )
        rig += ("plant.cogging_Nm=0.05",)
    plant, truth = run(
        rig, 0.04, f_h=lambda t: rng.uniform(-6, 6) * np.sin(rng.uniform(20, 400) * t), v0=rng.uniform(-5, 5),
        motor_pm=rng.uniform(-2000, 2000), brake_Nm=lambda t: 2.0 * (math.sin(400 * t) > 0),
    )  # fmt: skip
    found = balance(truth)
    turned = max(np.abs(truth[f"{name}_work_J"]).max() for name in WORKS) + truth["kinetic_energy_J"].max()
    assert np.abs(found - found[0]).max() <= 1e-11 * (turned + 1)
    for name in ("brake", "friction"):
        assert np.all(np.diff(truth[f"{name}_work_J"]) <= 1e-15)
    assert np.all(np.diff(truth["viscous_loss_J"]) >= 0.0)
    assert plant["detail"]["missed_events"] == 0


@pytest.mark.parametrize("motor_pm", [-400.0, 0.0, 700.0])
def test_friction_of_a_gear_grows_with_the_torque_of_the_motor_either_way(motor_pm):
    settings_ = ("plant.motor_lag_s=0.0", "plant.coulomb_Nm=0.1", "plant.brake_off_state_Nm=0.0")
    for v0 in (6.0, -6.0):
        _, truth = run((*settings_, *keys(friction={"load_share": 0.15})), 0.003, v0=v0, motor_pm=motor_pm)
        load_Nm = np.abs(truth["motor_Nm"])
        assert load_Nm[1:] == pytest.approx(load_Nm[-1])
        assert (load_Nm[-1] > 0.5) == (motor_pm != 0.0)
        assert -math.copysign(1.0, v0) * truth["friction_Nm"][1:] == pytest.approx(0.1 + 0.15 * load_Nm[-1])


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("backlash_rad", [2e-6, 2e-5, 2e-4])
def test_a_coupling_that_comes_off_and_back_within_a_step_keeps_the_energy_balance(backlash_rad, seed):
    rng = np.random.default_rng(seed)
    loose = {"damping_Nms_rad": 0.0, "backlash_rad": backlash_rad}
    rig = keys(
        cable=loose | {"stiffness_Nm_rad": 10 ** rng.uniform(1, 4.8), "motor_inertia_kg_m2": 1e-3},
        handle=loose | {"stiffness_Nm_rad": 10 ** rng.uniform(1, 4.8), "inertia_kg_m2": 5e-4},
    )
    plant, truth = run(
        rig, 0.06, f_h=lambda t: 6.0 * np.sin(rng.uniform(20, 400) * t), v0=rng.uniform(-5, 5),
        motor_pm=rng.uniform(-2000, 2000),
    )  # fmt: skip
    assert plant["detail"]["missed_events"] == 0
    assert plant["detail"]["events"] > 5
    found = balance(truth)
    assert np.abs(found - found[0]).max() < 1e-11 * truth["kinetic_energy_J"].max()


def test_the_sine_of_a_step_is_right():
    kept = new_records(WaveRecord)[0]
    angles = np.cumsum(np.random.default_rng(3).uniform(-0.06, 0.08, 3000))
    found = np.array([wave(kept, angle) for angle in angles])
    assert np.abs(found - np.sin(angles)).max() < 1e-12


def test_the_transducer_reads_the_handles_acceleration():
    quiet = ("plant.transducer_noise_Nm=0.0", "operator.stiffness_Nm_rad=0.0", "operator.damping_Nms_rad=0.0")
    plant, truth = run((*quiet, "plant.transducer_inertia_kg_m2=2e-4"), 0.01, f_h=lambda t: 1.0 + 0.0 * t)
    acceleration = np.diff(truth["speed_rad_s"])[-1] / 5e-5
    assert acceleration > 100
    assert transducer_Nm(plant) == pytest.approx(plant["f_operator"] + 2e-4 * acceleration, rel=1e-9)


@pytest.mark.parametrize(
    ("lines", "number", "said"),
    [
        ("[plant.cable]\nstiffness_Nm_rad = 1e7\nmotor_inertia_kg_m2 = 1e-3", 1, "at most 2.4e+05 with plant.step_s"),
        ("[plant.cable]\nstiffness_Nm_rad = 10.0\nmotor_inertia_kg_m2 = -1e-3", 2, "a number above 0"),
        ("[plant.cable]\nstiffness_Nm_rad = 10.0\nmotor_inertia_kg_m2 = 3e-3", 2, "less"),
        ("[plant.cable]\nstiffness_Nm_rad = 10.0\nmotor_inertia_kg_m2 = 1e-3\ndamping_Nms_rad = 99.0", 3, "at most 24"),
        ("[plant.handle]\nstiffnes = 10.0", 1, "did you mean 'stiffness_Nm_rad'"),
        ('[plant.friction]\nlaw = "dahl"', 1, 'one of "coulomb", "lugre", "gms", "leuven"'),
        ('[plant.friction]\nlaw = "leuven"', 1, "elements_Nm_rad: got none, expected a list of 1 to 8 numbers"),
        ('[plant.friction]\nlaw = "gms"\nelements_Nm_rad = [1]\nshares = [1]', 1, "C_Nm_s: got '0.0', expected above"),
        ('[plant.friction]\nlaw = "leuven"\nelements_Nm_rad = [1, -1]\nshares = [1, 1]', 2, "elements_Nm_rad"),
        ('[plant.friction]\nlaw = "leuven"\nelements_Nm_rad = [1, 2]\nshares = [1]', 3, "got 1 values where"),
        ('[plant.friction]\nlaw = "leuven"\nelements_Nm_rad = [1]\nshares = [0]', 3, "shares"),
        ('[plant.friction]\nlaw = "lugre"', 1, "bristles need a stiffness"),
        ("[plant.iron]\nplay_Nm = [1.0]\nweights = [0.5, 0.2]", 2, "got 2 values where play_Nm has 1"),
        ("[plant.iron]\nplay_Nm = [1.0, 2.0]\nweights = [0.5, 0.6]", 2, "together 1.1"),
        ("[plant.iron]\nplay_Nm = [-1.0]\nweights = [0.5]", 1, "numbers above 0"),
        ("[plant.ripple]\nshare = 1.5", 1, "0 to 0.99"),
        ("[plant.heat]\ncapacity_J_K = 0\nresistance_K_W = 1.0", 1, "above 0"),
    ],
)
def test_what_cannot_be_is_refused_with_its_line(tmp_path, lines, number, said):
    text = load_rig("bench").text + "\n" + lines + "\n"
    first = text[: text.rindex(lines)].count("\n") + 1
    file = tmp_path / "mine.toml"
    file.write_text(text)
    with pytest.raises(RigError) as caught:
        load_rig(str(file))
    (error,) = [line for line in caught.value.errors if said in line]
    place = error.split(": ")[0]
    assert place.startswith(f"{file}:")
    assert int(place.rpartition(":")[2]) in (first, first + number)


def test_a_step_ends_at_a_couplings_event_also_where_a_bodys_comes_later():
    axis = load_rig("bench").variant(*BACKLASH).one_axis()
    by_body = 0
    for seed in range(150):
        rng = np.random.default_rng(seed)
        p = new_plant(axis, 0)[0]
        d, side = p.detail, rng.choice([-1, 1])
        d.q[0] = side * (d.gap[0] + rng.choice([-1, 1]) * 10 ** rng.uniform(-9, -4))
        d.contact[0] = side if side * d.q[0] > d.gap[0] else 0
        d.v[:2] = rng.choice([-1, 1], 2) * 10 ** rng.uniform(-5, 0, 2)
        set_levels(p, 0.5 * rng.random())
        torques = 0.5 * rng.normal(), 0.5 * rng.normal()
        _try(p, 1e-4, *torques)
        h, event = 1e-4, _next_event(d, 1e-4, NO_EVENT)
        if event != NO_EVENT:
            h, event = _first_event(p, 1e-4, event, *torques)
        between = d.q[0] - d.q[1] + h * (d.u[0] - d.u[1])
        way = d.contact[0] * between - d.gap[0] if d.contact[0] else d.gap[0] - abs(between)
        assert event == 3 or h == 0.0 or way > -1e-15
        by_body += event in (0, 1)
    assert by_body > 20
