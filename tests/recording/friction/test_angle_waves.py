"""Torques over the angle: each kind is found as what it is, and none where there is none."""

from __future__ import annotations

import math

import numpy as np
import pytest

from coulombus.recording.friction.angle_waves import ALL_KINDS, find_waves, wave_columns
from coulombus.recording.friction.equations import equations
from coulombus.recording.friction.friction_fit import fit_friction
from coulombus.recording.friction.sliding import Slide, Sliding

T, RATIO, COUNT = 1e-3, 9.587, 5e-5
TRUTH = {"c": 0.08, "b": 0.01, "J": 3e-3}


def swept(waves, seed=1, turn_rad=1.4, hand_Nm=0.02, noise=5e-4):
    """Return slides to and fro at three speeds, the motor's torque from the truth; `waves`: kind -> function of x."""
    rng = np.random.default_rng(seed)
    slides, t0 = [], 0.0
    for k in range(18):
        sense, speed = 1 - 2 * (k % 2), (0.4, 1.0, 2.0)[k % 3]
        t = np.arange(0.0, turn_rad / speed, T)
        v = sense * speed * (1 + 0.3 * np.sin(9 * t + k))
        x = -sense * turn_rad / 2 + np.cumsum(v) * T
        a = np.gradient(v, T)
        hand = hand_Nm * np.sin(3 * t + k)
        friction = TRUTH["c"] + waves.get("uneven", np.zeros_like)(x)
        torque = TRUTH["J"] * a + TRUTH["b"] * v + friction * np.sign(v) + waves.get("cogging", np.zeros_like)(x) - hand
        motor = torque / (1 + waves.get("ripple", np.zeros_like)(x))
        noisy = hand + noise * rng.standard_normal(len(t))
        slides.append(Slide(t0 + t, np.rint(x / COUNT) * COUNT, noisy, motor))
        t0 += t[-1] + 1.0
    return Sliding(tuple(slides), T, COUNT, True, {}, ())


WAVES = {
    "cogging": lambda x: 0.006 * np.sin(12 * RATIO * x + 0.4),
    "ripple": lambda x: 0.04 * np.sin(6 * RATIO * x - 1.0),
    "uneven": lambda x: 0.012 * np.sin(3 * x + 2.0),
}


@pytest.mark.thorough
@pytest.mark.parametrize("kinds", [(), ("cogging",), ("ripple",), ("uneven",), ("uneven", "cogging", "ripple")])
@pytest.mark.parametrize("seed", [0, *(pytest.param(seed, marks=pytest.mark.long) for seed in (1, 2))])
def test_what_is_there_is_found_and_nothing_else(kinds, seed):
    slides = swept({kind: WAVES[kind] for kind in kinds}, seed)
    found = find_waves(slides, RATIO, ALL_KINDS)
    assert [wave.kind for wave in found] == list(kinds)
    periods = {wave.kind: wave.periods for wave in found}
    assert periods.get("cogging", 12) == 12
    assert periods.get("ripple", 6) == 6


@pytest.mark.thorough
def test_with_all_waves_in_the_fit_its_figures_are_right():
    slides = swept(WAVES)
    rows = equations(slides.slides, T, COUNT, 0.031)
    columns = wave_columns(find_waves(slides, RATIO, ALL_KINDS), rows, slides.slides)
    fit = fit_friction(rows, rows.hand_Nm + rows.motor_Nm, None, columns)
    assert fit.viscous_Nms_rad.value == pytest.approx(TRUTH["b"], rel=0.02)
    assert fit.inertia_kg_m2.value == pytest.approx(TRUTH["J"], rel=0.01)
    cogging = math.hypot(*(fit.others[f"cogging {name}"].value for name in ("sine", "cosine")))
    assert cogging == pytest.approx(0.006, rel=0.02)
    without = fit_friction(rows, rows.hand_Nm + rows.motor_Nm, None, {})
    assert abs(without.inertia_kg_m2.value / TRUTH["J"] - 1) > 0.05


def test_the_ratio_need_not_be_exact():
    (wave,) = find_waves(swept({"cogging": WAVES["cogging"]}), 1.002 * RATIO, ["cogging"])
    assert wave.wave_rad == pytest.approx(12 * RATIO, rel=2e-4)


def test_one_direction_tells_no_wave():
    slides = swept(WAVES)
    forth = Sliding(slides.slides[::2], T, COUNT, True, {}, ())
    assert find_waves(forth, RATIO, ALL_KINDS) == ()
