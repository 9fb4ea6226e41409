"""The most that a motor alone displays quietly: against dimensions, eigenvalues, and the rig through PDOs."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from coulombus.analysis.rig import chatter as module
from coulombus.analysis.rig.chatter import device
from coulombus.analysis.rig.maps import LoopParameters
from coulombus.analysis.theory.z_width import Handle, stable_predicted
from coulombus.cli.main import main
from coulombus.lab.simulate import simulate
from coulombus.rigs.rig import load_rig

KNOB = device(5e-6, 1000.0, 16384, 1e-3, damping_Nms_rad=2e-5, friction_Nm=1e-3)


@pytest.fixture(autouse=True)
def quickly(monkeypatch):
    monkeypatch.setattr(module, "RATES", np.array([1.0, 2.0]))
    monkeypatch.setattr(module, "REMEDIES", module.REMEDIES[-1:])


def friction(loop):
    return module._friction(loop)[0]


def wall(loop):
    return module._wall(loop)[0]


@pytest.mark.thorough
def test_all_torques_scale_alike():
    heavier = device(5e-5, 1000.0, 16384, 1e-3, damping_Nms_rad=2e-4, friction_Nm=1e-2)
    assert friction(heavier) == pytest.approx(10 * friction(KNOB), rel=0.02)
    assert wall(heavier) == pytest.approx(10 * wall(KNOB), rel=0.02)


@pytest.mark.thorough
def test_time_scales():
    """In half the time, a device of a quarter of the inertia and half the damping is the same."""
    quicker = device(1.25e-6, 2000.0, 16384, 0.5e-3, damping_Nms_rad=1e-5, friction_Nm=1e-3)
    quicker = replace(quicker, settle_s=KNOB.settle_s / 2, window_s=KNOB.window_s / 2)
    assert friction(quicker) == pytest.approx(friction(KNOB), rel=0.02)


@pytest.mark.thorough
def test_without_own_friction_the_level_is_as_coarse_as_the_encoder():
    smooth = replace(KNOB, coulomb_Nm=0.0)
    finer = replace(smooth, count_rad=smooth.count_rad / 4, tap_rad_s=smooth.tap_rad_s / 4)
    assert 0.0 < friction(finer) == pytest.approx(friction(smooth) / 4, rel=0.02)


@pytest.mark.thorough
def test_less_than_the_own_friction_moves_nothing():
    assert friction(KNOB) >= 0.99 * KNOB.coulomb_Nm


@pytest.mark.parametrize(("cycles", "damping"), [(0, 2e-5), (1, 2e-5), (2, 1e-4)])
def test_the_wall_is_that_of_the_exact_eigenvalues(cycles, damping):
    loop = device(5e-6, 1000.0, 1e9, cycles * 1e-3, damping_Nms_rad=damping)
    handle = Handle(5e-6, damping, 1e-3, cycles)
    low, high = 1e-6, 100.0
    while high > 1.001 * low:
        middle = math.sqrt(low * high)
        low, high = (middle, high) if stable_predicted(handle, middle, 0.0, "active") else (low, middle)
    assert wall(loop) == pytest.approx(low, rel=2e-3)


@pytest.mark.parametrize("name", ["delay_s", "motor_lag_s"])
def test_the_wall_falls_steadily_with_the_delay_and_the_lag(name):
    walls = [wall(replace(KNOB, **{name: late_s})) for late_s in (1e-3, 1.4e-3, 1.999e-3, 2e-3, 2.001e-3)]
    assert walls == sorted(walls, reverse=True)
    assert walls[2] == pytest.approx(walls[4], rel=5e-3)


BENCH = device(
    2.5e-3,
    1000.0,
    4 * 2048 * 9.587,
    1e-3,
    damping_Nms_rad=0.005,
    friction_Nm=0.14,
    lag_s=1e-3,
    limit_Nm=1.5,
    hand=(5e-4, 0.1, 5.0),
)
"""The bench rig with its hand."""


def chattering(tmp_path, friction_Nm):
    """The share of six taps of the rig's hand that start a limit cycle, through PDOs."""
    law = ("law.function=coulomb", f"mode.active.F_d_Nm={friction_Nm}", f"mode.active.F_s_Nm={friction_Nm}")
    plain = ("mode.active.compensation=0", "law.velocity_band_counts=0")
    count = 0
    for tap_Nm in np.geomspace(0.4, 1.0, 6):
        tap = f"taps_s=[0.6],tap_Nm={tap_Nm},tap_s=0.01"
        phases = (
            f'phase=[{{kind="rest",duration_s=1.2}},{{kind="hold",duration_s=9.0,push_F_s=0.0,frequency_Hz=0.1,{tap}}}]'
        )
        simulate("bench", "active", 5.0, truth=tmp_path / "t.npz", overrides=(*law, *plain, phases), force=True)
        with np.load(tmp_path / "t.npz") as truth:
            late = (truth["t_s"] > 4.0) & (truth["t_s"] < 5.2)
            count += np.ptp(truth["angle_rad"][late]) > 2.5 * BENCH.count_rad
    return count / 6


def test_the_rig_is_that_device():
    assert replace(LoopParameters.of_axis(load_rig("bench").one_axis()), tap_rad_s=BENCH.tap_rad_s) == replace(
        BENCH,
        torque_step_Nm=pytest.approx(0.18e-3 * 9.587),
        compensation_Nm=pytest.approx(0.97 * 0.14),
        velocity_band_counts=2.0,
        settle_s=1.5,
        window_s=0.75,
        count_rad=pytest.approx(BENCH.count_rad),
        motor_limit_Nm=pytest.approx(1.5),
    )


@pytest.mark.thorough
@pytest.mark.slow
def test_the_rig_is_quiet_below_the_level_and_chatters_above_it(tmp_path):
    level = friction(BENCH)
    assert chattering(tmp_path, 0.95 * level) == 0.0
    assert chattering(tmp_path, 1.1 * level) > 0.5


@pytest.mark.thorough
def test_the_verb_tells_and_draws(tmp_path, monkeypatch):
    monkeypatch.setattr(module, "TAPS", 8)
    words = "analyse chatter --inertia 5e-6 --rate 1000 --counts 16384 --delay 1e-3 --damping 2e-5 --friction 1e-3"
    done = CliRunner().invoke(main, [*words.split(), "--brake", "0.05", "--json", "--figures", str(tmp_path)])
    assert done.exit_code == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["friction_max_Nm"] == pytest.approx(friction(KNOB))
    assert told["with_brake_friction_max_Nm"] == pytest.approx(0.05 + told["friction_max_Nm"])
    assert told["remedies"]["twice the own friction"]["friction_max_Nm"] > told["friction_max_Nm"]
    assert (tmp_path / "chatter.png").read_bytes().startswith(b"\x89PNG")
    text = CliRunner().invoke(main, words.split()).stdout
    assert f"{told['friction_max_Nm']:.4g} Nm" in text


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ("--inertia 0", "inertia_kg_m2"),
        ("--counts 0", "counts"),
        ("--rate -1", "rate_Hz"),
        ("--delay 1", "delay_s"),
        ("--brake nan", "brake_Nm"),
    ],
)
def test_a_wrong_number_is_refused_with_its_name(given, told):
    words = "analyse chatter --inertia 5e-6 --rate 1000 --counts 16384 --damping 2e-5"
    done = CliRunner().invoke(main, [*words.split(), *given.split()])
    assert done.exit_code == 2
    assert told in done.stderr
