"""Logs of other tools that mislead their reader: one that would stay for ever, or fill the memory."""

from __future__ import annotations

import gzip
import struct
import zlib

import can
import pytest

from coulombus.recording.log_files import LogError, read_log
from coulombus.recording.logs.blf import BASE, LEAST, MOST
from coulombus.wire.can_flags import CAN_ERR_FLAG

FRAMES = 300  # more than a container of 4 kB


def written(path, level=0):
    with can.BLFWriter(path, compression_level=level, max_container_size=4096) as writer:
        for k in range(FRAMES):
            writer.on_message_received(can.Message(1.0 + k, 0x181, is_extended_id=False, data=[k % 256] * (k % 9)))
    return bytearray(path.read_bytes())


@pytest.mark.parametrize("level", [0, 9])
def test_a_whole_file_is_read_as_before(tmp_path, level):
    path = tmp_path / "whole.blf"
    written(path, level)
    log = read_log(path)
    assert (len(log.frames), log.remarks) == (FRAMES, ())
    assert log.frames["t_ns"].tolist() == [k * 10**9 for k in range(FRAMES)]
    (tmp_path / "whole.blf.gz").write_bytes(gzip.compress(path.read_bytes()))
    assert (read_log(tmp_path / "whole.blf.gz").frames == log.frames).all()


@pytest.mark.parametrize("version", [1, 9])  # python-can would give the frame again and again, or nothing for ever
@pytest.mark.parametrize("packed", [False, True])
def test_an_object_of_no_length_is_left_out_alone(tmp_path, version, packed):
    path = tmp_path / "stays.blf"
    data = written(path)
    second = data.index(b"LOBJ", 144 + BASE.size)  # the first one in the container
    struct.pack_into("<HLL", data, second + 6, version, 0, 86)
    if packed:
        path = tmp_path / "stays.blf.gz"
    path.write_bytes(gzip.compress(data) if packed else data)
    log = read_log(path)
    assert len(log.frames) == FRAMES - 1
    assert [text.removeprefix(f"{path}: ") for text in log.remarks] == [
        "1 object was left out: shorter than its kind, or of an unknown form"
    ]


def test_a_container_of_no_length_ends_the_file(tmp_path):
    path = tmp_path / "short.blf"
    data = written(path)
    struct.pack_into("<L", data, 144 + 8, LEAST - 1)
    path.write_bytes(data)
    log = read_log(path)
    assert len(log.frames) == 0
    assert f"{FRAMES} objects were left out" in log.remarks[0]


def test_a_container_that_fills_the_memory_is_refused(tmp_path):
    path = tmp_path / "bomb.blf"
    content = struct.pack("<H6xL4x", 2, 4096) + zlib.compress(bytes(MOST + 1))
    head = BASE.pack(b"LOBJ", 16, 1, BASE.size + len(content), 10)
    path.write_bytes(written(path)[:144] + head + content)
    with pytest.raises(LogError, match="the container at byte 144 has more than 64 MB"):
        read_log(path)


@pytest.mark.parametrize("stamp", ["1e10", "-1e300", "nan", "inf", "9" * 40, ""])
def test_a_row_whose_stamp_no_clock_tells_is_left_out(tmp_path, stamp):
    path = tmp_path / "stamp.log"
    path.write_text(f"(1.0) can0 181#00\n({stamp}) can0 181#00\n")
    log = read_log(path)
    assert len(log.frames) == 1
    assert log.remarks == (f"{path}: 1 row was left out: no frame of this format (the first is line 2)",)


def test_error_frames_of_a_blf_are_read_on_their_bus(tmp_path):
    path = tmp_path / "errors.blf"
    with can.BLFWriter(path) as writer:
        writer.on_message_received(can.Message(1.0, 0x181, is_extended_id=False, data=[1]))
        writer.on_message_received(can.Message(2.0, 0x4, is_error_frame=True, dlc=8, data=range(8), channel=1))
    old = struct.pack("<HHL", 2, 0, 0)  # CAN_ERROR: the channel alone
    stamp = struct.pack("<LHHQ", 1, 0, 0, 300_000)
    path.write_bytes(path.read_bytes() + BASE.pack(b"LOBJ", 32, 1, 32 + len(old), 2) + stamp + old)
    log = read_log(path)
    rows = [(int(f["t_ns"]) // 10**9, int(f["can_id"]), int(f["length"])) for f in log.frames]
    assert rows == [(0, 0x181, 1), (1, CAN_ERR_FLAG | 0x4, 8), (3, CAN_ERR_FLAG | 0x80, 0)]
    assert log.frames["word"].tolist()[1] == int.from_bytes(range(8), "little")
    assert [log.buses[source] for source in log.frames["source"]] == ["1", "2", "2"]
    assert log.remarks == ()
