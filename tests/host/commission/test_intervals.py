"""What the intervals of commissioning are made of: independent samples, counts, earlier steps."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from coulombus.host.commission.samples import counted_reach, independent, mean_in
from coulombus.host.commission.step import Given, rounded, shares
from coulombus.recording.friction.regression import Estimate, SpeedLevels, clusters_of, regress, solve, widened
from coulombus.recording.signals import Series


def correlated(rng, share, n=4000):
    """Return a signal whose neighbours have the correlation `share`."""
    noise = rng.standard_normal(n)
    values = np.empty(n)
    values[0] = noise[0]
    for k in range(1, n):
        values[k] = share * values[k - 1] + np.sqrt(1 - share**2) * noise[k]
    return values


@pytest.mark.parametrize("share", [0.0, 0.5, 0.9])
def test_correlated_samples_count_for_fewer(share):
    worth = np.median([independent(correlated(np.random.default_rng(seed), share)) for seed in range(10)])
    assert worth == pytest.approx(4000 * (1 - share) / (1 + share), rel=0.25)


def test_a_constant_signal_is_known_to_half_a_count():
    t = np.arange(1000) * 1e-3
    mean = mean_in(Series(t, np.full(1000, 0.003), "Nm"), 0.0, 1.0, "zero", 0.001)
    assert mean.reach == pytest.approx(0.0005)


@pytest.mark.parametrize("noise", [0.0, 0.1, 0.3, 1.0])
def test_the_mean_of_counts_is_off_by_less_than_is_said(noise):
    for offset in np.linspace(-0.5, 0.5, 9):
        counts = np.rint(offset + noise * np.random.default_rng(3).standard_normal(20_000))
        scatter = 3 * np.std(counts) / np.sqrt(20_000)
        assert abs(np.mean(counts) - offset) <= counted_reach(float(np.std(counts)), 1.0) + scatter


def test_the_error_of_counts_is_bounded_for_any_noise_and_any_place_within_a_count():
    """Near the edge of a count, noise far below a count was taken for a dither."""
    rng, k = np.random.default_rng(1), np.arange(-30, 31)
    for noise, place in zip(
        np.exp(rng.uniform(np.log(0.01), np.log(2), 2000)), rng.uniform(-0.5, 0.5, 2000), strict=True
    ):
        share = norm.cdf((k + 0.5 - place) / noise) - norm.cdf((k - 0.5 - place) / noise)
        mean = np.sum(k * share)
        deviation = float(np.sqrt(np.sum((k - mean) ** 2 * share)))
        assert abs(mean - place) <= counted_reach(deviation, 1.0) + 1e-9


def test_the_interval_of_a_mean_holds_the_truth_of_correlated_noise():
    rng = np.random.default_rng(7)
    t = np.arange(2000) * 1e-3
    held = []
    for _ in range(200):
        mean = mean_in(Series(t, 0.7 + correlated(rng, 0.8, 2000), "Nm"), 0.0, 2.0, "noise")
        held.append(abs(mean.value - 0.7) <= mean.reach)
    assert 0.9 <= np.mean(held) <= 0.99


def finding(key, old, new, reach, changed, name=""):
    return {"key": key, "name": name, "old": old, "new": new, "uncertainty": reach, "changed": changed}


def test_a_figure_that_was_not_written_counts_with_its_difference():
    steps = {
        "weight": {"findings": [finding("scale", 0.001, 0.0012, 6e-6, True)]},
        "encoder": {"findings": [finding("ratio", 10.0, 10.02, 0.05, False), finding("sign", 1, 1, None, False)]},
        "motor": {"findings": [finding("", 1.7, 1.8, 0.018, True, name="torque")]},
    }
    known = shares(steps)
    assert known == pytest.approx({"scale": 0.005, "ratio": 0.007, "torque": 0.01})


def test_a_figure_that_no_step_measured_is_named():
    given = Given(shares={"ratio": 0.01})
    assert given.share("position", "ratio") == 0.01
    assert given.share("scale") == 0.0
    (remark,) = given.exact({"the scale (step weight)": ("scale",), "the ratio": ("position", "ratio")})
    assert remark.endswith("exact: the scale (step weight)")
    assert given.exact({"the ratio": ("ratio",)}) == ()


def test_relative_intervals_add_in_squares():
    wide = widened(Estimate(2.0, 1.94, 2.06), 0.04, 0.0)
    assert wide.reach == pytest.approx(0.1)
    assert wide.value == 2.0
    assert wide.low == pytest.approx(1.9)


@pytest.mark.parametrize(("value", "reach"), [(0.123456, 0.004), (9.587123, 0.02), (4.23456e-3, 3e-6), (-1234.5, 60.0)])
def test_rounding_leaves_the_digits_that_the_interval_carries(value, reach):
    assert abs(rounded(value, reach) - value) <= 0.05 * reach
    assert rounded(value, 0.0) == pytest.approx(value, rel=1e-5)


def test_the_count_of_a_steady_torque_does_not_average_out():
    """A quantised torque at each of three speeds, both ways: the fit's own interval is too narrow, that
    with levels holds.
    """
    rng, count = np.random.default_rng(11), 2e-3
    held, narrow = [], []
    for _ in range(60):
        c, b = rng.uniform(0.02, 0.1), rng.uniform(0.005, 0.01)
        v = np.repeat([0.4, 1.0, 2.0, -0.4, -1.0, -2.0], 200)
        swing = 1.5 * count * np.sin(0.9 * np.arange(len(v)))
        torque = np.rint((c * np.sign(v) + b * v + swing) / count) * count - swing
        slide = np.repeat(np.arange(6), 200)
        columns = {"c": (np.sign(v), 0.0), "b": (v, 0.0)}
        fitted = regress(columns, torque, slide)
        solution = solve(np.column_stack([np.sign(v), v]), torque, np.zeros(2))
        extra = SpeedLevels.from_speeds(v, count).variance(solution)
        wide = np.hypot(fitted["c"].reach, 1.96 * np.sqrt(extra[0]))
        held.append(abs(fitted["c"].value - c) <= wide)
        narrow.append(abs(fitted["c"].value - c) <= fitted["c"].reach)
    assert len(clusters_of(slide)) > 6
    assert np.mean(held) >= 0.9
    assert np.mean(narrow) < 0.8
