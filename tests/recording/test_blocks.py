"""A recording gone through block by block: the same figures as from the whole, in a memory that
does not grow with it.
"""

from __future__ import annotations

import struct
import tracemalloc

import numpy as np
import pytest
from scipy.signal import welch

import coulombus.recording.pcapng_reader
from coulombus.monitor.decode import rows
from coulombus.recording import measures
from coulombus.recording.friction.identify import IdentifyError, identify
from coulombus.recording.measures import measure, phases
from coulombus.recording.pcapng_reader import iter_pcapng
from coulombus.recording.pcapng_writer import PcapngWriter
from coulombus.recording.reading import blocks, read
from coulombus.recording.signals import series
from coulombus.rigs.rig import load_rig
from coulombus.wire.frame import FRAME

MS = 1_000_000
ENABLED = 0x1637  # statusword of a drive in Operation Enabled
SMALL = 1 << 15
"""Bytes read at a time here: 680 frames, a sixth of a second."""


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch):
    monkeypatch.setattr(coulombus.recording.pcapng_reader, "CHUNK", SMALL)


def long_recording(path, seconds, seed=1, *, driven=True):
    """Write a run of the bench rig: four PDOs a cycle, a hold over most of it and a stroke.

    The signals are noise.

    The drive is enabled; unless it is `driven`, the motor has no torque, as where no sign check is
    done.
    """
    rig = load_rig("bench")
    kinds = [phase.kind for phase in rig.one_axis().phases]
    assert "hold" in kinds
    assert "stroke" in kinds
    begins = {round(k * 1000 * seconds / len(kinds)): f"phase {kind}" for k, kind in enumerate(kinds)}
    noise = np.random.default_rng(seed)
    attachments = {"rig.toml": rig.effective().encode(), **{n: text.encode() for n, text in rig.eds_texts.items()}}
    with PcapngWriter(path, attachments=attachments) as writer:
        for first in range(0, 1000 * seconds, 1000):
            frames = np.zeros((1000, 4), FRAME)
            cycle = np.arange(first, first + 1000)
            frames["t_ns"] = cycle[:, None] * MS + np.arange(4) * 100_000
            frames["can_id"], frames["length"] = (0x181, 0x182, 0x201, 0x202), (8, 6, 4, 2)
            angle = np.rint(4e4 * np.sin(cycle / 150) + noise.normal(0, 3, 1000)).astype(np.int64)
            frames["word"][:, 0] = angle << 16 & 0xFFFFFFFF0000 | ENABLED | noise.integers(0, 50, 1000) << 48
            frames["word"][:, 1] = noise.integers(0, 1 << 15, 1000)
            frames["word"][:, 2] = driven * noise.integers(0, 1 << 16, 1000) << 16
            frames["length"][::100, 0] = 7  # malformed
            comments = {4 * (row - first) + 1: text for row, text in begins.items() if first <= row < first + 1000}
            writer.write(frames.ravel(), comments)
    return path


def whole_figures(recording):
    """Figures from the whole recording at once, as they were computed before there were blocks."""
    spans, period = phases(recording), recording.rig.bus.period_s
    angle, target = recording["motor.position_rad"], recording["motor.target_torque_Nm"]
    handle = recording["brake.handle_torque_Nm"]
    between = np.maximum(np.rint(np.diff(angle.t_s) / period), 1.0)
    t, v = angle.t_s[1:], np.diff(angle.values) / (between * period)
    windows = [(span.begin_s + 0.8, span.end_s - 0.02) for span in spans if span.kind == "hold"]
    dwells = []
    for span in spans:
        if span.kind == "stroke":
            stroke = recording.rig.one_axis().phases[span.index]
            dwell = span.begin_s + stroke.move_s
            while dwell < span.end_s:
                dwells.append((dwell + 0.35, min(dwell + min(0.95, stroke.dwell_s), span.end_s)))
                dwell += stroke.move_s + stroke.dwell_s

    def inside(t, windows):
        return np.any([(t >= begin) & (t < end) for begin, end in windows], axis=0)

    hold = inside(t, windows)
    torque = target.values[inside(target.t_s, windows)]
    frequency, power = welch(v[hold], 1 / period, nperseg=512)
    counts = np.rint(angle.values / abs(recording.scale("motor.position_rad")))
    flips = int(np.count_nonzero(np.diff(np.sign(torque[torque != 0]))))
    return {
        "hold_velocity_rms_rad_s": np.sqrt(np.mean(v[hold] ** 2)),
        "hold_counts_p2p": int(max(np.ptp(counts[inside(angle.t_s, [window])]) for window in windows)),
        "torque_flips_per_s": flips / (hold.sum() * period),
        "stick_velocity_rms_rad_s": np.sqrt(np.mean(v[inside(t, dwells)] ** 2)),
        "hold_peak_Hz": frequency[np.argmax(power)],
        "hold_push_Nm": np.max(np.abs(handle.values[inside(handle.t_s, windows)])),
    }


