"""Intervals of Clopper and Pearson: against their definition, published values, and by coverage."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import beta, binom

from coulombus.lab.sweep.rates import Rate, clopper_pearson


@pytest.mark.parametrize(
    ("count", "of", "low", "high"),
    [
        # Brown, Cai, DasGupta 2001, and tables of exact limits (Documenta Geigy), 95 %
        (0, 10, 0.0, 0.3085),
        (1, 10, 0.0025, 0.4450),
        (5, 10, 0.1871, 0.8129),
        (10, 10, 0.6915, 1.0),
        (0, 100, 0.0, 0.0362),
        (5, 100, 0.0164, 0.1128),
        (50, 100, 0.3983, 0.6017),
        (997, 1000, 0.9913, 0.9994),
    ],
)
def test_the_limits_are_those_of_the_tables(count, of, low, high):
    assert clopper_pearson(count, of) == (pytest.approx(low, abs=6e-5), pytest.approx(high, abs=6e-5))


@pytest.mark.parametrize(("count", "of", "confidence"), [(3, 17, 0.95), (200, 1000, 0.99), (1, 2, 0.5)])
def test_the_limits_are_quantiles_of_beta_and_tails_of_the_binomial(count, of, confidence):
    low, high = clopper_pearson(count, of, confidence)
    tail = (1 - confidence) / 2
    assert low == pytest.approx(beta.ppf(tail, count, of - count + 1), rel=1e-10)
    assert high == pytest.approx(beta.ppf(1 - tail, count + 1, of - count), rel=1e-10)
    assert binom.sf(count - 1, of, low) == pytest.approx(tail)
    assert binom.cdf(count, of, high) == pytest.approx(tail)


@pytest.mark.parametrize("true", [0.01, 0.1, 0.5, 0.9, 0.997])
def test_the_interval_holds_the_true_rate_as_often_as_it_says(true):
    counts = np.random.default_rng(1).binomial(60, true, 4000)
    limits = [clopper_pearson(count, 60) for count in range(61)]
    covered = np.mean([limits[count][0] <= true <= limits[count][1] for count in counts])
    assert covered >= 0.95 - 3 * np.sqrt(0.95 * 0.05 / 4000)


def test_of_no_run_nothing_is_known():
    assert clopper_pearson(0, 0) == (0.0, 1.0)


@pytest.mark.parametrize(("count", "of", "confidence"), [(2, 1, 0.95), (-1, 1, 0.95), (0, 1, 1.0), (0, 1, 0.0)])
def test_what_cannot_be_is_refused(count, of, confidence):
    with pytest.raises(ValueError, match="expected 0 <= count <= of"):
        clopper_pearson(count, of, confidence)


def test_a_rate_is_said_with_its_interval():
    assert Rate("still", 997, 1000).text == "still in 997 of 1000 runs (99.13 to 99.94 %)"
    assert Rate("still", 1, 10).as_dict() == dict(
        zip(("count", "of", "low", "high"), (1, 10, *clopper_pearson(1, 10)), strict=True)
    )
