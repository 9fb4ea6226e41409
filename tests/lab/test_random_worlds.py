"""Random worlds outside feed no hand, shake none and do not trip; `python -m benchmarks worlds` makes many."""

import math

import pytest

from benchmarks.random_worlds import HANDS, MOST_J, STILL_M_S, STILL_RAD_S, TIP_HANDS, on_arm, on_bench, run_world
from coulombus import LinearField, Model, load_rig

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(("seed", "mode", "hand"), [(1000, "passive", 0), (1007, "hybrid", 2), (1011, "active", 3)])
def test_a_random_world_gives_the_hand_nothing(seed, mode, hand):
    _, outcome = on_bench(seed, mode, HANDS[hand])
    assert outcome.given_J < MOST_J
    assert outcome.speed < STILL_RAD_S
    assert outcome.trip is None


def test_a_random_world_gives_the_hand_at_an_arms_tip_nothing():
    _, outcome = on_arm(1002, "active", TIP_HANDS[2])
    assert outcome.given_J < MOST_J
    assert outcome.speed < STILL_M_S
    assert outcome.trip is None


def test_a_field_that_drives_gives_the_hand_energy():
    rows = []

    def model(state):
        rows.append((state.x_rad, state.handle_Nm, 0.0, 0.0))
        return Model(field=LinearField(Nm=0.5 * math.sin(6.0 * state.t_s)), law=0.0, life_s=0.5)

    assert (
        run_world(load_rig("bench", ("phase=[{kind='rest', duration_s=4.0}]",)), "active", 3.0, model, rows).given_J
        > MOST_J
    )
