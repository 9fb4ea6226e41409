import hashlib
import math

import numpy as np
import pytest
from scipy.signal import lfilter

from coulombus.host.world.model_check import ModelRefused
from coulombus.host.world.model_parts import LinearField, Model, Spring, Wall
from coulombus.host.world.recorded import ROW
from coulombus.host.world.state import RUN
from coulombus.lab.replay import host_replay as replay_module
from coulombus.lab.replay.host_replay import ReplayError, host_replay
from coulombus.lab.simulate import simulate
from coulombus.recording.reading import read
from coulombus.recording.trace import unpack_models
from coulombus.rigs.arguments import WrongCall
from coulombus.rigs.rig import load_rig

PUSHES = ("mode.hybrid.motor_limit_Nm=1.5",)


def wall_and_less_friction(state):
    """A wall that moves outwards, with less friction, for the first second and a half."""
    if state.t_s > 2.5:
        return None
    place = 0.05 * math.sin(5.0 * state.t_s)
    return Model(wall=Wall(place, 2.0, 0.05), law=0.5, parameters={"F_s_Nm": 2.0, "F_d_Nm": 1.0})


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    path = tmp_path_factory.mktemp("world") / "a.pcapng"
    result = simulate("bench", "hybrid", 3, world=wall_and_less_friction, record=path, seed=3)
    assert result.trip is None
    return path


def test_the_same_world_gives_the_same_bytes(recorded, tmp_path):
    again = tmp_path / "b.pcapng"
    simulate("bench", "hybrid", 3, world=wall_and_less_friction, record=again, seed=3)
    digests = {hashlib.sha256(path.read_bytes()).hexdigest() for path in (recorded, again)}
    assert len(digests) == 1


def test_the_recording_shows_the_models_part_and_its_fade(recorded):
    recording = read(recorded)
    names = "host.world_share", "host.world_model", "host.law_share", "host.world_brake_Nm"
    share, model, law_share, brake_Nm = (recording[name].values for name in names)
    assert (share[0], model[0], law_share[0]) == (0.0, 0, 1.0)
    assert share.max() == 1.0
    assert share[-1] == 0.0
    falling = share[(share > 0.0) & (share < 1.0)]
    assert np.allclose(np.diff(falling), -0.005, atol=2e-4)  # 1 ms of 0.2 s
    assert np.allclose(law_share, 1.0 - 0.5 * share, atol=2e-4)
    assert brake_Nm.max() > 0.05
    assert np.all(np.diff(model) >= 0)


@pytest.mark.thorough
def test_a_replay_renders_the_world_again_bit_for_bit(recorded):
    result = host_replay(recorded)
    assert (result.difference, result.judged, result.unchecked) == (None, True, 0)
    assert result.frames["brake.RPDO1"] == result.cycles > 3000


def test_a_replay_notices_another_model(recorded, monkeypatch):
    def tampered(attachments):
        rows = np.frombuffer(bytearray(unpack_models(attachments)), ROW).copy()
        rows["model"]["law"][1000:] = 0.4
        return rows.tobytes()

    monkeypatch.setattr(replay_module, "unpack_models", tampered)
    assert host_replay(recorded).difference is not None


def test_a_replay_without_the_models_tells_what_is_missing(recorded, monkeypatch):
    monkeypatch.setattr(replay_module, "unpack_models", lambda attachments: b"")
    with pytest.raises(ReplayError, match=r"host\.models"):
        host_replay(recorded)


@pytest.mark.thorough
@pytest.mark.parametrize("mode", ["active", "hybrid"])
def test_a_spring_that_stands_does_no_net_work_and_one_that_moves_trips(mode):
    def still(state):
        return Model(spring=Spring(0.0, 5.0, 0.02), law=0.0)

    def driven(state):
        return Model(spring=Spring(0.5 * math.sin(2.0 * math.pi * state.t_s), 5.0), law=0.0)

    assert simulate("bench", mode, 4, world=still, overrides=PUSHES).trip is None
    trip = simulate("bench", mode, 6, world=driven, overrides=PUSHES).trip
    assert trip is not None
    assert trip.startswith("NET_WORK")


@pytest.mark.thorough
def test_a_wall_that_damps_and_is_too_stiff_for_the_motor_does_no_net_work():
    wall = Model(wall=Wall(0.2, 2.0, 0.1), law=0.0)
    assert simulate("bench", "active", 9, world=lambda state: wall).trip is None


STEADY_PUSH = (
    'phase = [{kind = "rest", duration_s = 0.2}, {kind = "hold", duration_s = 9.0, push_F_s = 0.6, '
    "frequency_Hz = 0.05, taps_s = [0.6, 1.1], tap_Nm = 0.6, tap_s = 0.01}]"
)
"""A hand that leans on what it meets, and taps twice."""


