"""Ordinary load for the latency test: ``python -m coulombus.host.doctor.load PARENT NUMBER FOLDER``.

The process runs until it is killed. With an even number it copies memory; with an odd number it makes system
calls and writes to the disk.
"""

from __future__ import annotations

import os
import sys
import tempfile
from contextlib import suppress

from coulombus.system.realtime import die_with_parent

__all__ = ["main"]

BLOCK = 8 << 20
WRITTEN = 1 << 20
SYSTEM_CALLS = 2000


def _copy() -> None:
    block = bytearray(BLOCK)
    while True:
        block[:] = bytes(reversed(block))


def _call(folder: str) -> None:
    block = os.urandom(WRITTEN)
    reading, writing = os.pipe()
    with suppress(OSError), tempfile.TemporaryFile(dir=folder) as file:
        while True:
            file.seek(0)
            file.write(block)
            file.flush()
            os.fsync(file.fileno())
            for _ in range(SYSTEM_CALLS):
                os.write(writing, b"x")
                os.read(reading, 1)
    while True:  # the folder cannot be written
        os.write(writing, b"x")
        os.read(reading, 1)


def main(parent: int, number: int, folder: str) -> None:
    """Work until the parent ends."""
    die_with_parent(parent)
    if number % 2:
        _call(folder)
    _copy()


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), sys.argv[3])
