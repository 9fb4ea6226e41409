"""Fits of simulated studies whose threshold is known."""

import numpy as np
import pytest
from scipy.special import ndtr, ndtri

from coulombus.lab.study.methods import Fixed, Mirrored, Quest, Staircase
from coulombus.lab.study.results.fit import fit_comparisons, fit_magnitudes

JND, REFERENCE = 0.15, 2.0
LAPSE = 0.01


def both_sides(above, rng):
    return Mirrored(REFERENCE, above(60), above(60), rng)


METHODS = {
    "constant": lambda rng: Fixed([1.6, 1.8, 1.9, 2.1, 2.2, 2.4], 30, rng),
    "staircase": lambda rng: both_sides(lambda n: Staircase(2.8, (2.0, 3.2), [0.2, 0.1, 0.05], 2, 1.0, n), rng),
    "weighted": lambda rng: both_sides(lambda n: Staircase(2.8, (2.0, 3.2), [0.1, 0.05], 1, 3.0, n), rng),
    "quest": lambda rng: Quest(REFERENCE, (0.8, 3.2), 80, LAPSE),
    "above": lambda rng: Staircase(2.8, (2.0, 3.2), [0.2, 0.1, 0.05], 2, 1.0, 120),
}


def simulated(method, rng, shift=0.0, bias=0.0, lapse=0.0, drift=0.0):
    """Answers of an observer; `shift`, and its `drift` over 120 trials, in JND, `bias` in sigma."""
    sigma = JND / ndtri(0.75)
    levels, larger, second, orders = [], [], [], []
    while not method.done:
        level = method.level()
        orders = orders or list(rng.permutation([-1, 1]))
        order = orders.pop()
        moved = shift + drift * (len(levels) / 120 - 0.5)
        middle = (level - REFERENCE - moved * JND) / sigma + order * bias
        judged = bool(rng.random() < lapse / 2 + (1 - lapse) * ndtr(middle))
        levels.append(level)
        larger.append(judged)
        second.append(order > 0)
        method.update(level, judged if level >= REFERENCE else not judged)
    return levels, larger, second


def fitted(kind, seed, **faults):
    rng = np.random.default_rng([20, seed])
    levels, larger, second = simulated(METHODS[kind](rng), rng, **faults)
    return fit_comparisons(levels, larger, REFERENCE, second)


def holds(bounds, truth):
    low, high = bounds
    return (low is None or low <= truth) and (high is None or truth <= high)


LONG = ("staircase", "weighted", "quest", "above")
"""The fit knows levels and answers, not the method that chose them."""


@pytest.mark.thorough
@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=pytest.mark.long if kind in LONG else ()) for kind in METHODS]
)
def test_the_intervals_hold_the_truth_in_90_to_99_of_100_studies(kind):
    held, fits = np.zeros(2), []
    for seed in range(100):
        draw = np.random.default_rng([21, seed])
        shift, bias, lapse = draw.uniform(-0.5, 0.5), draw.uniform(-0.5, 0.5), draw.uniform(0, 0.04)
        fit = fitted(kind, seed, shift=shift, bias=bias, lapse=lapse)
        held += holds(fit.jnd_95, JND), holds(fit.pse_95, REFERENCE + shift * JND)
        fits.append(fit.jnd)
    if kind == "above":  # levels on one side tell neither the shift nor the slope alone: the interval says so
        assert held[0] >= 90
        return
    assert 90 <= held.min() <= held.max() <= 99
    assert np.median(fits) == pytest.approx(JND, rel=0.1)


