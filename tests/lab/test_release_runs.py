"""A loaded hand is let go no faster than `check` says, from simulated ends and trips."""

from __future__ import annotations

import random

import pytest

from benchmarks.releases import ENDS, End, ended
from coulombus.host.setup.release import GENTLE_RAD_S, failure_of
from coulombus.rigs.rig import load_rig

OF_MOTOR = [name for name in ENDS if name.startswith("motor")]
SHARE = 1.1
"""What a run may exceed the figure of `check` by."""


@pytest.mark.parametrize("push", [0.6, 0.95])
def test_an_orderly_end_in_mode_active_lets_a_hand_go_gently(push):
    run = ended("bench", "active", End(), push, 3.5)
    assert run.marker == "safe"
    assert 0.0 < run.speed_rad_s <= 0.5


def test_a_brake_weaker_than_the_motor_lets_a_hand_go_gently():
    run = ended("bench", "active", End(), 0.95, 3.5, ("limits.brake_torque_Nm=0.6",))
    assert run.marker == "safe"
    assert run.speed_rad_s <= GENTLE_RAD_S


@pytest.mark.parametrize("seed", range(4))
def test_a_motor_that_fails_moves_the_hand_no_faster_than_check_says(seed):
    draw = random.Random(seed)
    inertia, fluid_s = draw.uniform(2e-3, 8e-3), draw.uniform(5e-3, 40e-3)
    overrides = (
        f"plant.inertia_kg_m2={inertia}",
        f"mechanics.inertia_kg_m2={inertia}",
        f"plant.brake_fluid_lag_s={fluid_s}",
        f"brake.fluid_lag_s={fluid_s}",
        "brake.coil_lag_s=0.003",
        f"limits.missed_tpdo_cycles={draw.randint(2, 6)}",
    )
    failure = failure_of(load_rig("bench", overrides).axes[0])
    run = ended("bench", "active", ENDS[draw.choice(OF_MOTOR)], draw.uniform(0.6, 0.97), 3.5, overrides, seed)
    assert run.marker.startswith("trip")
    assert 0.2 < run.speed_rad_s <= SHARE * failure.speed_rad_s
    assert run.setpoint_Nm >= 0.6 * 1.2


def test_a_brake_that_fails_with_the_motor_is_no_worse_than_check_says():
    failure = failure_of(load_rig("bench").axes[0])
    run = ended("bench", "active", ENDS["brake: all power lost"], 0.9, 3.5)
    assert failure.speed_rad_s < run.speed_rad_s <= SHARE * failure.alone_rad_s


def test_a_stranger_who_commands_the_drive_gives_the_handle_little():
    run = ended("bench", "active", ENDS["another node commands 1.5 Nm"], 0.3, 3.5)
    assert run.marker == "trip SECOND_HOST"
    assert run.speed_rad_s <= GENTLE_RAD_S


@pytest.mark.thorough
def test_a_joint_of_an_arm_hands_over_as_an_axis_does():
    for what, least_Nm in (("orderly end", 0.24), ("motor: TPDO lost", 0.5)):
        run = ended("plane", "active", ENDS[what], 0.9, 3.5)
        assert run.speed_rad_s <= 0.3
        assert run.setpoint_Nm >= least_Nm
