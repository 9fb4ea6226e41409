"""A study file: what is read, and what is refused with its line."""

import re

import pytest

from coulombus.lab.study.study import StudyError, read_study
from coulombus.rigs.rig import RigError
from mutilated import mutilated
from study_text import TEXT

STAIRS = 'kind = "staircase"\nstart = 2.5\nlow = 2.0\nhigh = 3.0\nsteps = [0.2]\ntrials = 5'
CONSTANT = 'kind = "constant"\nlevels = [1.6, 2.4]\nrepeats = 2'


def refusal(path, text):
    (path / "study.toml").write_text(text)
    with pytest.raises(StudyError) as error:
        read_study(path / "study.toml")
    return str(error.value)


@pytest.mark.parametrize(
    ("old", "new", "line", "said"),
    [
        ("repeats = 2", "repeats = 0", 12, "method.repeats"),
        ("levels = [1.6, 2.4]", "levels = [1.6, 1.6]", 11, "is given twice"),
        ("levels = [1.6, 2.4]", "levels = [1.6, 9.0]", 11, "limits.brake_torque_Nm"),
        ("reference = 2.0", "reference = 9.0", 4, "limits.brake_torque_Nm"),
        ('kind = "constant"', 'kind = "constnt"', 10, "did you mean"),
        ("mode.{mode}.F_s_Nm", "mode.{mode}.F_s", 7, "refuses"),
        ('name = "a"', 'name = "a"\n[[condition]]\nname = "a"', 16, "a is given twice"),
        ('name = "a"', 'name = "a"\nset = ["plant.no=1"]', 15, "refuses"),
        ('name = "a"', 'name = "a"\nset = ["law.function=no.py:f"]', 15, "there is no file no.py"),
        (
            *('name = "a"', 'name = "a"\n[[factor]]\nname = "x"\nkey = "law.function"\nvalues = ["no.py:f"]'),
            *(15, "there is no file no.py"),
        ),
        ('name = "a"', 'name = "a"\nmode = "passiv"', 15, "passive"),
        ('name = "a"', 'name = "a"\n[[factor]]\nname = "x"\nkey = "plant.no"\nvalues = [1]', 15, "refuses"),
        ("reference = 2.0\n", "", 1, "reference is missing"),
        (CONSTANT, STAIRS.replace("[0.2]", "[-0.2]"), 14, "expected steps above 0"),
        (CONSTANT, STAIRS.replace("start = 2.5", "start = 4.0"), 11, "is not from low"),
        (CONSTANT, STAIRS.replace("low = 2.0", "low = 3.5"), 12, "is not below high"),
        (CONSTANT, STAIRS.replace("low = 2.0", "low = 1.5"), 12, "below the reference"),
        (CONSTANT, STAIRS.replace("trials = 5", "trials = 0"), 15, "method.trials"),
        (CONSTANT, STAIRS.replace("high = 3.0", "high = 9.0"), 13, "limits.brake_torque_Nm"),
        ("seconds = 0.05", "seconds = 0.05\nsecond = 1", 3, "did you mean"),
    ],
)
def test_a_study_that_contradicts_itself_is_refused_with_its_line(tmp_path, old, new, line, said):
    assert old in TEXT
    told = refusal(tmp_path, TEXT.replace(old, new, 1))
    assert f"study.toml:{line}:" in told
    assert said in told


def test_factors_cross_the_conditions(tmp_path):
    more = '[[condition]]\nname = "b"\nmode = "passive"\n[[factor]]\nname = "K"\nkey = "mode.{mode}.K_p_Nm_rad"\n'
    (tmp_path / "study.toml").write_text(f"{TEXT}{more}values = [5000.0, 8000.0]\n")
    study = read_study(tmp_path / "study.toml")
    assert [one.name for one in study.conditions] == ["a_K=5000.0", "a_K=8000.0", "b_K=5000.0", "b_K=8000.0"]
    rig = study.variant(study.conditions[3], 2.0).axes[0]
    assert (rig.mode["passive"].K_p_Nm_rad, rig.mode["passive"].F_s_Nm) == (8000.0, 2.0)
    assert rig.mode["passive"].F_d_Nm == 1.7


def test_comments_leave_a_study_what_it_is(tmp_path):
    (tmp_path / "study.toml").write_text(TEXT)
    one = read_study(tmp_path / "study.toml").fingerprint()
    (tmp_path / "study.toml").write_text(f"# more\n{TEXT}")
    assert read_study(tmp_path / "study.toml").fingerprint() == one
    (tmp_path / "study.toml").write_text(TEXT.replace("seed = 3", "seed = 4"))
    assert read_study(tmp_path / "study.toml").fingerprint() != one


WIDER = 'name = "a"\n'


@pytest.mark.parametrize(
    ("old", "new", "line", "said"),
    [
        (WIDER, WIDER + 'set = ["limits.brake_torque_Nm=5"]', 15, "wider than the rig's 4.5"),
        (WIDER, WIDER + 'set = ["limits.travel_rad=2.0", "limits.speed_rad_s=16.0"]', 15, "wider than the rig's 15"),
        (WIDER, WIDER + 'set = ["mode.hybrid.motor_limit_Nm=0.2"]', 15, "wider than the rig's 0.168"),
        (WIDER, WIDER + 'set = ["mechanics.friction_Nm=0.15"]', 15, "wider than the rig's 0.14"),
        (WIDER, WIDER + 'set = ["mechanics.ratio=5.0"]', 15, "may not change it"),
        (WIDER, WIDER + 'set = ["host.deadman=none"]', 15, "may not change it"),
        (WIDER, WIDER + '[[factor]]\nname="f"\nkey="limits.speed_rad_s"\nvalues=[14.0, 16.0]\n', 18, "wider"),
        ("[level]\n", '[level]\n"mechanics.friction_Nm" = 0.1\n', 7, "wider than the rig's 0.14"),
    ],
)
def test_a_study_widens_no_limit_of_the_rig(tmp_path, old, new, line, said):
    told = refusal(tmp_path, TEXT.replace(old, new, 1))
    assert f"study.toml:{line}:" in told
    assert said in told


def test_a_study_may_set_laws_plants_and_narrower_limits(tmp_path):
    sets = [
        "limits.brake_torque_Nm=4.0",
        "plant.ratio=9.0",
        "operator.inertia_kg_m2=0.01",
        "mode.hybrid.motor_limit_Nm=0.1",
    ]
    sets += ["mechanics.friction_Nm=0.1", "mechanics.viscous_Nms_rad=0.01"]
    (tmp_path / "study.toml").write_text(f"{TEXT}set = {sets}\n")
    assert read_study(tmp_path / "study.toml").conditions[0].settings == tuple(sets)


def test_a_mutilated_file_is_read_or_refused_with_its_line(tmp_path):
    refused = []
    for text in mutilated(TEXT + 'set = ["mode.hybrid.K_p_Nm_rad=8000.0"]\n', 150):
        (tmp_path / "study.toml").write_text(text)
        try:
            assert read_study(tmp_path / "study.toml").conditions
        except (StudyError, RigError) as error:
            refused.append(str(error))
    assert len(refused) > 50
    assert [text for text in refused if re.search(r"study\.toml:\d+: |rig", text) is None] == []
