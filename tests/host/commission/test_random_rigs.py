"""Random rigs, commissioned in virtual time: each step passes, and the figures are right.

`python -m benchmarks coverage` does the same with many, and has the table of docs/commissioning.md.
"""

from __future__ import annotations

from dataclasses import replace

import pytest

from benchmarks.coverage import MEASURED, commissioned, random_rig, scores, table
from coulombus.host.commission.motor import LOAD_SHARE

pytestmark = [pytest.mark.slow, pytest.mark.thorough]

SEEDS = (1009, 1013)
"""Both cog, the second with a single period in a revolution: it was 1.8 % wrong where the hand held
the handle in one place.
"""


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    folder = tmp_path_factory.mktemp("coverage")
    return [(random_rig(seed), *commissioned(random_rig(seed), folder)) for seed in SEEDS]


def values(findings):
    return {finding.key or finding.name: finding for finding in findings}


def test_all_eight_steps_pass(results):
    assert [failures for _, _, failures in results] == [[], []]
    assert len(MEASURED) == 8


@pytest.mark.parametrize(
    ("key", "share"),
    [
        ("motor.rated_torque_Nm", 0.01),
        ("mechanics.inertia_kg_m2", 0.03),
        ("mechanics.friction_Nm", 0.01),
        ("mechanics.cogging_Nm", 0.05),
    ],
)
def test_a_motor_that_cogs_is_measured_right(results, key, share):
    for rig, findings, _ in results:
        assert values(findings)[key].new == pytest.approx(rig.figures[key], rel=share), rig.seed


def test_friction_that_grows_with_the_motors_torque_is_measured_apart(tmp_path):
    """Its share is of the true torque, though the rig file believes another one."""
    rig = random_rig(1010)
    rig = replace(rig, truth=(*rig.truth, "plant.friction.load_share=0.12"))
    findings, failures = commissioned(rig, tmp_path, ("zero", "weight", "encoder", "motor"))
    assert failures == []
    by_name = values(findings)
    rated, share = by_name["motor.rated_torque_Nm"], by_name[LOAD_SHARE]
    assert abs(rated.new - rig.figures["motor.rated_torque_Nm"]) < 1.5 * rated.uncertainty < 0.01 * rated.new
    assert abs(share.new - 0.12) < 1.5 * share.uncertainty < 0.01


def test_signs_are_found(results):
    for rig, findings, _ in results:
        for key in ("motor", "encoder", "transducer"):
            name = f"mechanics.{key}_polarity"
            assert values(findings)[name].new == rig.figures[name]


def test_every_figure_that_is_written_has_an_interval(results):
    derived = ("polarity", "periods", "motor_limit", "_lag")
    for _, findings, _ in results:
        for finding in findings:
            if finding.key and not any(word in finding.key for word in derived):
                assert finding.uncertainty is not None, finding.key
                assert finding.uncertainty > 0


def test_most_intervals_hold(results):
    by_name = scores([(rig, findings) for rig, findings, _ in results])
    held = [flag for score in by_name.values() for flag in score.held]
    assert sum(held) >= 0.85 * len(held) > 20
    assert len(table(by_name)) == len(by_name) + 2
