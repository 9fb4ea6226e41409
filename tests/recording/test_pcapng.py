"""pcapng files: ours byte by byte, as tshark sees them, torn, damaged, on a full disk; and other
tools' files.
"""

import bisect
import errno
import hashlib
import itertools
import json
import os
import re
import resource
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import zlib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import coulombus.recording.pcapng_reader
import coulombus.recording.pcapng_writer
from coulombus.recording.file_content import Capture
from coulombus.recording.pcapng_blocks import PcapngError, RecordingError, attachment_block
from coulombus.recording.pcapng_reader import iter_pcapng, read_pcapng
from coulombus.recording.pcapng_writer import PcapngWriter, SectionTexts
from coulombus.wire.frame import CAN_EFF_FLAG, CAN_ERR_FLAG, CAN_RTR_FLAG, FRAME, data_word
from places import ROOT

needs_tshark = pytest.mark.skipif(shutil.which("tshark") is None, reason="tshark is not installed")

Row = tuple[int, int, bytes]  # t_ns, can_id with flags, data


def records(rows: list[Row]) -> np.ndarray:
    out = np.zeros(len(rows), FRAME)
    for record, (t_ns, can_id, data) in zip(out, rows, strict=True):
        record["t_ns"], record["can_id"], record["length"] = t_ns, can_id, len(data)
        record["word"] = data_word(data)
    return out


def as_rows(frames: np.ndarray) -> list[Row]:
    return [
        (int(f["t_ns"]), int(f["can_id"]), int(f["word"]).to_bytes(8, "little", signed=True)[: int(f["length"])])
        for f in frames
    ]


ROWS: list[Row] = [
    (0, 0x080, b""),
    (1_000_000, 0x181, bytes([0x37, 0x02, 1, 2, 3, 4, 0xFE, 0xFF])),
    (1_234_567_890_123_456_789, 0x281, b"\xff\xff\xff\xff"),
    (1_234_567_890_123_456_790, CAN_EFF_FLAG | 0x1ABCDEF0, b"\x80"),
    (1_234_567_890_123_456_791, CAN_ERR_FLAG | 0x4, bytes(8)),
]


def written(path: Path, rows: list[Row], comments: dict[int, str] | None = None, **options: object) -> Path:
    arguments: dict = {"attachments": {}, **options}
    with PcapngWriter(path, **arguments) as writer:
        writer.write(records(rows), comments)
    return path


def block(kind: int, body: bytes, order: str = "<") -> bytes:
    body += bytes(-len(body) % 4)
    return struct.pack(order + "II", kind, len(body) + 12) + body + struct.pack(order + "I", len(body) + 12)


def section(order: str = "<") -> bytes:
    return block(0x0A0D0D0A, struct.pack(order + "IHHq", 0x1A2B3C4D, 1, 0, -1), order)


def interface(order: str = "<", linktype: int = 227, options: bytes = b"") -> bytes:
    return block(1, struct.pack(order + "HHI", linktype, 0, 0) + options, order)


def packet(stamp: int, payload: bytes, order: str = "<", number: int = 0, options: bytes = b"") -> bytes:
    head = struct.pack(order + "IIIII", number, stamp >> 32, stamp & 0xFFFFFFFF, len(payload), len(payload))
    return block(6, head + payload + bytes(-len(payload) % 4) + options, order)


def can(can_id: int, data: bytes, padded: bool = True, flags: int = 0) -> bytes:
    return struct.pack(">IBBH", can_id, len(data), flags, 0) + (data.ljust(8, b"\0") if padded else data)


# ------------------------------------------------------------------------------------------------
# our own files


def test_the_bytes_of_a_small_file(tmp_path: Path):
    path = written(
        tmp_path / "a.pcapng",
        [(0x1_0000_0005, 0x181, b"\x01\x02")],
        interface="",
        texts=SectionTexts(operating_system=""),
    )
    head = block(0x0A0D0D0A, struct.pack("<IHHq", 0x1A2B3C4D, 1, 0, -1) + b"\4\0\x09\0coulombus\0\0\0" + bytes(4))
    head += block(1, struct.pack("<HHI", 227, 0, 16) + b"\x09\0\1\0\x09\0\0\0" + bytes(4))
    frame = bytes.fromhex("06000000 30000000 00000000 01000000 05000000 10000000 10000000")
    frame += bytes.fromhex("00000181 02000000 0102000000000000 30000000")
    assert path.read_bytes() == head + frame
    assert len(frame) == 48


def test_written_and_read(tmp_path: Path):
    comments = {0: "run begins", 3: "phase hold: Reibung, μ = 0.3, 摩擦"}
    attachments = {"rig.toml": b"[rig]\n" * 40_000, "motor.eds": bytes(range(256)), "empty": b""}
    path = written(
        tmp_path / "a.pcapng", ROWS, comments,
        attachments=attachments,
        texts=SectionTexts("bench, hybrid", application="coulombus 0.1.0", hardware="virtual bus"),
    )  # fmt: skip
    capture = read_pcapng(path)
    assert as_rows(capture.frames) == ROWS
    assert capture.comments == sorted(comments.items())
    assert capture.attachments == attachments
    assert (capture.comment, capture.application) == ("bench, hybrid", "coulombus 0.1.0")
    assert (capture.hardware, capture.operating_system) == ("virtual bus", "Linux")
    assert (capture.torn, capture.skipped, capture.warnings) == (0, 0, ())


