"""What python-can's reader of .blf logs does not look at: an object of no length, at which it would
stay for ever, and a container that is far larger than it says.
"""

from __future__ import annotations

import gzip
import struct
import zlib
from pathlib import Path
from typing import BinaryIO

__all__ = ["check"]

FILE_HEADER = struct.Struct("<4sL")
OBJECT_HEADER = struct.Struct("<4sHHLL")
CONTAINER = struct.Struct("<H6xL4x")
LOG_CONTAINER, DEFLATE = 10, 2
WHOLE_HEADER = 72
LEAST = 32
"""Bytes of an object: the two headers that each has."""
MOST = 1 << 26
"""Bytes of a container's content; writers begin a new one after 128 kB."""
PADDING = 8


def check(path: str | Path) -> None:
    """Go through the objects of a .blf file, or of a .blf.gz; what python-can refuses by itself is
    left to it.

    Raises
    ------
    ValueError
        an object is shorter than its headers, or a container is too large
    """
    with gzip.open(path) if str(path).lower().endswith(".gz") else Path(path).open("rb") as file:
        begin = file.read(FILE_HEADER.size)
        if len(begin) == FILE_HEADER.size:
            file.seek(max(FILE_HEADER.unpack(begin)[1], WHOLE_HEADER))
            _check_objects(file)


def _check_objects(file: BinaryIO | gzip.GzipFile) -> None:
    tail = b""
    while True:
        header = file.read(OBJECT_HEADER.size)
        if len(header) < OBJECT_HEADER.size:
            return
        signature, _, _, size, kind = OBJECT_HEADER.unpack(header)
        if signature != b"LOBJ":
            return
        at = file.tell() - len(header)
        if size < LEAST:
            raise ValueError(f"the object at byte {at} has {size} bytes, less than its headers")
        content = file.read(size - len(header))
        file.read(size % 4)
        if kind == LOG_CONTAINER:
            tail = _check_content(tail + _unpacked(content, at), at)


def _unpacked(content: bytes, at: int) -> bytes:
    method, _ = CONTAINER.unpack_from(content)
    data = content[CONTAINER.size :]
    if method != DEFLATE:
        return data
    packed = zlib.decompressobj()
    data = packed.decompress(data, MOST)
    if packed.unconsumed_tail:
        raise ValueError(f"the container at byte {at} has more than {MOST >> 20} MB")
    return data


def _check_content(data: bytes, at: int) -> bytes:
    """Check the objects of a container; return the end of it, which goes on in the next one."""
    place = 0
    while True:
        begin = data.find(b"LOBJ", place, place + PADDING)
        if begin < 0 or begin + OBJECT_HEADER.size > len(data):
            return data[place:]
        size = OBJECT_HEADER.unpack_from(data, begin)[3]
        if size < LEAST:
            raise ValueError(f"in the container at byte {at} an object has {size} bytes, less than its headers")
        if begin + size > len(data):
            return data[place:]
        place = begin + size
