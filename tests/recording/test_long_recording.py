"""A long recording, of which only what is asked for is read, is the same as one that is kept; and a span of it."""

from __future__ import annotations

import gzip
import shutil
from pathlib import Path

import numpy as np
import pytest
import zstandard

from coulombus.kernels.records import Records, new_records
from coulombus.recording import reading as module
from coulombus.recording.export.export import export
from coulombus.recording.host_telemetry import FIRST, SOURCE_INSIDE
from coulombus.recording.pcapng_blocks import block
from coulombus.recording.pcapng_writer import PcapngWriter, SectionTexts
from coulombus.recording.pictures.plot import traces_of
from coulombus.recording.reading import blocks, read
from coulombus.recording.recorder import About, Recorder
from coulombus.recording.segments import Rotation, SegmentedRecorder
from coulombus.recording.signals import UnknownSignal, series
from coulombus.rigs.arguments import WrongCall
from coulombus.rigs.rig import Rig, load_rig
from coulombus.wire.frame import Frame

pytestmark = pytest.mark.slow  # in plain Python each packet takes some microseconds

CYCLES, MS = 4000, 1_000_000
STRETCH = 120_000
"""Bytes read at a time: some hundred frames."""


def some_frames(rig: Rig, seed: int, cycles: int = CYCLES) -> Records:
    """Return frames of all PDOs of a rig, a millisecond apart, some too short, with the host's telemetry."""
    chance = np.random.default_rng(seed)
    layouts = [pdo.layout for pdo in rig.pdos()]
    ids = [0x80, *(layout.cob_id for layout in layouts), FIRST, FIRST + 1]
    lengths = [0, *(layout.length for layout in layouts), 8, 8]
    count = len(ids) * cycles
    frames = new_records(Frame, count)
    frames["t_ns"] = MS + np.repeat(np.arange(cycles) * MS, len(ids)) + np.tile(np.arange(len(ids)) * 9000, cycles)
    frames["can_id"] = np.tile(ids, cycles)
    frames["length"] = np.tile(lengths, cycles) - (chance.random(count) < 0.01) * (np.tile(lengths, cycles) > 0)
    frames["word"] = np.cumsum(chance.integers(-900, 1000, count)) & ((1 << 32) - 1)
    frames["word"] &= np.array([(1 << 8 * n) - 1 for n in range(8)] + [-1])[frames["length"]]
    frames["source"] = np.where(frames["can_id"] >= FIRST, SOURCE_INSIDE, 0)
    return frames


def record(recorder: Recorder, frames: Records) -> None:
    with recorder:
        for at_s in (0.5, 1.5, 2.25, 3.75):
            recorder.mark(int(at_s * 1e9), f"phase {at_s}")
        for number, part in enumerate(np.array_split(frames, 40)):
            recorder.write(part)
            recorder.attach(f"host.trace.{number}", np.random.default_rng(number).bytes(3000))