row = st.tuples(
    st.integers(0, (1 << 62)),
    st.integers(0, 0x7FF) | st.integers(0, 0x1FFFFFFF).map(lambda i: i | CAN_EFF_FLAG),
    st.binary(max_size=8),
)


@given(st.lists(st.lists(row, max_size=6), max_size=4), st.data())
@settings(max_examples=60, deadline=None)
def test_any_batches(batches: list[list[Row]], data: st.DataObject):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.pcapng"
        expected, at = [], 0
        with PcapngWriter(path, attachments={}) as writer:
            for batch in batches:
                rows = st.sampled_from(range(len(batch))) if batch else st.nothing()
                size = min(3, len(batch))
                comments = data.draw(st.dictionaries(rows, st.text(max_size=9), max_size=size))
                writer.write(records(batch), comments)
                expected += [(at + i, text) for i, text in sorted(comments.items())]
                at += len(batch)
            assert writer.frames == at
        capture = read_pcapng(path)
    assert as_rows(capture.frames) == list(itertools.chain(*batches))
    assert capture.comments == expected


def test_a_remote_frame_keeps_its_dlc_and_has_no_data(tmp_path: Path):
    frame = records([(5, CAN_RTR_FLAG | 0x181, bytes(6))])
    with PcapngWriter(tmp_path / "a.pcapng", attachments={}) as writer:
        writer.write(frame)
    frames = read_pcapng(tmp_path / "a.pcapng").frames
    assert (frames["can_id"][0], frames["length"][0], frames["word"][0]) == (CAN_RTR_FLAG | 0x181, 6, 0)


def test_same_input_same_bytes_and_epoch(tmp_path: Path):
    first = written(tmp_path / "a.pcapng", ROWS[:2], {1: "x"}, attachments={"e": b"1" * 999})
    second = written(tmp_path / "b.pcapng", ROWS[:2], {1: "x"}, attachments={"e": b"1" * 999})
    assert first.read_bytes() == second.read_bytes()
    late = written(tmp_path / "c.pcapng", ROWS[:2], epoch_ns=1_700_000_000_000_000_000)
    assert read_pcapng(late).frames["t_ns"].tolist() == [1_700_000_000_000_000_000, 1_700_000_000_001_000_000]


def test_many_frames_cross_the_readers_chunks(tmp_path: Path):
    count = 140_000
    frames = np.zeros(count, FRAME)
    frames["t_ns"] = np.arange(count) * 1000
    frames["can_id"], frames["length"] = 0x181, 8
    frames["word"] = np.arange(count) - count // 2
    with PcapngWriter(tmp_path / "a.pcapng", attachments={}) as writer:
        for start in range(0, count, 9_999):
            writer.write(frames[start : start + 9_999], {0: f"batch {start}"})
    capture = read_pcapng(tmp_path / "a.pcapng")
    assert (capture.frames == frames).all()
    assert capture.comments == [(i, f"batch {i}") for i in range(0, count, 9_999)]


@pytest.mark.parametrize(
    ("rows", "comments", "text"),
    [
        ([(-1, 1, b"")], {}, "1970"),
        ([(0, 1, b"")], {1: "x"}, "rows \\[1\\]"),
        ([(0, 1, b"")], {-1: "x"}, "counted from 0"),
        ([(0, 1, b"")], {0: "x" * 65_536}, "65535"),
    ],
)
def test_a_callers_mistake(tmp_path: Path, rows: list[Row], comments: dict[int, str], text: str):
    with pytest.raises(ValueError, match=text):
        written(tmp_path / "a.pcapng", rows, comments)
    assert len(read_pcapng(tmp_path / "a.pcapng").frames) == 0


def test_a_length_beyond_eight_and_a_closed_recording(tmp_path: Path):
    frames = records([(0, 1, b"")])
    frames["length"] = 9
    with PcapngWriter(tmp_path / "a.pcapng", attachments={}) as writer:
        with pytest.raises(ValueError, match="CAN FD"):
            writer.write(frames)
        writer.flush()
    writer.close()
    with pytest.raises(ValueError, match="closed"):
        writer.write(records(ROWS))


def test_an_attachment_that_no_tool_would_read_is_refused(tmp_path: Path):
    noise = np.random.default_rng(1).bytes(17 << 20)
    with pytest.raises(ValueError, match="'noise'"):
        PcapngWriter(tmp_path / "a.pcapng", attachments={"noise": noise})


# ------------------------------------------------------------------------------------------------
# torn and damaged


def whole_blocks(data: bytes) -> tuple[int, int]:
    """Packets that stand complete in `data`, and the bytes behind the last whole block.

    Counted with struct alone.
    """
    at = packets = 0
    while at + 12 <= len(data):
        kind, length = struct.unpack_from("<II", data, at)
        if at + length > len(data):
            break
        packets += kind == 6
        at += length
    return packets, len(data) - at


