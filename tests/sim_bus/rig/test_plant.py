"""The simulated rig's physics: energy, passivity, exact stiction, lags.

Each held against an independent computation.
"""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from coulombus.rigs.rig import load_rig
from coulombus.sim_bus.rig.plant import TRUTH_COLUMNS, advance, new_plant, sample_noise
from coulombus.sim_bus.rig.records import PLANT

KNOT_S = 1e-3


def run(
    overrides=(), seconds=1.0, motor_pm=lambda t: 0.0, brake_Nm=lambda t: 0.0, f_h=lambda t: 0.0 * t, seed=0, v0=0.0
):
    """Run the bench plant with commands held for 1 ms each; return plant and truth by column."""
    rig = load_rig("bench", ("operator.tremor_Nm=0.0", *overrides))
    plant = new_plant(rig.one_axis(), seed)
    plant["v"] = v0
    knots = round(seconds / KNOT_S)
    per_knot = round(KNOT_S / rig.one_axis().simulation.plant.step_s)
    force = np.asarray(f_h(np.arange(knots + 1) * KNOT_S), float)
    truth = np.zeros((knots * per_knot, len(TRUTH_COLUMNS)))
    for k in range(knots):
        t = k * KNOT_S
        plant["motor_pm"], plant["brake_Nm"] = motor_pm(t), brake_Nm(t)
        advance(plant[0], force, per_knot, k * per_knot, per_knot, truth, k * per_knot)
    return plant[0], dict(zip(TRUTH_COLUMNS, truth.T, strict=True)), rig


def chatter(t):
    return 500.0 if math.floor(t / 0.004) % 2 else -500.0


def push(t):
    return 1.5 * np.sin(2 * np.pi * 1.3 * t)


@pytest.mark.parametrize("step_s", [2e-4, 1e-4, 5e-5])
def test_energy_balance_computed_from_torques_and_speed_closes_and_shrinks_with_the_step(step_s):
    _, truth, rig = run((f"plant.step_s={step_s}",), 2.0, chatter, lambda t: 0.4, push)
    work = sum(truth[f"{name}_work_J"][-1] for name in ("operator", "motor", "brake", "friction"))
    kinetic = 0.5 * rig.one_axis().simulation.plant.inertia_kg_m2 * truth["speed_rad_s"][-1] ** 2
    # the viscous loss from the speed alone, by the trapezoidal rule: not the plant's own sum
    viscous = rig.one_axis().simulation.plant.viscous_Nms_rad * np.trapezoid(truth["speed_rad_s"] ** 2, truth["t_s"])
    residual = abs(work - viscous - kinetic)
    assert residual <= 0.01 * abs(truth["operator_work_J"][-1]) * (step_s / 2e-4)


def test_works_are_torque_times_way():
    _, truth, _ = run((), 1.0, chatter, lambda t: 0.2, push)
    for name in ("operator", "motor", "brake", "friction"):
        way = np.diff(truth["angle_rad"], prepend=0.0)
        assert np.sum(truth[f"{name}_Nm"] * way) == pytest.approx(truth[f"{name}_work_J"][-1], rel=2e-2, abs=2e-3)


@settings(max_examples=25, deadline=None)
@given(
    motor=st.floats(-3000, 3000),
    brake=st.floats(0, 8),
    force=st.floats(-8, 8),
    frequency=st.floats(0.5, 40),
)
def test_brake_and_friction_never_push(motor, brake, force, frequency):
    _, truth, _ = run(
        (),
        0.1,
        lambda t: motor * math.sin(300 * t),
        lambda t: brake,
        lambda t: force * np.sin(2 * np.pi * frequency * t),
    )
    for name in ("brake", "friction"):
        assert np.all(truth[f"{name}_Nm"] * truth["speed_rad_s"] <= 0.0)
        assert np.all(np.diff(truth[f"{name}_work_J"]) <= 0.0)


def test_stuck_is_exactly_still_until_the_load_exceeds_the_friction():
    friction = 0.06 + 0.08
    _, below, _ = run((), 1.0, f_h=lambda t: 0.999 * friction * t)
    assert np.all(below["speed_rad_s"] == 0.0)
    assert np.all(below["angle_rad"] == 0.0)
    # stuck, brake and friction bear the whole load
    assert below["brake_Nm"][-1] + below["friction_Nm"][-1] == pytest.approx(-0.999 * friction, abs=1e-4)
    _, above, _ = run((), 1.0, f_h=lambda t: 1.2 * friction * t)
    moves = above["t_s"][np.argmax(above["speed_rad_s"] > 0)]
    assert moves == pytest.approx(1 / 1.2, abs=1e-3)


def test_slip_agrees_with_an_independent_integrator():
    """Constant push, Coulomb and viscous friction, the operator's spring: scipy with a stop
    event.
    """
    rig = load_rig("bench")
    axis = rig.one_axis()
    plant = axis.simulation.plant
    mass = plant.inertia_kg_m2 + axis.simulation.operator.inertia_kg_m2
    damping = plant.viscous_Nms_rad + axis.simulation.operator.damping_Nms_rad
    level = plant.coulomb_Nm + plant.brake_off_state_Nm

    def slip(t, y):
        return [
            y[1],
            (1.0 - level - damping * y[1] - axis.simulation.operator.stiffness_Nm_rad * y[0]) / mass,
        ]

    def stop(t, y):
        return y[1] if t > 1e-6 else 1.0

    stop.terminal, stop.direction = True, -1
    reference = solve_ivp(slip, (0, 1), [0.0, 0.0], events=stop, rtol=1e-10, atol=1e-12)
    _, truth, _ = run((), 0.5, f_h=lambda t: np.ones_like(t))
    stopped = truth["angle_rad"][-1]
    assert truth["speed_rad_s"][-1] == 0.0
    assert stopped == pytest.approx(reference.y[0, -1], rel=1e-3)


