"""`explain` against runs whose truth is known: the simulated bus, and what was done to it. `make long`
has two thousand of them.
"""

from __future__ import annotations

import pytest

from benchmarks.explain_runs import RIG_FAULTS, outcome, rig_outcome
from benchmarks.explain_scenarios import PAIR, SCENARIOS
from benchmarks.explain_truths import Score
from coulombus.explain.explained import explain
from coulombus.lab.simulate import simulate

pytestmark = pytest.mark.slow


@pytest.mark.thorough
def test_forty_runs_are_told_as_they_were():
    score = Score()
    for seed in range(40):
        score.add(rig_outcome(seed) if seed % 5 == 0 else outcome(seed))
    assert score.runs + score.healthy == 40
    assert score.cause >= 0.95 * score.runs, score.matrix
    assert score.node >= 0.95 * score.runs
    assert score.state >= 0.95 * score.runs
    assert score.culprit >= 0.95 * score.runs
    assert (score.invented, score.healthy > 1) == (0, True)


@pytest.mark.thorough
@pytest.mark.parametrize("name", [*SCENARIOS, PAIR, *RIG_FAULTS])
def test_each_thing_that_is_done_is_told(name):
    result = rig_outcome(3, name) if name in RIG_FAULTS else outcome(4, name)  # three drives
    assert result.name == name
    assert result.right == (True, True, True, True), [vars(i.root) for i in result.told.incidents]


@pytest.mark.parametrize(
    ("rig", "mode"), [("bench", "active"), ("bench", "passive"), ("paper", "hybrid"), ("two_axes", "hybrid")]
)
def test_a_healthy_recording_is_ok(tmp_path, rig, mode):
    path = tmp_path / "run.pcapng"
    simulate(rig, mode, 1.2, record=path)
    told = explain(path)
    assert (told.verdict, [vars(i.root) for i in told.incidents]) == ("ok", [])
    assert told.nodes[0].name
