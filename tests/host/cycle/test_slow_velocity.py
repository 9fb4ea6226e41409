"""The velocity of slow motion: the adaptive window over creeping, starting and lost positions."""

from __future__ import annotations

import numpy as np
import pytest

from coulombus.host.cycle.slow_velocity import slide_velocity
from host_bench import HostBench


def slide(positions, window=32):
    """Return the estimate in each cycle of a course of positions [counts]."""
    bench = HostBench("hybrid", f"law.velocity_window_cycles={window}")
    c, h, found, before = bench.c, bench.h, [], 0
    for counts in positions:
        h.fresh, h.v_counts, h.counts = 1, counts - before, counts
        slide_velocity(c, h)
        found.append(float(h.slide_counts))
        before = counts
    return np.array(found)


@pytest.mark.parametrize("v", [0.1, 0.25, 0.9, 7.3, -0.25])
def test_a_slow_slide_is_estimated_to_a_count_in_the_window(v):
    k = np.arange(200)
    assert np.abs(slide(np.floor(v * k).astype(int).tolist())[40:] - v).max() <= 1 / 16


def test_a_count_that_flickers_is_no_motion():
    assert np.abs(slide([k % 2 for k in range(100)])[40:]).max() <= 1 / 16  # 2 counts in 32 cycles


def test_a_start_and_a_stop_are_seen_within_some_cycles():
    start = slide([0] * 50 + [5 * k for k in range(1, 30)])
    assert start[51] == 5.0
    stop = slide([5 * k for k in range(50)] + [245] * 40)
    assert stop[52] == 0.0


def test_a_window_of_one_cycle_is_the_backward_difference():
    positions = [0, 3, 3, 10, 4]
    assert slide(positions, window=1).tolist() == np.diff([0, *positions]).tolist()


def test_a_gap_begins_the_window_anew():
    bench = HostBench("hybrid", "law.velocity_window_cycles=32")
    h = bench.h
    for counts in range(10):
        h.fresh, h.v_counts, h.counts = 1, 1, counts
        slide_velocity(bench.c, h)
    h.fresh = 0
    slide_velocity(bench.c, h)
    assert h.track_length == 0
    assert h.slide_counts == h.v_counts
