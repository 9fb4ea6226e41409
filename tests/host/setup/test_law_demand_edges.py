"""A law held against what motor and brake can show, at the bounds: from which count on it is cut off."""

from __future__ import annotations

import math

import numpy as np
import pytest

from coulombus.host.cycle.output_limits import torque_step_Nm
from coulombus.host.setup.law_demand import check_demand, cut_off
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
