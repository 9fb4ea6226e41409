"""Nothing of another tool's log is lost unseen: frames, and what the remarks say was left out, are
together all rows of the file, wherever it is cut and whichever row is shortened.
"""

from __future__ import annotations

import gzip
import re
import struct

import can
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from zstandard import ZstdCompressor

from coulombus.kernels.records import new_records
from coulombus.recording.export.logs import AscWriter, BlfWriter, CandumpWriter
from coulombus.recording.log_files import LogError, read_log
from coulombus.recording.logs.mf4 import ready
from coulombus.recording.reading import read
from coulombus.wire.can_flags import CAN_EFF_FLAG, CAN_ERR_FLAG, CAN_RTR_FLAG
from coulombus.wire.data_word import data_bytes, data_word
from coulombus.wire.frame import Frame

START_NS = 1_700_000_000 * 10**9
BATCH = 5  # rows that our writers get at a time
OURS = {"our.log": CandumpWriter, "our.asc": AscWriter, "our.blf": BlfWriter}
TEXTS = ("their.log", "their.asc", "their.trc", "their.csv", "our.log", "our.asc")
BINARIES = ("their.blf", "our.blf")
COUNT = re.compile(r"(\d+) (?:rows?|objects?) (?:was|were) left out")
BYTES = re.compile(r"[1-9]\d* bytes were left out")


@st.composite
def a_frame(draw):
    """Return identifier with flags, length, data: standard, extended, remote, error."""
    kind = draw(st.sampled_from(("standard", "extended", "remote", "error")))
    data = draw(st.binary(max_size=8))
    if kind == "error":
        return CAN_ERR_FLAG | draw(st.integers(1, 0x1FF)), 8, data.ljust(8, b"\0")
    if kind == "extended":
        return CAN_EFF_FLAG | draw(st.integers(0, 0x1FFFFFFF)), len(data), data
    base = draw(st.integers(0, 0x7FF))
    return (base | CAN_RTR_FLAG, len(data), b"") if kind == "remote" else (base, len(data), data)


some_frames = st.lists(a_frame(), min_size=2, max_size=4)


def without_what_trc_has_not(frames):
    """python-can's TRC writer leaves remote and error frames out."""
    return [frame for frame in frames if not frame[0] & (CAN_RTR_FLAG | CAN_ERR_FLAG)]


def written(path, frames, container=100):
    """Write a file of frames 1 ms apart; objects of .blf go on in the next container after so many bytes."""
    if path.name in OURS:
        records = new_records(Frame, len(frames))
        records[:] = [
            (k * 10**6, can_id, length, data_word(data), 0) for k, (can_id, length, data) in enumerate(frames)
        ]
        writer = OURS[path.name](path, START_NS)
        for begin in range(0, len(frames), BATCH):
            writer.add(records[begin : begin + BATCH])
        writer.close()
        return
    options = {"max_container_size": container, "compression_level": 0} if path.suffix == ".blf" else {}
    with can.Logger(path, **options) as log:
        for k, (can_id, length, data) in enumerate(frames):
            extended = bool(can_id & (CAN_EFF_FLAG | CAN_ERR_FLAG))
            log.on_message_received(
                can.Message(
                    timestamp=START_NS / 1e9 + k / 1e3,
                    arbitration_id=can_id & (0x1FFFFFFF if extended else 0x7FF),
                    is_extended_id=extended,
                    is_remote_frame=bool(can_id & CAN_RTR_FLAG),
                    is_error_frame=bool(can_id & CAN_ERR_FLAG),
                    dlc=length,
                    data=data,
                )
            )


def read_and_told(path):
    """Return the frames, how many rows were told as left out, and the remarks."""
    log = read_log(path)
    told = sum(int(match[1]) for text in log.remarks if (match := COUNT.search(text.removeprefix(str(path)))))
    return len(log.frames), told, log.remarks


