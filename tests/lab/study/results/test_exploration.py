"""Staircases' turns, and how a hand explored a display."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from coulombus.cli.main import main
from coulombus.lab.simulate import simulate
from coulombus.lab.study.results.exploration import _reversals, explored
from coulombus.lab.study.results.staircase import staircase
from study_text import TEXT


def test_a_staircases_turns_are_counted_and_the_first_left_out():
    levels = [3.0, 2.8, 2.6, 2.6, 2.8, 2.6, 2.4, 2.6, 2.6, 2.4, 2.4, 2.6]
    right = [True, True, False, False, True, True, False, True, True, False, False, True]
    found = staircase(levels, right)
    # down to 2.6 (turn), up to 2.8 (turn), down to 2.4, up to 2.6, down to 2.4
    assert found["turns"] == 5
    assert found["threshold"] == pytest.approx((2.6 + 2.4) / 2)
    assert staircase([2.0, 2.1, 2.0], [True] * 3) is None


@pytest.mark.parametrize(
    ("theta", "count"),
    [([0, 1, 0, 1, 0], 3), ([0, -1, 1], 1), ([0, 0.019, 0, 0.019], 0), ([0, 1, 0.99, 2], 0), ([0, 1, 2], 0)],
)
def test_reversals_are_ways_back_and_no_noise(theta, count):
    assert _reversals(np.array(theta, float)) == count
    assert _reversals(-np.array(theta, float)) == count


@pytest.mark.slow
def test_how_a_hand_explored_agrees_with_its_schedule_and_its_work(tmp_path):
    path = tmp_path / "run.pcapng"
    simulate("bench", "hybrid", 13.0, record=path)
    one = explored(path)
    # 8 s of stroke: 4 moves of 1 s at a mean of up to 2 rad/s against some 3 Nm, and rests
    assert 1.0 < one.path_rad < 16.0
    assert one.range_rad <= one.path_rad
    assert 0.05 < one.moving < 0.5
    assert one.speed_rad_s < one.peak_rad_s < 5.0
    assert 2.0 < one.peak_Nm < 6.0
    assert 0.5 * 3.0 * one.path_rad < one.work_J < 1.5 * 3.5 * one.path_rad


def test_free_exploration_is_told_by_level(tmp_path):
    text = TEXT.replace("reference = 2.0\n", "").replace('question = "more?"\n', "")
    text = text.replace('"constant"', '"free"').replace("repeats = 2", "repeats = 1").replace("0.05", "0.3")
    (tmp_path / "study.toml").write_text(text)
    words = ["experiment", str(tmp_path / "study.toml"), "-o", str(tmp_path / "out"), "--subject", "S01", "--virtual"]
    result = CliRunner().invoke(main, words)
    assert result.exit_code == 0, result.output
    result = CliRunner().invoke(main, ["analyse", "study", str(tmp_path / "out"), "--json"])
    hand = json.loads(result.stdout)["subjects"]["S01"]["a"]["exploration"]
    assert list(hand) == ["1.6", "2.4"]
    assert hand["1.6"]["displays"] == 1
    assert hand["1.6"]["path_rad"] >= hand["1.6"]["range_rad"] >= 0
    figures = str(tmp_path / "figures")
    assert "level 1.6 Nm: path" in CliRunner().invoke(main, ["analyse", "study", str(tmp_path / "out")]).stdout
    assert CliRunner().invoke(main, ["analyse", "study", str(tmp_path / "out"), "--figures", figures]).exit_code == 0
    assert (tmp_path / "figures" / "sub-S01_exploration.png").exists()
    page = (tmp_path / "figures" / "report.md").read_text().splitlines()
    assert "| subject | condition | level [Nm] | path [rad] | reversals | moving | speed [rad/s] |" in page[-4]
    assert [line.count("|") for line in page[-4:]] == [page[-1].count("|")] * 4
    (tmp_path / "out" / "sub-S01" / "recordings" / "trial-0001_display-1.pcapng").unlink()
    refused = CliRunner().invoke(main, ["analyse", "study", str(tmp_path / "out")])
    assert refused.exit_code == 2
    assert "trial-0001_display-1.pcapng" in refused.output
