"""Write user-named files without overwriting existing ones, unless forced.

`check` fails early; `open_new` and `new_file` enforce it at the instant of writing, against races
with other processes. Named pipes and character devices (/dev/null, /dev/stdout) are always
writable.
"""

from __future__ import annotations

import os
import shutil
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from coulombus.eds.regular_file import naming
from coulombus.system.unfinished_file import remove_unfinished, unfinished

__all__ = ["check", "is_stream", "named_after", "new_file", "open_new", "reason_against"]

FORCE = "choose another name, or replace it with --overwrite (in Python: force=True)"


def named_after(recording: Path, suffix: str) -> Path:
    """Return the default name of an output: that of the recording with another ending; for a folder its name and it."""
    if recording.is_dir():
        return Path(f"{recording}{suffix}")
    packed = recording.suffix.lower() in (".gz", ".zst") and len(recording.suffixes) > 1
    return (recording.with_suffix("") if packed else recording).with_suffix(suffix)


def is_stream(path: Path) -> bool:
    """Return whether the path is a named pipe or a character device."""
    try:
        mode = path.stat().st_mode
    except OSError:
        return False
    return stat.S_ISFIFO(mode) or stat.S_ISCHR(mode)


def reason_against(path: Path, *, force: bool, remedy: str = FORCE) -> str | None:
    """Return the reason why the file cannot be written, or None."""
    if is_stream(path):
        return None if os.access(path, os.W_OK) else f"{path} cannot be written"
    parent = path.absolute().parent
    if not parent.is_dir():
        return f"{path}: there is no directory {parent}"
    if os.path.lexists(path):
        if path.exists() and not path.is_file():
            return f"{path} is a directory or a device; expected a file"
        if not force:
            return f"{path} exists; {remedy}"
    place = path if path.exists() else parent
    return None if os.access(place, os.W_OK) else f"{path}: {place} cannot be written"


def check(path: Path, *, force: bool) -> None:
    """Raise FileExistsError for an existing file that must not be overwritten."""
    if os.path.lexists(path) and not force and not is_stream(path):
        raise FileExistsError(17, f"exists; {FORCE}", str(path))


def open_new(path: Path, *, force: bool) -> int:
    """Open the file for writing and return its descriptor.

    Raises
    ------
    FileExistsError
        It exists, and `force` was not given.
    OSError
    """
    if is_stream(path):
        return os.open(path, os.O_WRONLY | os.O_CLOEXEC)
    if not force:
        try:
            return os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
        except FileExistsError:
            raise FileExistsError(17, f"exists; {FORCE}", str(path)) from None
    return os.open(path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o666)


@contextmanager
def new_file(path: Path, *, force: bool) -> Iterator[Path]:
    """Yield a temporary name for writing the file.

    At the end of the block the file is renamed atomically. Unfinished files of killed processes in
    its folder are removed.

    Raises
    ------
    FileExistsError
        It was created meanwhile, and `force` was not given.
    OSError
    """
    check(path, force=force)
    if is_stream(path):
        with naming(path):
            yield path
        return
    remove_unfinished(path.absolute().parent)
    beside = unfinished(path)
    try:
        try:
            yield beside
        except OSError as error:
            if error.filename is None or str(error.filename) == str(beside):
                error.filename = str(path)
            raise
        if not beside.exists():
            return
        if force:
            os.replace(beside, path)
            return
        try:
            os.link(beside, path)
        except FileExistsError:
            raise FileExistsError(17, f"exists; {FORCE}", str(path)) from None
        except OSError:  # a file system without hard links
            with beside.open("rb") as whole, os.fdopen(open_new(path, force=False), "wb") as file:
                shutil.copyfileobj(whole, file)
    finally:
        with suppress(OSError):
            beside.unlink()