def rows_of(name, content):
    """Return where the rows of a text begin and end, without the lines around them."""
    places, at = [], 0
    for line in content.splitlines(keepends=True):
        text = line.strip()
        head = {
            "asc": lambda t: not re.match(rb"\d+\.\d+ \d", t),
            "trc": lambda t: t.startswith(b";"),
            "csv": lambda t: t.startswith(b"timestamp"),
            "log": lambda t: False,
        }[name.rpartition(".")[2]]
        if not head(text):
            places.append((at + len(line) - len(line.lstrip()), at + len(line.rstrip())))
        at += len(line)
    return places


@pytest.mark.thorough
@pytest.mark.parametrize("name", TEXTS)
@settings(max_examples=4, derandomize=True, database=None, deadline=None)
@given(frames=some_frames)
def test_a_text_cut_anywhere_has_frames_and_told_rows(tmp_path_factory, name, frames):
    path = tmp_path_factory.mktemp("cut") / name
    frames = without_what_trc_has_not(frames) if name.endswith("trc") else frames
    written(path, frames)
    content = path.read_bytes() if frames else b""
    rows = rows_of(name, content)
    assert len(rows) == len(frames)
    for cut in range(1, len(content) + 1):
        path.write_bytes(content[:cut])
        count, told, remarks = read_and_told(path)
        begun = sum(begin < cut for begin, _ in rows)
        assert count + told == begun, (content[:cut], remarks)
        assert count >= sum(end < cut for _, end in rows), (content[:cut], remarks)  # whole rows are frames


@pytest.mark.thorough
@pytest.mark.parametrize("name", TEXTS)
@settings(max_examples=4, derandomize=True, database=None, deadline=None)
@given(frames=some_frames)
def test_each_row_of_a_text_may_be_shortened(tmp_path_factory, name, frames):
    path = tmp_path_factory.mktemp("short") / name
    frames = without_what_trc_has_not(frames) if name.endswith("trc") else frames
    written(path, frames)
    content = path.read_bytes() if frames else b""
    for begin, end in rows_of(name, content):
        for cut in range(begin + 1, end):
            path.write_bytes(content[:cut] + content[end:])
            try:
                count, told, remarks = read_and_told(path)
            except LogError:
                assert len(frames) == 1  # nothing of it is a frame
                continue
            assert count + told == len(frames), (content[begin:cut], remarks)


@pytest.mark.thorough
@pytest.mark.parametrize("name", BINARIES)
@settings(max_examples=4, derandomize=True, database=None, deadline=None)
@given(frames=some_frames)
def test_a_blf_file_cut_anywhere_has_frames_and_told_objects(tmp_path_factory, name, frames):
    path = tmp_path_factory.mktemp("cut") / name
    written(path, frames)
    content = path.read_bytes()
    for cut in range(1, len(content) + 1):
        path.write_bytes(content[:cut])
        count, told, remarks = read_and_told(path)
        if cut < 72:  # the header, which has the number of objects
            assert count == 0
            assert BYTES.search(remarks[0])
        else:
            assert count + told == len(frames), (cut, remarks)


@settings(max_examples=4, derandomize=True, database=None, deadline=None)
@given(frames=some_frames, missing=st.integers(1, 47))
def test_each_object_of_a_blf_file_may_be_shortened(tmp_path_factory, frames, missing):
    path = tmp_path_factory.mktemp("short") / "their.blf"
    written(path, frames, container=1 << 17)
    content = path.read_bytes()
    for match in re.finditer(b"LOBJ(?=[\x20\x28]\0)", content):
        size = int.from_bytes(content[match.start() + 8 : match.start() + 12], "little")
        end = match.start() + size
        path.write_bytes(content[: end - min(missing, size - 1)] + content[end:])
        count, told, remarks = read_and_told(path)
        assert count + told == len(frames), remarks
        assert told, remarks


