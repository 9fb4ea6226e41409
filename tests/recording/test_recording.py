"""Recordings as arrays: hand-made bytes of the bench rig against SI values worked out by hand."""

import math
import os
import shutil
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from coulombus.eds.pdo import Entry
from coulombus.recording.file_content import append_late
from coulombus.recording.log_files import LogError
from coulombus.recording.pcapng_blocks import PcapngError, RecordingError, attachment_block
from coulombus.recording.pcapng_reader import read_pcapng
from coulombus.recording.pcapng_writer import PcapngWriter
from coulombus.recording.pdo_columns import decode_field
from coulombus.recording.reading import blocks, read
from coulombus.recording.recorder import Recorder
from coulombus.recording.signals import Recording
from coulombus.rigs.rig import Rig, RigError, load_rig
from coulombus.wire.frame import CAN_EFF_FLAG, CAN_RTR_FLAG, FRAME, data_word
from host_bench import VELOCITY

RATIO, COUNTS = 9.587, 8192
TORQUE = 0.180 * RATIO / 1000  # Nm at the handle for one per mille
ANGLE = 2 * math.pi / (COUNTS * RATIO)  # rad at the handle for one count

MS = 1_000_000


@pytest.fixture(scope="module")
def rig() -> Rig:
    return load_rig("bench", VELOCITY)


def attached(rig: Rig) -> dict[str, bytes]:
    return {"rig.toml": rig.effective().encode(), **{name: text.encode() for name, text in rig.eds_texts.items()}}


def save(
    path: Path,
    rows: list[tuple[int, int, bytes]],
    attachments: dict[str, bytes],
    comments: dict[int, str] | None = None,
) -> Path:
    frames = np.zeros(len(rows), FRAME)
    for record, (t_ns, can_id, data) in zip(frames, rows, strict=True):
        record["t_ns"], record["can_id"], record["length"], record["word"] = t_ns, can_id, len(data), data_word(data)
    with PcapngWriter(path, attachments=attachments) as writer:
        writer.write(frames, comments)
    return path


CYCLE = [
    (1 * MS, 0x080, b""),
    (1 * MS + 100, 0x201, struct.pack("<Hh", 0x000F, -500)),
    (1 * MS + 200, 0x202, struct.pack("<h", 3500)),
    (1 * MS + 300, 0x181, struct.pack("<Hih", 0x0237, -123_456, 77)),
    (1 * MS + 400, 0x281, struct.pack("<i", 1000)),
    (1 * MS + 500, 0x182, struct.pack("<hhh", -1250, 640, 221)),
    (2 * MS, 0x080, b""),
    (2 * MS + 300, 0x181, struct.pack("<Hih", 0x1237, 2**31 - 1, -32768)),
]


def test_signals_in_si_units(tmp_path: Path, rig: Rig):
    recording = read(save(tmp_path / "a.pcapng", CYCLE, attached(rig)))
    expected = {
        "motor.controlword": ([0x000F], ""),
        "motor.target_torque_Nm": ([-500 * TORQUE], "Nm"),
        "motor.statusword": ([0x0237, 0x1237], ""),
        "motor.position_rad": ([-123_456 * ANGLE, (2**31 - 1) * ANGLE], "rad"),
        "motor.torque_Nm": ([77 * TORQUE, -32768 * TORQUE], "Nm"),
        "motor.velocity_rad_s": ([1000 * ANGLE], "rad/s"),
        "brake.setpoint_Nm": ([3.5], "Nm"),
        "brake.handle_torque_Nm": ([-1.25], "Nm"),
        "brake.coil_current_A": ([0.64], "A"),
        "brake.coil_temperature_degC": ([22.1], "degC"),
    }
    assert {name: series.unit for name, series in recording.signals.items()} == {k: u for k, (_, u) in expected.items()}
    for name, (values, _) in expected.items():
        np.testing.assert_allclose(recording[name].values, values, rtol=1e-14)
    assert recording["motor.torque_Nm"].t_s.tolist() == [0.0010003, 0.0020003]
    assert len(recording["motor.torque_Nm"]) == 2
    assert (recording["motor.statusword"].values & 0x6F).tolist() == [0x27, 0x27]
    assert recording.t_s.tolist() == [t / 1e9 for t, _, _ in CYCLE]
    assert set(recording.malformed.values()) == {0}
    assert recording.rig == rig
    assert recording.epoch_ns == 0


def test_scale_and_signal(tmp_path: Path, rig: Rig):
    recording = read(save(tmp_path / "a.pcapng", CYCLE, attached(rig)))
    assert recording.scale("motor.position_rad") == pytest.approx(ANGLE, rel=1e-14)
    assert (recording.signal("brake.setpoint_Nm").index, recording.signal("brake.setpoint_Nm").unit) == (0x7300, "Nm")
    with pytest.raises(KeyError, match=r"no signal 'motor\.positon_rad'.*motor\.position_rad"):
        recording["motor.positon_rad"]
    with pytest.raises(
        KeyError, match=r"there is motor\.controlword, .* and \d+ others; coulombus pdo lists those of a bus"
    ):
        recording.scale("zzzzzz")


