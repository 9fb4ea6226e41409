"""The compiled loop against an independent integration, and the maps: same numbers however they are
computed.
"""

from __future__ import annotations

import json
import math
import sys
from dataclasses import asdict, replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from coulombus.analysis.rig.maps import LoopParameters, at, oscillation_map, simulate_point
from coulombus.analysis.theory.bounds import (
    abbott_okamura_stiffness,
    bounds,
    colgate_stiffness,
    diolaiti_speed,
    diolaiti_stiffness,
)
from coulombus.rigs.rig import load_rig

PAPER = LoopParameters(
    inertia_kg_m2=0.1,
    viscous_Nms_rad=0.5,
    coulomb_Nm=0.0,
    operator_inertia_kg_m2=1.287,
    operator_damping_Nms_rad=29.33,
    operator_stiffness_Nm_rad=178.0,
    delay_s=0.0,
    motor_lag_s=0.0,
    motor_limit_Nm=1e6,
    torque_step_Nm=0.0,
    count_rad=1e-7,
    relay=True,
    F_d_Nm=10.0,
    velocity_band_counts=0.0,
    compensation_Nm=0.0,
    tap_rad_s=0.05,
    settle_s=2.0,
    window_s=1.0,
)
SMALL = {
    "operator_inertia_kg_m2": np.geomspace(3e-4, 0.05, 5),
    "operator_damping_Nms_rad": np.geomspace(0.02, 10.0, 6),
    "rate_Hz": [500.0, 1000.0],
    "delay_s": [0.0, 0.4e-3, 1e-3],
    "friction_level": [0.3, 1.0],
}


def reference(p: LoopParameters, seconds: float) -> np.ndarray:
    """Return x, v at the samples: scipy's integrator with events, one smooth piece after the
    other.
    """
    m = p.inertia_kg_m2 + p.operator_inertia_kg_m2
    b = p.viscous_Nms_rad + p.operator_damping_Nms_rad
    k, F, lag, T = p.operator_stiffness_Nm_rad, p.coulomb_Nm, p.motor_lag_s, 1 / p.rate_Hz
    x, v, u = 0.0, p.tap_rad_s, 0.0
    whole = math.floor(p.delay_s / T)
    early = p.delay_s - whole * T
    sent: list[float] = []
    counts, rows = 0, []

    def piece(x, v, u, target, span):
        while span > 1e-15:
            if v == 0.0 and F > 0:
                load = u - k * x
                if abs(load) <= F:
                    end = target + (u - target) * math.exp(-span / lag)
                    if abs(end - k * x) <= F:
                        return x, 0.0, end
                    level = math.copysign(F, end - k * x) + k * x
                    t = lag * math.log((u - target) / (level - target))
                    u, span, sign = level, span - t, math.copysign(1.0, end - k * x)
                else:
                    sign = math.copysign(1.0, load)
            else:
                sign = math.copysign(1.0, v)

            def slope(t, y, sign=sign):
                return y[1], (y[2] - b * y[1] - k * y[0] - sign * F) / m, (target - y[2]) / lag

            def stops(t, y):
                return y[1]

            stops.terminal, stops.direction = F > 0, -sign
            lead = 0.0
            if v == 0.0:  # leave the event's zero by a step that is nothing
                lead = min(1e-9, span)
                x, v, u = np.array([x, v, u]) + lead * np.array(slope(0, (x, v, u)))
            made = solve_ivp(slope, (0, span - lead), (x, v, u), "DOP853", events=stops, rtol=1e-12, atol=1e-14)
            x, v, u = made.y[:, -1]
            span -= lead + made.t[-1]
            if made.status == 1:
                v = 0.0
        return x, v, u

    for sample in range(round(seconds * p.rate_Hz)):
        rows.append((x, v))
        before, counts = counts, math.floor(x / p.count_rad + 0.5)
        sent.append(-p.F_d_Nm * p.friction_level * (counts > before) + p.F_d_Nm * p.friction_level * (counts < before))
        for age, span in ((whole + 1, early), (whole, T - early)):
            target = sent[sample - age] if sample >= age else 0.0
            x, v, u = piece(x, v, u, target, span)
    return np.array(rows)