@pytest.mark.thorough
@pytest.mark.parametrize(
    "kind", ["staircase", *(pytest.param(kind, marks=pytest.mark.long) for kind in ("constant", "weighted", "quest"))]
)
def test_a_shifted_pse_and_an_interval_bias_leave_the_jnd_right(kind):
    fits = [fitted(kind, seed, shift=1 / 3, bias=0.5) for seed in range(40)]
    assert np.median([fit.jnd for fit in fits]) == pytest.approx(JND, rel=0.12)
    shift, bias = JND / 3, 0.5 * JND / ndtri(0.75)
    assert np.median([fit.pse - REFERENCE for fit in fits]) == pytest.approx(shift, abs=0.2 * JND)
    assert np.median([fit.bias for fit in fits]) == pytest.approx(bias, abs=0.2 * JND)


def test_levels_on_one_side_are_said_to_be():
    assert fitted("above", 1).one_sided
    assert not fitted("staircase", 1).one_sided


def test_lapses_are_fitted_where_easy_levels_tell_them():
    levels = np.repeat([1.2, 1.4, 1.8, 1.9, 2.1, 2.2, 2.6, 2.8], 200)

    def fit_of(lapse):  # as many answers as are expected
        chance = lapse / 2 + (1 - lapse) * ndtr((levels - 2.0) / 0.2)
        return fit_comparisons(levels, np.tile(np.arange(200) + 0.5, 8) < 200 * chance, REFERENCE)

    for lapse in (0.0, 0.05):
        fit = fit_of(lapse)
        assert fit.lapse == pytest.approx(lapse, abs=0.015)
        assert fit.jnd == pytest.approx(0.2 * ndtri(0.75), rel=0.05)


@pytest.mark.thorough
def test_the_deviance_finds_a_subject_who_changes_and_no_other():
    rng = np.random.default_rng(5)
    levels = np.tile([1.6, 1.8, 1.9, 2.1, 2.2, 2.4], 40)
    steady = [fit_comparisons(levels, rng.random(240) < ndtr((levels - 2.0) / 0.2), REFERENCE) for _ in range(60)]
    shares = np.array([fit.probability for fit in steady])
    assert np.sum(shares < 0.05) <= 8
    assert 0.3 < np.median(shares) < 0.7
    assert np.mean([fit.overdispersion for fit in steady]) == pytest.approx(1.0, abs=0.2)
    chance = np.where(np.isin(levels, [1.8, 2.2]), 0.5, ndtr((levels - 2.0) / 0.2))
    odd = fit_comparisons(levels, rng.random(240) < chance, REFERENCE)
    assert odd.probability < 0.05
    assert odd.overdispersion > 2


@pytest.mark.thorough
def test_the_jnd_of_a_tenth_of_lapses_is_that_of_an_observer_who_has_them():
    """The answers hardly tell the lapses: the fit's own JND is too large then."""
    rng = np.random.default_rng(7)
    levels = np.tile([1.5, 1.7, 1.8, 1.9, 2.0, 2.1, 2.2, 2.3, 2.5], 20)
    fits = [
        fit_comparisons(levels, rng.random(180) < 0.05 + 0.9 * ndtr((levels - 2.0) / 0.2), REFERENCE) for _ in range(40)
    ]
    jnd = 0.2 * ndtri(0.75)
    assert np.median([fit.jnd_lapses for fit in fits]) == pytest.approx(jnd, rel=0.1)
    assert np.median([fit.jnd for fit in fits]) > 1.1 * jnd


@pytest.mark.thorough
def test_a_drift_is_found_and_none_where_there_is_none():
    """A staircase follows the subject: the deviance does not see it, and the JND is too large."""
    still = [fitted("staircase", seed, bias=0.3) for seed in range(40)]
    assert sum(fit.drift_probability < 0.05 for fit in still) <= 6
    assert 0.3 < np.median([fit.drift_probability for fit in still]) < 0.7
    drifts = [fitted("staircase", seed, drift=drift) for drift in (2.0, -2.0) for seed in range(6)]
    assert sum(fit.drift_probability < 0.05 for fit in drifts) >= 8
    assert sum(fit.probability < 0.05 for fit in drifts) <= 4
    assert np.median([fit.drift for fit in drifts[:6]]) == pytest.approx(2 * JND, rel=0.25)
    assert np.median([fit.drift for fit in drifts[6:]]) == pytest.approx(-2 * JND, rel=0.25)


