"""Logs of other tools that mislead their reader: one that would stay for ever, or fill the memory."""

from __future__ import annotations

import gzip
import struct
import zlib

import can
import pytest

from coulombus.recording.blf_log import LEAST, MOST, OBJECT_HEADER
from coulombus.recording.log_files import LogError, read_log

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
    frames, remarks = read_log(path)
    assert (len(frames), remarks) == (FRAMES, [])
    (tmp_path / "whole.blf.gz").write_bytes(gzip.compress(path.read_bytes()))
    assert (read_log(tmp_path / "whole.blf.gz")[0] == frames).all()


@pytest.mark.parametrize("version", [1, 9])  # the frame comes again and again; nothing comes for ever
@pytest.mark.parametrize("packed", [False, True])
def test_an_object_of_no_length_is_refused(tmp_path, version, packed):
    path = tmp_path / "stays.blf"
    data = written(path)
    second = data.index(b"LOBJ", 144 + OBJECT_HEADER.size)  # the first one in the container
    struct.pack_into("<HLL", data, second + 6, version, 0, 86)
    if packed:
        path = tmp_path / "stays.blf.gz"
    path.write_bytes(gzip.compress(data) if packed else data)
    with pytest.raises(LogError, match="in the container at byte 144 an object has 0 bytes, less than its headers"):
        read_log(path)


def test_a_container_of_no_length_is_refused(tmp_path):
    path = tmp_path / "short.blf"
    data = written(path)
    struct.pack_into("<L", data, 144 + 8, LEAST - 1)
    path.write_bytes(data)
    with pytest.raises(LogError, match=f"the object at byte 144 has {LEAST - 1} bytes"):
        read_log(path)


def test_a_container_that_fills_the_memory_is_refused(tmp_path):
    path = tmp_path / "bomb.blf"
    content = struct.pack("<H6xL4x", 2, 4096) + zlib.compress(bytes(MOST + 1))
    head = OBJECT_HEADER.pack(b"LOBJ", 16, 1, OBJECT_HEADER.size + len(content), 10)
    path.write_bytes(written(path)[:144] + head + content)
    with pytest.raises(LogError, match="the container at byte 144 has more than 64 MB"):
        read_log(path)


@pytest.mark.parametrize("stamp", ["1e10", "-1e300", "nan", "inf"])
def test_a_stamp_that_no_clock_tells_is_refused(tmp_path, stamp):
    path = tmp_path / "stamp.log"
    path.write_text(f"(1.0) can0 181#00\n({stamp}) can0 181#00\n")
    with pytest.raises(LogError, match=r"after frame 1: .*expected one before the year 2262"):
        read_log(path)