@pytest.mark.parametrize("delay", [0.0, 0.4e-3, 1e-3])
def test_the_compiled_loop_is_the_integrators_solution(delay, record_property):
    """Inherent friction, motor lag, fractional delay, a coarse encoder: stick, slip and break-away
    included.
    """
    p = replace(LoopParameters(), relay=True, velocity_band_counts=0.0, compensation_Nm=0.0, torque_step_Nm=0.0)
    p = replace(p, delay_s=delay, tap_rad_s=1.0, settle_s=0.05, window_s=0.05)
    expected = reference(p, 0.1)
    error = np.max(np.abs(simulate_point(p).trace[:, :2] - expected), axis=0)
    record_property("largest error of angle [rad], speed [rad/s]", error.tolist())
    assert np.any(expected[:, 1] < 0)  # it has turned back
    assert error[0] < 2e-9
    assert error[1] < 2e-7


@pytest.mark.parametrize(("cycles", "samples"), [(0, 4), (1, 8), (2, 12)])
def test_the_papers_loop_has_its_exact_orbits(cycles, samples):
    found = simulate_point(replace(PAPER, delay_s=cycles * 1e-3))
    assert not found.quiet
    assert found.frequency_Hz == pytest.approx(1000 / samples, rel=1e-9)


def test_the_rigs_loop_has_the_frequency_of_the_rig_on_its_bus():
    """The hold on the bench rig peaks at 74 Hz; the loop without a bus is as fast."""
    found = simulate_point(LoopParameters.of_axis(load_rig("bench").one_axis()))
    assert not found.quiet
    assert 65 <= found.frequency_Hz <= 85


def test_of_axis_is_what_the_defaults_say():
    of_axis, default = asdict(LoopParameters.of_axis(load_rig("bench").one_axis())), asdict(LoopParameters())
    assert of_axis == pytest.approx(default, rel=1e-12)


def test_without_a_tap_it_stays_stuck_and_a_stale_swing_is_quiet():
    assert simulate_point(replace(LoopParameters(), tap_rad_s=0.0)).quiet
    assert simulate_point(replace(LoopParameters(), F_s_Nm=0.0, F_d_Nm=0.0, compensation_Nm=0.0)).quiet


def test_workers_and_order_change_nothing():
    one, two = (oscillation_map(SMALL, workers=n) for n in (1, 2))
    assert one.share.shape == (5, 6, 2, 3, 2)
    assert 0 < np.mean(one.oscillates) < 1
    for name in ("share", "velocity_rms_rad_s", "frequency_Hz"):
        assert getattr(one, name).tobytes() == getattr(two, name).tobytes()
    assert one.simulated_s == pytest.approx(5 * 6 * 2 * 3 * 2 * 2 * 2.25)
    assert np.array_equal(np.isnan(one.frequency_Hz), ~one.oscillates)
    json.dumps(one.as_dict(), allow_nan=False)
    point = simulate_point(
        replace(
            one.base,
            operator_inertia_kg_m2=float(SMALL["operator_inertia_kg_m2"][1]),
            operator_damping_Nms_rad=float(SMALL["operator_damping_Nms_rad"][2]),
            rate_Hz=1000.0,
            delay_s=0.4e-3,
            friction_level=1.0,
            tap_rad_s=3.0,
        )
    )
    other = simulate_point(replace(one.base, tap_rad_s=1.0))
    assert other.trace[0, 1] == 1.0
    assert one.velocity_rms_rad_s[1, 2, 1, 1, 1] >= point.velocity_rms_rad_s


def test_a_slice_keeps_its_axes_and_tells_the_rest():
    found = at(oscillation_map(SMALL), rate_Hz=900.0, delay_s=1e-3, friction_level=1.0)
    assert list(found.axes) == ["operator_inertia_kg_m2", "operator_damping_Nms_rad"]
    assert (found.base.rate_Hz, found.base.delay_s) == (1000.0, 1e-3)
    assert found.oscillates[0, 0]  # a light hand
    assert not found.oscillates[:, -1].any()  # F_d / b is less than the stick band: nothing can leave it


