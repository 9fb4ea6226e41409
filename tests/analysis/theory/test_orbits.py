"""Exact orbits and the delay table against brute-force simulation written here."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from coulombus.analysis.theory import relay_loop
from coulombus.analysis.theory.delay import delay_row, sign_changes
from coulombus.analysis.theory.operators import Operator
from coulombus.analysis.theory.orbits import orbits, pattern_of, patterns
from coulombus.analysis.theory.parameters import Parameters

PAPER = Parameters()
M, B, K, C = 1.387, 29.83, 178.0, 10.0


def simulate(T, delay_s, x, v, seconds):
    """The loop by its own matrices: every switching instant of the force gets a step of its own."""
    A = np.array([[0, 1, 0], [-K / M, -B / M, 1 / M], [0, 0, 0]])
    whole = int(delay_s / T + 1e-9)
    late = delay_s - whole * T
    first, rest = expm(A * late)[:2], expm(A * (T - late))[:2]
    y, before, queue = np.array([x, v]), x - v * T, [0.0] * (whole + 2)
    estimates, forces = [], []
    for _ in range(round(seconds / T)):
        estimate = (y[0] - before) / T
        before = y[0]
        queue = [C * np.sign(estimate), *queue[:-1]]
        y = first @ np.append(y, -queue[whole + 1])
        y = rest @ np.append(y, -queue[whole])
        estimates.append(estimate)
        forces.append(queue[whole])
    return np.array(estimates), np.array(forces)


def test_patterns_are_all_primitive_necklaces():
    for period in range(1, 11):
        words = ["".join("+" if s > 0 else "-" for s in row) for row in patterns(period)]
        brute = set()
        for letters in itertools.product("+-", repeat=period):
            word = "".join(letters)
            rotations = {word[i:] + word[:i] for i in range(period)}
            if len(rotations) == period:
                brute.add(min(rotations))
        assert len(words) == len(set(words)) == len(brute)
        assert set(words) == brute


def test_pattern_of_a_sequence():
    assert pattern_of(np.resize([-1, 1, 1, -1], 40)) == "++--"
    assert pattern_of(np.resize([-1, 1, -1], 40)) == "+--"
    assert pattern_of(np.array([1, -1, 1, 1, -1, -1, 1, 1])) is None
    assert pattern_of(np.resize([0, 1], 40)) is None


def test_the_papers_orbits():
    found = {orbit.pattern: orbit for orbit in orbits(PAPER).found}
    assert set(found) == {"++--", "++-", "+--", "+-"}
    assert found["++--"].frequency_Hz == pytest.approx(250.0)
    assert found["++--"].period_samples == 4
    assert all(orbit.stable for orbit in found.values())


@pytest.mark.parametrize("delay_s", [0.0, 0.5e-3, 1e-3, 2e-3])
def test_orbits_repeat_when_simulated(delay_s):
    """Start the brute-force loop on each orbit, by its force's periodic response: it comes back
    after a period.
    """
    parameters = replace(PAPER, delay_s=delay_s)
    T = 1e-3
    whole, late = int(delay_s / T + 1e-9), delay_s % T if delay_s != 2e-3 and delay_s != 1e-3 else 0.0
    A = np.array([[0, 1, 0], [-K / M, -B / M, 1 / M], [0, 0, 0]])
    first, rest = expm(A * late)[:2], expm(A * (T - late))[:2]
    found = orbits(parameters).found
    assert found
    for orbit in found:
        u = np.array([1.0 if s == "+" else -1.0 for s in orbit.pattern])
        p = len(u)
        # periodic state by solving y_p = y_0
        Phi, step = np.eye(2), np.zeros(2)
        for k in range(p):
            for half, force in ((first, u[(k - whole - 1) % p]), (rest, u[(k - whole) % p])):
                Phi, step = half[:, :2] @ Phi, half[:, :2] @ step - half[:, 2] * C * force
        y = np.linalg.solve(np.eye(2) - Phi, step)
        x = []
        for k in range(p):
            x.append(y[0])
            for half, force in ((first, u[(k - whole - 1) % p]), (rest, u[(k - whole) % p])):
                y = half[:, :2] @ y - half[:, 2] * C * force
        x = np.array(x)
        estimate = (x - np.roll(x, 1)) / T
        assert np.min(u * estimate) == pytest.approx(orbit.margin_m_s, rel=1e-6, abs=1e-12)
        assert np.max(np.abs(estimate)) == pytest.approx(orbit.velocity_peak_m_s, rel=1e-9)


def test_random_starts_reach_the_main_orbit():
    found = orbits(PAPER, starts=40, seed=2)
    share = {orbit.pattern: orbit.share for orbit in found.found}
    assert sum(share.values()) + found.elsewhere == pytest.approx(1.0)
    rng = np.random.default_rng(7)
    hits = 0
    for _ in range(5):
        x, v = rng.uniform(-3e-3, 3e-3), rng.uniform(-0.05, 0.05)
        estimate, _ = simulate(1e-3, 0.0, x, v, 6.0)
        hits += pattern_of(np.sign(estimate[-200:])) == "++--"
    assert hits == 5
    assert share["++--"] > 0.9


def test_larger_starts_reach_other_orbits_too(monkeypatch):
    monkeypatch.setattr(relay_loop, "LARGEST_START", (20e-3, 0.5))
    share = {orbit.pattern: orbit.share for orbit in orbits(Parameters(), starts=400, seed=1).found}
    assert share["++--"] == pytest.approx(0.89, abs=0.02)
    assert share["++-"] + share["+--"] == pytest.approx(0.11, abs=0.02)


def test_without_a_spring_the_position_drifts_and_the_orbit_stands():
    """Orbits of the velocity do not need a spring; stability is that of the velocity."""
    free = Parameters(mass_kg=0.5, damping_Ns_m=2.0, operator=Operator.mass_damper_spring(0.0, 1.0, 0.0))
    found = {orbit.pattern: orbit for orbit in orbits(free, starts=10).found}
    assert found["++--"].stable


@pytest.mark.parametrize(("delay_s", "exact"), [(0.0, 250.0), (1e-3, 125.0), (2e-3, 83.3)])
def test_delay_of_whole_cycles(delay_s, exact):
    row = delay_row(replace(PAPER, delay_s=delay_s))
    assert row.simulated_Hz == pytest.approx(exact, rel=0.01)
    assert row.predicted_Hz == pytest.approx(exact, rel=0.03)


@pytest.mark.parametrize(("rate", "delay_s"), [(1000.0, 0.5e-3), (500.0, 0.5e-3)])
def test_delay_row_against_brute_force(rate, delay_s):
    row = delay_row(replace(PAPER, period_s=1 / rate, delay_s=delay_s))
    rng = np.random.default_rng(11)
    frequencies, amplitudes = [], []
    for _ in range(5):
        x, v = rng.uniform(-3e-3, 3e-3), rng.uniform(-0.05, 0.05)
        estimate, force = simulate(1 / rate, delay_s, x, v, 6.0)
        last = round(2 * rate)
        frequencies.append(sign_changes(force[-last:]) / 4)
        amplitudes.append(np.sqrt(2) * np.std(estimate[-last:]))
    assert row.slowest_Hz * 0.99 <= np.median(frequencies) <= row.fastest_Hz * 1.01
    assert row.simulated_amplitude_m_s == pytest.approx(np.median(amplitudes), rel=0.05)


def test_sign_changes_skip_zeros():
    assert sign_changes(np.array([0.0, 1.0, 0.0, 1.0, 0.0, -1.0, -1.0, 1.0])) == 2
