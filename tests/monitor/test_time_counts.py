"""Counted times have the quantiles of kept ones, to the last bit."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coulombus.monitor import time_counts as module
from coulombus.monitor.time_counts import TimeCounts
from coulombus.monitor.timing import Stamps, timing
from coulombus.recording.maps.known_bus import KnownBus

PERCENTS = (50, 99, 100)
times_of = st.lists(st.integers(-(10**12), 10**12) | st.integers(999_990, 1_000_010), min_size=1, max_size=200)


def counted(times, parts):
    counts = TimeCounts()
    for part in np.array_split(np.array(times, np.int64), parts):
        counts.add(part)
    return counts


@settings(max_examples=80, derandomize=True, deadline=None)
@given(times=times_of, parts=st.integers(1, 5))
def test_quantiles_are_those_of_numpy(times, parts):
    counts = counted(times, parts)
    assert len(counts) == len(times)
    assert counts.percentiles(PERCENTS) == np.percentile(np.array(times), PERCENTS).tolist()
    assert counts.median() == np.median(times)
    apart = np.abs(np.array(times) - counts.median()).astype(np.int64)
    assert counts.distances(counts.median()).percentiles(PERCENTS) == np.percentile(apart, PERCENTS).tolist()


def test_the_memory_is_that_of_the_different_times(monkeypatch):
    monkeypatch.setattr(module, "WAITING", 1000)
    counts, chance = TimeCounts(), np.random.default_rng(5)
    for _ in range(300):
        counts.add(1_000_000 + chance.integers(-50, 50, 100))
    assert len(counts) == 30_000
    assert len(counts._times) <= 100
    assert counts._size < 1000


@pytest.mark.parametrize("parts", [1, 7, 100])
def test_the_timing_does_not_depend_on_the_stretches(parts):
    chance = np.random.default_rng(6)
    t_ns = np.sort(chance.integers(0, 10**9, 3000))
    can_ids = chance.choice([0x80, 0x181, 0x182, 0x701], 3000)
    stamps = Stamps()
    for rows in np.array_split(np.arange(3000), parts):
        stamps.add_stamps(t_ns[rows], can_ids[rows])
    syncs = t_ns[can_ids == 0x80]
    for row in timing(KnownBus(), stamps):
        own = t_ns[can_ids == row.can_id]
        gaps = np.diff(own)
        assert (row.frames, row.period_ms) == (len(own), np.median(gaps) / 1e6)
        jitter = np.percentile(np.abs(gaps - np.median(gaps)).astype(np.int64), PERCENTS) / 1e3
        assert [row.jitter.p50_us, row.jitter.p99_us, row.jitter.max_us] == jitter.tolist()
        if row.can_id in (0x181, 0x182):
            last = np.searchsorted(syncs, own, "right") - 1
            delays = np.percentile((own - syncs[last])[last >= 0], PERCENTS) / 1e3
            assert [row.from_sync.p50_us, row.from_sync.p99_us, row.from_sync.max_us] == delays.tolist()
