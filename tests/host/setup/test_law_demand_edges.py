"""A law held against what motor and brake can show, at the bounds: from which count on it is cut off."""

from __future__ import annotations

import math

import numpy as np
import pytest

from coulombus.host.cycle.output_limits import torque_step_Nm
from coulombus.host.plane.plane_host import load_plane
from coulombus.host.setup.law_demand import check_demand, cut_off, meanings_of
from coulombus.rigs.kinematics.pose_kernels import condition
from coulombus.rigs.rig import load_rig, load_rig_text
from eds_edit import edit
from places import RIGS, ROOT

BENCH = (RIGS / "bench.toml").read_text(encoding="utf-8")
MOTOR, BRAKE = ((ROOT / "eds" / name).read_text(encoding="utf-8") for name in ("motor.eds", "mr_brake.eds"))
WALL = ("law.function=wall", "law.wall.most_Nm=0.8")
MINE = "law.function=mine.py:law"
BRAKE_SCALE_Nm = 0.001


def axis_of(*overrides):
    return load_rig("bench", list(overrides)).one_axis()


@pytest.mark.parametrize(("limit_Nm", "cut"), [(0.93, True), (0.94, False)])
def test_a_law_that_pushes_does_so_while_the_motor_compensates(limit_Nm, cut):
    """0.8 Nm and 0.97 of 0.14 Nm are 0.9358 Nm."""
    rig = load_rig("bench", [*WALL, f"mode.hybrid.motor_limit_Nm={limit_Nm}"])
    found = cut_off(rig, "hybrid")
    assert len(found) == cut
    if cut:
        assert "law.wall.most_Nm" in found[0]
        assert "not 0.9358 Nm: mode.hybrid.motor_limit_Nm" in found[0]
    assert cut_off(rig, "passive") == []  # its motor does not push


@pytest.mark.parametrize("mode", ["active", "passive", "hybrid"])
def test_a_law_of_the_users_own_is_cut_off_nowhere_beforehand(mode):
    assert cut_off(load_rig("bench", [MINE]), mode) == []


def test_a_rig_that_cuts_nothing_off_is_not_refused():
    rig = load_rig("bench")
    for mode in rig.modes:
        check_demand(rig, mode)


def test_a_count_beyond_the_limit_is_rounding_and_more_is_not():
    step_Nm = torque_step_Nm(axis_of())
    for key, limit_Nm, least_Nm in (("active", 1.5, step_Nm), ("hybrid", 4.5, BRAKE_SCALE_Nm)):
        most_Nm = limit_Nm + least_Nm
        assert cut_off(load_rig("bench", [f"mode.{key}.F_s_Nm={most_Nm!r}"]), key) == []
        assert len(cut_off(load_rig("bench", [f"mode.{key}.F_s_Nm={most_Nm + 1e-9!r}"]), key)) == 1


@pytest.mark.parametrize("sense", [1, -1])
@pytest.mark.parametrize(("F_s_Nm", "cut"), [(4.0009, 0), (4.0011, 1)])
def test_a_count_has_no_sign_where_a_brakes_table_falls(sense, F_s_Nm, cut):
    table = f"\n[role.brake_setpoint]\ntable = [[0, 0.0], [{sense * 4000}, 4.0]]\n"
    texts = {"motor.eds": MOTOR, "mr_brake.eds": edit(BRAKE, "7300sub1", LowLimit=-5000)}
    rig = load_rig_text(BENCH + table, "r.toml", texts, [f"mode.hybrid.F_s_Nm={F_s_Nm}"])
    assert len(cut_off(rig, "hybrid")) == cut


REACH_M = {"shoulder": 2 * 0.2 * math.cos(1.92 / 2), "elbow": 0.2}
"""Distances of the tip from the joints at the plane rig's start: two links of 0.2 m, bent by 1.92 rad."""


@pytest.mark.parametrize(("mode", "limit_Nm", "whose"), [("passive", 4.5, "brake_torque_Nm"), ("active", 1.5, "motor")])
def test_the_largest_force_at_the_tip_is_the_weakest_joints(mode, limit_Nm, whose):
    bound_N = {name: (limit_Nm + 0.14) / length_m for name, length_m in REACH_M.items()}
    for force_N, named in (
        (0.999 * bound_N["shoulder"], []),
        (1.001 * bound_N["shoulder"], ["shoulder"]),
        (1.001 * bound_N["elbow"], ["shoulder", "elbow"]),
    ):
        found = cut_off(load_rig("plane", [f"law.plane_karnopp.F_s_N={force_N:.9g}"]), mode)
        assert len(found) == len(named), force_N
        for text, name in zip(found, named, strict=True):
            assert f"at most {bound_N[name]:.4g} N at the start: " in text
            assert whose in text
            assert f" of {name} ends there" in text
            assert "law.plane_karnopp.F_s_N" in text


