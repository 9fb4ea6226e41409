"""A file that is written as a whole: until then it has another name, next to its final one.

A process that is killed leaves its unfinished file behind. The name identifies the machine and the
process, so that the next process that writes into the folder removes it.
"""

from __future__ import annotations

import os
import re
import zlib
from contextlib import suppress
from pathlib import Path

__all__ = ["remove_unfinished", "unfinished", "write_whole"]

MACHINE = f"{zlib.crc32(os.uname().nodename.encode(errors='surrogateescape')):08x}"
"""Identifier of this machine, or container: process ids repeat among those that share a folder."""
NAME = re.compile(rf"\..+-{MACHINE}-([0-9]+)-[0-9a-f]{{8}}(\.[^.]*)?", re.DOTALL)


def unfinished(path: Path) -> Path:
    """Return a new hidden name, with the suffix of `path`, for this process's file that becomes `path`."""
    return path.with_name(f".{path.stem}-{MACHINE}-{os.getpid()}-{os.urandom(4).hex()}{path.suffix}")


def remove_unfinished(folder: Path) -> None:
    """Remove the unfinished files of this machine's ended processes from a folder, as far as permitted."""
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            match = NAME.fullmatch(entry.name)
            if match is not None and entry.is_file(follow_symlinks=False) and _has_ended(int(match[1])):
                with suppress(OSError):
                    os.unlink(entry.path)


def _has_ended(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return True
    except OSError:  # owned by another user
        return False
    return False


def write_whole(path: Path, content: bytes, mode: int = 0o644, *, new: bool = False) -> None:
    """Write a file atomically: it is synced to disk before it is renamed.

    Raises
    ------
    FileExistsError
        the file must be `new` but exists
    OSError
        it cannot be written; an old one is unchanged
    """
    remove_unfinished(path.absolute().parent)
    beside = unfinished(path)
    try:
        with beside.open("xb") as file:
            os.fchmod(file.fileno(), mode)
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        if new:
            path.open("xb").close()
        os.replace(beside, path)
    finally:
        with suppress(OSError):
            beside.unlink()
