"""Orders, staircases and QUEST+ against what theory says of them."""

from collections import Counter
from itertools import pairwise

import numpy as np
import pytest
from scipy.special import ndtr

from coulombus.lab.study.methods import Fixed, Mirrored, Quest, Staircase, mirrored, target
from coulombus.lab.study.trials import williams


@pytest.mark.parametrize("count", range(1, 8))
def test_a_williams_design_is_balanced(count):
    rows = williams(count)
    assert all(sorted(row) == list(range(count)) for row in rows)
    for place in range(count):
        assert len(set(Counter(row[place] for row in rows).values())) == 1
    followed = Counter(pair for row in rows for pair in pairwise(row))
    assert len(followed) == count * (count - 1)
    assert len(set(followed.values())) <= 1


def test_constant_stimuli_show_each_level_as_often():
    one = Fixed([1.0, 2.0, 3.0], 4, np.random.default_rng(1))
    shown = []
    while not one.done:
        shown.append(one.level())
        one.update(shown[-1], True)
    assert Counter(shown) == {1.0: 4, 2.0: 4, 3.0: 4}


def test_a_staircase_goes_down_after_two_right_answers_and_up_after_a_wrong_one():
    one = Staircase(2.0, (1.0, 2.5), [0.4, 0.1], 2, 3.0, 9)
    shown = []
    for right in (True, True, True, False, True, True, False, False, False):
        shown.append(one.level())
        one.update(shown[-1], right)
    assert shown == [2.0, 2.0, 1.6, 1.6, 1.9, 1.9, 1.8, 2.1, 2.4]
    assert one.level() == 2.5  # the bound
    assert one.done


@pytest.mark.parametrize(("down", "up_ratio", "share"), [(2, 1.0, 0.7071), (3, 1.0, 0.7937), (1, 3.0, 0.75)])
def test_a_staircase_comes_to_rest_at_its_target(down, up_ratio, share):
    assert target(down, up_ratio) == pytest.approx(share, abs=1e-4)
    rng = np.random.default_rng(5)
    one = Staircase(3.0, (2.0, 4.0), [0.1, 0.02], down, up_ratio, 6000)
    rights = []
    while not one.done:
        level = one.level()
        rights.append(rng.random() < ndtr((level - 2.0) / 0.5))
        one.update(level, bool(rights[-1]))
    assert np.mean(rights[500:]) == pytest.approx(share, abs=0.02)


def test_mirrored_staircases_come_to_rest_on_both_sides_of_a_shifted_pse():
    rng, pse, sigma = np.random.default_rng(7), 2.15, 0.5
    stairs = [Staircase(3.0, (2.0, 4.0), [0.1, 0.02], 2, 1.0, 4000) for _ in range(2)]
    both = Mirrored(2.0, *stairs, np.random.default_rng(8))
    shown = []
    while not both.done:
        level = both.level()
        larger = bool(rng.random() < ndtr((level - pse) / sigma))
        shown.append((level, larger))
        both.update(level, larger if level >= 2.0 else not larger)
    above, below = ([took for level, took in shown[1000:] if (level > 2.0) == side] for side in (True, False))
    assert np.mean(above) == pytest.approx(0.7071, abs=0.02)
    assert np.mean(below) == pytest.approx(0.2929, abs=0.03)
    for pair in zip(shown[::2], shown[1::2], strict=True):
        assert sum(level >= 2.0 for level, _ in pair) >= 1
        assert sum(level <= 2.0 for level, _ in pair) >= 1


def test_an_answer_at_the_reference_counts_for_the_staircase_that_showed_it():
    for wrong_side in (False, True):
        stairs = [Staircase(2.0, (2.0, 4.0), [0.1], 1, 1.0, 5) for _ in range(2)]
        both = Mirrored(2.0, *stairs, np.random.default_rng(1))
        for _ in range(2):
            both.update(both.level(), not wrong_side)  # judged larger, or smaller, at the reference
        assert sorted(stair.level() for stair in stairs) == [2.0, 2.1]
        assert stairs[int(not wrong_side)].level() == 2.1  # wrong for that side: it goes up


def test_a_mirrored_level_is_as_far_on_the_other_side():
    assert mirrored(2.3, 2.0) == 1.7
    assert mirrored(mirrored(0.1, 0.3), 0.3) == 0.1


def test_quest_shows_levels_near_the_threshold_and_learns_it():
    rng, sigma, pse = np.random.default_rng(2), 0.2, 2.1
    method = Quest(2.0, (0.8, 3.2), 150, 0.01)
    levels = []
    while not method.done:
        levels.append(method.level())
        larger = bool(rng.random() < ndtr((levels[-1] - pse) / sigma))
        method.update(levels[-1], larger if levels[-1] >= 2.0 else not larger)
    assert method.believed == pytest.approx(sigma, rel=0.3)
    assert 1.6 < np.quantile(levels[20:], 0.1) < pse < np.quantile(levels[20:], 0.9) < 2.6


@pytest.mark.parametrize("low", [2.0, 0.8])
def test_quest_shows_the_level_of_least_expected_entropy(low):
    method, rng = Quest(2.0, (low, 3.2), 25, 0.01), np.random.default_rng(4)
    x = np.linspace(low, 3.2, 25 if low == 2.0 else 49)
    sigma, shift = np.meshgrid(np.geomspace(0.012, 4.8, 60), np.linspace(-1.5, 1.5, 9), indexing="ij")
    p = 0.005 + 0.99 * ndtr((x[:, None] - 2.0) / sigma.ravel() - shift.ravel())
    weight = np.exp(-(shift.ravel() ** 2) / 2)
    weight /= weight.sum()
    while not method.done:
        expected = np.zeros(len(x))
        for chance in (p, 1 - p):
            joint = chance * weight
            whole = joint.sum(axis=1, keepdims=True)
            expected -= (joint * np.log(joint / whole)).sum(axis=1)
        k = int(np.argmin(np.abs(x - method.level())))
        assert expected[k] == pytest.approx(expected.min(), abs=1e-9)
        larger = bool(rng.random() < p[k, 270])
        weight = weight * (p[k] if larger else 1 - p[k])
        weight /= weight.sum()
        method.update(method.level(), larger if x[k] >= 2.0 - 1e-9 else not larger)


def test_quest_without_a_shift_is_the_quest_of_its_library():
    library = pytest.importorskip("questplus.qp").QuestPlus(
        stim_domain={"intensity": np.round(np.linspace(2.0, 3.2, 25), 12)},
        param_domain={
            "mean": np.array([2.0]),
            "sd": np.geomspace(0.012, 4.8, 60),
            "lower_asymptote": np.array([0.005]),
            "lapse_rate": np.array([0.005]),
        },
        outcome_domain={"response": ["right", "wrong"]},
        func="norm_cdf",
        stim_scale="linear",
    )
    method, rng = Quest(2.0, (2.0, 3.2), 12, 0.01, shifts=(0.0,)), np.random.default_rng(4)
    while not method.done:
        level = method.level()
        assert level == float(library.next_stim["intensity"])
        right = bool(rng.random() < ndtr((level - 2.0) / 0.2))
        method.update(level, right)
        library.update(stim={"intensity": level}, outcome={"response": "right" if right else "wrong"})