def test_a_rig_with_other_identifiers_and_reversed_polarity(tmp_path: Path, rig: Rig):
    other = rig.variant("motor.node_id=9", "mechanics.motor_polarity=-1", "mechanics.encoder_polarity=-1")
    rows = [(0, 0x189, struct.pack("<Hih", 0, 10, 10)), (0, 0x181, struct.pack("<Hih", 0, 99, 99))]
    recording = read(save(tmp_path / "a.pcapng", rows, attached(other)))
    assert recording["motor.position_rad"].values.tolist() == [pytest.approx(-10 * ANGLE)]
    assert recording["motor.torque_Nm"].values.tolist() == [pytest.approx(-10 * TORQUE)]


def test_wrong_lengths_are_left_out_and_counted(tmp_path: Path, rig: Rig):
    rows = [
        (1, 0x181, bytes(8)),
        (2, 0x181, bytes(7)),
        (3, 0x182, bytes(8)),
        (4, 0x181, b""),
        (5, CAN_RTR_FLAG | 0x181, b""),  # a request, no data that could be malformed
        (6, CAN_EFF_FLAG | 0x181, bytes(3)),  # another identifier
    ]
    recording = read(save(tmp_path / "a.pcapng", rows, attached(rig)))
    assert len(recording["motor.position_rad"]) == 1
    assert len(recording["brake.handle_torque_Nm"]) == 0
    assert recording.malformed == {
        "motor.RPDO1": 0, "motor.TPDO1": 2, "motor.TPDO2": 0, "brake.RPDO1": 0, "brake.TPDO1": 1,
    }  # fmt: skip
    assert len(recording.frames) == 6


def test_markers(tmp_path: Path, rig: Rig):
    comments = {6: "phase hold", 3: "enabled\nphase rest"}
    recording = read(save(tmp_path / "a.pcapng", CYCLE, attached(rig), comments))
    assert recording.markers == [(0.0010003, "enabled"), (0.0010003, "phase rest"), (0.002, "phase hold")]


def test_remarks_tell_what_was_left_out(tmp_path: Path, rig: Rig):
    path = save(tmp_path / "a.pcapng", [*CYCLE, (3 * MS, 0x181, b"short")], attached(rig))
    assert read(path).remarks == (f"{path}: 1 frames of motor.TPDO1 have a wrong length",)
    path.write_bytes(path.read_bytes()[:-60])
    assert read(path).remarks == (f"{path}: the last block is unfinished: 36 bytes were left out",)


def test_an_empty_recording(tmp_path: Path, rig: Rig):
    recording = read(save(tmp_path / "a.pcapng", [], attached(rig)))
    assert all(len(series) == 0 for series in recording.signals.values())
    assert recording.markers == []


def test_stamps_of_a_clock_count_from_the_first_frame(tmp_path: Path, rig: Rig):
    start = 1_700_000_000_123_456_789
    rows = [(start + t, can_id, data) for t, can_id, data in CYCLE]
    recording = read(save(tmp_path / "a.pcapng", rows, attached(rig), {6: "x"}))
    assert recording.epoch_ns == start + 1 * MS
    assert recording["motor.torque_Nm"].t_s.tolist() == [300e-9, 0.0010003]
    assert recording.markers == [(0.001, "x")]


def test_a_file_that_breaks_off_before_its_rig_says_so(tmp_path: Path, rig: Rig):
    path = save(tmp_path / "a.pcapng", CYCLE, attached(rig))
    path.write_bytes(path.read_bytes()[:200])
    for reader in (read, blocks):
        with pytest.raises(
            RigError, match=r"no rig\.toml is attached.*breaks off: its last block is unfinished, \d+ bytes"
        ):
            reader(path)


def test_a_file_that_breaks_off_within_its_rig_says_so(tmp_path: Path, rig: Rig):
    path = save(tmp_path / "a.pcapng", CYCLE, attached(rig))
    content = path.read_bytes()
    path.write_bytes(content[: content.index(b"motor.eds") + 20])  # within the first EDS file
    for reader in (read, blocks):
        with pytest.raises(
            RigError, match=r"a\.pcapng: its attached rig is not whole \(the file breaks off"
        ) as failure:
            reader(path)
        assert "rig.toml]:" not in str(failure.value)


