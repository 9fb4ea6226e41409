"""Hands that get stuck with brakes alone: against a search over brake torques, and over the forces at rest."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coulombus.analysis.theory.plane_friction import OVER, stuck_hands, wall_coefficients

LINKS = st.floats(0.1, 0.5)
ELBOWS = st.floats(math.radians(20), math.radians(160)) | st.floats(math.radians(-160), math.radians(-20))


def jacobian(q1, q2, l1=0.2, l2=0.2):
    x2, y2 = l2 * math.cos(q1 + q2), l2 * math.sin(q1 + q2)
    return np.array([[-l1 * math.sin(q1) - y2, -y2], [l1 * math.cos(q1) + x2, x2]])


def bears(J, normal, sense, push_rad):
    """Whether brakes can bear a push so that the hand slides: searched over the torques of both brakes."""
    tangent = sense * np.array([-normal[1], normal[0]])
    hand = -math.cos(push_rad) * normal + math.sin(push_rad) * tangent
    speed = np.linalg.solve(J, tangent)
    most = 20.0 * np.abs(J).max()
    for share in np.linspace(-1.0, 2.0, 601):  # of the normal force by the first brake
        torque = []
        for i, part in enumerate((share, 1.0 - share)):
            unit = np.linalg.solve(J.T, np.eye(2)[i])
            torque.append(-part * (hand @ normal) / (unit @ normal) if part else 0.0)
        torque = np.array(torque)
        if (torque * speed > 1e-12).any() or np.abs(torque).max() > most * 50:
            continue
        net = hand + np.linalg.solve(J.T, torque)
        assert net @ normal == pytest.approx(0.0, abs=1e-9)
        if net @ tangent > 0.0:
            return True
    return False


@pytest.mark.thorough
@settings(derandomize=True, max_examples=25, deadline=None)
@given(st.floats(-3, 3), ELBOWS, LINKS, LINKS, st.floats(0, 2 * math.pi))
def test_a_wall_of_brakes_resists_like_friction(q1, q2, l1, l2, normal_rad):
    J = jacobian(q1, q2, l1, l2)
    normal = np.array([math.cos(normal_rad), math.sin(normal_rad)])
    for sense, coefficient in zip((1, -1), wall_coefficients(J, np.array([normal_rad]))[0], strict=True):
        edge = math.atan(coefficient)
        if edge < math.radians(88):
            assert bears(J, normal, sense, edge + math.radians(1))
        if math.radians(1) < edge:
            assert not bears(J, normal, sense, edge - math.radians(1))


@settings(derandomize=True, max_examples=25, deadline=None)
@given(st.floats(-3, 3), ELBOWS, LINKS, LINKS)
def test_constant_levels_hold_a_rhombus(q1, q2, l1, l2):
    J = jacobian(q1, q2, l1, l2)
    stuck = stuck_hands(J)
    angle = 2 * math.pi * (np.arange(36000) + 0.5) / 36000
    torque = np.abs(J.T @ np.stack((np.cos(angle), np.sin(angle)))) / np.hypot(J[0], J[1])[:, None]
    held = 1.0 / torque.max(axis=0)  # the largest force held in each direction, over F_s
    assert stuck.friction_share == pytest.approx((held > OVER).mean(), abs=1e-3)
    assert stuck.friction_most == pytest.approx(held.max(), rel=1e-2)
    assert held.min() == pytest.approx(1.0, rel=1e-6)  # it never cuts the disc


@settings(derandomize=True, max_examples=25, deadline=None)
@given(st.floats(-3, 3), ELBOWS, LINKS, LINKS)
def test_the_shares_are_those_over_all_walls(q1, q2, l1, l2):
    J = jacobian(q1, q2, l1, l2)
    coefficients = wall_coefficients(J, 2 * math.pi * (np.arange(7200) + 0.5) / 7200)
    shares, stuck = np.arctan(coefficients).sum(axis=1) / math.pi, stuck_hands(J)
    assert stuck.wall_share == pytest.approx(shares.mean(), abs=1e-4)
    assert (stuck.wall_best_share, stuck.wall_worst_share) == pytest.approx((shares.min(), shares.max()), abs=1e-3)
    assert stuck.wall_one_way == pytest.approx(np.isinf(coefficients).any(axis=1).mean(), abs=1e-3)


def test_perpendicular_columns_let_a_hand_slide_along_their_walls():
    square = stuck_hands(np.eye(2) * 0.3)
    assert wall_coefficients(np.eye(2), np.array([1e-9]))[0].min() == pytest.approx(0.0, abs=1e-8)
    assert (square.wall_share, square.wall_one_way) == pytest.approx((0.5, 0.0))
    assert square.friction_most == pytest.approx(math.sqrt(2))
    stretched = stuck_hands(jacobian(0.0, math.radians(30)))
    assert stretched.wall_share > square.wall_share
    assert stretched.friction_most > 3.0


def test_the_share_turns_with_the_arm_and_not_with_its_size():
    first, second = stuck_hands(jacobian(0.3, 1.2)), stuck_hands(3.0 * jacobian(0.3 + math.radians(45), 1.2))
    assert vars(second) == pytest.approx(vars(first), rel=1e-6)


def test_a_singular_pose_has_no_figure():
    assert stuck_hands(jacobian(0.4, 0.0)) is None
