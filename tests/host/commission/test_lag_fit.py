"""The lags of coil and fluid along a recording: right, with intervals, and told where they are one."""

from __future__ import annotations

import numpy as np
import pytest

from coulombus.host.commission.response import LagFit, _lagged, step_answer

T = 1e-3


@pytest.mark.parametrize(("coil", "fluid"), [(3e-3, 15e-3), (5e-3, 5e-3), (1e-3, 30e-3)])
def test_the_lagged_set_point_is_the_answer_of_two_lags(coil, fluid):
    total, q = coil + fluid, 4 * coil * fluid / (coil + fluid) ** 2
    u = np.concatenate([np.zeros(20), np.ones(400)])
    t = (np.arange(len(u)) - 20) * T
    independent = np.zeros(len(u))
    x1 = x2 = 0.0
    for k in range(len(u) - 1):  # Euler's rule with a step of 2 us, the set-point a cycle late
        for _ in range(500):
            x1 += (u[max(k - 1, 0)] - x1) * 2e-6 / coil
            x2 += (x1 - x2) * 2e-6 / fluid
        independent[k + 1] = x2
    assert _lagged(u, T, T, total, q) == pytest.approx(independent, abs=2e-3)
    assert step_answer(t, T, total, q) == pytest.approx(independent, abs=2e-3)


def test_half_a_cycle_of_delay_shifts_by_half_a_cycle():
    u = np.concatenate([np.zeros(20), np.ones(400)])
    t = (np.arange(len(u)) - 20) * T
    assert _lagged(u, T, 1.5 * T, 0.025, 0.5) == pytest.approx(step_answer(t, 1.5 * T, 0.025, 0.5), abs=3e-3)


def fit(q, spread):
    covariance = np.diag([2e-5, 1e-4, spread]) ** 2
    return LagFit(np.array([1e-3, 0.02, q]), covariance, 1000, (np.zeros(1), np.zeros(1)))


def test_lags_that_may_be_equal_are_told():
    assert not fit(0.5, 0.02).together
    assert fit(0.99, 0.02).together


def test_each_time_has_an_interval_and_the_lags_their_order():
    figures = fit(0.64, 0.02).figures()
    coil, fluid = figures["brake: faster lag (coil)"], figures["brake: slower lag (fluid)"]
    assert coil[0] == pytest.approx(0.004)
    assert fluid[0] == pytest.approx(0.016)
    assert all(0.0 < reach < value for value, reach in figures.values())
    wide = fit(1.0, 0.02).figures()["brake: faster lag (coil)"]
    assert wide[1] > 5 * coil[1]


def test_iron_that_remembers_a_share_widens_each_interval_by_that_share_of_the_coils_time():
    known, iron = fit(0.64, 0.02).figures(), fit(0.64, 0.02).figures(0.1)
    for name, (value, reach) in known.items():
        assert iron[name] == (value, pytest.approx(np.hypot(reach, 0.1 * 0.004)))
