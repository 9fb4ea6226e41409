import numpy as np

from coulombus.scope.tracks import BIN_NS, ENVELOPE_BINS, Envelope, Samples, velocity

MS = 1_000_000


def test_an_envelope_holds_least_and_most_of_each_bin():
    envelope = Envelope()
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
    envelope = Envelope()
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
    envelope = Envelope()
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
