"""A virtual wall through bus, nodes and PDOs: on both sides of the predicted bound."""

from __future__ import annotations

import pytest

from coulombus.analysis.rig.wall_plane import WallPlane, WallRow, handle_of, stable_through_bus
from coulombus.analysis.theory.z_width import Lean, stable_leaning, stable_predicted
from coulombus.host.cycle.output_limits import motor_limit_Nm
from coulombus.host.setup.law_demand import cut_off
from coulombus.rigs.rig import load_rig


@pytest.fixture(scope="module")
def bench():
    return load_rig("bench")


@pytest.mark.parametrize(
    ("mode", "K", "B", "stable"),
    [
        ("active", 240.0, 0.5, True),
        ("active", 500.0, 0.5, False),
        ("hybrid", 240.0, 0.5, True),
        ("hybrid", 600.0, 0.5, False),
    ],
)
def test_the_bus_is_on_the_predictions_side(bench, mode, K, B, stable):
    assert stable_predicted(handle_of(bench), K, B, mode) is stable
    assert stable_through_bus(bench, K, B, mode) is stable


@pytest.mark.parametrize(("mode", "K"), [("active", 337.0), ("hybrid", 578.0)])
def test_above_1_Nms_rad_it_is_the_walls_one_side_that_bus_and_prediction_differ_by(bench, mode, K):
    """Within 30 % on both sides of the bus' own bound, where the prediction is off by a factor of 1.5 to 2."""
    handle = handle_of(bench)
    for near, stable in ((0.75, True), (1.3, False)):
        assert stable_through_bus(bench, near * K, 1.8, mode) is stable
        assert stable_leaning(handle, near * K, 1.8, mode, Lean()) is stable
    assert stable_predicted(handle, 1.3 * K, 1.8, mode) is (mode == "hybrid")
    assert stable_predicted(handle, 0.75 * K, 1.8, mode) is (mode == "hybrid")


def test_the_brake_damps_a_wall_that_the_motor_cannot(bench):
    assert stable_through_bus(bench, 150.0, 2.8, "hybrid")
    assert not stable_through_bus(bench, 150.0, 2.8, "active")


def test_the_gain_is_a_ratio_of_areas():
    rows = [WallRow(mode, B, 10.0, 2 * K, K) for mode, K in (("active", 10.0), ("hybrid", 40.0)) for B in (0.0, 1.0)]
    assert WallPlane("bench", tuple(rows)).as_dict()["hybrid_to_active"] == {
        "predicted": 1.0,
        "leaning": 4.0,
        "bus": 4.0,
    }


@pytest.mark.parametrize(("limit", "fits"), [(1.2, False), (1.33, False), (1.34, True)])
def test_in_hybrid_the_motor_must_hold_the_wall_and_compensate(bench, limit, fits):
    wall = bench.variant("law.function=wall", "law.wall.most_Nm=1.2", f"mode.hybrid.motor_limit_Nm={limit}")
    found = cut_off(wall, "hybrid")
    assert (not found) is fits
    assert all("law.wall.most_Nm" in text and "would cut it off" in text for text in found)


def test_no_other_law_lifts_hybrids_limit(bench):
    axis = bench.variant("mode.hybrid.motor_limit_Nm=1.5").one_axis()
    assert motor_limit_Nm(axis, "hybrid") == pytest.approx(1.2 * 0.14)