@given(st.data())
@settings(max_examples=60, deadline=None)
def test_a_file_cut_anywhere_gives_all_whole_blocks(data: st.DataObject):
    with tempfile.TemporaryDirectory() as folder:
        path = written(Path(folder) / "a.pcapng", ROWS * 2, {2: "here", 7: "there"}, attachments={"rig": b"x" * 99})
        whole = path.read_bytes()
        cut = whole[: data.draw(st.integers(1, len(whole)))]
        path.write_bytes(cut)
        capture = read_pcapng(path)
    expected, rest = whole_blocks(cut)
    assert as_rows(capture.frames) == (ROWS * 2)[:expected]
    assert capture.comments == [c for c in [(2, "here"), (7, "there")] if c[0] < expected]
    assert capture.torn == rest


def test_zeros_at_the_end_are_a_torn_block(tmp_path: Path):  # what a power cut leaves on some file systems
    path = written(tmp_path / "a.pcapng", ROWS)
    path.write_bytes(path.read_bytes() + bytes(4096))
    capture = read_pcapng(path)
    assert as_rows(capture.frames) == ROWS
    assert capture.torn == 4096


def test_a_killed_process_leaves_a_readable_file(tmp_path: Path):
    path = tmp_path / "a.pcapng"
    script = (
        "import os, signal, numpy as np\n"
        "from coulombus.wire.frame import frames\nfrom coulombus.recording.pcapng_writer import PcapngWriter\n"
        f"writer = PcapngWriter({str(path)!r}, attachments={{'rig': b'rig'}})\n"
        "for _ in range(3): writer.write(frames(1000), {0: 'batch'})\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    done = subprocess.run([sys.executable, "-c", script], cwd=ROOT, check=False, capture_output=True, text=True)
    assert done.returncode == -signal.SIGKILL, done.stderr
    capture = read_pcapng(path)
    assert (len(capture.frames), capture.torn) == (3000, 0)
    assert capture.comments == [(0, "batch"), (1000, "batch"), (2000, "batch")]


def test_what_is_damaged_is_told_and_the_rest_is_read(tmp_path: Path):
    path = written(tmp_path / "a.pcapng", ROWS)
    whole = bytearray(path.read_bytes())
    at = len(whole) - 2 * 48  # the last frame but one
    whole[at + 44] ^= 1  # its second length
    path.write_bytes(whole)
    capture = read_pcapng(path)
    assert as_rows(capture.frames) == [*ROWS[:-2], ROWS[-1]]
    assert capture.warnings == (
        f"{path}: offset {at}: 48 bytes were left out: a block (type 0x00000006) of 48 bytes ends with the length 49, "
        "expected the same",
    )


def told_bytes(capture: Capture) -> int:
    """Bytes that were left out, as the reader tells; a packet has 48."""
    gaps = [re.search(r": (\d+) (bytes|packets?) w", text) for text in capture.warnings]
    return capture.torn + sum(int(gap[1]) * (1 if gap[2] == "bytes" else 48) for gap in gaps)


def places(data: bytes) -> list[int]:
    """Where the packets begin in `data`."""
    at, begins = 0, []
    while at + 12 <= len(data):
        kind, length = struct.unpack_from("<II", data, at)
        begins += [at] if kind == 6 else []
        at += length
    return begins


@given(st.data())
@settings(max_examples=60, deadline=None)
def test_bytes_that_are_missing_in_its_midst_cost_the_blocks_that_they_were_of(data: st.DataObject):
    with tempfile.TemporaryDirectory() as folder:
        path = written(Path(folder) / "a.pcapng", ROWS * 3)
        whole = path.read_bytes()
        begins = places(whole)
        first = data.draw(st.integers(begins[0], len(whole) - 1))
        gap = st.integers(1, min(200, len(whole) - first)).filter(lambda n: n % 48)  # else two halves make a packet
        last = first + data.draw(gap)
        path.write_bytes(whole[:first] + whole[last:])
        capture = read_pcapng(path)
    before = bisect.bisect_right([*begins[1:], len(whole)], first)
    behind = len(begins) - bisect.bisect_left(begins, last)
    assert as_rows(capture.frames)[:before] == (ROWS * 3)[:before]
    if behind > 1:  # the length that ends a block may be the one with which the next begins
        assert as_rows(capture.frames)[1 - behind :] == (ROWS * 3)[1 - behind :]
    assert 48 * len(capture.frames) + told_bytes(capture) == len(whole) - begins[0] - (last - first)


@given(st.data())
@settings(max_examples=60, deadline=None)
def test_a_damaged_length_costs_one_packet(data: st.DataObject):
    with tempfile.TemporaryDirectory() as folder:
        path = written(Path(folder) / "a.pcapng", ROWS * 3)
        whole = bytearray(path.read_bytes())
        begins = places(bytes(whole))
        struck = data.draw(st.integers(0, len(begins) - 1))
        length = data.draw(st.one_of(st.integers(0, 400), st.integers(0, 2**32 - 1)).filter(lambda n: n != 48))
        struct.pack_into("<I", whole, begins[struck] + 4, length)
        path.write_bytes(whole)
        capture = read_pcapng(path)
    assert as_rows(capture.frames) == (ROWS * 3)[:struck] + (ROWS * 3)[struck + 1 :]
    assert (capture.torn == 48) == (struck == len(begins) - 1)
    assert capture.torn == 48 or ": 48 bytes were left out" in capture.warnings[0]


def test_damage_at_the_end_of_what_is_read_at_a_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(coulombus.recording.pcapng_reader, "CHUNK", 100)
    monkeypatch.setattr(coulombus.recording.pcapng_reader, "RESUMED", 64)
    path = written(tmp_path / "a.pcapng", ROWS * 3)
    whole = path.read_bytes()
    for at in [begin + part for begin in places(whole) for part in (4, 44)]:  # both lengths of each packet
        path.write_bytes(whole[:at] + b"\x55" * 4 + whole[at + 4 :])
        capture = read_pcapng(path)
        assert 48 * len(capture.frames) + told_bytes(capture) == len(whole) - places(whole)[0]
        assert len(capture.frames) == len(ROWS) * 3 - 1


@pytest.mark.parametrize("length", [0, 4, 49, (16 << 20) + 4, 0xFFFFFFFC])
def test_a_block_of_an_impossible_length(tmp_path: Path, length: int):
    path = tmp_path / "a.pcapng"
    rest = struct.pack("<II", 6, length) + b"garbage!" * 9
    path.write_bytes(section() + interface() + packet(1, can(1, b"")) + rest)
    capture = read_pcapng(path)
    assert (len(capture.frames), capture.torn) == (1, len(rest))


@pytest.mark.parametrize(
    ("damaged", "text"),
    [
        (
            block(6, struct.pack("<IIIII", 0, 0, 0, 99, 99)),
            "a packet of 99 bytes in a block of 32, .*: 1 packet was left out",
        ),
        (packet(1, can(1, b""), number=1), ", on interface 1 where 1 are described: 1 packet was left out"),
        (packet(1 << 63, can(1, b"")), "stamp is 9223372036854 s after 1970, .*: 1 packet was left out"),
        (packet(1 << 63, can(1, b"")) * 2, "stamp is .*: 2 packets were left out"),
    ],
)
def test_a_packet_that_cannot_be_is_left_out_and_told(tmp_path: Path, damaged: bytes, text: str):
    path = tmp_path / "a.pcapng"
    good = packet(1, can(1, b""))
    path.write_bytes(section() + interface() + good + damaged + good)
    capture = read_pcapng(path)
    assert (len(capture.frames), capture.torn, capture.skipped) == (2, 0, 0)
    offset = len(section() + interface() + good)
    assert re.fullmatch(rf"{re.escape(str(path))}: offset {offset}: .*{text}", capture.warnings[0])


@pytest.mark.parametrize("length", [12, 16, 20, 28])
@pytest.mark.parametrize("behind", [True, False])
def test_a_packet_block_that_is_too_short_is_left_out_at_the_files_end_too(tmp_path: Path, length: int, behind: bool):
    path = tmp_path / "a.pcapng"
    good = packet(1, can(1, b""))
    short = block(6, bytes(length - 12))
    path.write_bytes(section() + interface() + good + short + (good if behind else b""))
    capture = read_pcapng(path)
    assert len(capture.frames) == 1 + behind
    assert f"a packet's block of {length} bytes, expected 32 at least: 1 packet was left out" in capture.warnings[0]


@pytest.mark.parametrize("first", ["<", ">"])
@pytest.mark.parametrize("second", ["<", ">"])
def test_a_section_behind_damage_has_its_own_order_and_interfaces(tmp_path: Path, first: str, second: str):
    """As where a file that a power cut has torn is joined with another one."""
    path = tmp_path / "a.pcapng"
    ns = struct.pack(first + "HHBxxxHH", 9, 1, 9, 0, 0)
    torn = (
        section(first)
        + interface(first, options=ns)
        + packet(3000, can(1, b"a"), first)
        + packet(9, can(1, b""), first)[:-10]
    )
    other = (
        section(second) + interface(second, linktype=1) + interface(second) + packet(3, can(2, b"b"), second, number=1)
    )
    for damage in (b"", b"\0\0\0", b"garbage!!", struct.pack("<III", 0x0A0D0D0A, 28, 7) * 3):
        path.write_bytes(torn + damage + other)
        capture = read_pcapng(path)
        assert [row["t_ns"] for row in capture.frames] == [3000, 3000]
        assert [row["can_id"] for row in capture.frames] == [1, 2]
        assert "bytes were left out" in capture.warnings[0]


def test_the_first_stretch_has_all_that_stands_before_the_frames(tmp_path: Path):
    """Also where attachments of megabytes stand before the interface."""
    path = tmp_path / "a.pcapng"
    large = attachment_block("large", np.random.default_rng(1).bytes(3 << 20))
    path.write_bytes(section() + large + interface() + packet(1, can(1, b"")))
    first = next(iter(iter_pcapng(path)))
    assert (list(first.attachments), len(first.frames), len(first.buses)) == (["large"], 1, 1)


def test_the_comment_of_a_packet_with_an_invalid_stamp_moves_to_the_next_frame(tmp_path: Path):
    path = tmp_path / "a.pcapng"
    notes = [struct.pack("<HH4sI", 1, 4, text, 0) for text in (b"good", b"late", b"last")]
    stamps = [1, 1 << 63, 2]
    packets = [packet(stamp, can(1, b""), options=note) for stamp, note in zip(stamps, notes, strict=True)]
    path.write_bytes(section() + interface() + b"".join(packets))
    capture = read_pcapng(path)
    assert capture.frames["t_ns"].tolist() == [1000, 2000]
    assert capture.comments == [(0, "good"), (1, "late"), (1, "last")]


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (b"", "empty"),
        (b"[rig]\nname = 1\n", "offset 0: not a pcapng file: it begins with 5b 72 69 67.*no log that is known"),
        (bytes.fromhex("d4c3b2a1") + bytes(20), "editcap -F pcapng"),
        (bytes.fromhex("1f8b0800") + bytes(20), "gzip data are damaged .*: nothing of it can be unpacked"),
        (
            bytes.fromhex("28b52ffd") + bytes(20),
            "offset 24: its zstd data end too early: nothing of it can be unpacked",
        ),
        (block(0x0A0D0D0A, struct.pack("<IHHq", 0x1A2B3C4E, 1, 0, -1)), "offset 0: .*byte-order magic"),
        (block(0x0A0D0D0A, struct.pack("<IHHq", 0x1A2B3C4D, 2, 0, -1)), "version 2"),
        (section()[:-4] + bytes(4), "ends with the length 0"),
        (block(0x0A0D0D0A, struct.pack("<I", 0x1A2B3C4D)), "section header of 16 bytes"),
        (section() + block(1, b"\xe3\0"), "offset 28: an interface block of 4 bytes"),
        (section() + packet(1, can(1, b"")), "where 0 are described"),
        (section() + interface(linktype=1) + packet(1, bytes(60)), "link type 1, expected 227"),
    ],
)
def test_garbage_is_refused(tmp_path: Path, content: bytes, text: str):
    path = tmp_path / "a.pcapng"
    path.write_bytes(content)
    with pytest.raises(PcapngError, match=text) as caught:
        read_pcapng(path)
    assert str(caught.value).startswith(f"{path}: ")