def test_a_recording_that_is_still_being_written(tmp_path: Path, rig: Rig):
    """What is there counts; a later look at it finds more, and a block that is half there is left
    for then.
    """
    path = save(tmp_path / "a.pcapng", CYCLE * 20, attached(rig))
    whole = path.read_bytes()
    path.write_bytes(whole[: -19 * 8 * 48 - 20])
    source = blocks(path)
    stretches = iter(source)
    assert sum(len(block.frames) for block in stretches) == 7
    assert source.remarks == (f"{path}: the last block is unfinished: 28 bytes were left out",)
    path.write_bytes(whole)
    assert sum(len(block.frames) for block in source) == 160
    assert source.remarks == ()


def test_a_file_without_attachments_asks_for_a_rig_where_one_is_needed(tmp_path: Path, rig: Rig):
    path = save(tmp_path / "a.pcapng", CYCLE, {})
    for recording in (read(path), blocks(path)):
        assert recording.known_rig is None
        with pytest.raises(RigError, match=r"a\.pcapng: no rig\.toml is attached.*read\(path, rig=\.\.\.\), or --rig"):
            _ = recording.rig
    for chosen in (rig, "bench"):
        recording = read(path, rig=chosen)
        assert recording["brake.setpoint_Nm"].values.tolist() == [3.5]


def test_the_rig_given_comes_before_the_one_attached(tmp_path: Path, rig: Rig):
    path = save(tmp_path / "a.pcapng", CYCLE, attached(rig))
    other = rig.variant("mechanics.transducer_polarity=-1")
    assert read(path, rig=other)["brake.handle_torque_Nm"].values.tolist() == [1.25]


def test_an_attached_rig_that_cannot_be_read_says_where_and_what_to_do(tmp_path: Path, rig: Rig):
    attachments = attached(rig) | {"rig.toml": rig.effective().replace("ratio =", "rotio =").encode()}
    path = save(tmp_path / "a.pcapng", CYCLE, attachments)
    with pytest.raises(RigError) as caught:
        read(path)
    assert f"{path}[rig.toml]:" in str(caught.value)
    assert "rotio" in str(caught.value)
    assert "--rig" in caught.value.errors[-1]
    assert len(read(path, rig=rig)["brake.setpoint_Nm"]) == 1


def test_a_damaged_rig_is_told(tmp_path: Path, rig: Rig):
    path = save(tmp_path / "a.pcapng", CYCLE, {"rig.toml": b"x" * 50})
    whole = path.read_bytes()
    at = whole.index(b"CoulAtt1") + 8
    path.write_bytes(whole[:at] + bytes(32) + whole[at + 32 :])
    with pytest.raises(RigError, match="SHA-256 differs"):
        read(path)


def test_a_file_that_is_no_recording(tmp_path: Path):
    (tmp_path / "a.pcapng").write_bytes(b"nothing of the kind")
    with pytest.raises(PcapngError, match="not a pcapng file"):
        read(tmp_path / "a.pcapng")


def test_a_pipe_is_refused(tmp_path: Path):
    """It would be read once, for the rig, and never again."""
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(LogError, match="read more than once"):
        blocks(tmp_path / "pipe")


