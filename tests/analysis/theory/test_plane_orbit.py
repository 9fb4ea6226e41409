"""The limit cycle of a tip under Coulomb friction by motors: against closed forms and the exact loop."""

from __future__ import annotations

import math

import numpy as np
import pytest

from coulombus.analysis.theory.plane_orbit import TipLoop, predicted_orbit, response, settled_orbit

T = 1e-3
LOOPS = (
    TipLoop(T, 3.0),
    TipLoop(T, 3.0, window_cycles=3),
    TipLoop(T, 3.0, window_cycles=3, turn_cycles=12, turn_gain=0.25, lag_s=1e-3),
)


def test_a_free_mass_turns_in_eight_samples():
    orbit = predicted_orbit(TipLoop(T, 3.0), (1.0, 1.0))
    assert orbit.frequency_Hz == pytest.approx(1 / (8 * T))
    # v = a e^(j k pi/4), |v_{k+1} - v_k| = c T / m
    assert orbit.velocity_m_s == pytest.approx([3.0 * T / (2 * math.sin(math.pi / 8))] * 2)


@pytest.mark.parametrize("loop", LOOPS)
def test_with_equal_masses_the_prediction_is_exact(loop):
    predicted, settled = predicted_orbit(loop, (0.7, 0.7)), settled_orbit(loop, (0.7, 0.7))
    assert settled.frequency_Hz == pytest.approx(predicted.frequency_Hz, abs=0.5 / (4096 * T))
    assert settled.velocity_m_s == pytest.approx(predicted.velocity_m_s, rel=2e-3)


@pytest.mark.parametrize("loop", LOOPS)
@pytest.mark.parametrize("ratio", [1.2, 1.8])
def test_with_other_masses_it_is_an_ellipse(loop, ratio):
    predicted, settled = predicted_orbit(loop, (0.5, 0.5 * ratio)), settled_orbit(loop, (0.5, 0.5 * ratio))
    assert settled.frequency_Hz == pytest.approx(predicted.frequency_Hz, rel=0.02)
    assert settled.velocity_m_s[0] == pytest.approx(predicted.velocity_m_s[0], rel=0.05)
    assert settled.velocity_m_s[1] == pytest.approx(predicted.velocity_m_s[1], rel=0.15)


def test_very_unequal_masses_move_on_a_line():
    settled = settled_orbit(LOOPS[0], (0.45, 1.56))
    assert settled.velocity_m_s[1] < 1e-9 < 0.01 < settled.velocity_m_s[0]


def test_the_response_is_that_of_the_samples():
    loop, f = LOOPS[2], 40.0
    t = np.arange(6000)
    command = np.cos(2 * math.pi * f * T * t)
    x = v = force = 0.0
    path = []
    for u in np.concatenate(([0.0], command[:-1])):  # a cycle later
        path.append(x)
        for _ in range(100):  # of a unit mass, in small steps
            h, before = T / 100, force
            force += (u - force) * (1 - math.exp(-h / loop.lag_s))
            x, v = x + h * v + h * h * before / 2, v + h * (before + force) / 2
    path = np.array(path)
    mean = (path[12 + 3 :] - path[12:-3]) / (3 * T)
    earlier = (path[3:-12] - path[: -12 - 3]) / (3 * T)
    estimate = mean + loop.turn_gain * (mean - earlier)
    rows = t[15:]
    basis = np.stack(
        [np.cos(2 * math.pi * f * T * rows), np.sin(2 * math.pi * f * T * rows), np.ones(len(rows))], axis=1
    )
    real, imaginary, _ = np.linalg.lstsq(basis[1000:], estimate[1000:], rcond=None)[0]
    assert complex(real, -imaginary) == pytest.approx(response(loop, f), rel=0.01)
