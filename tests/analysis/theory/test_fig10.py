"""Fig. 10: exact recursion and events against scipy's solve_ivp, and against time stepping as the
step shrinks.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from coulombus.analysis.theory.fig10 import active_run, figure_10, passive_run
from coulombus.analysis.theory.operators import Operator, ParameterError
from coulombus.analysis.theory.parameters import Parameters
from coulombus.analysis.theory.stick_slip import PAPER_FORCE, HarmonicForce
from coulombus.sim_bus.rig.operator import paper_force_N

PAPER = Parameters()
M, B, K, C = 1.387, 29.83, 178.0, 10.0


def f_h(t):
    return 40 * np.sin(np.pi**2 / 4 * t) + np.sin(np.pi / 8 * t) + 2 * (1 - np.cos(np.pi / 2 * t))


def reference_stick_slip(seconds):
    """Stick and slip by scipy: DOP853 with an event for slip, Brent's method for the breakaway."""
    t, x, v, sense, stuck, intervals, pieces = 0.0, 0.0, 0.0, 0.0, True, [], []
    while t < seconds:
        if stuck:
            grid = np.arange(t + 1e-9, seconds, 1e-4)
            over = np.flatnonzero(np.abs(f_h(grid) - K * x) > C)
            if not len(over):
                intervals.append((t, seconds))
                break
            end = brentq(lambda q, x=x: abs(f_h(q) - K * x) - C, grid[over[0] - 1], grid[over[0]], xtol=1e-14)
            intervals.append((t, end))
            t, v, stuck, sense = end, 0.0, False, np.sign(f_h(end) - K * x)
            continue
        begin = t

        def stop(q, y, sense=sense, begin=begin):
            return sense * y[1] if q > begin + 1e-5 else 1.0

        stop.terminal, stop.direction = True, -1
        found = solve_ivp(
            lambda q, y, sense=sense: [y[1], (f_h(q) - B * y[1] - K * y[0] - sense * C) / M],
            (t, seconds),
            [x, v],
            events=stop,
            rtol=1e-11,
            atol=1e-13,
            method="DOP853",
            max_step=0.01,
            dense_output=True,
        )
        pieces.append((t, found.t[-1], found.sol))
        t, (x, v) = found.t[-1], found.y[:, -1]
        if found.status == 0:
            break
        load = f_h(t) - K * x
        stuck, v = abs(load) <= C, 0.0
        sense = 0.0 if stuck else np.sign(load)
    return intervals, pieces


def test_force_is_the_papers():
    t = np.linspace(0, 10, 1001)
    assert pytest.approx(f_h(t)) == PAPER_FORCE(t)
    assert pytest.approx(f_h(t)) == paper_force_N(t)


@pytest.mark.thorough
def test_passive_events_against_solve_ivp():
    run = passive_run(PAPER)
    intervals, pieces = reference_stick_slip(10.0)
    assert len(run.stick_intervals_s) == len(intervals) == 9
    # wanted: 1e-4 s; achieved: 1e-13 s
    assert np.array(run.stick_intervals_s) == pytest.approx(np.array(intervals), abs=1e-9)
    for begin, end, course in pieces:
        inside = (run.t_s > begin) & (run.t_s < end)
        x, v = course(run.t_s[inside])
        assert run.x_m[inside] == pytest.approx(x, abs=1e-10)
        assert run.v_m_s[inside] == pytest.approx(v, abs=1e-9)


@pytest.mark.thorough
def test_passive_friction_is_in_its_set():
    run = passive_run(PAPER)
    stuck = np.zeros(len(run.t_s), bool)
    for begin, end in run.stick_intervals_s:
        stuck |= (run.t_s >= begin) & (run.t_s < end)
    assert np.all(run.v_m_s[stuck] == 0.0)
    assert run.force_N[stuck] == pytest.approx(f_h(run.t_s[stuck]) - K * run.x_m[stuck], abs=1e-9)
    assert np.all(np.abs(run.force_N) <= C * (1 + 1e-12))
    assert run.force_N[~stuck] == pytest.approx(C * np.sign(run.v_m_s[~stuck]))


def test_time_stepping_converges_to_the_events():
    """Moreau's time stepping (implicit, set-valued) at 2 ms, 1 ms, 0.5 ms: the error at 3 s falls
    with the step.
    """
    exact = passive_run(PAPER)
    at = 3000
    errors = []
    for h in (2e-3, 1e-3, 5e-4):
        x = v = 0.0
        for k in range(round(3.0 / h)):
            free = (M * v + h * (f_h((k + 1) * h) - K * x)) / (M + h * B + h * h * K)
            reach = h * C / (M + h * B + h * h * K)
            v = free - np.clip(free, -reach, reach)
            x += h * v
        errors.append(abs(x - exact.x_m[at]))
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.2)
    assert errors[1] / errors[2] == pytest.approx(2.0, rel=0.2)
    assert errors[2] < 1e-3