@pytest.fixture
def recorded(tmp_path):
    return long_recording(tmp_path / "long.pcapng", 8)


@pytest.mark.slow
def test_figures_are_those_of_the_whole(recorded):
    assert len(list(blocks(recorded))) > 40
    figures, expected = vars(measure(blocks(recorded))), whole_figures(read(recorded))
    for name in ("hold_velocity_rms_rad_s", "stick_velocity_rms_rad_s"):  # summed block by block
        assert figures.pop(name) == pytest.approx(expected.pop(name), rel=1e-12)
    assert figures == expected
    assert phases(blocks(recorded)) == phases(read(recorded))
    # in one block even the sums are the same
    assert vars(measure(read(recorded))) == whole_figures(read(recorded))


def test_blocks_shorter_than_the_end_of_a_hold_are_measured_alike(recorded, monkeypatch):
    """A phase's end is known only some blocks later."""
    monkeypatch.setattr(coulombus.recording.pcapng_reader, "CHUNK", 1 << 11)
    durations = [
        block["motor.position_rad"].t_s[-1:] - block["motor.position_rad"].t_s[:1] for block in blocks(recorded)
    ]
    assert np.median(np.concatenate(durations)) < measures.HOLD_TAIL_S
    figures, expected = vars(measure(blocks(recorded))), vars(measure(read(recorded)))
    for name in ("hold_velocity_rms_rad_s", "stick_velocity_rms_rad_s"):
        assert figures.pop(name) == pytest.approx(expected.pop(name), rel=1e-12)
    assert figures == expected


@pytest.mark.slow
def test_identified_friction_is_that_of_the_whole(tmp_path):
    recorded = long_recording(tmp_path / "long.pcapng", 8, driven=False)
    assert identify(recorded).as_dict() == identify(read(recorded)).as_dict()


def test_a_file_of_two_runs_is_measured(recorded):
    """It has more phases than the rig."""
    once = measure(read(recorded))
    recorded.write_bytes(recorded.read_bytes() * 2)
    assert measure(blocks(recorded)).hold_counts_p2p >= once.hold_counts_p2p


def test_joined_captures_whose_stamps_go_back_are_not_fitted(recorded):
    """Samples are sought by their times: in a file that is not sorted by them, any would be
    found.
    """
    whole = recorded.read_bytes()
    recorded.write_bytes(whole + whole)  # a second section, as `cat` joins them
    with pytest.raises(IdentifyError, match=r"long\.pcapng: its stamps go back.*reordercap"):
        identify(recorded)


@pytest.mark.slow
def test_rows_and_remarks_are_those_of_the_whole(recorded):
    recorded.write_bytes(recorded.read_bytes()[:-60])
    assert list(rows(blocks(recorded))) == list(rows(read(recorded)))
    source = blocks(recorded)
    for _ in source:
        pass
    assert source.remarks == read(recorded).remarks
    assert [text.removeprefix(f"{recorded}: ") for text in source.remarks] == [
        "the last block is unfinished: 36 bytes were left out",
        "80 frames of motor.TPDO1 have a wrong length",
    ]