@pytest.mark.parametrize(
    ("mode", "K_Nm_rad", "B_Nms_rad", "hand", "softened"),
    [
        pytest.param("active", 60.0, 0.0, (), 0.0, marks=pytest.mark.thorough),
        pytest.param("active", 150.0, 0.1, (), 0.0, marks=pytest.mark.thorough),
        pytest.param("active", 400.0, 0.2, (), 0.2, marks=pytest.mark.thorough),
        pytest.param("active", 3000.0, 0.0, (), 0.6, marks=pytest.mark.thorough),
        pytest.param(
            *("active", 600.0, 0.0, ("operator.damping_Nms_rad = 0.01", "operator.inertia_kg_m2 = 1e-4"), 0.8),
            marks=pytest.mark.thorough,
        ),
        pytest.param("active", 200.0, 0.0, ("plant.motor_lag_s = 5e-3",), 0.7, marks=pytest.mark.thorough),
        ("hybrid", 3000.0, 0.0, (), 0.0),
        pytest.param("passive", 3000.0, 0.0, (), 0.0, marks=pytest.mark.thorough),
    ],
)
def test_a_stiff_wall_does_not_shake_a_hand_that_leans_on_it(mode, K_Nm_rad, B_Nms_rad, hand, softened):
    seen = []

    def world(state):
        seen.append(state)
        return Model(wall=Wall(0.02, K_Nm_rad, B_Nms_rad), law=0.0)

    result = simulate("bench", mode, 3, world=world, overrides=(STEADY_PUSH, *hand))
    assert result.trip is None
    x_rad = np.array([state.x_rad for state in seen])
    # a command acts a cycle later, and behind the drive's lag
    acting_Nm = lfilter([1 - math.exp(-1)], [1, -math.exp(-1)], [0.0, *(state.motor_Nm for state in seen[:-2])])
    assert np.sqrt(np.mean(((x_rad[-1000:] - x_rad[-1010:-10]) / 0.01) ** 2)) < 0.05
    assert acting_Nm[-2000:] @ np.diff(x_rad)[-2000:] < 0.02
    assert seen[-1].softened == pytest.approx(softened, abs=0.1)


def test_a_torque_that_drives_the_handle_trips():
    trip = simulate("bench", "active", 6, world=lambda state: Model(field=LinearField(1.0), law=0.0)).trip
    assert trip is not None
    assert trip.startswith("NET_WORK")


def test_the_function_sees_the_display_alone_each_nth_cycle_and_no_cycle_twice():
    seen = []
    simulate("bench", "passive", 0.5, world=seen.append, world_every=5)
    assert {state.phase for state in seen} == {RUN}
    numbers = [state.sequence for state in seen]
    assert numbers == list(range(numbers[0], numbers[-1] + 1, 5))
    assert len(numbers) > 50


def test_a_model_takes_effect_in_the_next_cycle():
    seen = []

    def world(state):
        seen.append(state)
        return Wall(-1.0, 2.0)

    simulate("bench", "active", 1, world=world)
    assert [state.model for state in seen] == list(range(len(seen)))
    assert (seen[0].world_Nm, seen[0].share, seen[1].share) == (0.0, 0.0, 1.0)
    assert seen[-1].world_Nm < 0.0


def test_each_axis_has_its_model():
    seen = {0: [], 1: []}

    def world(state):
        seen[state.axis].append(state)
        return Wall(-1.0, 1.0) if state.axis else None

    simulate("two_axes", "active", 0.5, world=world)
    assert {state.share for state in seen[0]} == {0.0}
    assert {state.share for state in seen[1]} == {0.0, 1.0}


@pytest.mark.thorough
def test_a_free_handle_has_no_friction_without_a_model():
    free = ('world.rest="free"',)
    result = simulate("bench", "passive", 3, world=lambda state: None, overrides=free)
    assert result.trip is None
    seen = []
    simulate("bench", "passive", 3, world=seen.append, overrides=free)
    assert max(state.brake_Nm for state in seen) == 0.0
    assert max(abs(state.law_Nm) for state in seen) > 0.5


def test_a_value_out_of_the_laws_bounds_ends_the_run_with_the_reason():
    with pytest.raises(ModelRefused, match=r"F_s_Nm=9: expected from 0 to 4\.5 Nm"):
        simulate("bench", "passive", 1, world=lambda state: Model(parameters={"F_s_Nm": 9.0}))
    with pytest.raises(ModelRefused, match="F_d_Nm=2 with F_s_Nm=1"):
        simulate("bench", "passive", 1, world=lambda state: Model(parameters={"F_s_Nm": 1.0, "F_d_Nm": 2.0}))
    with pytest.raises(WrongCall, match="compensation"):
        simulate("bench", "hybrid", 1, world=lambda state: Model(parameters={"compensation": 0.5}))
    with pytest.raises(ModelRefused, match="longest_life_s"):
        simulate("bench", "passive", 1, world=lambda state: Model(life_s=2.0))


@pytest.mark.parametrize(
    "wrong", [{"world": 7}, {"world": print, "world_every": 0}, {"world": print, "world_every": 1.5}]
)
def test_a_world_that_is_no_function_is_refused(wrong):
    with pytest.raises(WrongCall):
        simulate("bench", "passive", 1, **wrong)


def test_a_rig_on_several_buses_is_refused():
    rig = load_rig("two_axes", ('axis.right.bus.channel="b"', 'axis.left.bus.channel="a"'))
    with pytest.raises(WrongCall, match="buses"):
        simulate(rig, "passive", 1, world=lambda state: None)
