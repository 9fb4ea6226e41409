"""Friction in the plane by brakes: closed forms against a search through all directions of motion."""

from __future__ import annotations

import math

import numpy as np
import pytest

from coulombus.analysis.theory.plane_friction import (
    Levels,
    directions,
    force_ellipse,
    largest_friction_N,
    passive_display,
)

COUNT = 40_000


def arm(l1, l2, q1, q2):
    """The Jacobian of two links, by complex numbers."""
    elbow, tip = l1 * np.exp(1j * q1), l1 * np.exp(1j * q1) + l2 * np.exp(1j * (q1 + q2))
    columns = [1j * tip, 1j * (tip - elbow)]
    return np.array([[column.real for column in columns], [column.imag for column in columns]])


def nearest_deg(force, cone):
    """The angle from a force to the nearest one in a cone of two rays, by trying combinations of the rays."""
    weights = np.linspace(0.0, 1.0, 401)
    rays = np.outer(weights, cone[0] / np.hypot(*cone[0])) + np.outer(1 - weights, cone[1] / np.hypot(*cone[1]))
    rays /= np.hypot(*rays.T)[:, None]
    return math.degrees(math.acos(min(1.0, float((rays @ (force / np.hypot(*force))).max()))))


def by_search(jacobian, count=COUNT):
    """Share of wrong directions, worst angle and the motors' power over c |v|, direction by direction."""
    angle = 2 * math.pi * (np.arange(count) + 0.37) / count
    v = np.stack((np.cos(angle), np.sin(angle)))
    force, inverse = -v, np.linalg.inv(jacobian)
    torque, speed = jacobian.T @ force, inverse @ v
    wrong = (torque * speed > 0).any(axis=0)
    power = np.maximum(torque * speed, 0.0).sum(axis=0)
    worst = max(
        nearest_deg(force[:, k], [-np.sign(speed[i, k]) * inverse.T[:, i] for i in range(2)])
        for k in np.flatnonzero(wrong)[:: max(1, wrong.sum() // 1500)]
    )
    return wrong.mean(), worst, power.max()


@pytest.mark.parametrize("seed", range(12))
def test_closed_forms_agree_with_a_search_for_random_links_and_poses(seed):
    random = np.random.default_rng(seed)
    l1, l2 = random.uniform(0.05, 0.6, 2)
    q1, q2 = random.uniform(-math.pi, math.pi), random.choice([-1, 1]) * random.uniform(0.3, 2.8)
    jacobian = arm(l1, l2, q1, q2)
    found, (share, worst, power) = passive_display(jacobian), by_search(jacobian)
    assert found.share_wrong == pytest.approx(share, abs=2 / COUNT + 1e-4)
    assert found.worst_angle_deg == pytest.approx(worst, abs=0.4)
    assert found.motor_power_per_cv == pytest.approx(power, rel=1e-5)


@pytest.mark.parametrize("seed", range(6))
def test_any_jacobian_has_the_same_closed_forms(seed):
    jacobian = np.random.default_rng(100 + seed).normal(size=(2, 2))
    share, worst, power = by_search(jacobian)
    found = passive_display(jacobian)
    assert (found.share_wrong, found.worst_angle_deg) == pytest.approx((share, worst), abs=0.4)
    assert found.motor_power_per_cv == pytest.approx(power, rel=1e-4)


@pytest.mark.parametrize(
    ("elbow", "wrong", "worst"), [(90, 1 / 2, 45), (60, 2 / 3, 60), (110, 7 / 18, 35), (179, 1 / 180, 0.5)]
)
@pytest.mark.parametrize("sense", [1, -1])
def test_equal_links_have_the_figures_of_their_elbow(elbow, wrong, worst, sense):
    found = passive_display(arm(0.2, 0.2, 0.7, sense * math.radians(elbow)))
    assert (found.share_wrong, found.worst_angle_deg) == pytest.approx((wrong, worst))


def test_the_motors_of_equal_links_at_90_degrees_give_a_fifth():
    assert passive_display(arm(0.3, 0.3, -1.0, math.pi / 2)).motor_power_per_cv == pytest.approx((math.sqrt(2) - 1) / 2)


def test_columns_at_right_angles_need_no_motor():
    found = passive_display(np.array([[0.0, 0.2], [-0.5, 0.0]]))
    assert (found.share_wrong, found.worst_angle_deg, found.motor_power_per_cv) == pytest.approx((0, 0, 0), abs=1e-12)


def test_a_singular_pose_has_no_bound_of_the_motors():
    found = passive_display(arm(0.2, 0.2, 0.3, 0.0))
    assert (found.share_wrong, found.worst_angle_deg) == pytest.approx((1, 90))
    assert found.motor_power_per_cv == math.inf


def test_hybrid_displays_the_wanted_force_with_bounded_power_of_the_motors():
    jacobian = arm(0.25, 0.2, 0.4, 1.1)
    data = directions(jacobian, 3.0, Levels((9.0, 9.0), (9.0, 9.0)))
    assert data.hybrid_N == pytest.approx(data.wanted_N)
    assert data.active_N == pytest.approx(data.wanted_N)
    assert data.motor_share.max() == pytest.approx(passive_display(jacobian).motor_power_per_cv, rel=1e-3)
    assert data.off_deg("passive").max() == pytest.approx(passive_display(jacobian).worst_angle_deg, abs=1.0)


@pytest.mark.parametrize("seed", range(5))
def test_the_largest_friction_is_where_the_first_direction_fails(seed):
    random = np.random.default_rng(200 + seed)
    jacobian = arm(*random.uniform(0.1, 0.4, 2), 0.3, random.uniform(0.5, 2.6))
    levels = Levels(tuple(random.uniform(1, 5, 2)), tuple(random.uniform(0.2, 1.5, 2)))
    largest = largest_friction_N(jacobian, levels)
    for mode in ("active", "hybrid"):
        inside = directions(jacobian, 0.995 * largest[mode], levels, 3600)
        beyond = directions(jacobian, 1.005 * largest[mode], levels, 3600)
        assert getattr(inside, f"{mode}_N") == pytest.approx(inside.wanted_N)
        assert np.abs(getattr(beyond, f"{mode}_N") - beyond.wanted_N).max() > 1e-3 * largest[mode]
    assert largest["passive"] == 0.0
    assert largest["hybrid"] > largest["active"]


def test_the_disc_that_brakes_hold_is_within_their_box():
    jacobian, levels = arm(0.2, 0.3, 0.1, 1.4), Levels((2.0, 1.0), (1.0, 1.0))
    hold = largest_friction_N(jacobian, levels)["hold"]
    angle = np.linspace(0, 2 * math.pi, 3601)
    loads = np.abs(jacobian.T @ (hold * np.stack((np.cos(angle), np.sin(angle)))))
    share = loads.max(axis=1) / levels.brake_Nm
    assert share.max() == pytest.approx(1.0, abs=1e-5)


def test_the_force_ellipse_has_the_inverse_singular_values():
    jacobian = arm(0.22, 0.31, 0.9, 1.2)
    ellipse = force_ellipse(jacobian)
    assert ellipse.semi_axes_N == pytest.approx(sorted(1 / np.linalg.svd(jacobian, compute_uv=False), reverse=True))
    along = ellipse.semi_axes_N[0] * np.array([math.cos(ellipse.direction_rad), math.sin(ellipse.direction_rad)])
    assert np.hypot(*(jacobian.T @ along)) == pytest.approx(1.0)


def test_brakes_that_are_right_everywhere_have_the_whole_ellipse():
    assert force_ellipse(np.diag([0.2, 0.5])).passive_area == pytest.approx(1.0)
    assert 0.0 < force_ellipse(arm(0.2, 0.2, 0.0, 1.0)).passive_area < 0.7


def test_directions_of_a_singular_pose_are_refused():
    with pytest.raises(ValueError, match="singular"):
        directions(arm(0.2, 0.2, 0.0, 0.0), 1.0, Levels((1, 1), (1, 1)))