def test_a_drift_goes_with_the_trials_order():
    levels, larger, second = simulated(
        METHODS["constant"](np.random.default_rng(3)), np.random.default_rng(4), drift=2.0
    )
    forth = fit_comparisons(levels, larger, REFERENCE, second)
    back = fit_comparisons(levels[::-1], larger[::-1], REFERENCE, second[::-1])
    assert back.drift == pytest.approx(-forth.drift)
    assert back.drift_probability == pytest.approx(forth.drift_probability)
    assert (back.pse, back.jnd) == (forth.pse, forth.jnd)
    up = fit_comparisons([10 * level for level in levels], larger, 10 * REFERENCE, second)
    assert up.drift == pytest.approx(10 * forth.drift, rel=1e-3)


def test_the_same_answers_give_the_same_fit():
    assert fitted("staircase", 4, shift=0.3).as_dict() == fitted("staircase", 4, shift=0.3).as_dict()


@pytest.mark.parametrize("kind", ["constant", "staircase"])
def test_intervals_are_no_wider_than_those_of_psignifit(kind):
    psignifit = pytest.importorskip("psignifit", reason="psignifit is not installed; it is a comparison only")
    for seed in range(5):
        rng = np.random.default_rng([20, seed])
        levels, larger, _ = simulated(METHODS[kind](rng), rng)
        ours, x = fit_comparisons(levels, larger, REFERENCE), np.array(levels)
        table = [[level, np.sum(np.array(larger)[x == level]), np.sum(x == level)] for level in np.unique(x)]
        theirs = psignifit.psignifit(np.array(table, float), experiment_type="equal asymptote", sigmoid="norm")
        low, high = theirs.confidence_intervals["width"]["0.95"]  # from 5 to 95 %: twice 1.645 sigma
        assert 0.4 < np.log(ours.jnd_95[1] / ours.jnd_95[0]) / np.log(high / low) < 1.1
        sigma = theirs.parameter_estimate["width"] / (2 * ndtri(0.95))
        assert ours.jnd == pytest.approx(sigma * ndtri(0.75), rel=0.25)


def test_a_fit_is_told_with_its_bias_and_weber_fraction():
    rng = np.random.default_rng(3)
    levels = np.repeat([1.6, 1.8, 2.0, 2.2, 2.4, 2.6], 2000)
    fit = fit_comparisons(levels, rng.random(len(levels)) < ndtr((levels - 2.1) / 0.25), REFERENCE)
    assert fit.pse == pytest.approx(2.1, abs=0.02)
    assert fit.jnd == pytest.approx(0.25 * ndtri(0.75), rel=0.05)
    assert fit.weber == fit.jnd / 2.0
    assert fit.chance(fit.pse) == pytest.approx(0.5)


def test_answers_that_bound_nothing_say_so():
    fit = fit_comparisons([2.2] * 5, [True] * 5, REFERENCE)
    assert fit.jnd_95[0] is None
    assert fit_comparisons([2.2, 2.2], [True, False], REFERENCE).jnd_95[1] is None
    with pytest.raises(ValueError, match="no level differs"):
        fit_comparisons([2.0], [True], REFERENCE)


def test_magnitudes_follow_a_power_law():
    levels = np.repeat([1.0, 1.5, 2.0, 3.0], 30)
    answers = 10 * levels**0.8 * np.exp(np.random.default_rng(1).normal(0, 0.1, len(levels)))
    found = fit_magnitudes(levels, answers)
    assert found.exponent_95[0] < 0.8 < found.exponent_95[1]
    assert found.exponent_95[1] - found.exponent_95[0] < 0.2
    assert fit_magnitudes([1.0, 1.0, 1.0], [1.0, 2.0, 3.0]) is None