def test_classical_frames_of_can_fd_controllers_are_read(tmp_path):
    path = tmp_path / "their.blf"
    written(path, [(0x181, 8, bytes(8))] * 3)
    content = bytearray(path.read_bytes())
    content[24:40] = bytes(16)
    stamp = struct.pack("<LHHQ", 2, 0, 0, 5_000_000)
    fd_64 = struct.pack("<BBBBLLLLLLLHBBL", 2, 2, 2, 0, 0x182, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0) + b"\x37\x06\0\0"
    fd = struct.pack("<HBBLLBBB5x64s", 2, 0, 2, 0x183, 0, 0, 0, 2, b"\x37\x06")
    real_fd = struct.pack("<HBBLLBBB5x64s", 2, 0, 2, 0x183, 0, 0, 1, 2, b"\x37\x06")
    error = struct.pack("<HHL", 2, 0, 0)
    marker = bytes(48)
    objects = b"".join(
        struct.pack("<4sHHLL", b"LOBJ", 32, 1, 32 + len(body), kind) + stamp + body
        for kind, body in ((101, fd_64), (100, fd), (100, real_fd), (2, error), (96, marker))
    )
    container = struct.pack("<4sHHLLH6xL4x", b"LOBJ", 16, 1, 32 + len(objects), 10, 0, len(objects)) + objects
    path.write_bytes(content + container)
    log = read_log(path)
    assert log.frames["can_id"].tolist() == [0x181] * 3 + [0x182, 0x183, CAN_ERR_FLAG | 0x80]
    assert [data_bytes(word, 2) for word in log.frames["word"][3:5]] == [b"\x37\x06"] * 2
    assert log.buses == ("1", "2")
    assert [text.removeprefix(f"{path}: ") for text in log.remarks] == [
        "1 object was left out: a CAN FD frame",
        "1 object was left out: no CAN frame (statistics, markers, other buses)",
    ]


def test_a_blf_file_whose_writer_died_tells_bytes(tmp_path):
    path = tmp_path / "their.blf"
    written(path, [(0x181, 8, bytes(8))] * 40)
    content = bytearray(path.read_bytes())
    content[16:40] = bytes(24)  # sizes and the number of objects are written at its end
    path.write_bytes(content[:-70])
    count, told, remarks = read_and_told(path)
    assert (told, len(remarks)) == (0, 1)
    assert 30 < count < 40
    assert BYTES.search(remarks[0])


