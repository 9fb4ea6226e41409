"""The operator's schedule as torque over time."""

from __future__ import annotations

import math

import numpy as np
import pytest

from eds.rig import load_rig
from sim_bus.operator import Operator, paper_force_N


def at(operator, *times):
    return operator.schedule_Nm(np.array(times, float))


def test_bench_schedule_rests_holds_and_strokes():
    operator = Operator(load_rig("bench"), "active")
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
    active, hybrid = (Operator(load_rig("bench"), mode) for mode in ("active", "hybrid"))
    assert at(hybrid, 1.5)[0] / at(active, 1.5)[0] == pytest.approx(3.5 / 1.2)


def test_tremor_goes_on_before_and_after():
    operator = Operator(load_rig("bench"), "active")
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
    operator = Operator(load_rig("paper"), "active")
    start = operator.starts_s[[phase.kind for phase in load_rig("paper").phases].index("paper")]
    assert at(operator, start + t)[0] == pytest.approx(expected)


def test_a_csv_file_is_a_schedule(tmp_path):
    (tmp_path / "push.csv").write_text("t_s,torque_Nm\n0,0\n1,2\n2,0\n")
    source = (load_rig("bench").text).split("[[phase]]")[0]
    rig_file = tmp_path / "mine.toml"
    rig_file.write_text(source + '[[phase]]\nkind = "file"\nduration_s = 2.0\npath = "push.csv"\n')
    operator = Operator(load_rig(str(rig_file)), "active")
    assert list(at(operator, 0.5, 1.0, 1.75)) == pytest.approx([1.0, 2.0, 0.5])
