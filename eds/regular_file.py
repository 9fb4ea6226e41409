"""Reading a file that a user names: a regular file of a bounded size, or a reason at once.

A FIFO or a terminal has no end until somebody writes to it, a device
may have none at all, and opening some devices does something.
"""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

__all__ = ["MOST_BYTES", "NoRegularFile", "naming", "read_regular", "require_regular"]

MOST_BYTES = 1 << 26

KINDS = (
    (stat.S_ISDIR, "a directory"),
    (stat.S_ISFIFO, "a FIFO"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


class NoRegularFile(OSError):
    """The path is no regular file, or a larger one than is read; `strerror` says which."""


@contextmanager
def naming(path: str | Path) -> Iterator[None]:
    """Let an error of a file that is read inside tell which one;
    reading names none, only opening does.
    """
    try:
        yield
    except OSError as error:
        if error.filename is None:
            error.filename = str(path)
        raise


def require_regular(path: str | Path) -> None:
    """Raise what `read_regular` raises of anything but a regular file; open nothing."""
    try:
        mode = os.stat(path).st_mode
    except ValueError:
        raise NoRegularFile(0, "has a zero in its name", str(path)) from None
    _require_regular(path, mode)


def read_regular(path: str | Path, most_bytes: int = MOST_BYTES) -> bytes:
    """Return the bytes of a regular file.

    Raises
    ------
    NoRegularFile
        It is something else (nothing was opened), or has more than `most_bytes`.
    OSError
        It cannot be read.
    """
    require_regular(path)
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)  # the file may have changed since
    with open(descriptor, "rb") as file:
        _require_regular(path, os.fstat(descriptor).st_mode)
        with naming(path):
            raw = file.read(most_bytes + 1)
    if len(raw) > most_bytes:
        raise NoRegularFile(0, f"has more than {most_bytes >> 20} MiB", str(path))
    return raw


def _require_regular(path: str | Path, mode: int) -> None:
    if not stat.S_ISREG(mode):
        kind = next((name for test, name in KINDS if test(mode)), "no regular file")
        raise NoRegularFile(0, f"is {kind}, not a regular file", str(path))