@pytest.fixture(scope="module", params=["bench", "two_axes"])
def recorded_once(request, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("recorded") / "run.pcapng"
    about = About(law_state=(("z_rad", 1),), more={"meta.json": b'{"subject": "S01"}'})
    record(Recorder(path, load_rig(request.param), "hybrid", 3, about=about), some_frames(load_rig(request.param), 5))
    return path


@pytest.fixture
def recorded(recorded_once, tmp_path, monkeypatch) -> Path:
    monkeypatch.setattr("coulombus.recording.pcapng_reader.CHUNK", STRETCH)
    monkeypatch.setattr("coulombus.recording.time_search.CLOSE", STRETCH)
    monkeypatch.setattr("coulombus.recording.time_search.SLACK_NS", 20 * MS)
    return Path(shutil.copy(recorded_once, tmp_path))


def long(path, monkeypatch, **options):
    monkeypatch.setattr(module, "KEPT_BYTES", 0)
    recording = read(path, **options)
    monkeypatch.undo()
    assert recording.is_streamed
    return recording


def equal(values, others):
    return np.array_equal(values.view(np.int64), others.view(np.int64))  # to the bit, NaN too


def same(one, other):
    """Compare all that a recording gives."""
    assert list(one.signals) == list(other.signals)
    for name in one.signals:
        (a, b) = one[name], other[name]
        assert (a.unit, a.values.dtype) == (b.unit, b.values.dtype)
        assert np.array_equal(a.t_s, b.t_s), name
        assert equal(a.values, b.values), name
    assert one.markers == other.markers
    assert dict(one.malformed) == dict(other.malformed)
    assert dict(one.turns) == dict(other.turns)
    assert (one.path, one.epoch_ns, one.inside, one.bare) == (other.path, other.epoch_ns, other.inside, other.bare)
    assert (one.count, one.duration_s, one.extent()) == (other.count, other.duration_s, other.extent())
    assert (one.frames == other.frames).all()
    assert one.capture.comments == other.capture.comments
    assert np.array_equal(one.t_s, other.t_s)
    for mine, theirs in zip(one.tables, other.tables, strict=True):
        assert (mine.name, mine.malformed, mine.inside) == (theirs.name, theirs.malformed, theirs.inside)
        for column in ("rows", "t_ns", "order", "words"):
            assert np.array_equal(getattr(mine, column), getattr(theirs, column)), (mine.name, column)
        assert all(equal(a, b) for a, b in zip(mine.columns, theirs.columns, strict=True))


@pytest.mark.thorough
def test_it_is_the_recording_that_is_kept(recorded, monkeypatch):
    kept, other = read(recorded), long(recorded, monkeypatch)
    assert not kept.is_streamed
    same(other, kept)
    assert other.remarks == kept.remarks
    assert repr(other) == repr(kept)
    assert other._repr_html_() == kept._repr_html_()
    assert other.meta == kept.meta == {"subject": "S01"}
    assert {name: data for name, data in kept.attachments.items() if not name.startswith("host.")} == other.attachments
    assert other.capture.attachments == kept.capture.attachments
    for mine, theirs in zip(other.axes, kept.axes, strict=True):
        same(mine, theirs)
    assert traces_of(other).markers == traces_of(kept).markers
    name = kept.pdos[0].signals[0].name
    assert equal(series(other, name)[0].values, kept[name].values)
    assert all(map(equal, *([signal.values for signal in each.signals.values()] for each in (other, kept))))
    with pytest.raises(UnknownSignal):
        other["motor.nothing"]


@pytest.mark.parametrize("seed", range(3))
def test_it_is_the_same_in_other_blocks(recorded, monkeypatch, seed):
    kept = read(recorded)
    for size in np.random.default_rng(seed).integers(5_000, 400_000, 2).tolist():
        monkeypatch.setattr("coulombus.recording.pcapng_reader.CHUNK", size)
        streamed = blocks(recorded)
        for name, values in zip(kept.names, series(streamed, *kept.names), strict=True):
            assert equal(values.values, kept[name].values), (size, name)
        assert streamed.remarks == kept.remarks
        same(streamed, kept)


def test_a_torn_and_damaged_recording_has_the_same_remarks(recorded, monkeypatch):
    content = bytearray(recorded.read_bytes())
    content[200_000:200_050] = b"\xff" * 50
    recorded.write_bytes(content[:-5])
    kept, other = read(recorded), long(recorded, monkeypatch)
    assert len(kept.remarks) > 2
    assert other.remarks == kept.remarks
    same(other, kept)


def test_signals_of_one_pdo_share_their_times_and_are_read_once(recorded, monkeypatch):
    other = long(recorded, monkeypatch)
    first, second = (signal.name for signal in other.pdos[0].signals[:2])
    assert other[first].t_s is other[second].t_s
    assert other[first] is other[first]


SPANS = [(0.7, 1.6), (None, 0.4), (3.0, None), (2.25, 2.2500001), (-5.0, 0.2), (50.0, 60.0), (0.0, 100.0)]


def of_span(whole, span):
    """Return the signals and markers of a span, from the whole."""
    begin, end = (default if time is None else time for time, default in zip(span, (-np.inf, np.inf), strict=True))
    signals = {
        name: signal.values[(signal.t_s >= begin) & (signal.t_s <= end)] for name, signal in whole.signals.items()
    }
    return signals, [marker for marker in whole.markers if begin <= marker[0] <= end]


def packed(path, pack):
    other = path.with_name(path.name + ".packed")
    other.write_bytes(pack(path.read_bytes()))
    return other


def foreign(path):
    """Return the recording as another program's, whose stamps need not rise."""
    other = path.with_name("foreign.pcapng")
    capture = read(path).capture
    attached = {name: data for name, data in capture.attachments.items() if not name.startswith("host.trace")}
    comments = dict(capture.comments)
    with PcapngWriter(other, attachments=attached, interface="can0", texts=SectionTexts(application="x")) as writer:
        writer.write(
            capture.frames[::-1].copy(), {len(capture.frames) - 1 - row: text for row, text in comments.items()}
        )
    return other


@pytest.mark.parametrize(
    ("recorded_once", "kind"),
    [
        ("bench", lambda path: path),
        pytest.param("two_axes", lambda path: path, marks=pytest.mark.long),
        pytest.param("bench", lambda path: packed(path, gzip.compress), marks=pytest.mark.long),
        pytest.param("bench", lambda path: packed(path, ZSTD), marks=pytest.mark.thorough),
        pytest.param("two_axes", foreign, marks=pytest.mark.thorough),
    ],
    indirect=["recorded_once"],
)
def test_a_span_is_that_part_of_the_whole(recorded, kind):
    path = kind(recorded)
    whole = read(path)
    for span in SPANS:
        part = read(path, span=span)
        signals, markers = of_span(whole, span)
        assert part.markers == markers, span
        for name, values in signals.items():
            assert equal(part[name].values, values), (span, name)
        assert part.rig.name == whole.rig.name
        assert sum(len(block.frames) for block in blocks(path, span=span)) == part.count == len(part.frames), span


ZSTD = zstandard.ZstdCompressor(1).compress


def test_a_span_reads_little_of_a_file(recorded, monkeypatch):
    for name in ("pcapng_reader.CHUNK", "time_search.CLOSE"):
        monkeypatch.setattr(f"coulombus.recording.{name}", 40_000)
    size, read_ = [], module.Content.read

    def counted(content, count):
        data = read_(content, count)
        size.append(len(data))
        return data

    monkeypatch.setattr(module.Content, "read", counted)
    read(recorded, span=(3.0, 3.1))
    assert sum(size) < 0.5 * recorded.stat().st_size
    size.clear()
    blocks(recorded).extent()
    assert 0 < sum(size) < 0.3 * recorded.stat().st_size


@pytest.mark.parametrize("kind", [lambda path: path, lambda path: packed(path, ZSTD), foreign])
def test_the_extent_is_that_of_the_frames(recorded, kind):
    path = kind(recorded)
    assert blocks(path).extent() == read(path).extent()


@pytest.mark.thorough
def test_a_span_of_a_run_in_segments(tmp_path, monkeypatch):
    monkeypatch.setattr("coulombus.recording.time_search.SLACK_NS", 20 * MS)
    rig = load_rig("bench")
    recorder = SegmentedRecorder(tmp_path, rig, "hybrid", Rotation(100_000), About())
    record(recorder, some_frames(rig, 6))
    whole, opened = read(tmp_path), []
    assert len(list(recorder.run.glob("*.pcapng"))) > 8
    init = module.Content.__init__
    for span in SPANS:
        part = read(tmp_path, span=span)
        signals, markers = of_span(whole, span)
        assert part.markers == markers
        assert all(equal(part[name].values, values) for name, values in signals.items())
    monkeypatch.setattr(
        module.Content, "__init__", lambda self, path: (opened.append(Path(path).name), init(self, path))[1]
    )
    list(blocks(tmp_path, span=(3.0, 3.05)))
    assert len(set(opened)) < 8
    assert blocks(tmp_path).extent() == read(tmp_path).extent()


def test_a_short_counter_is_followed_from_the_beginning(tmp_path):
    rig = load_rig("bench")
    text = next(text for name, text in rig.eds_texts.items() if "motor" in name)
    assert "6064" in text
    path = tmp_path / "run.pcapng"
    frames = some_frames(rig, 7)
    tpdo = next(pdo for pdo in rig.pdos() if any(signal.key == "motor.position_rad" for signal in pdo.signals))
    place = [signal.key for signal in tpdo.signals].index("motor.position_rad")
    start, bits = tpdo.layout.starts[place], tpdo.layout.entries[place].bits
    rows = np.flatnonzero((frames["can_id"] == tpdo.layout.cob_id) & (frames["length"] == tpdo.layout.length))
    counts = (np.arange(len(rows)) * (1 << 20)) % (1 << bits)  # it wraps in the middle
    frames["word"][rows] = counts.astype(np.uint64).view(np.int64) << start
    record(Recorder(path, rig, "hybrid", 3), frames)
    whole = read(path)
    monkey = pytest.MonkeyPatch()
    with monkey.context() as patch:
        patch.setattr("coulombus.recording.signals.LONG_COUNTER", 33)
        part = read(path, span=(3.5, 3.6))
        values = part["motor.position_rad"].values
    t_s = whole["motor.position_rad"].t_s
    assert np.array_equal(values, whole["motor.position_rad"].values[(t_s >= 3.5) & (t_s <= 3.6)])


def test_a_block_is_not_sought_within_an_attachment(tmp_path, monkeypatch):
    """Random data with whole blocks in it, as another program's block may have them."""
    monkeypatch.setattr("coulombus.recording.pcapng_reader.CHUNK", 30_000)
    monkeypatch.setattr("coulombus.recording.time_search.CLOSE", 1000)
    monkeypatch.setattr("coulombus.recording.time_search.SLACK_NS", MS)
    path, rig = tmp_path / "run.pcapng", load_rig("bench")
    frames = some_frames(rig, 8, 200)
    with Recorder(tmp_path / "inner.pcapng", rig, "hybrid") as inner:
        inner.write(frames[:3])
    blocks_of_packets = (tmp_path / "inner.pcapng").read_bytes()[-144:]
    with Recorder(path, rig, "hybrid") as recorder:
        for number, part in enumerate(np.array_split(frames, 20)):
            recorder.write(part)
            trap = blocks_of_packets + np.random.default_rng(number).bytes(60_000)
            recorder._writer._write(block(0x80000BAD, trap))
    whole = read(path)
    for begin_s in (0.01, 0.05, 0.1, 0.15):
        part = read(path, span=(begin_s, None))
        assert part.count == int((whole.t_s >= begin_s).sum())
        assert not part.capture.warnings


@pytest.mark.parametrize("span", ["3:5", (1,), 3, ("1", "2")])
def test_what_is_no_span_is_refused(recorded, span):
    with pytest.raises(WrongCall, match="span is"):
        read(recorded, span=span)


def test_an_export_of_a_long_recording(recorded, tmp_path):
    assert export(recorded, tmp_path / "a.csv", "csv").rows > 0


def test_a_rig_given_by_name_and_a_bare_log(tmp_path, monkeypatch):
    path = tmp_path / "bare.pcapng"
    frames = some_frames(load_rig("bench"), 9, 600)
    with PcapngWriter(path, attachments={}) as writer:
        writer.write(frames[frames["source"] == 0])
    same(long(path, monkeypatch), read(path))
    same(long(path, monkeypatch, rig="bench"), read(path, "bench"))
    part, whole = read(path, span=(0.2, 0.3)), read(path)
    signals, _ = of_span(whole, (0.2, 0.3))
    assert all(equal(part[name].values, values) for name, values in signals.items())
