"""Long recordings are compared piece by piece, with the result of whole ones."""

from __future__ import annotations

import numpy as np
import pytest

from coulombus.kernels.records import new_records
from coulombus.recording import reading
from coulombus.recording.comparison import CommonSpan, Tally, compare, pieces
from coulombus.recording.difference import Pair
from coulombus.recording.recorder import Recorder
from coulombus.rigs.rig import load_rig
from coulombus.wire.frame import Frame

pytestmark = pytest.mark.slow  # in plain Python each packet takes some microseconds

MS = 1_000_000


def recorded(path, seed, *, shift=0, cycles=3000, without=(500, 900), phases=(0.4, 1.5, 2.2)):
    """Record the PDOs of the bench rig: noisy values, one PDO with a pause, and one with few samples."""
    rig, chance = load_rig("bench"), np.random.default_rng(seed)
    layouts = [pdo.layout for pdo in rig.pdos()]
    count = len(layouts)
    frames = new_records(Frame, count * cycles)
    which = np.tile(np.arange(count), cycles)
    frames["t_ns"] = MS * (1 + shift) + np.repeat(np.arange(cycles), count) * MS + which * 50_000
    frames["can_id"] = np.array([layout.cob_id for layout in layouts])[which]
    frames["length"] = np.array([layout.length for layout in layouts])[which]
    frames["word"] = chance.integers(0, 1 << 30, count * cycles)
    frames["word"] &= np.array([(1 << 8 * n) - 1 for n in range(8)] + [-1])[frames["length"]]
    cycle = np.repeat(np.arange(cycles), count)
    kept = ~((which == 1) & (cycle > without[0]) & (cycle < without[1])) & ~((which == 2) & (cycle % 701 != 3))
    with Recorder(path, rig, "hybrid", 1) as recorder:
        for number, at_s in enumerate(phases):
            recorder.mark(round(at_s * 1e9) + shift * MS, f"phase {number}")
        recorder.write(frames[kept])
    return path


@pytest.fixture
def small(monkeypatch):
    monkeypatch.setattr("coulombus.recording.pcapng_reader.CHUNK", 20_000)
    monkeypatch.setattr("coulombus.recording.comparison.PIECE_NS", 130 * MS)


def as_values(comparison):
    values = comparison.as_dict()
    rms = [signal.pop("rms") for signal in values["signals"]]
    return values, rms


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("other", "tolerances"),
    [
        ({"seed": 1}, {"": 0.5}),
        ({"seed": 2, "shift": 70}, {}),
        ({"seed": 3, "cycles": 2500, "without": (1700, 2100)}, {"motor.position_rad": 1e9}),
        ({"seed": 4, "phases": (0.4, 1.2, 2.5)}, {"": 0.5}),
        ({"seed": 5, "phases": ()}, {}),
        ({"seed": 6, "without": (-1, 5000)}, {"motor.position_rad": 1e9}),
    ],
)
def test_pieces_give_the_result_of_the_whole(tmp_path, small, monkeypatch, tolerances, other):
    a, b = recorded(tmp_path / "a.pcapng", 1), recorded(tmp_path / "b.pcapng", **other)
    whole = compare(a, b, tolerances=tolerances)
    for kept in (0, a.stat().st_size - 1 if a.stat().st_size > b.stat().st_size else 0):
        monkeypatch.setattr(reading, "KEPT_BYTES", kept)
        pieced = compare(a, b, tolerances=tolerances)
        values, rms = as_values(pieced)
        expected, expected_rms = as_values(whole)
        assert values == expected
        assert rms == expected_rms  # few enough that their squares are summed at once
        for name, pair in whole.pairs.items():
            assert all(
                np.array_equal(x, y, equal_nan=True)
                for x, y in zip(vars_of(pair), vars_of(pieced.pairs[name]), strict=True)
            )
    assert whole.same_bytes == (other == {"seed": 1})
    assert sum(signal.samples > 100 for signal in whole.signals) >= 3


def vars_of(pair):
    return pair.t_s, pair.a, pair.b


def test_many_squares_are_summed_part_by_part(monkeypatch):
    monkeypatch.setattr("coulombus.recording.comparison.SUMMED", 100)
    tally, values = Tally(), np.random.default_rng(2).normal(size=1000)
    for part in np.array_split(values, 30):
        tally.add(Pair(part, part, np.zeros(len(part))), len(part), "hold")
        assert sum(map(len, tally._squares)) <= 200
    tally.end()
    assert tally.rms == pytest.approx(np.sqrt(np.mean(values**2)), rel=1e-14)
    assert (tally.samples, tally.largest, tally.phase, tally.whole) == (1000, np.abs(values).max(), "hold", True)


def test_a_span_in_which_the_second_has_no_sample_does_not_count():
    tally, pair = Tally(), Pair(np.arange(3.0), np.arange(3.0), np.full(3, np.nan))
    tally.add(pair, 0, "rest")
    tally.add(pair, 0, "rest")
    tally.end()
    assert (tally.samples, tally.whole) == (0, False)
    tally.add(pair, 0, "hold")
    tally.add(Pair(np.arange(2.0), np.ones(2), np.zeros(2)), 2, "hold")  # the pieces before count, too
    tally.end()
    assert (tally.samples, tally.largest, tally.phase) == (5, np.inf, "hold")


def test_the_pieces_of_a_span_are_the_span(monkeypatch):
    monkeypatch.setattr("coulombus.recording.comparison.PIECE_NS", 400 * MS)
    span = CommonSpan("hold", (1.0, 2.0), -0.5, 1.25)
    parts = list(pieces(span, is_long=True))
    assert [begin for begin, _ in parts] == [-0.5e9, -0.1e9, 0.3e9, 0.7e9, 1.1e9]
    assert [end for _, end in parts[:-1]] == [begin for begin, _ in parts[1:]]
    assert parts[-1][1] == 1.25e9
    assert list(pieces(span, is_long=False)) == [(-0.5e9, 1.25e9)]