def test_signals_gathered_are_those_of_the_whole(recorded):
    whole = read(recorded)
    for name, signal in zip(whole.signals, series(blocks(recorded), *whole.signals), strict=True):
        assert signal.unit == whole[name].unit
        np.testing.assert_array_equal(signal.t_s, whole[name].t_s)
        np.testing.assert_array_equal(signal.values, whole[name].values)


def test_a_transfer_that_goes_across_blocks_is_decoded(tmp_path, monkeypatch):
    """The segments of an SDO transfer tell their object only by what came before them."""
    frames = np.zeros(40, FRAME)
    frames["can_id"], frames["length"] = 0x581, 8
    frames["word"] = int.from_bytes(struct.pack("<BHBI", 0x41, 0x1008, 0, 273), "little")
    frames["word"][1:] = int.from_bytes(b"\0abcdefg", "little")
    with PcapngWriter(tmp_path / "a.pcapng", attachments={}) as writer:
        writer.write(frames)
    monkeypatch.setattr(coulombus.recording.pcapng_reader, "CHUNK", 256)
    decoded = list(rows(blocks(tmp_path / "a.pcapng", "bench")))
    assert [(row["index"], row["phase"]) for row in decoded[1:]] == [(0x1008, "Upload segment response")] * 39


def test_times_of_a_clock_count_from_the_first_frame_of_all(tmp_path, monkeypatch):
    frames = np.zeros(100, FRAME)
    frames["t_ns"] = 1_700_000_000_000_000_000 + np.arange(100) * MS
    frames["can_id"] = 0x80
    with PcapngWriter(tmp_path / "a.pcapng", attachments={}) as writer:
        writer.write(frames)
    monkeypatch.setattr(coulombus.recording.pcapng_reader, "CHUNK", 300)
    assert [row["t_s"] for row in rows(blocks(tmp_path / "a.pcapng", "bench"))] == [k / 1000 for k in range(100)]


def peak_bytes(work):
    """Return the largest memory that `work` took at a time, over what was there before."""
    work()  # what is imported or cached once
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    work()
    peak = tracemalloc.get_traced_memory()[1] - before
    tracemalloc.stop()
    return peak


def row_by_row(source):
    for _ in rows(source):
        pass


@pytest.mark.thorough
@pytest.mark.slow
@pytest.mark.parametrize(("work", "seconds", "chunk"), [(measure, (3, 9), SMALL), (row_by_row, (1, 2), SMALL // 4)])
def test_the_memory_does_not_grow_with_the_recording(tmp_path, monkeypatch, work, seconds, chunk):
    monkeypatch.setattr(coulombus.recording.pcapng_reader, "CHUNK", chunk)
    sources = [blocks(long_recording(tmp_path / f"{n}.pcapng", n), "bench") for n in seconds]
    short, long = (peak_bytes(lambda source=source: work(source)) for source in sources)
    assert long < 1.1 * short
    # what is kept is one signal's samples, not the frames
    gathered = peak_bytes(lambda: series(sources[1], "motor.position_rad"))
    assert gathered < long + 2.5 * 16 * 1000 * seconds[1]


def test_only_the_beginning_is_read_for_the_rig(recorded, monkeypatch):
    counts = []

    def counted(path, *window):
        for part in iter_pcapng(path, *window):
            counts.append(len(part.frames))
            yield part

    monkeypatch.setattr("coulombus.recording.captures.iter_pcapng", counted)
    assert blocks(recorded).rig.name == "bench"
    assert len(counts) == 1


@pytest.mark.parametrize(("count", "samples"), [(1, 1), (2, 2), (101, 101), (511, 511), (512, 512), (1300, 512)])
def test_the_spectrum_is_that_of_scipys_welch(count: int, samples: int) -> None:
    values = np.random.default_rng(count).normal(3.0, 1.0, count)
    frequency, power = measures._welch(values, 1e-3, samples)
    of_scipy = welch(values, 1e3, nperseg=samples)
    assert np.array_equal(frequency, of_scipy[0])
    assert power == pytest.approx(of_scipy[1], rel=1e-9, abs=1e-12 * (power.max() or 1.0))
