"""The worlds of examples/worlds, in virtual time."""

import runpy
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from coulombus import Model, Spring, Wall
from coulombus.host.world.records import MODEL, STATE
from places import ROOT

FOLDER = ROOT / "examples/worlds"


def outcome(name):
    return runpy.run_path(str(FOLDER / f"{name}.py"))["in_virtual_time"]()


@pytest.mark.thorough
def test_the_wheel_meets_its_detents_one_after_the_other():
    met, trip = outcome("detent_wheel")
    assert trip is None
    assert max(met) >= 2
    assert set(np.abs(np.diff(met))) == {1}


@pytest.mark.thorough
def test_the_wall_is_met_and_the_brake_resists():
    depth_rad, brake_Nm, trip = outcome("wall_with_friction")
    assert trip is None
    assert depth_rad > 0.0
    assert 1.0 < brake_Nm <= 4.5


@pytest.mark.thorough
def test_the_latch_opens():
    events, trip = outcome("latch")
    assert trip is None
    assert events[0][1] == "open"


@pytest.mark.thorough
def test_a_local_model_is_still_where_a_stream_of_torques_shakes(tmp_path):
    example = runpy.run_path(str(FOLDER / "stability_map.py"))
    maps, tripped = example["in_virtual_time"](rates_Hz=(30, 1000), delays_ms=(0, 20))
    assert (maps["local model"] < example["STILL_RAD_S"]).all()
    assert (maps["torque stream"] < example["STILL_RAD_S"]).tolist() == [[False, False], [True, False]]
    assert not tripped["local model"].any()
    assert tripped["torque stream"].tolist() == [[True, True], [False, True]]
    *_, slow, fast = example["table"](maps, tripped, (30, 1000), (0, 20))
    assert slow == "| 30 | 0.015 / trips | 0.015 / trips |"
    assert fast.endswith(" / trips |")
    example["draw"](maps, tmp_path / "map.png")
    assert (tmp_path / "map.png").read_bytes().startswith(b"\x89PNG")


@pytest.mark.thorough
def test_a_brake_makes_a_wall_many_times_as_stiff_as_a_motor_can():
    felt = runpy.run_path(str(FOLDER / "stiffness.py"))["felt"]
    (active, withheld, _), (hybrid, none, trip) = felt("active", 1000.0), felt("hybrid", 1000.0)
    assert 200.0 < active < hybrid / 5.0
    assert 0.3 < withheld < 0.8
    assert (none, trip) == (0.0, None)


@pytest.mark.thorough
def test_a_motor_alone_displays_no_wall_in_full_that_a_brake_does():
    example = runpy.run_path(str(FOLDER / "z_width.py"))
    assert [example["in_full"](mode, 3000.0, 0.0) for mode in ("active", "hybrid")] == [False, True]
    assert [example["stable"](K, 0.0) for K in (40.0, 45.0)] == [True, False]
    assert example["largest_that_holds"](lambda value: value < 3, (1, 2, 3, 4)) == 2
    assert example["largest_that_holds"](lambda value: False, (1, 2)) == 0.0


def test_the_numbers_of_mujoco_become_a_wall_a_spring_and_friction():
    door = runpy.run_path(str(FOLDER / "door_mujoco.py"))
    model_of, stop, catch = door["model_of"], door["Stop"], door["Catch"]
    free = model_of(0.2, 0.3, 0.01)
    assert (free.wall, free.spring, free.field.Nms_rad) == (None, None, -0.01)
    assert free.parameters == {"F_s_Nm": 0.3, "F_d_Nm": 0.3}
    closed = model_of(-0.02, 0.3, 0.01, stop(-0.002, 0.1, 8.0, 0.1)).wall
    assert (closed.x_rad, closed.K_Nm_rad, closed.B_Nms_rad, closed.side) == (0.0, 8.0, 0.1, "below")
    assert model_of(0.5, 0.3, 0.01, stop(0.01, -0.1, 8.0, 0.1)).wall == Wall(0.6, 8.0, 0.1, "above")
    for slope_m_rad in (-0.1, 0.1, 0.001):
        spring = model_of(0.2, 0.3, 0.01, None, catch(5.0, 500.0, slope_m_rad)).spring
        assert spring.K_Nm_rad == pytest.approx(max(500.0 * slope_m_rad**2, 0.5))
        assert spring.K_Nm_rad * (spring.x_rad - 0.2) == pytest.approx(5.0 * slope_m_rad)


def test_the_door_of_mujoco_holds_opens_and_falls_shut():
    pytest.importorskip("mujoco", reason="mujoco is not installed: pip install -e '.[worlds]'")
    events, trip = outcome("door_mujoco")
    assert trip is None
    assert [event for _, event in events[:2]] == ["open", "closed"]
    door = runpy.run_path(str(FOLDER / "door_mujoco.py"))["Door"]()
    models = [
        door.world(SimpleNamespace(t_s=0.001 * step, x_rad=0.001 * step - 0.05, v_rad_s=1.0)) for step in range(751)
    ]
    at = dict(zip(range(-50, 701), models, strict=True))
    torque_Nm = {x: at[x].spring.K_Nm_rad * (at[x].spring.x_rad - 0.001 * x) for x in (200, 500)}
    assert torque_Nm[200] < -0.3
    assert torque_Nm[500] > 0.3
    assert (at[-40].wall.side, at[-40].wall.x_rad) == ("below", pytest.approx(0.0, abs=0.005))
    assert (at[700].wall, at[700].spring) == (None, None)