def refusal(path: Path) -> str | None:
    """What the reader says against the file.

    Any other exception than its own is the caller's failure.
    """
    try:
        read_pcapng(path)
    except PcapngError as error:
        return str(error)
    return None


@given(st.binary(min_size=1, max_size=200))
@settings(deadline=None)
def test_nothing_but_a_clear_error_comes_of_noise(noise: bytes):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.pcapng"
        path.write_bytes(section() + interface() + noise)
        said = refusal(path)
    assert said is None or "offset" in said


@given(st.data())
@settings(max_examples=60, deadline=None)
def test_any_damaged_byte_is_read_or_refused(data: st.DataObject):
    with tempfile.TemporaryDirectory() as folder:
        path = written(Path(folder) / "a.pcapng", ROWS, {2: "here"}, attachments={"rig": b"x" * 99})
        whole = bytearray(path.read_bytes())
        whole[data.draw(st.integers(0, len(whole) - 1))] ^= data.draw(st.integers(1, 255))
        path.write_bytes(whole)
        said = refusal(path)
    assert said is None or str(path) in said


def test_a_damaged_attachment_is_left_out_and_said(tmp_path: Path):
    path = written(tmp_path / "a.pcapng", ROWS, attachments={"rig.toml": b"x" * 99, "motor.eds": b"y"})
    whole = path.read_bytes()
    digest = hashlib.sha256(b"x" * 99).digest()
    packed = zlib.compress(b"x" * 99, 1)
    assert whole.count(digest) == whole.count(packed) == 1
    for damaged in (whole.replace(digest, bytes(32)), whole.replace(packed, bytes(len(packed)))):
        path.write_bytes(damaged)
        capture = read_pcapng(path)
        assert list(capture.attachments) == ["motor.eds"]
        assert as_rows(capture.frames) == ROWS
        assert len(capture.warnings) == 1
        assert "'rig.toml' is damaged" in capture.warnings[0]