@pytest.mark.parametrize("name", [*TEXTS, *BINARIES])
@settings(max_examples=10, derandomize=True, database=None, deadline=None)
@given(frames=some_frames)
def test_what_is_read_is_what_was_written(tmp_path_factory, name, frames):
    path = tmp_path_factory.mktemp("whole") / name
    frames = without_what_trc_has_not(frames) if name.endswith("trc") else frames
    if not frames:
        return
    written(path, frames)
    log = read_log(path)
    assert log.remarks == ()
    assert len(log.frames) == len(frames)
    without_class = name in ("their.log", "their.asc", "our.asc")  # which tell of an error frame that there was one
    for frame, (can_id, length, data) in zip(log.frames, frames, strict=True):
        if can_id & CAN_ERR_FLAG and without_class:
            assert frame["can_id"] & CAN_ERR_FLAG
            continue
        back = int(frame["can_id"])
        if name == "their.log" and can_id & CAN_RTR_FLAG:  # whose writer leaves the length out
            length = 0
        assert back & ~CAN_EFF_FLAG == can_id & ~CAN_EFF_FLAG
        assert (back & CAN_EFF_FLAG == can_id & CAN_EFF_FLAG) or can_id & CAN_ERR_FLAG
        assert (frame["length"], data_bytes(frame["word"], length)) == (length, data.ljust(length, b"\0"))
    steps = (log.frames["t_ns"] - log.frames["t_ns"][0]) / 1e6
    assert steps.tolist() == pytest.approx(range(len(frames)), abs=1e-3)


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_an_mf4_file_cut_anywhere_has_frames_or_told_bytes(tmp_path):
    pytest.importorskip("asammdf")
    ready()
    path = tmp_path / "their.mf4"
    frames = [(0x181, 8, bytes(8)), (0x705, 1, b"\x7f"), (CAN_ERR_FLAG | 0x40, 8, bytes(8))] * 3
    written(path, frames)
    content = path.read_bytes()
    assert read_and_told(path)[:2] == (len(frames), 0)
    for cut in [1, 7, 8, 100, *range(1000, len(content), len(content) // 9), len(content) - 1]:
        path.write_bytes(content[:cut])
        count, told, remarks = read_and_told(path)
        assert count + told == len(frames) or any(BYTES.search(text) for text in remarks), cut


@pytest.mark.parametrize("part", [0.3, 0.7, 0.99])
@pytest.mark.parametrize("pack", [gzip.compress, ZstdCompressor().compress])
def test_a_compressed_log_that_is_cut_is_read_to_there(tmp_path, part, pack):
    path = tmp_path / "their.log.gz"
    lines = "".join(f"({k}.{k * 7919 % 10**6:06}) can0 181#{k * 2654435761 % 2**32:08X}\n" for k in range(9000))
    packed = pack(lines.encode())
    path.write_bytes(packed[: int(part * len(packed))])
    log = read_log(path)
    assert 9000 * part - 5000 < len(log.frames) < 9000
    assert f"{path}: offset {path.stat().st_size}: its " in log.remarks[-1]
    assert "data end too early" in log.remarks[-1]


def test_a_file_is_refused_only_where_nothing_of_it_is_a_log(tmp_path):
    path = tmp_path / "system.log"
    path.write_text("Nov 26 10:00:00 host kernel: link is up\n")
    with pytest.raises(LogError, match=r"system.log:1: .* is no line of a log format that is known"):
        read_log(path)
    path.write_bytes(b"")
    with pytest.raises(LogError, match="the file is empty"):
        read_log(path)
    (tmp_path / "no.blf").write_bytes(bytes(200))
    with pytest.raises(LogError, match=r"does not begin as a [.]blf file does"):
        read_log(tmp_path / "no.blf")


@pytest.mark.parametrize("name", ["run.log.1", "run.txt", "run", "run.asc"])
def test_a_log_is_known_by_its_content(tmp_path, name):
    path = tmp_path / name
    path.write_text("(1700000000.000100) can0 181#3706000000000000\n")
    assert read(path, "bench")["motor.statusword"].values.tolist() == [0x0637]


CONSOLE = """  can0  080   [0]
 (1700000000.000100)  can0  181   [8]  37 06 10 00 00 00 00 00
 (2023-11-14 22:13:20.000200)  can0  181   [8]  37 06 10 00 00 00 00 00   '7.......'
  can0  RX - -  705   [1]  7F
  can0  705   [1]  remote request
  can0  20000004   [8]  00 20 00 00 00 00 7F 00   ERRORFRAME
\tcontroller-problem{tx-error-passive}
  can0  00000181   [08]  00 00 00 00 00 00 00 00
  can0  181   [8]  37 06 10
"""


def test_what_candump_prints_is_read(tmp_path):
    path = tmp_path / "console.log"
    path.write_text(CONSOLE)
    log = read_log(path)
    assert [hex(can_id) for can_id in log.frames["can_id"]] == [
        *("0x80", "0x181", "0x181", "0x705", "0x40000705", "0x20000004")
    ]
    assert (log.frames["t_ns"][1:3] - START_NS).tolist() == [100_000, 200_000]
    assert [text.removeprefix(f"{path}: ") for text in log.remarks] == [
        "1 row was left out: a CAN FD frame (the first is line 8)",
        "1 row was left out: fewer data bytes than the length says (the first is line 9)",
        "4 frames have no time stamp and got the time 0: log with time stamps (candump -L)",
    ]


ASC = """date Mon Jan 15 10:00:00.000 am 2024
base {base}  timestamps {stamps}
{events}   0,001000 1  {sync}              Rx   d 0
   0.000200 2  {tpdo}             Rx   d 2 55 16
   0.000300 1  Statistic: D 10 R 0 XD 0 XR 0 E 0 O 0 B 1.00%
   0.000400 CANFD   1 Rx        {tpdo}  Name     0 0 2  2 55 16        0   0        0        0
   0.000500 CANFD   1 Rx        {tpdo}           1 0 2  2 55 16        0   0     3000        0
   0.000600 1  ErrorFrame
   0.000700 1  {tpdo}             Rx   d 3 55 16
"""


@pytest.mark.parametrize("base", ["hex", "dec"])
@pytest.mark.parametrize("events", ["", "no internal events logged\n"])
def test_rows_of_asc_are_read_by_its_head(tmp_path, base, events):
    path = tmp_path / "their.asc"
    sync, tpdo = ("80", "181") if base == "hex" else ("128", "385")
    path.write_text(ASC.format(base=base, stamps="absolute", events=events, sync=sync, tpdo=tpdo))
    log = read_log(path)
    assert log.frames["can_id"].tolist() == [0x80, 0x181, 0x181, CAN_ERR_FLAG | 0x80]
    assert log.frames["t_ns"].tolist() == [1_000_000, 200_000, 400_000, 600_000]
    assert data_bytes(log.frames["word"][1], 2) == (b"\x55\x16" if base == "hex" else bytes([55, 16]))
    assert (log.buses, log.frames["source"].tolist()) == (("1", "2"), [0, 1, 0, 0])
    assert [int(match[1]) for text in log.remarks if (match := COUNT.search(text))] == [1, 1, 1]
    assert "1 stamp goes back: that of frame 2" in log.remarks[-1]


def test_relative_stamps_of_asc_are_added_up(tmp_path):
    path = tmp_path / "their.asc"
    path.write_text(ASC.format(base="hex", stamps="relative", events="", sync="80", tpdo="181"))
    assert (read_log(path).frames["t_ns"] / 1000).tolist() == [1000, 1200, 1900, 3000]


TRC = {
    "1.0": "     1)    1000      0080  0 \n     2)    1001      0181  2  37 06\n     3)    1002  FFFFFFFF  4  00 00 00 08 \n",
    "1.1": "1) 1000,0 Rx 0080 0\n2) 1001.0 Tx 0181 2 37 06\n3) 1002.0 Warng FFFFFFFF 4 00 00 00 08 BUSHEAVY\n",
    "1.3": "1) 1000.0 1 Rx 0080 - 0\n2) 1001.0 2 Rx 0181 - 2 37 06\n3) 1002.0 1 Warng FFFFFFFF - 4 00 00 00 08\n",
    "2.0": "1 1000.0 DT 0080 Rx 0\n2 1001.0 DT 0181 Rx 2 37 06\n3 1002.0 ST Rx 00 00 00 08\n",
    "2.1": "1 1000.0 DT 1 0080 Rx - 0\n2 1001.0 DT 2 0181 Rx - 2 37 06\n3 1002.0 EV User-defined event\n",
}
COLUMNS = {"2.0": ";$COLUMNS=N,O,T,I,d,l,D\n", "2.1": ";$COLUMNS=N,O,T,B,I,d,R,L,D\n"}


@pytest.mark.parametrize("version", TRC)
def test_each_version_of_trc_is_read(tmp_path, version):
    path = tmp_path / "their.trc"
    path.write_text(f";$FILEVERSION={version}\n{COLUMNS.get(version, '')};\n{TRC[version]}")
    log = read_log(path)
    assert log.frames["can_id"].tolist() == [0x80, 0x181]
    assert log.frames["t_ns"].tolist() == [10**9, 1_001_000_000]
    assert log.buses == (("1", "2") if version in ("1.3", "2.1") else ("",))
    assert [int(COUNT.search(text)[1]) for text in log.remarks] == [1]


def test_remote_and_error_rows_of_trc_are_frames(tmp_path):
    path = tmp_path / "their.trc"
    path.write_text(";$FILEVERSION=1.1\n1) 1.0 Rx 0705 1 RTR\n2) 1.9 Error 0008 4 00 19 08 08\n3) 2.0 Rx 00000181 0\n")
    assert read_log(path).frames["can_id"].tolist() == [0x705 | CAN_RTR_FLAG, CAN_ERR_FLAG | 0x80, CAN_EFF_FLAG | 0x181]