class FakeHand:
    """A display whose handle turns by 0.01 rad in each state."""

    def __init__(self):
        self.rendered, self.levels, self.x_rad = [], [], 0.0

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    @property
    def state(self):
        return SimpleNamespace(x_rad=self.x_rad, v_rad_s=10.0, handle_Nm=-0.5)

    def next(self):
        self.x_rad += 0.01
        return self.state

    def render(self, model):
        self.rendered.append(model)

    def set(self, **parameters):
        self.levels.append(parameters)


def test_a_ros_topic_holds_for_its_time_and_no_longer():
    example = runpy.run_path(str(FOLDER / "ros2_node.py"))
    commands = example["Commands"]()
    assert commands.model(0.0) == Model(life_s=0.2)
    assert commands.update("wall", [0.5, 8.0, 0.1], 1.0) is None
    assert commands.update("spring", [0.1, 2.0, 0.0], 1.1) is None
    assert commands.update("friction", [2.0, 1.5], 1.1) is None
    assert commands.update("wall", [0.5, 8.0], 1.15) == "wall: expected 3 numbers, got 2"
    model = commands.model(1.15)
    assert (model.wall, model.spring) == (Wall(0.5, 8.0, 0.1), Spring(0.1, 2.0))
    assert model.parameters == {"F_s_Nm": 2.0, "F_d_Nm": 1.5}
    assert commands.model(1.25).wall is None
    assert commands.model(1.35) == Model(life_s=0.2)


def test_a_ros_node_publishes_states_and_renders_what_its_topics_say(monkeypatch):
    hand, published, topics = FakeHand(), [], {}

    class Node:
        def create_publisher(self, kind, topic, depth):
            assert topic == "handle/joint_states"
            return SimpleNamespace(publish=published.append)

        def create_subscription(self, kind, topic, take, depth):
            topics[topic] = take

        def create_timer(self, period_s, tick):
            self.tick = tick

        def get_clock(self):
            return SimpleNamespace(now=lambda: SimpleNamespace(to_msg=lambda: "now"))

    def spin(node):
        topics["handle/wall"](SimpleNamespace(data=[0.3, 4.0, 0.0]))
        node.tick()

    def message(**fields):
        return SimpleNamespace(header=SimpleNamespace(stamp=None), **fields)

    ros = {
        "rclpy": SimpleNamespace(init=lambda: None, create_node=lambda name: Node(), spin=spin),
        "sensor_msgs.msg": SimpleNamespace(JointState=message),
        "std_msgs.msg": SimpleNamespace(Float64MultiArray=None),
    }
    for name, module in {**ros, "sensor_msgs": None, "std_msgs": None}.items():
        monkeypatch.setitem(sys.modules, name, module or SimpleNamespace())
    monkeypatch.setattr("coulombus.connect", lambda bus: hand)
    runpy.run_path(str(FOLDER / "ros2_node.py"))["main"]()
    assert set(topics) == {"handle/wall", "handle/spring", "handle/friction"}
    assert vars(published[0]) == {
        "header": SimpleNamespace(stamp="now"),
        "name": ["handle"],
        "position": [0.0],
        "velocity": [10.0],
        "effort": [-0.5],
    }
    assert [model.wall for model in hand.rendered] == [Wall(0.3, 4.0)]


def test_the_trials_of_psychopy_display_both_levels_and_judge_the_answer(monkeypatch, capsys):
    hand = FakeHand()
    clock = SimpleNamespace(reset=lambda: setattr(hand, "x_rad", 0.0), getTime=lambda: 10.0 * hand.x_rad)
    psychopy = SimpleNamespace(
        core=SimpleNamespace(Clock=lambda: clock),
        event=SimpleNamespace(waitKeys=lambda keyList: ["1"]),
        visual=SimpleNamespace(
            Window=lambda fullscr: SimpleNamespace(flip=lambda: None),
            TextStim=lambda window: SimpleNamespace(draw=lambda: None, text=""),
        ),
    )
    monkeypatch.setitem(sys.modules, "psychopy", psychopy)
    monkeypatch.setattr("coulombus.connect", lambda bus: hand)
    example = runpy.run_path(str(FOLDER / "psychopy_trials.py"))
    example["main"](trials=4)
    head, *rows = capsys.readouterr().out.splitlines()
    assert head == "trial,first_Nm,second_Nm,answer,right,way_1_rad,way_2_rad"
    levels = [pair for trial in range(4) for pair in example["levels_of"](trial)[0]]
    assert [parameters["F_d_Nm"] for parameters in hand.levels] == levels
    for trial, row in enumerate(rows):
        _, first, second, answer, right, *ways = row.split(",")
        assert (answer, right) == ("1", str(int(float(first) > float(second))))
        assert ways == ["0.300", "0.300"]
        assert [float(first), float(second)] == example["levels_of"](trial)[0]


@pytest.mark.parametrize("dtype", [MODEL, STATE])
def test_the_page_has_each_byte_of_the_record(dtype):
    kinds = {"i8": "i64", "f8": "f64", "f4": "f32"}
    lines = (ROOT / "docs/worlds.md").read_text().splitlines()
    for name in dtype.names:
        field, offset = dtype.fields[name][:2]
        kind = kinds[field.base.str[1:]] + (f" x {field.shape[0]}" if field.shape else "")
        assert any(line.startswith(f"| {offset} | {kind} | `{name}` |") for line in lines), name
