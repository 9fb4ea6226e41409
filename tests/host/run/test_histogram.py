"""Histograms of a run's timing as other programs get them, and the steps of its sliders."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from coulombus.host.cycle.controllers import Controllers
from coulombus.host.cycle.parameter_changes import parameters_of
from coulombus.host.run.histogram import coarse, coarse_dict
from coulombus.rigs.rig import load_rig


def test_each_count_is_in_the_bin_of_its_time():
    bins = np.zeros(10_000, np.int64)
    for us, count in ((0, 3), (1, 5), (2, 7), (57, 11), (1000, 13), (9999, 17)):
        bins[us] = count
    found = coarse_dict(bins)
    edges, counts = found["edges"], found["counts"]
    assert len(edges) == len(counts) + 1
    assert edges[0] == 1.0  # what is shorter counts with what follows
    assert edges == sorted(set(edges))
    for us, count in ((1, 8), (2, 7), (57, 11), (1000, 13), (9999, 17)):
        (k,) = (k for k in range(len(counts)) if edges[k] <= us < edges[k + 1])
        assert counts[k] == count
    assert sum(counts) == 56
    assert all(isinstance(one, int) for one in counts)


def test_it_ends_with_the_last_bin_that_is_not_empty():
    bins = np.zeros(10_000, np.int64)
    bins[40] = 2
    found = coarse_dict(bins)
    assert found["counts"][-1] == 2
    assert found["edges"][-2] <= 40 < found["edges"][-1]
    assert len(found["counts"]) < len(coarse(bins)[1])


def test_of_no_cycle_there_is_nothing():
    assert coarse_dict(np.zeros(10_000, np.int64)) == {"edges": [], "counts": []}


@pytest.fixture(scope="module")
def parameter():
    return parameters_of(Controllers(load_rig("bench"), "hybrid").each[0])[0]


@pytest.mark.parametrize(
    ("value", "low", "high", "step"),
    [
        (1.0, 0.0, 10.0, 0.1),
        (1.0, 0.0, 19.9, 0.1),  # to its bound, which is near
        (1.0, 0.0, 1000.0, 0.1),  # to ten times the value
        (0.97, 0.0, 1000.0, 0.05),
        (2.5, 0.0, 1000.0, 0.2),
        (0.0, 0.0, 7.0, 0.05),  # nothing stands in the file: to the bound
        (0.0, 2.0, 7.0, 0.05),
        (0.0, -5.0, 7.0, 0.05),
        (3e-4, 0.0, 1.0, 2e-5),
        (0.0, 0.0, 0.0, 0.01),  # it can be one thing only
    ],
)
def test_a_slider_has_steps_of_1_2_or_5(parameter, value, low, high, step):
    found = replace(parameter, value=value, low=low, high=high).step
    assert found == step
    assert math.isclose(float(f"{found:.0e}"), found)


def test_a_slider_has_a_hundred_steps_or_more_whatever_the_numbers(parameter):
    rng = np.random.default_rng(5)
    for _ in range(2000):
        value, high = 10.0 ** rng.uniform(-6, 5), 10.0 ** rng.uniform(-6, 7)
        found = replace(parameter, value=value, low=0.0, high=high).step
        likely = 10 * value if 20 * value < high else high
        assert 100 * (1 - 1e-9) <= likely / found <= 250 * (1 + 1e-9)
        assert f"{found:.0e}"[0] in "125"
