"""How fast a loaded hand is let go: the formulas of `check` against an integration of their equation."""

from __future__ import annotations

import math
import random

import pytest

from coulombus.host.setup.release import failure_of, release_of, speed_of_failure, speed_of_ramp, speed_of_step
from coulombus.rigs.rig import load_rig


def integrated(force, B, K, J, seconds):
    """Return the largest speed of J v' + B v + K x = force(t), from rest, by Heun's method."""
    v = x = most = 0.0
    natural = (K / J) ** 0.5
    dt = 0.002 / (natural + B / J)
    for k in range(int(seconds / dt)):
        a = (force(k * dt) - B * v - K * x) / J
        v1, x1 = v + a * dt, x + v * dt
        a1 = (force((k + 1) * dt) - B * v1 - K * x1) / J
        x += 0.5 * (v + v1) * dt
        v += 0.5 * (a + a1) * dt
        most = max(most, v)
    return most


@pytest.mark.parametrize("seed", range(12))
def test_the_speeds_are_those_of_the_equation(seed):
    draw = random.Random(seed)
    J, K = 10 ** draw.uniform(-3, -1), draw.uniform(1.0, 20.0)
    B = 2.0 * draw.uniform(0.1, 2.0) * (J * K) ** 0.5
    natural = (K / J) ** 0.5
    rate, load = draw.uniform(0.5, 10.0), draw.uniform(0.5, 5.0)
    assert speed_of_step(load, B, K, J) == pytest.approx(integrated(lambda t: load, B, K, J, 8 / natural), rel=5e-3)
    assert speed_of_ramp(rate, B, K, J) == pytest.approx(
        integrated(lambda t: rate * t, B, K, J, 30 / natural * max(1.0, B * natural / K)), rel=5e-3
    )


def test_a_hand_without_a_spring_is_only_damped():
    assert speed_of_step(3.0, 0.5, 0.0, 1e-3) == 6.0
    assert speed_of_ramp(3.0, 0.5, 0.0, 1e-3) == speed_of_step(3.0, 0.0, 0.0, 1e-3) == float("inf")


@pytest.mark.parametrize("name", ["bench", "paper"])
def test_the_packaged_rigs_let_a_hand_go_gently(name):
    axis = load_rig(name).axes[0]
    release = release_of(axis, axis.limits.brake_torque_Nm, axis.brake.ramp_s)
    assert release.is_gentle
    assert release.within_s <= 2.0


def test_a_short_ramp_throws_the_hand_and_a_driver_without_one_throws_it_most():
    axis = load_rig("bench", ("limits.safe_ramp_s=0.5",)).axes[0]
    short, none = (
        release_of(axis, 4.5, 0.0),
        release_of(load_rig("bench", ("limits.safe_ramp_s=0.0",)).axes[0], 4.5, 0.5),
    )
    assert not short.is_gentle
    assert short.speed_rad_s < short.alone_rad_s == none.speed_rad_s
    assert none.alone_rad_s == short.speed_rad_s


def test_a_failed_motor_without_a_brake_is_the_step_of_the_load():
    axis = load_rig("bench").axes[0]
    J = axis.mechanics.inertia_kg_m2 + axis.operator.inertia_kg_m2
    B, K = axis.mechanics.viscous_Nms_rad + axis.operator.damping_Nms_rad, axis.operator.stiffness_Nm_rad
    assert speed_of_failure(axis, 1.2, math.inf) == pytest.approx(speed_of_step(1.2, B, K, J), rel=5e-3)


def test_a_failed_motor_is_worse_the_later_it_is_noticed_and_the_slower_the_brake():
    bench = load_rig("bench").axes[0]
    slow = load_rig("bench", ("brake.coil_lag_s=0.003", "brake.fluid_lag_s=0.05")).axes[0]
    late = load_rig("bench", ("limits.missed_tpdo_cycles=9",)).axes[0]
    failures = [failure_of(axis) for axis in (bench, slow, late)]
    assert failures[0].load_Nm == 1.2
    assert failures[0].speed_rad_s < min(failures[1].speed_rad_s, failures[2].speed_rad_s)
    assert all(failure.speed_rad_s < failure.alone_rad_s for failure in failures)


def test_a_brake_weaker_than_the_motor_is_named():
    weak = failure_of(load_rig("bench", ("limits.brake_torque_Nm=0.6",)).axes[0])
    assert not weak.brake_bears
    assert "weaker than the motor" in str(weak)
    assert "weaker" not in str(failure_of(load_rig("bench").axes[0]))