def test_motor_lag_is_first_order():
    _, truth, rig = run(("plant.coulomb_Nm=50.0",), 0.02, lambda t: 100.0)
    full = 0.1 * rig.one_axis().simulation.plant.motor_rated_torque_Nm * rig.one_axis().simulation.plant.ratio
    t = truth["t_s"] - rig.one_axis().simulation.plant.step_s / 2  # the mean of a step stands for its middle
    assert truth["motor_Nm"] == pytest.approx(full * (1 - np.exp(-t / 1e-3)), abs=1e-3 * full)


def test_brake_reaches_95_percent_in_54_ms():
    """Coil 3 ms and fluid 15 ms in series: the step response is known in closed form."""
    rig = load_rig("bench")
    plant = new_plant(rig.one_axis())
    truth = np.zeros((1, len(TRUTH_COLUMNS)))
    fluid = []
    for _ in range(200):
        plant["brake_Nm"] = 1.0
        advance(plant[0], np.zeros(2), 20, 0, 20, truth, -1)
        fluid.append(float(plant["fluid"][0]))
    t = np.arange(1, 201) * 1e-3
    expected = 1 - (15 * np.exp(-t / 15e-3) - 3 * np.exp(-t / 3e-3)) / 12
    assert fluid == pytest.approx(expected, abs=5e-3)
    assert np.searchsorted(fluid, 0.95) + 1 == pytest.approx(49, abs=6)


def test_commands_saturate():
    _, truth, rig = run(("plant.coulomb_Nm=50.0",), 0.1, lambda t: 1e6, lambda t: -3.0)
    assert truth["motor_Nm"].max() == pytest.approx(
        rig.one_axis().simulation.plant.motor_peak_ratio * 0.18 * 9.587, rel=1e-3
    )
    plant, _, rig = run((), 0.5, brake_Nm=lambda t: 1e9)
    assert plant["fluid"] == pytest.approx(rig.one_axis().simulation.plant.brake_max_Nm)
    plant, _, _ = run((), 0.5, brake_Nm=lambda t: -1.0)
    assert plant["fluid"] == 0.0


def test_zero_lags_act_at_once():
    overrides = (
        "plant.motor_lag_s=0.0",
        "plant.brake_coil_lag_s=0.0",
        "plant.brake_fluid_lag_s=0.0",
        "plant.coulomb_Nm=50.0",
    )
    plant, truth, rig = run(overrides, 0.001, lambda t: 100.0, lambda t: 2.0)
    assert truth["motor_Nm"][-1] == pytest.approx(
        100 * rig.one_axis().simulation.plant.motor_rated_torque_Nm * rig.one_axis().simulation.plant.ratio / 1000
    )
    assert plant["fluid"] == 2.0


def test_noise_has_unit_variance_and_follows_its_seed():
    plant = new_plant(load_rig("bench").one_axis(), seed=5)
    values = np.array([sample_noise(plant[0]) for _ in range(20_000)])
    assert np.mean(values) == pytest.approx(0.0, abs=0.03)
    assert np.std(values) == pytest.approx(1.0, abs=0.02)
    again = new_plant(load_rig("bench").one_axis(), seed=5)
    other = new_plant(load_rig("bench").one_axis(), seed=6)
    assert sample_noise(again[0]) == values[0]
    assert sample_noise(other[0]) != values[0]


def test_plain_python_gives_the_same_course():
    """The kernel without its compiler is the same function."""
    rig = load_rig("bench")
    truth = np.zeros((200, len(TRUTH_COLUMNS)))
    plain = truth.copy()
    a, b = new_plant(rig.one_axis()), new_plant(rig.one_axis())
    force = np.linspace(0, 1.0, 11)
    for plant in a, b:
        plant["motor_pm"], plant["brake_Nm"] = 30.0, 0.1
    advance(a[0], force, 20, 0, 200, truth, 0)
    getattr(advance, "py_func", advance)(b[0], force, 20, 0, 200, plain, 0)
    assert plain == pytest.approx(truth, rel=1e-9, abs=1e-12)
    assert set(PLANT.names) == set(a.dtype.names)


def test_lags_that_decay_reach_0_and_do_not_stay_at_a_subnormal_number():
    """Hours at rest would be computed with subnormal numbers otherwise, which processors are slow
    with.
    """
    plant, _, rig = run(
        ("plant.motor_lag_s=0.001", "plant.brake_coil_lag_s=0.001", "plant.brake_fluid_lag_s=0.001"),
        2.0,
        lambda t: 100.0 if t < 0.01 else 0.0,
        lambda t: 1.0 if t < 0.01 else 0.0,
    )
    assert math.exp(-1.99 / rig.one_axis().simulation.plant.motor_lag_s) == 0.0  # long enough
    assert (plant["motor"], plant["coil"], plant["fluid"]) == (0.0, 0.0, 0.0)