# ------------------------------------------------------------------------------------------------
# full disks


def test_a_recording_is_not_overwritten_unless_asked(tmp_path: Path):
    path = tmp_path / "a.pcapng"
    with PcapngWriter(path, attachments={"a": b"first"}):
        pass
    before = path.read_bytes()
    with pytest.raises(RecordingError, match=r"a\.pcapng exists; .*--overwrite"):
        PcapngWriter(path, attachments={})
    assert path.read_bytes() == before
    with PcapngWriter(path, attachments={"a": b"second"}, force=True):
        pass
    assert read_pcapng(path).attachments == {"a": b"second"}
    (tmp_path / "link.pcapng").symlink_to(tmp_path / "nowhere")
    with pytest.raises(RecordingError, match="exists"):
        PcapngWriter(tmp_path / "link.pcapng", attachments={})


def test_attachments_that_unpack_to_gigabytes_are_left_out_and_said(tmp_path: Path):
    """60 attachments of 64 MB, 3.8 MB in the file."""
    path, zeros = tmp_path / "bomb.pcapng", bytes(64 << 20)
    with PcapngWriter(path, attachments={"small": b"kept"}) as writer:
        attachment = attachment_block("zeros", zeros)
        for n in range(60):
            os.write(writer._fd, attachment.replace(b"zeros", b"zer%02d" % n))
        writer.write(records([(0, 1, b"")]))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    capture = read_pcapng(path)
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    assert grown < 400 << 10  # KiB
    assert capture.attachments["small"] == b"kept"
    assert sum(map(len, capture.attachments.values())) <= (128 << 20) + 4 * path.stat().st_size
    (warning,) = capture.warnings
    assert "left out from here on" in warning
    assert len(capture.frames) == 1


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="no /dev/full here")
def test_a_device_that_is_full():
    with pytest.raises(RecordingError, match=r"/dev/full: .*stopped after 0 frames.*free some space"):
        PcapngWriter("/dev/full", attachments={})