def test_progress_reaches_the_end():
    seen: list[float] = []
    oscillation_map({"friction_level": np.linspace(0.1, 1, 100)}, progress=seen.append)
    assert seen[-1] == 1.0
    assert seen == sorted(seen)


@pytest.mark.parametrize(
    ("axes", "text"),
    [
        ({"operator_inertia": [1.0]}, r"no axis 'operator_inertia'; there is .*operator_inertia_kg_m2"),
        ({"rate_Hz": []}, "one or more values"),
        ({"inertia_kg_m2": [-1.0]}, "inertia_kg_m2 = .*-1.0.*above 0"),
        ({"rate_Hz": [math.nan]}, "rate_Hz = .*nan.*finite"),
        ({"delay_s": [0.2]}, "200 cycles; expected at most 60"),
        ({"delay_s": [0.9], "rate_Hz": [50.0]}, "longer than the window"),
    ],
)
def test_what_cannot_be_is_refused_by_name(axes, text):
    with pytest.raises(ValueError, match=text):
        oscillation_map(axes)


def test_a_cluster_without_dask_is_told(monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(ImportError, match=r"'\.\[cluster\]'"):
        oscillation_map({"friction_level": [1.0]}, dask="tcp://127.0.0.1:1")


@pytest.mark.thorough
def test_a_dask_cluster_computes_the_same_bits():
    distributed = pytest.importorskip("distributed", reason="dask.distributed is not installed (extra [cluster])")
    here = oscillation_map(SMALL)
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, silence_logs=False
    ) as cluster:
        there = oscillation_map(SMALL, dask=cluster.scheduler_address)
    for name in ("share", "velocity_rms_rad_s", "frequency_Hz"):
        assert getattr(here, name).tobytes() == getattr(there, name).tobytes()


def test_bounds_are_the_sources_formulas():
    assert colgate_stiffness(0.1, 1e-3) == pytest.approx(200.0)
    assert colgate_stiffness(0.1, 1e-3, virtual_damping=-0.04) == pytest.approx(120.0)
    assert colgate_stiffness(0.1, 1e-3, virtual_damping=0.2) == 0.0
    assert abbott_okamura_stiffness(0.1, 0.004, 1e-3, 8e-5) == pytest.approx(100.0)  # quantisation binds
    assert abbott_okamura_stiffness(0.1, 0.14, 1e-3, 8e-5) == pytest.approx(200.0)  # sampling binds
    assert diolaiti_stiffness(0.1, 0.14, 1e-3, 1e-3, 8e-5) == pytest.approx(0.1 / 1.5e-3)
    # at v* what the spring gives and what the device burns are equal
    K, b, c, T, tau, count = 100.0, 0.1, 0.14, 1e-3, 1e-3, 8e-5
    v = diolaiti_speed(K, b, c, T, tau, count)
    assert K * (T / 2 + tau) * v**2 + K * count / 2 * v == pytest.approx(b * v**2 + c * v)
    assert diolaiti_speed(10.0, b, c, T, tau, count) == math.inf
    assert diolaiti_speed(1e5, b, c, T, tau, count) == 0.0


def test_bounds_certify_or_do_not():
    assert bounds(50.0, 0.1, 0.14, 1e-3).certified == {"colgate": True, "abbott_okamura": True, "diolaiti": True}
    late = bounds(100.0, 0.1, 0.14, 1e-3, delay_s=1e-3)
    assert late.certified == {"colgate": True, "abbott_okamura": True, "diolaiti": False}
    assert LoopParameters().bounds().certified == {"colgate": False, "abbott_okamura": False, "diolaiti": False}
    with pytest.raises(ValueError, match="viscous = -1"):
        colgate_stiffness(-1, 1e-3)
    with pytest.raises(ValueError, match="period_s = 0"):
        colgate_stiffness(1.0, 0)
