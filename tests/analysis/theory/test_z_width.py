"""The K-B plane of a virtual wall: predicted against the literature, and against the simulation."""

from __future__ import annotations

import numpy as np
import pytest

from coulombus.analysis.theory.bounds import colgate_stiffness, diolaiti_speed
from coulombus.analysis.theory.z_width import Handle, hulin_stiffness, stable_predicted, stable_simulated, z_width


def test_without_delay_the_free_handle_bears_what_colgate_says():
    handle = Handle(delay_cycles=0)
    bound = colgate_stiffness(handle.viscous_Nms_rad, handle.period_s)
    assert stable_predicted(handle, 0.98 * bound, 0.0, "active")
    assert not stable_predicted(handle, 1.05 * bound, 0.0, "active")


def test_a_cycle_of_delay_takes_two_thirds_of_it():
    assert stable_predicted(Handle(), 3.2, 0.0, "active")
    assert not stable_predicted(Handle(), 3.5, 0.0, "active")


def test_the_simulation_agrees_with_the_prediction_up_to_1_Nms_rad():
    found = z_width(most_K=400.0, most_B=1.0, points=10)
    assert found.agreement("active") >= 0.95
    assert found.agreement("hybrid") >= 0.95


def test_hybrid_bears_a_larger_area_than_active():
    found = z_width(points=10)
    assert found.simulated["active"][-1].sum() == 0  # damping by the motor has an end, too
    assert found.simulated["hybrid"][-1].sum() > 5
    assert found.ratio("simulated") > 3
    assert found.ratio("predicted") > 3


@pytest.mark.parametrize("mode", ["active", "hybrid"])
def test_the_simulated_motion_of_a_soft_wall_dies_out_and_of_a_stiff_one_does_not(mode):
    stable = stable_simulated(Handle(), np.array([20.0, 900.0]), np.array([0.3, 0.3]), mode)
    assert stable.tolist() == [True, False]


@pytest.mark.parametrize("cycles", [0, 1, 2, 5])
@pytest.mark.parametrize("B", [0.0, 0.01, 0.05])
def test_a_soft_loop_with_delay_bears_what_hulin_says(cycles, B):
    """With damping of the motor the exact boundary bends away: up to 0.05 Nms/rad by less than 6 %."""
    handle = Handle(delay_cycles=cycles)
    bound = hulin_stiffness(handle, B)
    near = 0.02 if B == 0.0 else 0.06
    assert stable_predicted(handle, (1 - near) * bound, B, "active")
    assert not stable_predicted(handle, (1 + near) * bound, B, "active")


@pytest.mark.parametrize("coulomb", [0.01, 0.02])
def test_no_speed_is_passive_where_a_count_generates_more_than_friction_takes(coulomb):
    stiffness, count = 50.0, 2e-3  # half a count of the spring: 0.05 Nm
    for viscous in (0.0, 10.0):  # with too little damping, and with enough of it
        assert diolaiti_speed(stiffness, viscous, coulomb, 1e-3, 0.0, count) == 0.0
    assert diolaiti_speed(stiffness, 0.0, coulomb + 0.05, 1e-3, 0.0, count) == pytest.approx(coulomb / 0.025)