@pytest.mark.parametrize("force", [False, True])
def test_a_recording_whose_head_cannot_be_written_is_not_left(tmp_path: Path, force: bool):
    path = tmp_path / "a.pcapng"
    if force:
        path.write_text("mine")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (10, hard))
    try:
        with pytest.raises(RecordingError, match="0 frames"):
            PcapngWriter(path, attachments={}, force=force)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert path.exists() is force


def test_a_folder_that_does_not_exist(tmp_path: Path):
    with pytest.raises(RecordingError, match="choose a folder that exists"):
        PcapngWriter(tmp_path / "none" / "a.pcapng", attachments={})


def test_a_limit_reached_in_the_midst_of_a_batch(tmp_path: Path):
    path = tmp_path / "a.pcapng"
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    with PcapngWriter(path, attachments={}) as writer:
        writer.write(records(ROWS))
        size = writer.bytes
        resource.setrlimit(resource.RLIMIT_FSIZE, (size + 100, hard))  # two blocks and a torn third would fit
        try:
            with pytest.raises(RecordingError, match=f"stopped after 5 frames, {size} bytes .*stays readable"):
                writer.write(records(ROWS))
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        with pytest.raises(RecordingError, match="stopped after 5 frames"):
            writer.write(records(ROWS))
    capture = read_pcapng(path)
    assert (as_rows(capture.frames), capture.torn) == (ROWS, 0)


