"""Random worlds outside feed no hand, shake none and do not trip; `python -m benchmarks worlds` makes many."""

import math

import pytest

from benchmarks.random_worlds import (
    HANDS,
    MOST_J,
    STILL_M_S,
    STILL_RAD_S,
    TIP_HANDS,
    Course,
    on_arm,
    on_bench,
    run_world,
)
from coulombus import LinearField, Model, load_rig

pytestmark = pytest.mark.slow


@pytest.mark.thorough
@pytest.mark.parametrize(("seed", "mode", "hand"), [(1000, "passive", 0), (1007, "hybrid", 2), (1011, "active", 3)])
def test_a_random_world_gives_the_hand_nothing(seed, mode, hand):
    _, outcome = on_bench(seed, mode, HANDS[hand])
    assert outcome.given_J < MOST_J
    assert outcome.speed < STILL_RAD_S
    assert outcome.trip is None


@pytest.mark.thorough
def test_a_random_world_gives_the_hand_at_an_arms_tip_nothing():
    _, outcome = on_arm(1002, "active", TIP_HANDS[2])
    assert outcome.given_J < MOST_J
    assert outcome.speed < STILL_M_S
    assert outcome.trip is None


@pytest.mark.thorough
def test_a_field_that_drives_gives_the_hand_energy():
    course = Course(1e-3)

    def model(state):
        course.note(state.x_rad, state.handle_Nm, 0.0, 0.0)
        return Model(field=LinearField(Nm=0.5 * math.sin(6.0 * state.t_s)), law=0.0, life_s=0.5)

    rig = load_rig("bench", ("phase=[{kind='rest', duration_s=4.0}]",))
    assert run_world(rig, "active", 3.0, model, course).given_J > MOST_J


def test_the_work_of_a_motion_and_of_a_profile_is_the_worlds_own():
    course = Course(1e-3, moves=0.1, plays=2.0, displayed=0.5)
    for _ in range(1600):
        course.note(course.t_s, -3.0, 1.0, course.shift, course.profile)
    moved = course.outcome(0.0, None)
    assert max(row[3] for row in course.rows) == pytest.approx(0.1, rel=1e-3)  # the way of the motion, and back
    assert max(row[4] for row in course.rows) == 0.5  # what the mode's motor displays of the profile
    assert moved.given_J == pytest.approx(3.0 * 1.599, abs=0.01)
    assert moved.speed == pytest.approx(1.0)
    assert not moved.passive
