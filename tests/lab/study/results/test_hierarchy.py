"""The hierarchical fit of a group: simulated subjects whose median threshold is known."""

import numpy as np
import pytest
from scipy.special import ndtr, ndtri

from coulombus.lab.study.results.hierarchy import hierarchical
from coulombus.lab.study.results.posterior import counted, posterior

JND, SPREAD, REFERENCE = 0.15, 0.25, 2.0
LEVELS = np.repeat([1.5, 1.7, 1.9, 2.1, 2.3, 2.5], 20)


def subject(rng, jnd, levels=LEVELS):
    larger = rng.random(len(levels)) < ndtr((levels - REFERENCE) / (jnd / ndtri(0.75)))
    return posterior(counted(levels, larger, REFERENCE, None))


@pytest.mark.thorough
def test_the_interval_of_a_group_holds_its_median_and_spread():
    held = np.zeros(2)
    for seed in range(30):
        rng = np.random.default_rng([31, seed])
        jnds = JND * np.exp(rng.normal(0.0, SPREAD, 8))
        group = hierarchical({str(k): subject(rng, jnd) for k, jnd in enumerate(jnds)})
        held += group.jnd_95[0] <= JND <= group.jnd_95[1], group.spread_95[0] <= SPREAD <= group.spread_95[1]
    assert held.min() >= 26


def test_a_subject_of_few_answers_is_drawn_towards_the_group():
    rng = np.random.default_rng(4)
    subjects = {f"S{k}": subject(rng, JND) for k in range(6)}
    alone = subject(rng, 3 * JND, LEVELS[::8])
    with_it = hierarchical({**subjects, "few": alone})
    without = hierarchical(subjects)
    jnd = float(alone.sigma_at([0.5])[0] * ndtri(0.75))
    assert jnd > with_it.subject_jnd["few"] > with_it.jnd
    assert with_it.jnd == pytest.approx(without.jnd, rel=0.15)
    assert with_it.subjects == 7


def test_one_subject_is_no_group():
    assert hierarchical({"S1": subject(np.random.default_rng(1), JND)}) is None