def test_a_disk_that_is_full_and_lets_nothing_be_cut(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    real_write, left = os.write, [1000]

    def write(fd: int, data: memoryview) -> int:
        if not left[0]:
            raise OSError(errno.ENOSPC, "No space left on device")
        count = min(left[0], len(data))
        left[0] -= count
        return real_write(fd, data[:count])

    def refuse(fd: int, size: int) -> None:
        raise OSError(errno.EPERM, "Operation not permitted")

    path = tmp_path / "a.pcapng"
    monkeypatch.setattr(coulombus.recording.pcapng_writer.os, "write", write)
    monkeypatch.setattr(coulombus.recording.pcapng_writer.os, "ftruncate", refuse)
    with PcapngWriter(path, attachments={}) as writer:
        for _ in range(3):
            writer.write(records(ROWS))
        with pytest.raises(RecordingError, match="No space left"):
            writer.write(records(ROWS * 10))
    capture = read_pcapng(path)
    assert path.stat().st_size == 1000
    expected, rest = whole_blocks(path.read_bytes())
    assert expected > 10
    assert capture.torn == rest > 0
    assert as_rows(capture.frames) == (ROWS * 10)[:expected]


def test_errors_of_flush_and_close(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def refuse(fd: int) -> None:
        raise OSError(errno.EIO, "Input/output error")

    writer = PcapngWriter(tmp_path / "a.pcapng", attachments={})
    with monkeypatch.context() as patch:
        patch.setattr(coulombus.recording.pcapng_writer.os, "fsync", refuse)
        with pytest.raises(RecordingError, match=r"Input/output error.*another place"):
            writer.flush()
    writer.close()
    writer = PcapngWriter(tmp_path / "b.pcapng", attachments={})
    fd = writer._fd
    with monkeypatch.context() as patch:
        patch.setattr(coulombus.recording.pcapng_writer.os, "close", refuse)
        with pytest.raises(RecordingError):
            writer.close()
    os.close(fd)


def test_a_pipe(tmp_path: Path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    with PcapngWriter(pipe, attachments={}) as writer:
        writer.write(records(ROWS))
        writer.flush()
    (tmp_path / "a.pcapng").write_bytes(os.read(reader, 65536))
    os.close(reader)
    assert as_rows(read_pcapng(tmp_path / "a.pcapng").frames) == ROWS


# ------------------------------------------------------------------------------------------------
# other tools' files


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("padded", [True, False])
def test_both_byte_orders_and_both_captured_lengths(tmp_path: Path, order: str, padded: bool):
    path = tmp_path / "a.pcapng"
    comment = struct.pack(order + "HH", 1, 5) + b"there\0\0\0" + bytes(4)
    resolution = struct.pack(order + "HH", 9, 1) + b"\x09\0\0\0" + bytes(4)
    content = section(order) + interface(order, options=resolution)
    for i, (t_ns, can_id, data) in enumerate(ROWS):
        content += packet(t_ns, can(can_id, data, padded), order, options=comment if i == 2 else b"")
        content += block(5, bytes(12), order)  # interface statistics, of no interest
    path.write_bytes(content)
    capture = read_pcapng(path)
    assert as_rows(capture.frames) == ROWS
    assert capture.comments == [(2, "there")]


@pytest.mark.parametrize(
    ("resolution", "ticks", "t_ns"),
    [
        (None, 1_700_000_000_123_456, 1_700_000_000_123_456_000),  # microseconds, without the option
        (6, 5, 5_000),
        (3, 7, 7_000_000),
        (0, 7, 7_000_000_000),
        (12, 1_999, 1),
        (0x80 | 10, 1536, 1_500_000_000),
        (9, (1 << 63) - 1, (1 << 63) - 1),
    ],
)
def test_time_resolutions(tmp_path: Path, resolution: int | None, ticks: int, t_ns: int):
    path = tmp_path / "a.pcapng"
    options = b"" if resolution is None else struct.pack("<HHB3xI", 9, 1, resolution, 0)
    path.write_bytes(section() + interface(options=options) + packet(ticks, can(1, b"")))
    assert read_pcapng(path).frames["t_ns"].tolist() == [t_ns]


def test_stamp_offset_sections_and_interfaces(tmp_path: Path):
    path = tmp_path / "a.pcapng"
    offset = struct.pack("<HHqI", 14, 8, 1_700_000_000, 0)
    content = section() + interface() + interface(linktype=1) + interface(options=offset)
    content += packet(1, can(1, b"")) + packet(2, bytes(60), number=1) + packet(3, can(3, b""), number=2)
    content += section(">") + interface(">") + packet(4, can(4, b"\x04"), ">")
    path.write_bytes(content)
    capture = read_pcapng(path)
    assert as_rows(capture.frames) == [(1000, 1, b""), (1_700_000_000_000_003_000, 3, b""), (4000, 4, b"\x04")]
    assert capture.frames["source"].tolist() == [0, 2, 3]
    assert capture.skipped == 1


def test_what_is_no_classical_frame_is_skipped_and_counted(tmp_path: Path):
    path = tmp_path / "a.pcapng"
    content = section() + interface() + packet(1, can(0x181, b"\x01\x02", padded=False))
    content += packet(2, can(2, bytes(8), flags=0x04))  # CAN FD
    content += packet(3, can(3, bytes(12)))  # longer than a classical frame
    content += packet(4, can(4, bytes(8))[:12])  # cut by a snapshot length
    content += packet(5, b"\0\0\0\5")  # less than a head
    content += block(3, struct.pack("<I", 16) + can(6, b""))  # simple packet: it has no stamp
    content += block(0x0BAD, b"custom") + block(0x80434C42, b"another's local use")
    path.write_bytes(content)
    capture = read_pcapng(path)
    assert as_rows(capture.frames) == [(1000, 0x181, b"\x01\x02")]
    assert (capture.skipped, capture.torn, capture.attachments) == (5, 0, {})


def test_bytes_beyond_the_length_are_cleared(tmp_path: Path):
    path = tmp_path / "a.pcapng"
    path.write_bytes(section() + interface() + packet(1, can(1, b"\x01\x02")[:10] + b"\xff" * 6))
    assert read_pcapng(path).frames["word"].tolist() == [0x0201]


def run_tool(*command: str) -> str:
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    complaints = [line for line in done.stderr.splitlines() if not line.startswith("Running as user")]
    assert (done.returncode, complaints) == (0, []), done.stderr
    return done.stdout


@needs_tshark
def test_tshark_reads_it_without_a_complaint(tmp_path: Path):
    path = written(
        tmp_path / "a.pcapng", ROWS, {1: "phase hold", 4: "phase stroke, μ"},
        attachments={"rig.toml": b"[rig]\n" * 99, "version": b"0.1.0"},
        texts=SectionTexts("bench", application="coulombus 0.1.0", hardware="virtual bus"),
    )  # fmt: skip
    assert len(run_tool("tshark", "-r", str(path)).splitlines()) == len(ROWS)
    packets = json.loads(run_tool("tshark", "-r", str(path), "-T", "json"))
    for packet_, (t_ns, can_id, data) in zip(packets, ROWS, strict=True):
        layers = packet_["_source"]["layers"]
        assert layers["frame"]["frame.time_epoch"] == f"{t_ns // 10**9}.{t_ns % 10**9:09d}"
        shown = layers["can"].get("can.id", layers["can"].get("can.err"))
        if not can_id & CAN_ERR_FLAG:
            assert int(shown, 0) == can_id & 0x1FFFFFFF
            assert layers["can"]["can.flags.xtd"] == ("1" if can_id & CAN_EFF_FLAG else "0")
            assert layers.get("data", {}).get("data.data", "") == data.hex(":")
    verbose = run_tool("tshark", "-V", "-r", str(path))
    assert "phase hold" in verbose
    assert "phase stroke, μ" in verbose
    assert "Interface name: can0" in verbose
    information = run_tool("capinfos", str(path))
    for text in ("SocketCAN", "nanoseconds (9)", "coulombus 0.1.0", "virtual bus", "Linux", "bench"):
        assert text in information


STARTED_NS = 1_795_351_385_123_456_789  # 2026-11-22T12:43:05Z and a fraction


def test_the_start_stands_beside_the_stamps_which_stay_what_they_are(tmp_path: Path):
    without = written(tmp_path / "a.pcapng", ROWS)
    path = written(tmp_path / "b.pcapng", ROWS, started_ns=STARTED_NS)
    assert as_rows(read_pcapng(path).frames) == ROWS
    option = struct.pack("<HHq", 14, 8, STARTED_NS // 10**9)
    assert option in path.read_bytes()
    assert path.read_bytes().endswith(without.read_bytes()[-48 * len(ROWS) :])


def test_another_program_s_offset_counts(tmp_path: Path):
    path = written(tmp_path / "a.pcapng", ROWS[:2], started_ns=STARTED_NS, texts=SectionTexts(application="dumpcap"))
    begin_ns = STARTED_NS // 10**9 * 10**9
    assert [t_ns for t_ns, _, _ in as_rows(read_pcapng(path).frames)] == [begin_ns, begin_ns + 1_000_000]


@needs_tshark
def test_wireshark_shows_the_date_of_a_recording_in_real_time(tmp_path: Path):
    path = written(tmp_path / "a.pcapng", ROWS[:2], started_ns=STARTED_NS)
    times = run_tool("tshark", "-r", str(path), "-t", "ud", "-T", "fields", "-e", "_ws.col.Time").splitlines()
    assert times == ["2026-11-22 12:43:05.000000000", "2026-11-22 12:43:05.001000000"]


@needs_tshark
@pytest.mark.parametrize("command", [("editcap",), ("editcap", "-F", "pcapng"), ("mergecap", "-w")])
def test_files_made_by_editcap_and_mergecap(tmp_path: Path, command: tuple[str, ...]):
    path = written(tmp_path / "a.pcapng", ROWS, {1: "phase hold"})
    other = tmp_path / "b.pcapng"
    run_tool(*command, *((str(other), str(path)) if command[0] == "mergecap" else (str(path), str(other))))
    capture = read_pcapng(other)
    assert as_rows(capture.frames) == ROWS
    assert capture.comments == [(1, "phase hold")]


@needs_tshark
def test_files_made_by_text2pcap(tmp_path: Path):
    text, path = tmp_path / "a.txt", tmp_path / "a.pcapng"
    payloads = [can(0x181, b"\x01\x02", padded=False), can(0x80, b"", padded=False), can(0x282, bytes(range(8)))]
    text.write_text("".join(f"000000 {payload.hex(' ')}\n" for payload in payloads))
    done = subprocess.run(["text2pcap", "-l", "227", str(text), str(path)], capture_output=True, check=False)
    assert done.returncode == 0, done.stderr
    capture = read_pcapng(path)
    assert [(i, d) for _, i, d in as_rows(capture.frames)] == [
        (0x181, b"\x01\x02"), (0x80, b""), (0x282, bytes(range(8))),
    ]  # fmt: skip


# ------------------------------------------------------------------------------------------------
# hostile files


@pytest.mark.parametrize("part", [section(), section() + interface() + packet(1, can(1, b"")), interface()])
def test_more_sections_and_interfaces_than_a_recording_has_are_refused(tmp_path: Path, part: bytes, monkeypatch):
    path = tmp_path / "a.pcapng"
    most = 40
    monkeypatch.setattr(coulombus.recording.pcapng_reader, "MOST_DESCRIBED", most)
    path.write_bytes(section() + interface() + packet(1, can(1, b"")) + part * (most + 1))
    with pytest.raises(PcapngError, match=rf"offset \d+: more than {most} sections and interfaces.*head -c") as refused:
        read_pcapng(path)
    offset = int(re.search(r"offset (\d+)", str(refused.value))[1])
    path.write_bytes(path.read_bytes()[:offset])  # the remedy that the text names
    assert len(read_pcapng(path).frames) >= 1


def test_a_thousand_captures_in_a_row_are_read(tmp_path: Path):
    path = tmp_path / "a.pcapng"
    path.write_bytes(b"".join(section() + interface() + packet(t, can(t, b"")) for t in range(1000)))
    capture = read_pcapng(path)
    assert capture.frames["can_id"].tolist() == capture.frames["source"].tolist() == list(range(1000))
    assert capture.frames["t_ns"].tolist() == list(range(0, 1_000_000, 1000))


def test_of_many_link_types_a_line_names_the_first(tmp_path: Path):
    path = tmp_path / "a.pcapng"
    path.write_bytes(section() + b"".join(interface(linktype=kind) for kind in range(1000, 1050)))
    with pytest.raises(PcapngError, match=r"link type 1000, .*, 1009 and 40 more, expected 227"):
        read_pcapng(path)
