"""`coulombus analyse plane`: the figures of poses and workspace, the picture, what is refused."""

from __future__ import annotations

import json
import math

import pytest
from click.testing import CliRunner

from coulombus.cli.main import main


def analyse(*arguments):
    return CliRunner().invoke(main, ["analyse", "plane", *arguments])


def poses(*arguments):
    result = analyse("--rig", "plane", "--grid", "4", "--json", *arguments)
    assert result.exit_code == 0, result.output
    return json.loads(result.stdout)["poses"]


def test_poses_are_in_degrees_and_told_in_radians():
    first, second = poses("--pose", "0,90", "--pose", "-30,60")
    assert first["q_rad"] == pytest.approx([0, math.pi / 2])
    assert (first["share_wrong"], first["worst_angle_deg"]) == pytest.approx((0.5, 45))
    assert first["motor_power_per_cv"] == pytest.approx(0.20711, abs=1e-5)
    assert second["q_rad"] == pytest.approx([-math.pi / 6, math.pi / 3])
    assert (second["share_wrong"], second["worst_angle_deg"]) == pytest.approx((2 / 3, 60))


def test_other_links_are_set():
    (pose,) = poses("--pose", "0,90", "--set", "kinematics.l1_m=0.3", "--set", "kinematics.l2_m=0.4")
    off = 90 - math.degrees(math.atan2(0.3, 0.4))
    assert pose["worst_angle_deg"] == pytest.approx(off)
    assert pose["share_wrong"] == pytest.approx(off / 90)


def test_without_a_pose_the_start_is_analysed():
    (pose,) = poses()
    assert pose["q_rad"] == [-0.95, 1.92]
    assert pose["allowed"] is True


def test_a_singular_pose_has_no_bound_of_the_motors():
    (pose,) = poses("--pose", "20,0")
    assert (pose["share_wrong"], pose["worst_angle_deg"], pose["allowed"]) == (1.0, 90.0, False)
    assert pose["stuck"] is None
    assert pose["motor_power_per_cv"] is None


def test_hands_that_get_stuck_are_counted():
    (pose,) = poses("--pose", "0,60")
    assert pose["stuck"]["wall_share"] == pytest.approx(0.5 + (2 / 3) ** 2 / 4)
    assert pose["stuck"]["wall_one_way"] == pytest.approx(2 / 3)
    assert pose["stuck"]["friction_most"] == pytest.approx(1 / math.sin(math.radians(15)))
    text = " ".join(analyse("--rig", "plane", "--pose", "0,60", "--grid", "2").stdout.split())
    assert "is stuck in 61 % of its pushes; constant levels at rest hold up to 3.86 F_s" in text


def test_motors_alone_have_a_limit_cycle_in_each_pose():
    found = json.loads(analyse("--rig", "plane", "--grid", "2", "--pose", "0,90", "--pose", "0,5", "--json").stdout)
    first, second = found["motors_alone"]
    assert second is None  # the arm is not armed there
    assert first["friction_N"] == 3.0
    assert 20 < first["predicted"]["frequency_Hz"] < 60
    double = json.loads(analyse("--rig", "plane", "--grid", "2", "--pose", "0,90", "--friction", "6", "--json").stdout)
    ratio = double["motors_alone"][0]["predicted"]["velocity_m_s"][0] / first["predicted"]["velocity_m_s"][0]
    assert ratio == pytest.approx(2.0)
    text = " ".join(analyse("--rig", "plane", "--pose", "0,90", "--grid", "2").stdout.split())
    assert f"describing function {first['predicted']['frequency_Hz']:.1f} Hz" in text


def test_the_map_has_the_allowed_poses_alone():
    found = json.loads(
        analyse("--rig", "plane", "--grid", "12", "--set", "kinematics.x_m=[0.0, 0.3]", "--json").stdout
    )["map"]
    assert 0 < found["allowed"] == len(found["rows"]) < found["tried"] == 144
    assert all(row["condition"] >= 0.15 and 0 <= row["x_m"][0] <= 0.3 for row in found["rows"])
    assert found["ranges"]["share_wrong"]["most"] == max(row["share_wrong"] for row in found["rows"])


def test_the_table_says_what_the_json_does():
    text = " ".join(analyse("--rig", "plane", "--pose", "0,90", "--grid", "4").stdout.split())
    assert "wrong in 50.0 % of the directions, by up to 45.0 deg" in text
    assert "at most 0.207 c |v|" in text


def test_the_picture_is_drawn_and_not_replaced(tmp_path):
    path = str(tmp_path / "plane.png")
    assert analyse("--rig", "plane", "--pose", "0,60", "--grid", "2", "--picture", path).exit_code == 0
    assert (tmp_path / "plane.png").read_bytes().startswith(b"\x89PNG")
    assert analyse("--rig", "plane", "--grid", "2", "--picture", path).exit_code == 2


@pytest.mark.thorough
@pytest.mark.slow
def test_a_circle_is_drawn_in_each_mode():
    result = analyse("--rig", "plane", "--grid", "2", "--circle", "1", "--friction", "2.5", "--json")
    circle = json.loads(result.stdout)["circle"]
    assert (circle["frequency_Hz"], circle["friction_N"]) == (1.0, 2.5)
    assert list(circle["modes"]) == ["hybrid", "passive", "active"]
    hybrid, passive, active = circle["modes"].values()
    assert hybrid["median_deg"] < 2.0 < passive["median_deg"]
    assert hybrid["median_N"] == pytest.approx(2.5, rel=0.03)
    assert passive["motor_work_J"] == 0.0 > active["motor_work_J"]
    text = analyse("--rig", "plane", "--grid", "2", "--circle", "1", "--friction", "2.5").stdout
    assert f"hybrid {hybrid['median_deg']:7.1f} deg ({hybrid['p95_deg']:.1f})" in text


@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        (["--rig", "bench"], 3, "has no [kinematics]"),
        (["--rig", "plane", "--pose", "90"], 2, "expected two angles"),
        (["--rig", "plane", "--pose", "a,b"], 2, "expected two angles"),
        (["--rig", "plane", "--pose", "nan,1"], 2, "expected two angles"),
        (["--rig", "plane", "--set", "kinematics.l1_m=0"], 3, "kinematics.l1_m"),
        (["--rig", "plane", "--grid", "1"], 2, "--grid"),
        (["--rig", "plane", "--circle", "0"], 2, "--circle"),
        (["--rig", "plane", "--pose", "0,0", "--picture", "x.png"], 3, "singular"),
    ],
)
def test_what_is_wrong_is_said(arguments, status, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = analyse(*arguments)
    assert result.exit_code == status
    assert words in " ".join(result.stderr.split())
    assert not list(tmp_path.iterdir())