def test_a_start_as_near_to_singular_as_is_allowed_is_not_refused():
    rig = load_rig("plane")
    x, y = 1 + math.cos(1.92), math.sin(1.92)
    jacobian = np.array([[-y, -y], [x, math.cos(1.92)]])
    sizes = np.linalg.svd(jacobian, compute_uv=False)
    found = float(sizes[1] / sizes[0])
    for least, refused in ((found * 0.999, False), (found * 1.001, True)):
        force_N = 40 if refused else 3.3  # a start that is refused has no force that the joints bear
        overrides = [f"kinematics.least_condition={least:.9g}", f"law.plane_karnopp.F_s_N={force_N}"]
        text = cut_off(load_rig("plane", overrides), "hybrid")
        assert bool(text) == refused
        if refused:
            assert len(text) == 1
            assert f"kinematics.start_rad: the Jacobian's condition is {found:.2g} there" in text[0]
            line = next(k for k, row in enumerate(rig.text.splitlines(), 1) if row.startswith("start_rad"))
            assert text[0].startswith(f"{rig.path}:{line}: ")


def test_a_bound_in_the_plane_that_is_just_kept_is_kept():
    """The start at the least condition, and a force that is exactly the weakest joint's torque."""
    rig = load_rig("plane")
    pose = load_plane(rig, "passive").mechanism.pose(*rig.kinematics.start_rad)
    length_m = math.hypot(*(float(row[0]) for row in pose["jacobian"]))
    limit_Nm = 4.5 + rig.axes[0].mechanics.friction_Nm
    about_N = limit_Nm / length_m
    forces_N = about_N, math.nextafter(about_N, 0.0), math.nextafter(about_N, math.inf)
    force_N = next(force_N for force_N in forces_N if force_N * length_m == limit_Nm)
    least = f"kinematics.least_condition={float(condition(pose))!r}"
    assert cut_off(load_rig("plane", [least, f"law.plane_karnopp.F_s_N={force_N!r}"]), "passive") == []


# what a limit means at the handle


def meant(mode, *overrides):
    return dict(text.split(": ", 1) for text in meanings_of(axis_of(*overrides), mode))


RATE, FALL, OLD = "limits.torque_rate_Nm_s", "limits.brake_fall_Nm_s", "limits.safe_brake_Nm"


@pytest.mark.parametrize(
    ("rate_Nm_s", "meaning"),
    [
        (250, "mode active reverses 0.5 Nm in 4 ms"),
        (999, "mode active reverses 0.5 Nm in 1 ms"),
        (1000, "mode active reverses 0.5 Nm in 1 ms: it never acts, a cycle is 1 ms"),
        (4000, "mode active reverses 0.5 Nm in 0.25 ms: it never acts, a cycle is 1 ms"),
    ],
)
def test_a_rate_of_the_motor_says_how_long_a_reversal_takes(rate_Nm_s, meaning):
    assert meant("active", "mode.active.motor_limit_Nm=0.5", f"{RATE}={rate_Nm_s}") == {
        RATE: meaning,
        "mode.active.motor_limit_Nm": "it moves a free handle by 0.2 rad/s in a cycle",
    }


def test_a_motor_and_a_brake_of_nothing_have_no_meaning():
    assert meant("active", "mode.active.motor_limit_Nm=0.0") == {}
    assert meant("passive", "limits.brake_torque_Nm=0.0", "mode.passive.motor_limit_Nm=0.0") == {}


@pytest.mark.parametrize(
    ("torque_Nm", "fall_Nm_s", "meaning"),
    [
        (4.5, 90, "the law lets 4.5 Nm go in 50 ms"),
        (0.5, 499, "the law lets 0.5 Nm go in 1 ms"),
        (0.5, 500, "the law lets 0.5 Nm go in 1 ms: it never acts, a cycle is 1 ms"),
        (0.5, 2000, "the law lets 0.5 Nm go in 0.25 ms: it never acts, a cycle is 1 ms"),
    ],
)
def test_a_fall_of_the_brake_says_how_long_it_lets_go(torque_Nm, fall_Nm_s, meaning):
    limits = f"limits.brake_torque_Nm={torque_Nm}", f"{FALL}={fall_Nm_s}"
    assert meant("passive", *limits) == {FALL: meaning}
    assert meant("hybrid", *limits)[FALL] == meaning
    assert FALL not in meant("active", *limits)


def test_a_key_of_an_older_version_is_named():
    assert meant("passive", f"{OLD}=0.0")[OLD] == "it is of version 0.2 and without effect; delete it"
    assert OLD not in meant("passive")
