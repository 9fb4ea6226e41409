"""Orders, staircases and QUEST+ against what theory says of them."""

import sys
from collections import Counter
from itertools import pairwise

import numpy as np
import pytest
from scipy.special import ndtr

from coulombus.lab.study.methods import Fixed, Quest, QuestMissing, Staircase, target
from coulombus.lab.study.orders import williams


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
        one.take(shown[-1], True)
    assert Counter(shown) == {1.0: 4, 2.0: 4, 3.0: 4}


def test_a_staircase_goes_down_after_two_right_answers_and_up_after_a_wrong_one():
    one = Staircase(2.0, (1.0, 2.5), [0.4, 0.1], 2, 3.0, 9)
    shown = []
    for right in (True, True, True, False, True, True, False, False, False):
        shown.append(one.level())
        one.take(shown[-1], right)
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
        one.take(level, bool(rights[-1]))
    assert np.mean(rights[500:]) == pytest.approx(share, abs=0.02)


def test_quest_shows_levels_near_the_threshold_and_learns_it():
    pytest.importorskip("questplus")
    rng, sigma = np.random.default_rng(2), 0.2
    one = Quest(2.0, (2.0, 3.2), 150, 0.01)
    levels = []
    while not one.done:
        levels.append(one.level())
        one.take(levels[-1], bool(rng.random() < ndtr((levels[-1] - 2.0) / sigma)))
    assert one.believed == pytest.approx(sigma, rel=0.3)
    assert 2.05 < np.median(levels[20:]) < 2.6


def test_quest_shows_the_level_of_least_expected_entropy():
    pytest.importorskip("questplus")
    one, rng = Quest(2.0, (2.0, 3.2), 40, 0.01), np.random.default_rng(4)
    x, sigma = np.linspace(2.0, 3.2, 25), np.geomspace(0.012, 4.8, 60)
    p = 0.005 + 0.99 * ndtr((x[:, None] - 2.0) / sigma)
    weight = np.full(60, 1 / 60)
    while not one.done:
        expected = np.zeros(25)
        for chance in (p, 1 - p):
            joint = chance * weight
            whole = joint.sum(axis=1, keepdims=True)
            expected -= (joint * np.log(joint / whole)).sum(axis=1)
        k = int(np.argmin(np.abs(x - one.level())))
        assert expected[k] == pytest.approx(expected.min(), abs=1e-9)
        right = bool(rng.random() < p[k, 30])
        weight = weight * (p[k] if right else 1 - p[k])
        weight /= weight.sum()
        one.take(one.level(), right)


def test_without_questplus_it_is_said_how_to_get_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "questplus.qp", None)
    with pytest.raises(QuestMissing, match=r"pip install '\.\[study\]'"):
        Quest(2.0, (2.0, 3.2), 10, 0.01)
