"""The operator's schedule as torque over time."""

from __future__ import annotations

import math

import numpy as np
import pytest

from coulombus.rigs.rig import RigError, load_rig, load_rig_text
from coulombus.sim_bus.network.event_loop import Exit
from coulombus.sim_bus.rig.operator import LET_GO_S, Operator, paper_force_N
from coulombus.sim_bus.server.rig_server import PacedRig


def at(operator, *times):
    return operator.schedule_Nm(np.array(times, float))


def test_bench_schedule_rests_holds_and_strokes():
    operator = Operator(load_rig("bench").one_axis(), "active")
    assert list(operator.starts_s) == [0.0, 1.0, 5.0, 13.0]
    assert list(at(operator, -0.5, 0.5, 13.5, 100.0)) == [0.0] * 4
    # 0.6 F_s sin(2 pi 0.5 t), and the tap of 0.6 Nm at 0.6 s for 10 ms
    push = 0.6 * 1.2 * math.sin(2 * math.pi * 0.5 * 0.605)
    assert at(operator, 1.605)[0] == pytest.approx(push + 0.6)
    assert at(operator, 1.615)[0] == pytest.approx(0.6 * 1.2 * math.sin(2 * math.pi * 0.5 * 0.615))
    # the stroke: K_o theta_d + B_o theta_d'
    assert at(operator, 5.25)[0] == pytest.approx(5.0 * 0.5 + 0.1 * 2.0)
    assert at(operator, 6.5)[0] == pytest.approx(5.0 * 2.0)
    assert at(operator, 7.5)[0] == pytest.approx(5.0 * 1.0 - 0.1 * 2.0)
    assert at(operator, 8.5)[0] == pytest.approx(0.0, abs=1e-12)


def test_push_is_a_share_of_the_modes_f_s():
    active, hybrid = (Operator(load_rig("bench").one_axis(), mode) for mode in ("active", "hybrid"))
    assert at(hybrid, 1.5)[0] / at(active, 1.5)[0] == pytest.approx(3.5 / 1.2)


def test_tremor_goes_on_before_and_after():
    operator = Operator(load_rig("bench").one_axis(), "active")
    t = np.linspace(0, 1, 1001)
    tremor = operator.torque_Nm(t, None)
    assert np.max(np.abs(tremor)) == pytest.approx(0.02, rel=1e-3)
    assert np.count_nonzero(np.diff(np.sign(tremor[1:-1])) != 0) == 17  # 9 Hz
    started = operator.torque_Nm(np.array([1.5]), 0.0)
    assert started[0] == pytest.approx(at(operator, 1.5)[0] + operator.tremor_Nm(np.array([1.5]))[0])


def test_papers_force():
    t = 0.7
    expected = 40 * math.sin(math.pi**2 / 4 * t) + math.sin(math.pi / 8 * t) + 2 * (1 - math.cos(math.pi / 2 * t))
    assert paper_force_N(np.array([t]))[0] == pytest.approx(expected)
    operator = Operator(load_rig("paper").one_axis(), "active")
    start = operator.starts_s[[phase.kind for phase in load_rig("paper").one_axis().phases].index("paper")]
    assert at(operator, start + t)[0] == pytest.approx(expected)


def test_a_csv_file_is_a_schedule(tmp_path):
    (tmp_path / "push.csv").write_text("t_s,torque_Nm\n0,0\n1,2\n2,0\n")
    source = (load_rig("bench").text).split("[[phase]]")[0]
    rig_file = tmp_path / "mine.toml"
    rig_file.write_text(source + '[[phase]]\nkind = "file"\nduration_s = 2.0\npath = "push.csv"\n')
    operator = Operator(load_rig(str(rig_file)).one_axis(), "active")
    assert list(at(operator, 0.5, 1.0, 1.75)) == pytest.approx([1.0, 2.0, 0.5])


def test_a_schedule_that_is_left_fades_without_a_jump():
    """The hand's stiffness flung the freed handle back to 0: its torque had dropped from 10 Nm to
    nothing at once.
    """
    operator = Operator(load_rig("bench").one_axis(), "active")
    t = np.linspace(6.5, 6.5 + 2 * LET_GO_S, 4001)
    found = operator.torque_Nm(t, 0.0, 6.5) - operator.tremor_Nm(t)
    assert found[0] == pytest.approx(at(operator, 6.5)[0]) == pytest.approx(10.0)
    assert np.all(np.diff(found) <= 0)
    assert np.max(-np.diff(found)) < 10.0 * np.pi / 2 / LET_GO_S * 0.0021
    assert np.all(found[2001:] == 0)


def test_the_simulated_hand_lets_go_when_the_drive_is_disabled():
    world = PacedRig(load_rig("bench"), "hybrid", 0, 0)
    world.run_until(10_000_000)
    world._axes["operator_start_ns"] = 1
    world.run_until(6_500_000_000)
    before = world.operators[0].torque_Nm(np.array([6.5]), 1e-9)[0]
    world.rest()
    assert int(world._axes["operator_start_ns"][0]) == -1
    after = world._f_h[0]
    assert after[0] == pytest.approx(before)
    assert np.max(np.abs(np.diff(after))) < 0.02
    world._axes["operator_start_ns"] = world.t_ns  # enabled again: the schedule begins anew
    world.answer(Exit.ENABLED)
    assert np.max(np.abs(world._f_h[0][:900])) <= 0.021


MOTION = '[[phase]]\nkind = "motion"\npath = "hand.csv"\n'


def with_motion(folder, rows):
    """Return a rig file with a recorded hand's motion as its only phase, and another rest."""
    (folder / "hand.csv").write_text(rows)
    file = folder / "mine.toml"
    rest = '[[phase]]\nkind = "rest"\nduration_s = 1.0\n'
    file.write_text(load_rig("bench").text.split("[[phase]]")[0] + MOTION + rest)
    return str(file)


def test_a_recorded_motion_is_followed_by_the_hands_impedance(tmp_path):
    operator = Operator(load_rig(with_motion(tmp_path, "t_s,x_rad\n0,0\n1,0.5\n2,0.2\n")).one_axis(), "active")
    assert list(operator.starts_s) == [0.0, 2.0, 3.0]
    expected = [5.0 * 0.25 + 0.1 * 0.5, 5.0 * 0.35 - 0.1 * 0.3, 5.0 * 0.2]
    assert list(at(operator, 0.5, 1.5, 2.5)) == pytest.approx(expected)


@pytest.mark.parametrize(
    ("rows", "line", "said"),
    [
        ("t_s,torque_Nm\n0,0\n1,1\n", 1, "expected the header t_s,x_rad"),
        ("t_s,x_rad\n0,0\n1,nan\n", 3, "expected two finite numbers, t_s,x_rad"),
        ("t_s,x_rad\n1,0\n0.5,1\n", 3, "times that grow"),
        ("t_s,x_rad\n1,0\n", 2, "at least two"),
    ],
)
def test_a_recorded_motion_that_is_wrong_is_refused_with_its_line(tmp_path, rows, line, said):
    with pytest.raises(RigError, match=f"hand.csv:{line}: .*{said}"):
        load_rig(with_motion(tmp_path, rows))


def test_a_recorded_motion_travels_with_the_rig(tmp_path):
    rig = load_rig(with_motion(tmp_path, "t_s,x_rad\n0,0\n1,0.5\n2,0.2\n"))
    (tmp_path / "hand.csv").unlink()
    again = load_rig_text(rig.effective(), "elsewhere.toml", rig.eds_texts)
    assert again.one_axis().phases == rig.one_axis().phases
