"""Read a user's file: a regular file of bounded size, or an immediate error.

Reading a FIFO or a terminal blocks until data are written, a device may be endless, and opening
some devices has side effects.
"""

from __future__ import annotations

import difflib
import itertools
import os
import re
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

__all__ = ["MOST_BYTES", "NoRegularFile", "mode_of", "naming", "read_regular", "require_regular"]

MOST_BYTES = 1 << 26
MOST_NAMES = 10_000
"""Largest number of names in a folder that is searched for a missing file's name."""

KINDS = (
    (stat.S_ISDIR, "a directory"),
    (stat.S_ISFIFO, "a FIFO"),
    (stat.S_ISSOCK, "a socket"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
)


class NoRegularFile(OSError):
    """The path is no regular file, or the file is too large; `strerror` says which."""


@contextmanager
def naming(path: str | Path) -> Iterator[None]:
    """Add the file's name to errors raised in the block; only open() names it, read() does not."""
    try:
        yield
    except OSError as error:
        if error.filename is None:
            error.filename = str(path)
        raise


def mode_of(path: str | Path) -> int:
    """Return the mode of the path, as in `os.stat`.

    Raises
    ------
    FileNotFoundError
        The path does not exist; `strerror` also suggests a similar name.
    OSError
        The path cannot be examined.
    """
    try:
        return os.stat(path).st_mode
    except FileNotFoundError as error:
        raise FileNotFoundError(error.errno, f"{error.strerror}{_meant(str(path))}", str(path)) from None
    except ValueError:
        raise NoRegularFile(0, "has a zero in its name", str(path)) from None


def _meant(path: str) -> str:
    """Return a suggestion for a path that does not exist, preceded by a semicolon."""
    if "\\" in path:
        drive = re.match(r"([A-Za-z]):\\", path)
        wsl = f", under WSL /mnt/{drive[1].lower()}/{path[3:]}".replace("\\", "/") if drive else ""
        return f"; it reads as a path of Windows: write / between the folders{wsl}"
    if re.search(r"[*?\[]", path):
        return "; no file fits this pattern, which the shell then hands on as it stands"
    folder, name = os.path.split(path)
    if not os.path.isdir(folder or "."):
        return f"; there is no folder {folder}"
    names: list[str] = []
    with suppress(OSError), os.scandir(folder or ".") as entries:
        names = sorted(entry.name for entry in itertools.islice(entries, MOST_NAMES))
    near = difflib.get_close_matches(name, names, 1, 0.7)
    return f"; did you mean '{os.path.join(folder, near[0])}'?" if near else ""


def require_regular(path: str | Path) -> None:
    """Raise the errors of `read_regular` for anything but a regular file; open nothing."""
    _require_regular(path, mode_of(path))


def read_regular(path: str | Path, most_bytes: int = MOST_BYTES) -> bytes:
    """Return the bytes of a regular file.

    Raises
    ------
    NoRegularFile
        The path is not a regular file (nothing was opened), or has more than `most_bytes`.
    OSError
        The file cannot be read.
    """
    require_regular(path)
    descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)  # the file may have been replaced since
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
