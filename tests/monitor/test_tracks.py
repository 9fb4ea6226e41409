import numpy as np

from coulombus.monitor.tracks import BIN_NS, ENVELOPE_BINS, LiveEnvelope, Samples, velocity

MS = 1_000_000


def test_an_envelope_holds_least_and_most_of_each_bin():
    envelope = LiveEnvelope()
    t = np.arange(1000, 1100) * MS
    values = np.sin(t * 1e-7) - 3.0
    for part in np.array_split(np.arange(100), 7):  # batches end within bins
        envelope.add(t[part], values[part])
    first, low, high = envelope.since(1000 * MS // BIN_NS)
    assert first == 50
    for k in range(5):
        inside = t // BIN_NS == first + k
        assert (low[k], high[k]) == (values[inside].min(), values[inside].max())


def test_a_gap_is_nan_and_old_bins_are_forgotten():
    envelope = LiveEnvelope()
    envelope.add(np.array([0, 1]), np.array([5.0, 6.0]))
    envelope.add(np.array([3 * BIN_NS]), np.array([-1.0]))
    first, low, high = envelope.since(0)
    assert first == 0
    np.testing.assert_array_equal(low, [5, np.nan, np.nan, -1])
    np.testing.assert_array_equal(high, [6, np.nan, np.nan, -1])
    envelope.add(np.array([(ENVELOPE_BINS + 7) * BIN_NS]), np.array([2.0]))
    first, low, _ = envelope.since(0)
    assert (first, len(low)) == (8, ENVELOPE_BINS)
    assert np.flatnonzero(np.isfinite(low)).tolist() == [ENVELOPE_BINS - 1]


def test_late_samples_and_nan_change_no_envelope():
    envelope = LiveEnvelope()
    envelope.add(np.array([5 * BIN_NS]), np.array([1.0]))
    envelope.add(np.array([2 * BIN_NS, 5 * BIN_NS]), np.array([-9.0, np.nan]))
    _, low, high = envelope.since(5)
    assert (low.tolist(), high.tolist()) == ([1.0], [1.0])
    assert np.isnan(envelope.since(2)[1][0])


def test_a_ring_keeps_its_last_samples():
    ring = Samples(10)
    for k in range(0, 25, 3):
        ring.add(np.arange(k, k + 3), np.arange(k, k + 3) * 2.0)
    t, values = ring.last(99)
    assert t.tolist() == list(range(17, 27))
    assert values.tolist() == [2.0 * k for k in t]
    assert ring.since(25)[0].tolist() == [25, 26]
    ring.add(np.arange(100, 130), np.zeros(30))  # more than there is room
    assert ring.last(3)[0].tolist() == [127, 128, 129]


def test_the_velocity_is_the_difference_over_whole_periods():
    t = np.arange(20) * MS + np.tile([0, 90_000], 10)  # stamps that are late by 90 us
    _, v = velocity(t, -0.5 * np.arange(20) * 1e-3, MS, 5)
    np.testing.assert_allclose(v, -0.5)
    assert len(velocity(t[:5], t[:5] * 1.0, MS, 5)[0]) == 0


def test_signals_together_are_as_each_by_itself():
    """Times that rise, stand still, jump ahead and are set back; values that are no numbers."""
    rng = np.random.default_rng(7)
    together, ring = LiveEnvelope(3), Samples(50, 3)
    alone, rings = [LiveEnvelope() for _ in range(3)], [Samples(50) for _ in range(3)]
    now = 0
    for _ in range(300):
        n = int(rng.integers(0, 80))
        t = now + np.cumsum(rng.choice([0, MS, 7 * MS, 30 * MS], n))
        if n and rng.random() < 0.1:
            t[n // 2 :] -= int(rng.integers(0, 200)) * MS
        now = int(t[-1]) + int(rng.choice([0, MS, 400 * MS])) if n else now
        values = np.where(
            rng.random((3, n)) < 0.1, rng.choice([np.nan, np.inf, -np.inf], (3, n)), rng.normal(size=(3, n))
        )
        together.add(t, values)
        ring.add(t, values)
        for k in range(3):
            alone[k].add(t, values[k])
            rings[k].add(t, values[k])
            for a, b in zip(together.since(0, k), alone[k].since(0), strict=True):
                np.testing.assert_array_equal(a, b)
            for a, b in zip(ring.last(60, k), rings[k].last(60), strict=True):
                np.testing.assert_array_equal(a, b)
    assert ring.count == rings[0].count > 5000
    np.testing.assert_array_equal(ring.all_since(0)[1], [single.since(0)[1] for single in rings])


def test_an_envelope_is_that_of_all_samples_whatever_the_batches():
    rng = np.random.default_rng(3)
    envelope, t, values = LiveEnvelope(), np.sort(rng.integers(0, 9 * 10**9, 4000)), rng.normal(size=4000)
    values[::17] = np.nan
    for part in np.array_split(np.arange(4000), 97):
        envelope.add(t[part], values[part])
    first, low, high = envelope.since(0)
    assert first == 0
    for k in range(len(low)):
        inside = values[(t // BIN_NS == k) & np.isfinite(values)]
        assert np.array_equal(
            [low[k], high[k]], [inside.min(), inside.max()] if len(inside) else [np.nan] * 2, equal_nan=True
        )
