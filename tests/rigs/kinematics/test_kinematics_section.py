"""[kinematics] of the rig file: what it takes, and what is refused, with file and line."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from coulombus.rigs.field_help import accepted_range, fields_of, unit_of
from coulombus.rigs.kinematics.kinematics_section import Kinematics, PlanePlant, TrueKinematics
from coulombus.rigs.kinematics.load_mechanism import load_mechanism
from coulombus.rigs.rig import RigError, load_rig, load_rig_text, packaged_rig
from places import ROOT

MECHANISM = """
import math

def arm(m, pose):
    a, b = pose.angle_rad[0], pose.angle_rad[1]
    pose.x_m[0] = m.user[0] * math.cos(a) + m.user[1] * math.cos(b)
    pose.x_m[1] = m.user[0] * math.sin(a) + m.user[1] * math.sin(b)
    pose.jacobian[0, 0], pose.jacobian[0, 1] = -m.user[0] * math.sin(a), -m.user[1] * math.sin(b)
    pose.jacobian[1, 0], pose.jacobian[1, 1] = m.user[0] * math.cos(a), SCALE * m.user[1] * math.cos(b)

def raises(m, pose):
    pose.x_m[5] = 1.0

def three(m, pose, more):
    pass
"""
OWN = ("kinematics.user=[0.2, 0.15]", "kinematics.start_rad=[0.3, 1.8]")


def plane_file(tmp_path, *changes):
    text = packaged_rig("plane").read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / "plane.toml"
    path.write_text(text)
    return path


def own_mechanism(tmp_path, name="arm", scale=1.0):
    (tmp_path / "arm.py").write_text(MECHANISM.replace("SCALE", str(scale)))
    text = plane_file(tmp_path).read_text()
    links = [line for line in text.splitlines() if line.startswith(("l1_m", "l2_m"))]
    for line in links:
        text = text.replace(line + "\n", "")
    path = tmp_path / "own.toml"
    path.write_text(text.replace('kind = "serial_2r"', f'kind = "arm.py:{name}"'))
    return str(path)


def refusal(rig, *overrides):
    with pytest.raises(RigError) as caught:
        load_rig(str(rig), overrides)
    return caught.value.errors


def line_of(path, start):
    return next(n for n, line in enumerate(path.read_text().splitlines(), 1) if line.startswith(start))


def test_the_joints_are_the_axes_in_their_order():
    rig = load_rig("plane")
    assert rig.axis_names == ("shoulder", "elbow")
    assert rig.kinematics is not None
    assert (rig.kinematics.kind, rig.kinematics.l1_m, rig.kinematics.l2_m) == ("serial_2r", 0.2, 0.2)
    assert load_rig("two_axes").kinematics is None


def test_a_plane_rig_survives_its_text_overrides_and_pickle():
    rig = load_rig("plane")
    assert load_rig_text(rig.effective(), rig.path) == rig
    assert pickle.loads(pickle.dumps(rig)) == rig
    longer = rig.variant("kinematics.l1_m=0.31")
    assert longer != rig
    assert longer.kinematics.l1_m == 0.31
    assert longer.variant("kinematics.l1_m=0.2") == rig


def test_an_axis_alone_is_no_mechanism():
    assert load_rig("plane").alone("elbow").kinematics is None


@pytest.mark.parametrize("value", ["0.0", "-0.2", "nan", '"long"', "true"])
def test_a_link_without_a_length_is_refused_with_its_line(tmp_path, value):
    path = plane_file(tmp_path, ("l2_m = 0.2\n", f"l2_m = {value}\n"))
    (text,) = refusal(path)
    assert text.startswith(f"{path}:{line_of(path, 'l2_m')}: kinematics.l2_m: got")
    assert "expected a number above 0" in text


def test_a_missing_link_and_one_too_many_are_named(tmp_path):
    path = plane_file(tmp_path, ("l2_m = 0.2\n", "l3_m = 0.2\n"))
    missing, other = refusal(path)
    assert f"{path}:{line_of(path, '[kinematics]')}: kinematics.l2_m: missing in [kinematics]" in missing
    assert f'{path}:{line_of(path, "l3_m")}: kinematics.l3_m: no key of kind = "serial_2r"' in other


@pytest.mark.parametrize(
    ("axes", "words"),
    [
        ("", "has one axis without a name"),
        ("[axis.shoulder]\n", "has the axes shoulder"),
        (
            "[axis.a]\n[axis.b]\nmotor.node_id=3\nbrake.node_id=4\n[axis.c]\nmotor.node_id=5\nbrake.node_id=6\n",
            "a, b, c",
        ),
    ],
)
def test_joints_that_are_missing_or_too_many_are_refused(tmp_path, axes, words):
    text = packaged_rig("plane").read_text().partition("[axis.shoulder]")[0]
    path = tmp_path / "joints.toml"
    path.write_text(text + axes)
    (refused,) = refusal(path)
    assert refused.startswith(f"{path}:{line_of(path, '[kinematics]')}: kinematics: the rig has")
    assert words in refused
    assert "expected 2 joints" in refused


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("kinematics.start_rad=[0.3, 0.0]", "not singular"),
        ("kinematics.start_rad=[0.3, 3.141592653589793]", "not singular"),
        ("kinematics.start_rad=[0.3, -0.02]", "condition is 0.004"),
        ("kinematics.y_m=[0.3, -0.3]", "two numbers that grow"),
        ("kinematics.signs=[1, 2]", "each 1 or -1"),
        ("kinematics.signs=[1]", "each 1 or -1"),
        ("kinematics.kind=scara", '"serial_2r", "five_bar", "cartesian"'),
        ("kinematics.least_condition=1.0", "below 1"),
        ("kinematics=3", "a section"),
        ("kinematics.lenght=3", "unknown key"),
    ],
)
def test_what_makes_no_mechanism_is_refused(override, words):
    (text,) = refusal("plane", override)
    assert text.startswith(f"--set {override}: kinematics")
    assert words in text


def test_a_start_outside_the_workspace_is_refused():
    inside = ("kinematics.x_m=[0.2, 0.35]", "kinematics.y_m=[-0.1, 0.1]")
    assert load_rig("plane", inside).kinematics is not None
    (text,) = refusal("plane", *inside, "kinematics.x_m=[0.3, 0.35]")
    assert "plane.toml:" in text
    assert "kinematics.start_rad: got '[-0.95, 1.92]', expected a start in the workspace" in text


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("l1_m", "0.0", "expected a number above 0"),
        ("signs", "[1, 2]", "each 1 or -1"),
        ("start_rad", "[0.3, 0.0]", "a start that is not singular"),
        ("l3_m", "0.2", "unknown key"),
    ],
)
def test_a_truth_that_makes_no_mechanism_is_refused_with_its_line(tmp_path, key, value, words):
    path = plane_file(tmp_path, ("\n[plane]\n", f"\n[plane.kinematics]\n{key} = {value}\n\n[plane]\n"))
    (text,) = refusal(path)
    line = line_of(path, "[plane.kinematics]") + 1
    assert text.startswith(f"{path}:{line}: plane.kinematics.{key}: ")
    assert words in text


def test_a_truth_of_another_mechanism_than_the_simulated_one_is_refused():
    lengths = [f"kinematics.{name}=0.25" for name in ("l3_m", "l4_m")]
    five_bar = ("kinematics.kind=five_bar", "kinematics.base_m=0.1", "kinematics.start_rad=[2.0, 1.0]", *lengths)
    (text,) = refusal("plane", *five_bar, "plane.kinematics.l1_m=0.3")
    assert 'plane.kinematics: got kinematics.kind = "five_bar", expected "serial_2r"' in text


def test_the_truth_is_the_belief_but_for_what_it_says():
    rig = load_rig("plane", ["plane.kinematics.l2_m=0.3"])
    truth = rig.in_plane.true_kinematics
    assert (rig.kinematics.l2_m, truth.l2_m, truth.l1_m) == (0.2, 0.3, 0.2)
    assert (truth.start_rad, truth.signs) == (rig.kinematics.start_rad, rig.kinematics.signs)
    assert load_rig_text(rig.effective(), rig.path) == rig


def test_a_five_bar_whose_links_do_not_meet_is_refused():
    lengths = [f"kinematics.{name}=0.05" for name in ("l1_m", "l2_m", "l3_m", "l4_m")]
    (text,) = refusal("plane", "kinematics.kind=five_bar", "kinematics.base_m=0.4", *lengths)
    assert "its links do not meet there" in text


def test_the_plane_section_needs_kinematics():
    texts = refusal("two_axes", "plane.hand_mass_kg=1")
    assert any("expected [kinematics]" in text for text in texts)


def test_a_mechanism_of_the_users_own_is_compiled(tmp_path):
    rig = load_rig(own_mechanism(tmp_path), OWN)
    pose = load_mechanism(rig.kinematics, tmp_path).pose(0.3, 1.8)
    assert pose["x_m"] == pytest.approx(
        [0.2 * np.cos(0.3) + 0.15 * np.cos(1.8), 0.2 * np.sin(0.3) + 0.15 * np.sin(1.8)]
    )
    assert pickle.loads(pickle.dumps(rig)) == rig


def test_a_jacobian_of_another_mechanism_is_refused(tmp_path):
    path = own_mechanism(tmp_path, scale=1.01)
    (text,) = refusal(path, *OWN)
    assert f"{path}:" in text
    assert "arm.py:4: the Jacobian is not that of the kinematics" in text
    assert "jacobian[1, 1]" in text


def test_a_sign_of_a_joint_is_no_mistake_of_the_jacobian(tmp_path):
    path = own_mechanism(tmp_path)
    signs = "kinematics.signs=[-1, 1]"
    assert load_rig(path, (*OWN[:1], "kinematics.start_rad=[-0.3, 1.8]", signs)).kinematics is not None


@pytest.mark.parametrize(
    ("name", "words"),
    [("arms", "has no function 'arms'; it has arm"), ("three", "two arguments"), ("raises", "no finite tip")],
)
def test_what_is_no_mechanism_of_a_file_is_refused(tmp_path, name, words):
    (text,) = refusal(own_mechanism(tmp_path, name), *OWN)
    assert "kinematics.kind: got" in text
    assert words in text


def test_a_mechanism_file_that_is_not_there_is_refused(tmp_path):
    (text,) = refusal(plane_file(tmp_path), "kinematics.kind=elsewhere.py:arm")
    assert "there is no file elsewhere.py" in text


def test_a_recordings_mechanism_is_not_run(tmp_path):
    (tmp_path / "arm.py").write_text("raise RuntimeError('run')\n")
    rig = load_rig("plane")
    text = rig.effective().replace('kind = "serial_2r"', 'kind = "arm.py:arm"')
    attached = load_rig_text(text, str(tmp_path / "x.pcapng"), rig.eds_texts, attached=True)
    assert attached.kinematics.kind == "arm.py:arm"
    with pytest.raises(RigError, match="cannot be imported"):
        load_rig_text(text, str(tmp_path / "x.toml"), rig.eds_texts)


@pytest.mark.parametrize(
    ("heading", "model"),
    [("`[kinematics]`", Kinematics), ("`[plane]`", PlanePlant), ("`[plane.kinematics]`", TrueKinematics)],
)
def test_every_key_is_documented(heading, model):
    page = (ROOT / "docs" / "rig-file.md").read_text(encoding="utf-8")
    part = next(part for part in page.split("\n## ") if part.splitlines()[0].endswith(heading))
    rows = [[cell.strip() for cell in row.strip("|").split("|")] for row in part.splitlines() if row.startswith("| `")]
    assert [row[0].strip("`") for row in rows] == list(fields_of(model))
    for (_, unit, accepted, _, meaning), (name, info) in zip(rows, fields_of(model).items(), strict=True):
        assert unit == unit_of(name)
        assert accepted == accepted_range(info) or not accepted_range(info)
        assert len(meaning) > 8
