"""A brake that follows late: the predicted limit against the motion itself, and the ideal brake."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from coulombus.analysis.theory.brake_lag import BrakeLag, ripple_limit
from coulombus.analysis.theory.parameters import ParameterError

STEP_S, STEPS = 1e-4, 10
"""Of the motion, and so many of them in a cycle."""
COULOMB_NM = 0.14


def motions(brakes, slopes, *, push_Nm=1.5, seconds=4.0, start_rad_s=0.0):
    """Integrate the handle under a constant push: sampled speed, a cycle of delay, two lags, and a
    brake that opposes the speed or holds. Return the speeds of the last second, [time, motion].
    """
    J, beta, coil_s, fluid_s = (
        np.array([getattr(brake, name) for brake in brakes])
        for name in ("inertia_kg_m2", "damping_Nms_rad", "coil_lag_s", "fluid_lag_s")
    )
    shares = [np.where(lag > 0, -np.expm1(-STEP_S / np.maximum(lag, 1e-9)), 1.0) for lag in (coil_s, fluid_s)]
    slopes = np.asarray(slopes)
    v, x = np.full(slopes.shape, start_rad_s), np.zeros(slopes.shape)
    before, coil, fluid = x.copy(), slopes * abs(start_rad_s), slopes * abs(start_rad_s)
    waits, level = slopes * abs(start_rad_s), slopes * abs(start_rad_s)
    kept = []
    for k in range(round(seconds / STEP_S)):
        if k % STEPS == 0 and k:
            level, waits = waits, slopes * np.abs(x - before) / (STEP_S * STEPS)
            before = x.copy()
        coil = coil + (level - coil) * shares[0]
        fluid = fluid + (coil - fluid) * shares[1]
        pushed = (v + STEP_S / J * push_Nm) / (1 + STEP_S * beta / J)
        v = np.sign(pushed) * np.maximum(np.abs(pushed) - STEP_S / J * (fluid + COULOMB_NM), 0.0)
        x = x + STEP_S * v
        if k * STEP_S >= seconds - 1.0:
            kept.append(v)
    return np.array(kept)


def swings(speeds):
    return np.ptp(speeds, axis=0) > 0.05 * np.mean(speeds, axis=0)


def test_without_a_delay_the_limit_is_that_of_routh():
    brake = BrakeLag(delay_s=0.0)
    J, beta, T1, T2 = 3e-3, 0.105, 3e-3, 15e-3
    expected = (J + beta * (T1 + T2)) * (J * (T1 + T2) + beta * T1 * T2) / (J * T1 * T2) - beta
    assert ripple_limit(brake).damping_Nms_rad == pytest.approx(expected, rel=1e-9)
    for share, stable in ((0.999, True), (1.001, False)):
        poles = np.roots([J * T1 * T2, J * (T1 + T2) + beta * T1 * T2, J + beta * (T1 + T2), beta + share * expected])
        assert (poles.real.max() < 0) == stable


def test_a_brake_with_a_single_lag_has_no_limit():
    assert ripple_limit(BrakeLag(coil_lag_s=0.0, delay_s=0.0)).damping_Nms_rad == math.inf
    assert math.isfinite(ripple_limit(BrakeLag(coil_lag_s=0.0)).damping_Nms_rad)


@pytest.mark.parametrize("name", ["inertia_kg_m2", "fluid_lag_s"])
def test_a_brake_that_cannot_be_is_refused(name):
    with pytest.raises(ParameterError, match=name):
        replace(BrakeLag(), **{name: -1.0})


@pytest.mark.thorough
def test_a_late_brake_swings_from_the_predicted_slope_on():
    """Lag x damping x hand: four hands, three lags, 8 % below the limit and 8 % above."""
    brakes = [
        BrakeLag(damping_Nms_rad=0.005 + hand, coil_lag_s=3e-3 * lag, fluid_lag_s=15e-3 * lag)
        for hand, lag in product((0.05, 0.1, 0.5, 2.0), (0.5, 1.0, 2.0))
    ]
    limits = np.array([ripple_limit(brake).damping_Nms_rad for brake in brakes])
    assert limits.max() > 8 * limits.min()
    below, above = motions(brakes, 0.92 * limits), motions(brakes, 1.08 * limits)
    assert not swings(below).any()
    assert swings(above).all()


@pytest.mark.thorough
def test_the_push_does_not_move_the_limit():
    brake = BrakeLag()
    limit = ripple_limit(brake).damping_Nms_rad
    for push_Nm in (0.5, 4.0):
        speeds = motions([brake] * 2, [0.92 * limit, 1.08 * limit], push_Nm=push_Nm)
        assert swings(speeds).tolist() == [False, True]


@pytest.mark.thorough
def test_the_bench_swings_for_ever_under_a_constant_push():
    """2 Nms/rad and 1.5 Nm: a turn has the same size in the 4th second and in the 8th."""
    early = motions([BrakeLag()], [2.0], seconds=4.0)
    late = motions([BrakeLag()], [2.0], seconds=8.0)
    assert np.ptp(late) == pytest.approx(np.ptp(early), rel=0.02)
    assert np.ptp(late) == pytest.approx(1.67, rel=0.1)


def test_an_ideal_brake_does_not_swing_at_any_slope_and_from_any_start():
    """Without lags, damped by the last step's speed: two motions come together."""
    J, beta, B, h, push = 3e-3, 0.005, 50.0, 1e-4, 1.5
    v = np.array([-2.0, 0.0, 5.0])
    gaps = []
    for _ in range(20_000):
        pushed = v + h / J * push
        v = np.sign(pushed) * np.maximum(np.abs(pushed) - h / J * COULOMB_NM, 0.0) / (1 + h * (beta + B) / J)
        gaps.append(np.ptp(v))
    assert np.all(np.diff(gaps) <= 1e-15)
    assert v == pytest.approx((push - COULOMB_NM) / (beta + B), rel=1e-6)


def test_a_late_brake_under_a_hand_that_only_draws_a_spring_comes_to_rest():
    """The brake itself gives nothing: with a push that ends in a spring the motion ends."""
    J, beta, k, B, h = 3e-3, 0.0, 5.0, 6.0, 1e-4
    x, v, fluid, energy = 0.0, 0.0, 0.0, []
    for _ in range(60_000):
        fluid += (B * abs(v) - fluid) * h / 15e-3
        pushed = (v + h / J * (1.5 - k * x)) / (1 + h * beta / J + h * h * k / J)
        v = math.copysign(max(abs(pushed) - h / J * fluid, 0.0), pushed)
        x += h * v
        energy.append(0.5 * J * v * v + 0.5 * k * (x - 1.5 / k) ** 2)
    assert energy[-1] < 1e-3 * energy[0]
    assert np.max(np.diff(energy)) < 1e-4 * energy[0]