@pytest.mark.parametrize("delay_s", [0.0, 0.4e-3, 1e-3])
def test_active_recursion_against_solve_ivp(delay_s):
    """The recursion's samples against scipy's integration of the same held forces, over 0.3 s with
    chatter.
    """
    parameters = replace(PAPER, delay_s=delay_s, window_s=0.3)
    run = active_run(parameters)
    T, y, before = 1e-3, np.array([0.0, 0.0]), 0.0
    queue, worst = [0.0] * 3, 0.0
    whole, late = int(delay_s / T + 1e-9), delay_s % T if delay_s < T else 0.0
    for k in range(300):
        worst = max(worst, abs(y[0] - run.x_m[k]), 1e-3 * abs(y[1] - run.v_m_s[k]))
        estimate = (run.x_m[k] - before) / T  # of the run: a sign that hangs on rounding must not count
        before = run.x_m[k]
        queue = [C * np.sign(estimate), *queue[:-1]]
        for begin, end, psi in ((0.0, late, queue[whole + 1]), (late, T, queue[whole])):
            if end > begin:
                y = solve_ivp(
                    lambda t, y, psi=psi: [y[1], (f_h(t) - B * y[1] - K * y[0] - psi) / M],
                    (k * T + begin, k * T + end),
                    y,
                    rtol=1e-12,
                    atol=1e-15,
                    method="DOP853",
                ).y[:, -1]
    assert worst < 1e-12  # achieved: 1e-15 m
    assert sum(np.diff(np.sign(run.force_N[run.force_N != 0])) != 0) > 10


def test_active_chatters_and_passive_does_not():
    runs = figure_10(PAPER)
    assert runs.active.stick_intervals_s == ()
    assert len(runs.active.t_s) == 10_000
    assert runs.active.t_s[-1] == pytest.approx(9.999)
    assert runs.active.force_N[0] == 0.0  # sgn(0) = 0
    assert runs.active.force_flips_per_s > 50
    assert runs.passive.force_flips_per_s < 1
    assert runs.active.velocity_rms_above_100Hz_m_s > 50 * runs.passive.velocity_rms_above_100Hz_m_s
    assert runs.passive.chatter_Hz is None
    assert 100 < runs.active.chatter_Hz < 300


def test_an_operator_with_memory_sticks_as_well():
    """A Maxwell hand relaxes while the handle is held: the stick phase is no constant load.

    Against Moreau's stepping at 20 us.
    """
    k, tau = 400.0, 0.05  # spring and damper in series: k / (s + 1/tau)
    hand = Operator((1.287, 29.33 + 1.287 / tau, 29.33 / tau + k), (1.0, 1 / tau))
    run = passive_run(replace(PAPER, operator=hand, window_s=1.5))
    h, x, v, z, sticks, was = 2e-5, 0.0, 0.0, 0.0, [], False
    for i in range(75_000):
        free = (M * v + h * (f_h((i + 1) * h) - z)) / (M + h * B)
        v = free - np.clip(free, -h * C / (M + h * B), h * C / (M + h * B))
        x += h * v
        z = (z + h * k * v) / (1 + h / tau)
        if (v == 0.0) != was:
            sticks.append((i + 1) * h)
        was = v == 0.0
    events = [t for pair in run.stick_intervals_s for t in pair]
    assert len(events) - (events[-1] == 1.5) == len(sticks)
    assert events[1 : len(sticks)] == pytest.approx(sticks[1:], abs=1e-3)
    assert run.x_m[-1] == pytest.approx(x, abs=2e-4)


def test_an_encoder_is_rounded():
    coarse = active_run(replace(PAPER, resolution_m=1e-4, window_s=0.5))
    fine = active_run(replace(PAPER, resolution_m=1e-12, window_s=0.5))
    ideal = active_run(replace(PAPER, window_s=0.5))
    assert np.count_nonzero(coarse.force_N == 0.0) > 10  # counts stand still: sgn(0) = 0
    assert fine.x_m == pytest.approx(ideal.x_m, abs=1e-4)


def test_force_must_be_finite():
    with pytest.raises(ParameterError, match="finite"):
        HarmonicForce(((1.0, float("nan"), 1.0),))
