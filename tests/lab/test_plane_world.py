"""A world outside in the plane: an arm's tip meets a model through PDOs, in virtual time."""

import hashlib
import math

import numpy as np
import pytest

from coulombus.host.world.model_check import ModelRefused
from coulombus.host.world.model_parts import Model, PlaneField, PlaneSpring, PlaneWall, Wall
from coulombus.lab.replay.host_replay import host_replay
from coulombus.lab.simulate import simulate
from coulombus.recording.reading import read

WALL = PlaneWall((0.25, 0.0), (-1.0, 0.0), K_N_m=300.0, B_Ns_m=5.0)


def wall_for_a_while(state):
    """A wall in the circle's way, with less friction, until the last second."""
    return None if state.t_s > 7.0 else Model(wall=WALL, parameters={"F_d_N": 2.0, "F_s_N": 2.2})


def watched(seen):
    """Return the world; it keeps the states that it is asked with."""

    def world(state):
        seen.append(state)
        return wall_for_a_while(state)

    return world


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    path = tmp_path_factory.mktemp("world") / "a.pcapng"
    seen = []
    result = simulate("plane", "hybrid", 8, world=watched(seen), record=path, seed=3)
    assert result.trip is None
    return path, seen


@pytest.mark.thorough
def test_the_tip_meets_a_wall_along_its_normal(recorded):
    _, seen = recorded
    assert {state.axis for state in seen} == {0}
    x, y, fx, fy, share = (
        np.array([getattr(state, name) for state in seen])
        for name in ("tip_x_m", "tip_y_m", "world_x_N", "world_y_N", "share")
    )
    whole = np.flatnonzero(share == 1.0)
    assert np.all(fx <= 0.0)
    assert np.all(fy == 0.0)
    assert np.all(fx[whole[x[whole] < 0.249]] == 0.0)
    within = whole[x[whole] > 0.252]
    assert len(within) > 50
    assert fx[within].min() < -1.0
    assert x[whole].max() < 0.27
    assert np.ptp(y) > 0.08  # along its face the hand moves on


@pytest.mark.thorough
def test_the_same_world_gives_the_same_bytes_and_a_replay_renders_it_again(recorded, tmp_path):
    path, _ = recorded
    again = tmp_path / "b.pcapng"
    simulate("plane", "hybrid", 8, world=watched([]), record=again, seed=3)
    assert len({hashlib.sha256(one.read_bytes()).hexdigest() for one in (path, again)}) == 1
    result = host_replay(path)
    assert (result.difference, result.judged, result.unchecked) == (None, True, 0)


@pytest.mark.thorough
def test_the_recording_has_each_joints_share_and_the_fade(recorded):
    recording = read(recorded[0])
    for joint in ("shoulder", "elbow"):
        share = recording[f"{joint}.host.world_share"].values
        assert (share[0], share.max(), share[-1]) == (0.0, 1.0, 0.0)
        assert np.abs(recording[f"{joint}.host.world_Nm"].values).max() > 0.09
    falling = share[(share > 0.0) & (share < 1.0)]
    assert np.allclose(np.diff(falling), -0.01, atol=2e-4)  # 2 ms of 0.2 s


@pytest.mark.thorough
def test_a_spring_that_stands_does_no_net_work_and_one_that_moves_trips():
    def still(state):
        return Model(spring=PlaneSpring((0.23, 0.01), 40.0, 2.0), law=0.0)

    def driven(state):
        place = 0.23 + 0.05 * math.sin(4.0 * math.pi * state.t_s)
        return Model(spring=PlaneSpring((place, 0.0), 300.0), law=0.0)

    assert simulate("plane", "hybrid", 8, world=still).trip is None
    trip = simulate("plane", "hybrid", 8, world=driven).trip
    assert trip is not None
    assert "NET_WORK" in trip


@pytest.mark.thorough
def test_a_field_that_turns_the_tip_trips():
    curl = PlaneField(N_m=((0.0, -20.0), (20.0, 0.0)))
    trip = simulate("plane", "hybrid", 8, world=lambda state: Model(field=curl, law=0.0)).trip
    assert trip is not None
    assert "NET_WORK" in trip


@pytest.mark.thorough
@pytest.mark.parametrize("mode", ["passive", "active", "hybrid"])
def test_the_hand_presses_no_deeper_than_its_force_over_the_stiffness(mode):
    places = []

    def world(state):
        places.append((state.tip_x_m, state.hand_x_N, state.share))
        return Model(wall=PlaneWall((0.24, 0.0), (-1.0, 0.0), 400.0, 10.0), law=0.2)

    simulate("plane", mode, 4, world=world)
    x, hand_N, share = np.array(places).T
    assert x[share == 1.0].max() < 0.24 + np.abs(hand_N).max() / 400.0 + 2e-3


def test_a_part_of_one_axis_is_refused_with_the_reason():
    with pytest.raises(ModelRefused, match="an arm in the plane: expected parts in the plane"):
        simulate("plane", "hybrid", 8, world=lambda state: Wall(0.0, 1.0))
    with pytest.raises(ModelRefused, match="of single axes: expected parts of one axis"):
        simulate("bench", "hybrid", 3, world=lambda state: WALL)


@pytest.mark.parametrize(
    ("mode", "low", "high"), [("active", 0.1, 0.8), pytest.param("hybrid", 0.0, 0.6, marks=pytest.mark.thorough)]
)
def test_a_wall_that_is_too_stiff_for_the_motors_gets_softer_until_the_tip_does_not_swing(mode, low, high):
    seen = []

    def world(state):
        seen.append(state)
        return Model(wall=PlaneWall((0.25, 0.0), (-1.0, 0.0), K_N_m=20_000.0), law=0.0)

    assert simulate("plane", mode, 6, world=world).trip is None
    assert low <= max(state.softened for state in seen) <= high
    x_m = np.array([state.tip_x_m for state in seen])
    assert x_m.max() < 0.254
    if mode == "active":  # in hybrid the brakes stick and slip while the hand leaves
        assert turns(x_m[x_m > 0.25][-250:], 3e-4) <= 2  # the last half second of contact


def turns(values, band):
    """Return how often values turn back by more than a band."""
    count, extreme, rises = 0, values[0], True
    for value in values:
        if (value > extreme) == rises:
            extreme = value
        elif abs(value - extreme) > band:
            count, extreme, rises = count + 1, value, not rises
    return count


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("mode", "model", "least"),
    [
        (
            "active",
            Model(law=0.0, field=PlaneField((0.0, 0.0), Ns_m=((-300.0, 0.0), (0.0, -300.0)))),
            40,
        ),  # it swings, and gets softer
        ("hybrid", Model(law=0.0, wall=PlaneWall((0.0, 0.0), (-1.0, 0.0), 300.0, 1000.0)), 100),
    ],
)
def test_a_limit_that_acts_on_a_model_is_counted_and_is_none_of_the_law(mode, model, least):
    counts = []

    def world(state):
        counts.append(state.clipped)
        return model

    assert simulate("plane", mode, 3, world=world, measured=False).trip is None
    assert np.isin(np.diff(counts), (0, 1)).all()
    assert least < counts[-1] < len(counts)