def field_by_hand(data: bytes, start: int, bits: int, signed: bool) -> int:
    """Pick the bits one by one: bit i of the frame is bit i % 8 of byte i // 8."""
    value = sum(((data[i // 8] >> (i % 8)) & 1) << (i - start) for i in range(start, start + bits))
    return value - (1 << bits) if signed and value >> (bits - 1) else value


@given(
    st.lists(st.binary(min_size=8, max_size=8), min_size=1, max_size=5),
    st.integers(1, 64).flatmap(lambda bits: st.tuples(st.just(bits), st.integers(0, 64 - bits))),
    st.booleans(),
)
@settings(deadline=None)
def test_any_integer_field(data: list[bytes], place: tuple[int, int], signed: bool):
    bits, start = place
    words = np.array([data_word(content) for content in data], np.int64)
    entry = Entry(0x2000, 0, bits, signed, "int", "any")
    expected = [field_by_hand(content, start, bits, signed) for content in data]
    assert decode_field(words, start, entry).tolist() == expected


@given(st.floats(width=32, allow_nan=False), st.integers(0, 32))
@settings(deadline=None)
def test_real32_fields(value: float, start: int):
    pattern = struct.unpack("<I", struct.pack("<f", value))[0]
    word = data_word((pattern << start).to_bytes(8, "little"))
    entry = Entry(0x2000, 0, 32, False, "real", "any")
    assert decode_field(np.array([word], np.int64), start, entry).tolist() == [value]


@given(st.floats(allow_nan=False))
@settings(deadline=None)
def test_real64_fields(value: float):
    word = struct.unpack("<q", struct.pack("<d", value))[0]
    entry = Entry(0x2000, 0, 64, False, "real", "any")
    assert decode_field(np.array([word], np.int64), 0, entry).tolist() == [value]


def test_it_is_frozen(tmp_path: Path, rig: Rig):
    recording: Recording = read(save(tmp_path / "a.pcapng", CYCLE, attached(rig)))
    with pytest.raises(TypeError):
        recording.signals["x"] = recording["motor.torque_Nm"]  # type: ignore[index]
    with pytest.raises(AttributeError):
        recording.path = "x"  # type: ignore[misc]


@pytest.mark.parametrize("suffix", [".log", ".asc", ".log.gz"])
def test_a_log_of_another_tool_is_decoded_as_the_recording_is(tmp_path: Path, rig: Rig, suffix: str):
    import can

    path = tmp_path / f"a{suffix}"
    with can.Logger(path) as logger:
        for n in range(3):
            data = struct.pack("<Hih", 0x0237, 1000 * n, -7)
            logger(can.Message(timestamp=1.7e9 + n / 1000, arbitration_id=0x181, is_extended_id=False, data=data))
    for recording in (read(path, rig), next(iter(blocks(path, rig)))):
        angle = recording["motor.position_rad"]
        assert angle.t_s == pytest.approx([0, 0.001, 0.002], abs=2e-6)
        assert angle.values == pytest.approx(1000 * np.arange(3) * recording.scale("motor.position_rad"))
    assert not read(path).signals
    assert len(read(path).frames) == 3


def test_a_marker_is_the_comment_of_the_first_frame_at_or_after_its_time(tmp_path, rig):
    file = tmp_path / "r.pcapng"
    with Recorder(file, rig, "hybrid") as recorder:
        for t_ns, text in ((31, "later"), (10, "at its time"), (12, "second"), (11, "first"), (41, "behind the end")):
            recorder.mark(t_ns, text)
        for stamps in ((10, 20, 20), (30, 40)):
            frames = np.zeros(len(stamps), FRAME)
            frames["t_ns"] = stamps
            recorder.write(frames)
    assert list(read_pcapng(file).comments) == [(0, "at its time"), (1, "first\nsecond"), (4, "later")]
    assert read_pcapng(file).late == ((41, "behind the end"),)


def with_late_markers(file, rig):
    """Record a frame, and two markers behind it."""
    with Recorder(file, rig, "hybrid") as recorder:
        recorder.mark(3_000_000_000, "trip SPEED")
        recorder.mark(2_000_000_000, "phase end")
        frames = np.zeros(1, FRAME)
        frames["t_ns"] = 1_000_000_000
        recorder.write(frames)
    return [(2.0, "phase end"), (3.0, "trip SPEED")]


def test_markers_that_no_frame_follows_keep_their_times(tmp_path, rig):
    file = tmp_path / "r.pcapng"
    markers = with_late_markers(file, rig)
    recording = read(file)
    assert recording.markers == [marker for block in blocks(file) for marker in block.markers] == markers
    assert recording.ends_s == (1.0, 1.0)
    assert "markers" not in recording.attachments
    assert [text for block in blocks(file).within(0.5, 2.5) for _, text in block.markers] == ["phase end"]


def test_a_marker_is_appended_to_a_recording_that_breaks_off(tmp_path, rig):
    file = tmp_path / "r.pcapng"
    markers = with_late_markers(file, rig)
    with file.open("ab") as torn:
        torn.write(bytes.fromhex("0600000030000000"))
    append_late(file, [(4_000_000_000, "trip HOST")])
    assert read(file).markers == [*markers, (4.0, "trip HOST")]
    with pytest.raises(FileNotFoundError):
        append_late(tmp_path / "none.pcapng", [(1, "trip HOST")])
    assert not (tmp_path / "none.pcapng").exists()


@pytest.mark.parametrize(
    "content", [b"[1]", b"{", b'[["1", "x"]]', b"[[1, 2]]", b'[[true, "x"]]', b"[[1e300, 1]]", b"7"]
)
def test_damaged_markers_are_left_out_and_named(tmp_path, rig, content):
    file = tmp_path / "r.pcapng"
    markers = with_late_markers(file, rig)
    with file.open("ab") as more:
        more.write(attachment_block("markers", content))
    assert read(file).markers == markers
    assert any("attachment 'markers' is damaged" in remark for remark in read(file).remarks)


def test_a_removed_recording_is_an_error_at_the_next_write_and_at_its_end(tmp_path, rig):
    for name, writes in (("a", True), ("b", False)):
        file = tmp_path / name / "r.pcapng"
        file.parent.mkdir()
        recorder = Recorder(file, rig, "hybrid")
        shutil.rmtree(file.parent)
        frames = np.zeros(1, FRAME)
        with pytest.raises(RecordingError, match=r"the file or its folder was removed; record to another place"):
            recorder.write(frames) if writes else recorder.close()
