"""A hand that feels another torque than the displayed one: a trip or a remark, and none for a healthy rig."""

from __future__ import annotations

import random

import pytest

from coulombus import simulate

MS = 1_000_000
AT_S = 3.0
CIRCLE = (
    'phase=[{kind = "rest", duration_s = 1.5}, '
    '{kind = "tip_circle", duration_s = 60.0, radius_m = 0.05, frequency_Hz = 0.5}]'
)
STROKES = (
    'phase=[{kind = "rest", duration_s = 2.0}, '
    '{kind = "stroke", duration_s = 60.0, speed_rad_s = 1.5, move_s = 0.8, dwell_s = 0.2}]'
)


def changed(axis, **factors):
    """A script that multiplies fields of an axis' true plant in mid-run."""

    def change(world):
        for name, factor in factors.items():
            world.plant[axis][name] *= factor

    def wait(world):
        if world.enabled_ns is None:
            world.at(world.t_ns + MS, wait)
        else:
            world.at(world.enabled_ns + round(AT_S * 1e9), change)

    return lambda world: world.at(MS, wait)


def felt_wrong(result):
    """How the difference was reported: a trip, a remark, or not."""
    if result.trip is not None:
        assert "HANDLE_TORQUE" in result.trip
        return "trip"
    remarks = [text for text in result.remarks if "felt another torque" in text]
    assert len(remarks) == (result.counters["implausible_torque"] > 0)
    return "remark" if remarks else None


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("mode", "axis", "factors", "report"),
    [
        ("hybrid", 0, {"motor_Nm_pm": -1.0}, "remark"),
        ("hybrid", 1, {"motor_Nm_pm": -1.0}, "trip"),
        ("hybrid", 0, {"brake_gain": 0.3}, "trip"),
        ("hybrid", 1, {"brake_gain": 0.3}, "remark"),
        ("active", 1, {"motor_Nm_pm": -1.0}, "trip"),
        ("passive", 1, {"brake_gain": 1.8}, "trip"),
        ("hybrid", 0, {}, None),
    ],
)
def test_a_joint_that_gives_another_torque_is_reported(mode, axis, factors, report):
    result = simulate("plane", mode, 8.0, overrides=(CIRCLE,), script=changed(axis, **factors))
    assert felt_wrong(result) == report


@pytest.mark.parametrize(
    ("rig", "axis", "factors", "report"),
    [
        ("bench", 0, {"brake_gain": 0.3}, "trip"),
        ("bench", 0, {"brake_gain": 0.6}, "remark"),
        ("bench", 0, {"brake_gain": 1.2}, None),
        ("two_axes", 1, {"brake_gain": 0.3}, "trip"),
    ],
)
def test_an_axis_that_gives_another_torque_is_reported(rig, axis, factors, report):
    result = simulate(rig, "hybrid", 8.0, overrides=(STROKES,), script=changed(axis, **factors))
    assert felt_wrong(result) == report


LAWS = ("karnopp", "coulomb", "stribeck", "dahl", "lugre", "gms", "viscous", "texture")


def healthy(seed):
    """Draw rig, mode and overrides of a rig whose figures are known as well as commissioning knows them."""
    draw = random.Random(seed)
    uniform = draw.uniform
    rig = draw.choice(("bench", "bench", "two_axes", "plane"))
    mode = draw.choice(("active", "hybrid", "passive"))
    coulomb, gain = uniform(0.03, 0.07), uniform(0.88, 1.12)
    words = [
        f"plant.transducer_noise_Nm={uniform(0.0005, 0.03)}",
        f"plant.coulomb_Nm={coulomb}",
        f"plant.brake_gain={gain}",
        f"plant.brake_fluid_lag_s={uniform(0.005, 0.03)}",
        f"operator.stiffness_Nm_rad={uniform(2.0, 12.0)}",
        f"operator.damping_Nms_rad={uniform(0.05, 0.4)}",
    ]
    if rig != "plane":
        inertia = uniform(2e-3, 8e-3)
        words += [f"law.function={draw.choice(LAWS)}", f"plant.inertia_kg_m2={inertia}"]
        words += [f"mechanics.inertia_kg_m2={inertia * uniform(0.8, 1.2)}"]
        elastic = draw.choice(("", "cable", "handle"))
        if elastic:
            words += [
                f"plant.{elastic}.stiffness_Nm_rad={uniform(60.0, 400.0)}",
                f"plant.{elastic}.damping_Nms_rad={uniform(0.02, 0.1)}",
                f"plant.{elastic}.backlash_rad={uniform(0.0, 0.01)}",
            ]
            words += [f"plant.{elastic}.{'motor_' if elastic == 'cable' else ''}inertia_kg_m2={0.3 * inertia}"]
        words += [f"plant.cogging_Nm={uniform(0.0, 0.02)}"]
        words += [STROKES.replace("1.5,", f"{uniform(0.5, 6.0)},").replace("0.8", str(uniform(0.3, 1.5)))]
    else:
        frequency, radius = uniform(0.2, 1.5), uniform(0.02, 0.06)
        words += [CIRCLE.replace("0.05", str(radius)).replace("frequency_Hz = 0.5", f"frequency_Hz = {frequency}")]
    return rig, mode, tuple(words)


@pytest.mark.parametrize("seed", range(8))
def test_a_healthy_rig_neither_trips_nor_remarks(seed):
    rig, mode, overrides = healthy(seed)
    result = simulate(rig, mode, 6.0, overrides=overrides, seed=seed)
    assert result.trip is None or "HANDLE_TORQUE" not in result.trip
    assert result.counters["implausible_torque"] == 0
