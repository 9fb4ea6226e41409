"""The mechanisms: tip and Jacobian against geometry that is computed another way."""

from __future__ import annotations

import math

import numpy as np
import pytest

from coulombus.kernels.records import new_records
from coulombus.rigs.kinematics.kinematics_section import Kinematics
from coulombus.rigs.kinematics.load_mechanism import load_mechanism
from coulombus.rigs.kinematics.mechanisms import PoseRecord
from coulombus.rigs.kinematics.pose_kernels import columns_angle, condition
from places import RIGS

ARM = {"kind": "serial_2r", "l1_m": 0.23, "l2_m": 0.17}
FIVE_BAR = {"kind": "five_bar", "l1_m": 0.2, "l2_m": 0.26, "l3_m": 0.21, "l4_m": 0.25, "base_m": 0.1}
SLIDES = {"kind": "cartesian", "radii_m_rad": (0.05, -0.04)}
TURNED = {"offsets_rad": (0.3, -0.2), "signs": (-1, 1)}


def mechanism(values):
    return load_mechanism(Kinematics(**values), RIGS)


def poses(values, count=30):
    random, arm = np.random.default_rng(3), mechanism(values)
    centre = (2.2, 1.0) if values["kind"] == "five_bar" else (0.4, 1.3)
    for _ in range(count):
        q = np.array(centre) + random.uniform(-0.5, 0.5, 2)
        yield arm, q


@pytest.mark.parametrize("values", [ARM, FIVE_BAR, SLIDES], ids=lambda values: values["kind"])
@pytest.mark.parametrize("turned", [{}, TURNED], ids=["plain", "turned"])
def test_the_jacobian_is_that_of_the_tip(values, turned):
    seen = 0
    for arm, q in poses(values | turned):
        pose, h = arm.pose(*q), 1e-6
        if not np.isfinite(pose["x_m"]).all():
            continue
        seen += 1
        for i in range(2):
            step = h * np.eye(2)[i]
            difference = (arm.pose(*(q + step))["x_m"] - arm.pose(*(q - step))["x_m"]) / (2 * h)
            assert pose["jacobian"][:, i] == pytest.approx(difference, abs=1e-8)
    assert seen >= 15


def test_the_tip_of_two_links_is_a_sum_of_two_complex_numbers():
    for arm, (q1, q2) in poses(ARM | TURNED):
        first, second = 0.3 - q1, -0.2 + q2
        tip = 0.23 * np.exp(1j * first) + 0.17 * np.exp(1j * (first + second))
        assert arm.pose(q1, q2)["x_m"] == pytest.approx([tip.real, tip.imag], abs=1e-12)


def test_the_tip_of_a_five_bar_has_its_distances_from_both_elbows():
    for arm, (q1, q2) in poses(FIVE_BAR):
        tip = arm.pose(q1, q2)["x_m"]
        a = 0.2 * np.array([math.cos(q1), math.sin(q1)])
        b = [0.1, 0.0] + 0.21 * np.array([math.cos(q2), math.sin(q2)])
        assert np.hypot(*(tip - a)) == pytest.approx(0.26, abs=1e-12)
        assert np.hypot(*(tip - b)) == pytest.approx(0.25, abs=1e-12)
        assert np.linalg.det([b - a, tip - a]) > 0  # to the left of the way from A to B


def test_elbows_too_far_apart_give_no_pose():
    pose = mechanism(FIVE_BAR | {"l2_m": 0.05, "l4_m": 0.05}).pose(math.pi, 0.0)
    assert np.isnan(pose["x_m"]).all()
    assert condition(pose) == 0.0


@pytest.mark.parametrize("values", [ARM, FIVE_BAR, SLIDES], ids=lambda values: values["kind"])
def test_the_condition_is_the_ratio_of_the_singular_values(values):
    for arm, q in poses(values):
        pose = arm.pose(*q)
        if not np.isfinite(pose["x_m"]).all():
            continue
        largest, smallest = np.linalg.svd(pose["jacobian"], compute_uv=False)
        assert condition(pose) == pytest.approx(smallest / largest, rel=1e-9)


def test_an_arm_stretched_out_or_folded_is_singular():
    arm = mechanism(ARM)
    for q2 in (0.0, math.pi, -math.pi):
        assert condition(arm.pose(0.7, q2)) < 1e-9


def test_columns_of_equal_links_enclose_half_the_elbows_angle():
    arm = mechanism({"kind": "serial_2r", "l1_m": 0.2, "l2_m": 0.2})
    for degrees in (20, 60, 90, 110, 170):
        assert math.degrees(columns_angle(arm.pose(0.4, math.radians(degrees)))) == pytest.approx(degrees / 2)


def test_a_pose_of_zeros_is_singular():
    assert condition(new_records(PoseRecord)[0]) == 0.0
