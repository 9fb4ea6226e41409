"""What coil and fluid are believed to do: the level that the brake bears, and the lead for its lags."""

from __future__ import annotations

import math

import numpy as np
import pytest

from coulombus.host.cycle.brake_model import brake_level, expect, lead
from coulombus.host.cycle.records import Phase
from host_bench import HostBench

FELT = ('law.level="felt"', "law.velocity_window_cycles=32", "brake.coil_lag_s=0.003", "brake.fluid_lag_s=0.015")


def test_the_brake_bears_what_friction_and_motor_leave():
    bench = HostBench("hybrid", *FELT)
    c, h = bench.c, bench.h
    h.slide_counts = 0.0
    assert brake_level(c, h, 1.0, 0.0) == pytest.approx(0.86)
    h.slide_counts = -1e-3 / abs(c.rad_count)  # 1 rad/s
    assert brake_level(c, h, 1.0, 0.1358) == pytest.approx(1.0 - 0.14 - 0.005 + 0.1358)
    assert brake_level(c, h, 0.1, 0.0) == 0.0


def course(lags, level):
    """Return the plant's torque, cycle by cycle, of a brake whose set-point leads by these lags."""
    bench = HostBench("hybrid", *(f"brake.{name}={value}" for name, value in lags.items()))
    c, h, coil, fluid, found = bench.c, bench.h, 0.0, 0.0, []
    for _ in range(100):
        h.brake_Nm = lead(c, h, level)
        assert 0.0 <= h.brake_Nm <= c.brake_limit_Nm
        for _ in range(100):
            coil += (h.brake_Nm - coil) * (1 - math.exp(-1e-5 / 0.003))
            fluid += (coil - fluid) * (1 - math.exp(-1e-5 / 0.015))
        expect(c, h)
        found.append(fluid)
    return np.array(found)


def test_the_lead_brings_the_brake_to_its_level_sooner():
    slow = course({}, 2.0)
    fast = course({"coil_lag_s": 0.003, "fluid_lag_s": 0.015}, 2.0)
    arrived = [int(np.argmax(np.abs(one - 2.0) < 0.1)) for one in (slow, fast)]
    assert arrived[1] < 0.5 * arrived[0]
    assert fast.max() < 1.05 * 2.0
    assert fast[-1] == pytest.approx(2.0, rel=5e-3)


def test_the_set_point_that_is_sent_leads():
    bench = HostBench("passive", *FELT).enter(Phase.RUN)
    bench.c.gain_step, bench.k.law[0].F_s = 1.0, 1.0
    bench.cycles(2)
    assert bench.h.brake_Nm > 1.5  # a level of 1 Nm less the device's own friction


def test_a_lead_that_believes_in_wrong_lags_ends_at_the_level_all_the_same():
    assert course({"coil_lag_s": 0.006, "fluid_lag_s": 0.03}, 2.0)[-1] == pytest.approx(2.0, rel=0.01)
